"""Tags are read as tifffile and Pillow read them; what a few bytes claim to hold costs neither time nor memory."""

from __future__ import annotations

import io
import resource
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import tifffile
from capture.dng import write_dng

from telewide.capture.exif import read_photo_facts
from telewide.capture.images import read_image
from telewide.capture.tiff_tags import MOST_VALUES, check_directories, read_tags
from telewide.errors import InputError

SHORT, LONG, FRACTION, BYTES = 3, 4, 5, 7
GREY = ((256, LONG, 1, 64), (257, LONG, 1, 48), (258, SHORT, 1, 8), (259, SHORT, 1, 1), (277, SHORT, 1, 1))
PLAIN = (*GREY, (262, SHORT, 1, 1), (278, LONG, 1, 48), (279, LONG, 1, 64 * 48))
PLACE = 273  # of the pixels
Entry = tuple[int, int, int, int]


@contextmanager
def bounded(*, seconds: float = 10, megabytes: float = 150) -> Iterator[None]:
    begun_s, before_kb = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert time.process_time() - begun_s < seconds
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < megabytes * 1024


def tiff(entries: tuple[Entry, ...], *, has_pixels: bool = True) -> bytes:
    """A directory, and 64 x 48 grey pixels behind it; what does not fit into an entry lies at its value."""
    at = 8 + 2 + 12 * (len(entries) + has_pixels) + 4
    own = (*entries, *(((PLACE, LONG, 1, at),) if has_pixels else ()))
    packed = [struct.pack("<HHII", *entry) for entry in sorted(own)]
    return struct.pack("<2sHIH", b"II", 42, 8, len(own)) + b"".join(packed) + bytes(4) + bytes(range(64)) * 48


def with_exif(path: Path, *, is_big: bool = False) -> None:
    """A text and a number by tifffile; in a directory below, by hand, a date, a fraction and a number."""
    own = [(271, "s", 0, "Maker", True), (274, "H", 1, 6, True), (65000, "Q" if is_big else "I", 1, 0xABCDEF, True)]
    tifffile.imwrite(path, np.zeros((48, 64), np.uint8), extratags=own, bigtiff=is_big)
    data = path.read_bytes().replace(struct.pack("<H", 65000), struct.pack("<H", 34665))  # which it does not write
    data += bytes(len(data) % 2)
    place = len(data)
    data = data.replace(struct.pack("<I", 0xABCDEF), struct.pack("<I", place))
    number, head, size = ("Q", "HHQ", 20) if is_big else ("I", "HHI", 12)
    behind = place + struct.calcsize("<" + ("Q" if is_big else "H")) + 3 * size + struct.calcsize("<" + number)
    date = b"2024:05:06 07:08:09\0"
    entries = [(36867, 2, len(date), behind), (37386, FRACTION, 1, behind + len(date)), (41989, SHORT, 1, 77)]
    if is_big:
        entries[1] = (37386, FRACTION, 1, 627 | 100 << 32)  # fits into its entry
    packed = b"".join(struct.pack(f"<{head}{number}", *entry) for entry in entries)
    count = struct.pack("<Q" if is_big else "<H", 3)
    path.write_bytes(data + count + packed + struct.pack("<" + number, 0) + date + struct.pack("<II", 627, 100))


@pytest.mark.parametrize("is_big", [False, True])
def test_values_are_those_that_were_written(tmp_path: Path, *, is_big: bool) -> None:
    path = tmp_path / "a.tif"
    with_exif(path, is_big=is_big)
    wanted = {271, 274, 36867, 37386, 41989}
    with path.open("rb") as stream:
        tags = read_tags(stream, wanted)
    assert tags == {271: b"Maker\0", 274: 6, 36867: b"2024:05:06 07:08:09\0", 37386: (627, 100), 41989: 77}
    with tifffile.TiffFile(path) as oracle:
        theirs = oracle.pages.first.tags[34665].value
    assert (theirs["DateTimeOriginal"], theirs["FocalLength"]) == ("2024:05:06 07:08:09", (627, 100))
    facts = read_photo_facts(path)
    assert (facts.make, facts.orientation, facts.focal_length_mm, facts.f35_mm) == ("Maker", 6, 6.27, 77)
    assert facts.hw == (64, 48)


