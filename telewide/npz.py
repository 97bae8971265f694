"""A safe reader of ``.npz`` and ``.npy`` files: a small one may claim arrays of many gigabytes."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from telewide.archives import open_archive
from telewide.errors import InputError, TelewideError
from telewide.files import open_regular, read_regular

MOST_BYTES = 1 << 30
"""Of all arrays that are read together: 12 maps of a photo that is read whole."""
_PIECE_BYTES = 1 << 24


def read_npz(path: Path, names: Sequence[str], *, most_bytes: int = MOST_BYTES) -> tuple[NDArray[np.generic], ...]:
    """Read arrays of numbers; what they claim to hold is checked before any is.

    Args:
        path: the file.
        names: of the arrays.
        most_bytes: of all of them together.

    Returns:
        The arrays in the order of the names.

    Raises:
        UsageError: there is no such file.
        InputError: it is corrupt, lacks one of them, holds objects, or claims more than it may.
    """
    try:
        with open_regular(path) as stream, open_archive(stream) as archive:
            entries = [archive.getinfo(f"{name}.npy") for name in names]
            claimed = sum(entry.file_size for entry in entries)
            if claimed > most_bytes:
                raise ValueError(f"it claims to hold {claimed} bytes; at most {most_bytes} were expected")
            return tuple(_read_array(archive.open(entry), entry.file_size) for entry in entries)
    except (TelewideError, MemoryError):
        raise
    except Exception as error:  # numpy and zipfile fail on corrupt files in a dozen ways
        raise InputError(f"{path} is corrupt: {error}") from error


def names_in_npz(path: Path) -> frozenset[str]:
    """Names of the arrays that an ``.npz`` holds, unread.

    Args:
        path: the file.

    Raises:
        UsageError: there is no such file.
        InputError: it is corrupt.
    """
    try:
        with open_regular(path) as stream, open_archive(stream) as archive:
            return frozenset(name.removesuffix(".npy") for name in archive.namelist())
    except (TelewideError, MemoryError):
        raise
    except Exception as error:  # zipfile fails on corrupt files in several ways
        raise InputError(f"{path} is corrupt: {error}") from error


def read_npy(path: Path, *, most_bytes: int = MOST_BYTES) -> NDArray[np.generic]:
    """Read the array of an ``.npy`` file as :func:`read_npz` reads those of an ``.npz``.

    Args:
        path: the file.
        most_bytes: of the file.

    Returns:
        The array.

    Raises:
        UsageError: there is no such file.
        InputError: it is corrupt, holds objects, or is larger than it may be.
    """
    data = read_regular(path, most_bytes=most_bytes)
    try:
        return _read_array(io.BytesIO(data), len(data))
    except MemoryError:
        raise
    except Exception as error:  # numpy fails on corrupt files in a dozen ways
        raise InputError(f"{path} is corrupt: {error}") from error


def _read_array(stream: IO[bytes], n_bytes: int) -> NDArray[np.generic]:
    with stream:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):  # later ones may have headers of gigabytes
            raise ValueError(f"an array of version {version}")
        shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        expected = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or min(shape, default=1) < 0 or expected > n_bytes:
            raise ValueError(f"an array of {shape} {dtype} in {n_bytes} bytes")
        flat = np.empty(math.prod(shape), dtype)
        _fill(flat.view(np.uint8).data, stream)
    return flat.reshape(shape, order="F" if is_fortran else "C")


def _fill(data: memoryview, stream: IO[bytes]) -> None:
    """Read piece by piece into the array itself, so that there is one copy of it."""
    at = 0
    while at < len(data):
        piece = stream.read(min(_PIECE_BYTES, len(data) - at))
        if not piece:
            raise ValueError(f"it ends after {at} of {len(data)} bytes")
        data[at : at + len(piece)] = piece
        at += len(piece)
