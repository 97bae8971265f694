"""An archive is opened by the length of its index, wherever that is stated."""

from __future__ import annotations

import io
import struct
import zipfile

import pytest

from telewide.archives import MOST_INDEX_BYTES, open_archive


def archive(*, n_entries: int, comment: bytes = b"") -> bytes:
    """An archive of empty files with names of 100 letters."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as made:
        for number in range(n_entries):
            made.writestr(f"{number:0100d}", b"")
        made.comment = comment
    return stream.getvalue()


@pytest.mark.parametrize("comment", [b"", b"a comment", b"\0" * 60_000])
def test_an_index_that_is_not_too_long_is_read(comment: bytes) -> None:
    with open_archive(io.BytesIO(archive(n_entries=300, comment=comment))) as opened:
        assert len(opened.infolist()) == 300


@pytest.mark.parametrize("comment", [b"", b"a comment"])
@pytest.mark.parametrize("is_of_64_bits", [False, True])
def test_an_index_that_is_too_long_is_not_read(comment: bytes, *, is_of_64_bits: bool) -> None:
    stated, place = MOST_INDEX_BYTES + 1, len(archive(n_entries=3, comment=comment)) - 22 - len(comment)
    data = archive(n_entries=3, comment=comment)
    if is_of_64_bits:
        record = struct.pack("<4sQ2H2I4Q", b"PK\6\6", 44, 45, 45, 0, 0, 3, 3, stated, 0)
        data = data[:place] + record + struct.pack("<4sIQI", b"PK\6\7", 0, place, 1) + data[place:]
    else:
        data = data[: place + 12] + struct.pack("<I", stated) + data[place + 16 :]
    with pytest.raises(ValueError, match="1048577 bytes of names"):
        open_archive(io.BytesIO(data))


@pytest.mark.parametrize("data", [b"", b"PK", b"PK\5\6", b"PK\5\6" + bytes(17), bytes(100_000), b"PK\5\6" * 20])
def test_what_is_no_archive_is_said_by_its_reader(data: bytes) -> None:
    with pytest.raises((zipfile.BadZipFile, ValueError)):
        open_archive(io.BytesIO(data))


def test_a_length_stated_in_32_bits_alone_counts() -> None:
    data = bytearray(archive(n_entries=3))
    struct.pack_into("<I", data, len(data) - 22 + 12, 0xFFFFFFFF)
    with pytest.raises(ValueError, match="4294967295 bytes of names"):
        open_archive(io.BytesIO(data))
