"""Files that ``torch.save`` wrote, looked at before torch reads them.

``weights_only=True`` runs nothing, but a few bytes of pickle can name a tuple inside of a tuple forty times over: to
tell what is in it, or to take it for a key, would last for ever; of one in a million others it would end Python itself.
Networks name hardly any tuple twice.
"""

from __future__ import annotations

import io
import pickletools
from pathlib import Path

from telewide.archives import open_archive
from telewide.files import open_regular

MOST_PICKLE_BYTES = 1 << 22
"""Of names, sizes and numbers; the largest network's take a twentieth."""
MOST_TUPLES, MOST_SHARED_TUPLES = 1 << 15, 16
_PICKLE_NAME = "data.pkl"


def check_archive(path: Path) -> None:
    """Refuse an archive that holds more than its own length, or what could not be read through.

    Args:
        path: the file.

    Raises:
        UsageError: there is no such file.
        InputError: it is no regular file.
        ValueError: it is packed, holds one piece under many names, or a pickle that no network has.
        zipfile.BadZipFile: it is no archive.
    """
    with open_regular(path) as stream, open_archive(stream) as archive:
        entries = archive.infolist()
        n_bytes = sum(entry.file_size for entry in entries)
        if n_bytes > path.stat().st_size:
            raise ValueError(f"it claims to hold {n_bytes} bytes")
        for entry in entries:
            if entry.filename.endswith(_PICKLE_NAME):
                if entry.file_size > MOST_PICKLE_BYTES:
                    raise ValueError(f"a pickle of {entry.file_size} bytes")
                check_pickle(archive.read(entry))


def check_pickle(data: bytes) -> None:
    """Refuse a pickle of endless tuples, each of which may hold others.

    Args:
        data: one pickle.

    Raises:
        ValueError: it makes more than `MOST_TUPLES`, or names more than `MOST_SHARED_TUPLES` again; or is no pickle.
    """
    n_tuples = n_shared = 0
    of_tuples: set[object] = set()
    is_tuple = False  # what was put on the stack last
    for opcode, argument, _ in pickletools.genops(io.BytesIO(data)):
        if opcode.name.endswith("PUT"):
            (of_tuples.add if is_tuple else of_tuples.discard)(argument)
        elif opcode.name.endswith("GET"):
            is_tuple = argument in of_tuples
            n_shared += is_tuple
        else:
            is_tuple = "TUPLE" in opcode.name
            n_tuples += is_tuple
    if n_tuples > MOST_TUPLES or n_shared > MOST_SHARED_TUPLES:
        raise ValueError(f"{n_tuples} tuples, {n_shared} of them named again")