@pytest.mark.parametrize("order", ["<", ">"])
def test_every_type_is_read_as_tifffile_reads_it(tmp_path: Path, order: str) -> None:
    path = tmp_path / "a.tif"
    extra = [(65001, "H", 2, (7, 65535), True), (65002, "I", 2, (7, 1 << 31), True)]
    extra += [(65003, "h", 2, (-7, 7), True), (65004, "i", 1, -9, True), (65005, "d", 2, (0.5, -1e300), True)]
    extra += [(65006, "f", 1, 0.25, True), (65007, "2I", 1, (6, 7), True), (65008, "s", 0, "text", True)]
    tifffile.imwrite(path, np.zeros((8, 8), np.uint8), byteorder=order, extratags=extra)
    numbers = {entry[0] for entry in extra}
    with path.open("rb") as stream:
        tags = read_tags(stream, numbers)
    with tifffile.TiffFile(path) as oracle:
        theirs = {tag.code: tag.value for tag in oracle.pages.first.tags if tag.code in numbers}
    assert theirs.keys() == tags.keys()
    for number, value in tags.items():
        mine = value.rstrip(b"\0").decode() if isinstance(value, bytes) else value
        assert tuple(np.ravel(mine)) == tuple(np.ravel(theirs[number])), number


@pytest.mark.parametrize("suffix", [".tif", ".dng", ".nef"])
def test_thousands_of_long_tags_in_one_place_cost_nothing(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    many = tuple((10_000 + number, SHORT, 1_000_000, 4000) for number in range(3000))
    path.write_bytes(tiff((*PLAIN, (271, 2, 1_900_000, 4000), *many)) + bytes(2_000_000))
    with bounded():
        assert read_photo_facts(path).make is None
        if suffix == ".tif":
            assert read_image(path).shape == (48, 64, 3)


@pytest.mark.parametrize("tag", [PLACE, 279, 330, 34665, 10_000])
def test_a_tag_of_more_numbers_than_a_photo_needs_is_refused(tmp_path: Path, tag: int) -> None:
    path = tmp_path / "a.tif"
    entries = tuple(entry for entry in PLAIN if entry[0] != tag)
    numbers = (tag, LONG, MOST_VALUES + 1, 4000)
    path.write_bytes(tiff((*entries, numbers), has_pixels=tag != PLACE) + bytes(4 * MOST_VALUES + 4000))
    with bounded(), pytest.raises(InputError, match=f"its tag {tag} states 1048577 values"):
        read_image(path)
    assert read_photo_facts(path).hw is None


def test_directories_below_others_are_looked_at_too() -> None:
    below = tiff(((256, LONG, MOST_VALUES + 1, 4000),), has_pixels=False)
    first = tiff((*PLAIN, (330, LONG, 1, 0)))
    place = len(first)
    data = first.replace(struct.pack("<HHII", 330, LONG, 1, 0), struct.pack("<HHII", 330, LONG, 1, place)) + below[8:]
    with pytest.raises(ValueError, match="its tag 256 states"):
        check_directories(io.BytesIO(data))


def test_what_is_cut_off_anywhere_ends_in_no_error(tmp_path: Path) -> None:
    with_exif(tmp_path / "a.tif")
    data = (tmp_path / "a.tif").read_bytes()
    for length in range(min(len(data), 400)):
        read_tags(io.BytesIO(data[:length]), {271, 36867, 37386})
        check_directories(io.BytesIO(data[:length]))


@pytest.mark.parametrize(("kind", "count"), [(LONG, 2), (LONG, 5000), (FRACTION, 3), (BYTES, 0)])
def test_an_opcode_list_of_any_type_and_length_ends_nothing(tmp_path: Path, kind: int, count: int) -> None:
    path = write_dng(tmp_path / "a.dng", np.full((48, 64), 0.25, np.float32), opcodes={3: bytes(8)})
    with tifffile.TiffFile(path) as opened:
        offset = opened.pages.first.tags[51022].offset
    data = bytearray(path.read_bytes())
    struct.pack_into("<HII", data, offset + 2, kind, count, len(data))
    path.write_bytes(data + bytes(8 * count))
    assert read_image(path).shape == (48, 64, 3)
