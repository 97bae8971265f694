"""What an ``.npz`` claims to hold is checked before it is read; what numpy wrote comes back."""

from __future__ import annotations

import io
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest

from telewide.errors import InputError, UsageError
from telewide.npz import read_npz


def with_header(path: Path, header: str, *, n_bytes: int = 64) -> Path:
    """An archive of one array ``a`` of which only the header is free to choose."""
    stream = io.BytesIO()
    text = header.encode().ljust(118) + b"\n"
    stream.write(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(n_bytes))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", stream.getvalue())
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_come_back(tmp_path: Path, rng: np.random.Generator, save: object) -> None:
    first, second = rng.normal(size=(5, 7)).astype(np.float32), np.asfortranarray(rng.integers(0, 9, (3, 2)))
    save(tmp_path / "x.npz", first=first, second=second, third=np.float64(3))  # type: ignore[operator]
    again = read_npz(tmp_path / "x.npz", ("second", "first", "third"))
    for array, expected in zip(again, (second, first, np.float64(3)), strict=True):
        np.testing.assert_array_equal(array, expected)
        assert array.dtype == expected.dtype


def test_a_small_file_that_claims_much_is_refused(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "x.npz", a=np.zeros(1 << 22, np.float32))
    assert (tmp_path / "x.npz").stat().st_size < 1 << 15
    with pytest.raises(InputError, match="claims to hold 16777344 bytes"):
        read_npz(tmp_path / "x.npz", ("a",), most_bytes=1 << 20)


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000, 100000), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 4), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (2,), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': ('a',), }",
        "{'descr': 'nothing', 'fortran_order': False, 'shape': (2,), }",
        "__import__('os').system('true')",
        "{" * 50,
    ],
)
def test_a_header_that_cannot_be_believed_is_refused(tmp_path: Path, header: str) -> None:
    with pytest.raises(InputError, match=r"x\.npz is corrupt"):
        read_npz(with_header(tmp_path / "x.npz", header), ("a",))


@pytest.mark.parametrize("content", [b"", b"garbage" * 100, b"PK\x03\x04" + bytes(100), b"PK\x05\x06" + bytes(18)])
def test_garbage_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"x\.npz is corrupt"):
        read_npz(tmp_path / "x.npz", ("a",))


def test_an_array_that_is_missing_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "x.npz", a=np.zeros(2))
    with pytest.raises(InputError, match=r"b\.npy"):
        read_npz(tmp_path / "x.npz", ("b",))
    with pytest.raises(UsageError, match="does not exist"):
        read_npz(tmp_path / "y.npz", ("a",))


def test_an_array_is_in_memory_once(tmp_path: Path) -> None:
    """A small file may hold a gigabyte of zeros: twice as much would be more than it may ask for."""
    np.savez_compressed(tmp_path / "x.npz", a=np.zeros(1 << 25, np.float32))
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    (array,) = read_npz(tmp_path / "x.npz", ("a",))
    grown_bytes = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb)
    assert array.nbytes == 1 << 27
    assert grown_bytes < 1.5 * array.nbytes


@pytest.mark.parametrize("version", [(2, 0), (3, 0)])
def test_a_header_that_may_be_of_gigabytes_is_not_read(tmp_path: Path, version: tuple[int, int]) -> None:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.zeros(3), version=version)
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("a.npy", stream.getvalue())
    with pytest.raises(InputError, match="an array of version"):
        read_npz(tmp_path / "x.npz", ("a",))
