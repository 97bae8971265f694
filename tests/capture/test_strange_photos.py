"""Photos that strangers hand over: sizes beyond belief, directories without end, corrections no camera asks for.

Each is refused, or read without what is wrong with it, before it costs time or memory.
"""

from __future__ import annotations

import os
import resource
import struct
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from capture.dng import gain_map, opcode_list, warp, write_dng
from capture.strange_bytes import looped_tiff, overwrite_tag, png_of_size, progressive_jpeg
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from telewide.boards.shots import find_board_shots
from telewide.capture import formats, sizes
from telewide.capture.corrupt import why_corrupt
from telewide.capture.exif import read_photo_facts
from telewide.capture.images import read_image
from telewide.capture.importer import plan_import
from telewide.capture.layout import find_captures
from telewide.capture.lens_choice import LensChoice
from telewide.capture.opcodes import parse_opcodes
from telewide.capture.raw import read_raw
from telewide.errors import InputError
from telewide.files import fingerprint
from telewide.ranges import MAX_FILE_BYTES

FLAT = np.full((48, 64), 0.25, np.float32)
PLAIN_WARP = warp((1.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@contextmanager
def bounded(*, seconds: float = 10, megabytes: float = 600) -> Iterator[None]:
    """The body takes no longer, and the peak of this process grows by no more."""
    begun_s, before_kb = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert time.process_time() - begun_s < seconds
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < megabytes * 1024


@pytest.mark.parametrize("name", ["a.dng", "a.nef", "a.tif"])
@pytest.mark.parametrize("n_directories", [1, 3, 200])
def test_directories_without_end_are_read_once(tmp_path: Path, name: str, n_directories: int) -> None:
    path = tmp_path / name
    path.write_bytes(looped_tiff(n_directories=n_directories))
    with bounded():
        assert read_photo_facts(path).make is None
        with pytest.raises(InputError, match=name):
            read_image(path)


def test_a_roll_with_a_looped_photo_is_imported_without_it(tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes(looped_tiff())
    os.mkfifo(tmp_path / "b.jpg")
    with bounded():
        plan = plan_import(tmp_path, tmp_path / "captures", choice=LensChoice())
    reasons = {one.photo.path.name: one.reason for one in plan.unpaired}
    assert set(reasons) == {"a.dng", "b.jpg"}
    assert "is a pipe" in reasons["b.jpg"]


def test_a_size_beyond_belief_is_called_that(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png_of_size(60_000, 60_000))
    with pytest.raises(InputError, match="60000 x 60000 px, too large to be believed"):
        read_image(tmp_path / "a.png")
    with pytest.raises(InputError, match="too large to be believed"):
        read_photo_facts(tmp_path / "a.png")


@pytest.mark.parametrize("wh", [(4000, 100), (100, 4000), (70_000, 3000)])
def test_a_shape_that_no_photo_has_is_refused(tmp_path: Path, wh: tuple[int, int]) -> None:
    (tmp_path / "a.png").write_bytes(png_of_size(*wh))
    with pytest.raises(InputError, match=f"{wh[0]} x {wh[1]} px, which no photo has"):
        read_image(tmp_path / "a.png")
    Image.new("L", (640, 20)).save(tmp_path / "b.png")  # a panorama is one
    assert read_image(tmp_path / "b.png").shape == (20, 640, 3)


@pytest.mark.parametrize(
    "stated", [(5, 1, 26), (11, 1, 0x7F800000), (3, 1, 0), (3, 1, 9), (3, 1, 65535), (4, 1, 1 << 31), (2, 2, 0x36)]
)
def test_an_orientation_that_is_none_leaves_the_photo_as_it_lies(tmp_path: Path, stated: tuple[int, int, int]) -> None:
    """A fraction 0 / 0, infinity, numbers of no turn, a text."""
    kind, count, value = stated
    exif = b"Exif\0\0" + struct.pack("<2sHIHHHIIIII", b"II", 42, 8, 1, 274, kind, count, value, 0, 0, 0)
    for suffix in (".jpg", ".png", ".webp"):
        path = tmp_path / f"a{suffix}"
        Image.new("RGB", (64, 48)).save(path, exif=exif)
        assert read_image(path).shape == (48, 64, 3)
        assert read_photo_facts(path).hw == (48, 64)


def test_exif_of_megabytes_is_passed_over(tmp_path: Path) -> None:
    numbers = struct.pack("<2sHIHHHIII", b"II", 42, 8, 1, 274, 3, 4_000_000, 26, 0) + struct.pack("<H", 6) * 4_000_000
    chunk = b"eXIf" + numbers
    Image.new("RGB", (64, 48)).save(tmp_path / "a.png")
    plain = (tmp_path / "a.png").read_bytes()
    packed = struct.pack(">I", len(numbers)) + chunk + struct.pack(">I", zlib.crc32(chunk))
    (tmp_path / "a.png").write_bytes(plain[:33] + packed + plain[33:])
    with bounded(megabytes=100):
        assert read_photo_facts(tmp_path / "a.png").orientation == 1
        assert read_image(tmp_path / "a.png").shape == (48, 64, 3)


@pytest.mark.parametrize("name", ["a.tif", "a.png", "a.jpg", "a.webp"])
def test_the_limit_of_pillow_is_not_that_of_photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """It refuses TIFFs of 179 megapixels when it decodes them, and calls them an attack."""
    options = {"compression": "tiff_adobe_deflate"} if name == "a.tif" else {}
    Image.new("RGB", (64, 48)).save(tmp_path / name, **options)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    assert read_image(tmp_path / name).shape == (48, 64, 3)
    assert why_corrupt(tmp_path / name, read_photo_facts(tmp_path / name)) is None
    assert Image.MAX_IMAGE_PIXELS == 1000


@pytest.mark.parametrize(
    ("name", "head", "message"),
    [
        ("a.png", b"", "is no photo that can be read"),
        ("a.jpg", b"\xff\xd8\xff", "larger than 1 MiB"),
        ("a.webp", b"RIFF\0\0\0\0WEBP", "larger than 1 MiB"),
        ("a.heic", b"\0\0\0\x18ftypheic", "larger than 1 MiB"),
    ],
)
def test_a_hole_as_large_as_any_file_may_be_is_not_read_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, head: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(head)
    os.truncate(tmp_path / name, MAX_FILE_BYTES - 1)
    monkeypatch.setattr(formats, "MAX_PACKED_BYTES", 1 << 20)
    with bounded(megabytes=20), pytest.raises(InputError, match=message):
        read_image(tmp_path / name)


@pytest.mark.parametrize("name", ["a.tif", "a.dng"])
def test_a_small_tiff_of_a_size_beyond_belief_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "a.tif":
        tifffile.imwrite(path, np.zeros((8, 8), np.uint16), compression="zlib")
    else:
        write_dng(path, FLAT)
    overwrite_tag(path, 256, 26_000)
    overwrite_tag(path, 257, 26_000)
    with bounded(), pytest.raises(InputError, match="26000 x 26000 px, too large to be believed"):
        read_image(path)


def test_a_strip_that_decompresses_to_more_than_it_should_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    packed = zlib.compress(bytes(1 << 28), 1)
    tifffile.imwrite(path, np.zeros((64, 64), np.uint16), compression="zlib", rowsperstrip=64)
    with tifffile.TiffFile(path) as tiff:
        tags = tiff.pages.first.tags
        offsets = {name: tags[name].offset for name in ("StripOffsets", "StripByteCounts")}
    data = bytearray(path.read_bytes())
    for name, value in (("StripOffsets", len(data)), ("StripByteCounts", len(packed))):
        struct.pack_into("<HII", data, offsets[name] + 2, 4, 1, value)
    path.write_bytes(data + packed)
    with bounded(megabytes=100), pytest.raises(InputError, match="more than it should hold"):
        read_image(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".webp"])
@pytest.mark.parametrize("wh", [(64, 48), (65, 47)])
def test_a_very_large_photo_is_read_at_half_its_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, wh: tuple[int, int]
) -> None:
    """Its pixels are means of 2 x 2: a ramp of x keeps x' = (x + 0.5) / 2 - 0.5."""
    width, height = wh
    ramp = np.broadcast_to(20 + 3 * np.arange(width), (height, width)).astype(np.uint8)
    options = {".jpg": {"quality": 100, "subsampling": 0}, ".webp": {"lossless": True}}.get(suffix, {})
    Image.fromarray(np.dstack([ramp] * 3)).save(tmp_path / f"a{suffix}", **options)
    monkeypatch.setattr(sizes, "MAX_WHOLE_PIXELS", 2000)
    image = read_image(tmp_path / f"a{suffix}")
    assert image.shape[:2] == ((height + 1) // 2, (width + 1) // 2)
    assert read_photo_facts(tmp_path / f"a{suffix}").hw == image.shape[:2]
    expected = 20 + 3 * (2 * np.arange(width // 2) + 0.5)
    inner = slice(2, width // 2 - 2)  # a JPEG's last block is padded
    np.testing.assert_allclose(255 * image[5, inner, 0], expected[inner], atol=1.6)


@pytest.mark.parametrize(
    ("name", "mode"),
    [
        *(("a.png", mode) for mode in ("L", "LA", "RGB", "RGBA", "P")),
        *(("a.tif", mode) for mode in ("L", "RGBA", "CMYK", "P")),
        ("a.jpg", "CMYK"),
    ],
)
def test_a_very_large_photo_of_any_mode_is_halved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, mode: str
) -> None:
    """As half of what the whole one is read as: before it is copied, which of the largest would take gigabytes."""
    ramp = np.broadcast_to((20 + 3 * np.arange(64)).astype(np.uint8), (48, 64))
    photo = Image.fromarray(np.dstack([ramp, ramp // 2, 255 - ramp])).convert(mode)
    photo.save(tmp_path / name, **({"quality": 100} if name == "a.jpg" else {}))
    whole = read_image(tmp_path / name)
    monkeypatch.setattr(sizes, "MAX_WHOLE_PIXELS", 2000)
    half = read_image(tmp_path / name)
    assert half.shape == (24, 32, 3)
    expected = whole.reshape(24, 2, 32, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(half[2:-2, 2:-2], expected[2:-2, 2:-2], atol=2.1 / 255)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_very_large_deep_png_is_halved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, channels: int) -> None:
    levels = np.random.default_rng(3).integers(0, 65536, (48, 64, channels)).astype(np.uint16)
    assert cv2.imwrite(str(tmp_path / "a.png"), levels)
    whole = read_image(tmp_path / "a.png")
    stored = levels[..., [0, 0, 0] if channels == 1 else [2, 1, 0]] / np.float32(65535)
    np.testing.assert_allclose(whole, stored, atol=1e-6)
    monkeypatch.setattr(sizes, "MAX_WHOLE_PIXELS", 2000)
    half = read_image(tmp_path / "a.png")
    np.testing.assert_allclose(half, whole.reshape(24, 2, 32, 2, 3).mean(axis=(1, 3)), atol=1.1 / 65535)


def test_a_very_large_dng_is_developed_at_half_its_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_dng(tmp_path / "a.dng", FLAT)
    whole = read_image(path)
    monkeypatch.setattr(sizes, "MAX_WHOLE_PIXELS", 2000)
    half = read_image(path)
    assert half.shape == (24, 32, 3)
    assert read_photo_facts(path).hw == (24, 32)
    np.testing.assert_allclose(half.mean(axis=(0, 1)), whole.mean(axis=(0, 1)), atol=2e-3)


@pytest.mark.parametrize(
    "opcodes",
    [
        opcode_list(gain_map(np.ones((1, 2_000_000, 1), np.float32), area=(0, 0, 48, 64))),
        opcode_list(gain_map(np.ones((2, 2, 100), np.float32), area=(0, 0, 48, 64))),
        opcode_list(*[PLAIN_WARP] * 4),
        opcode_list(*[(4, b"\0" * 8)] * 65),
    ],
    ids=["a gain map of 2 million columns", "100 planes of gains", "4 warps", "65 opcodes"],
)
def test_corrections_that_no_camera_asks_for_are_left_out(
    tmp_path: Path, opcodes: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse_opcodes(opcodes)
    path = write_dng(tmp_path / "a.dng", FLAT, opcodes={3: opcodes})
    with bounded():
        assert read_image(path).shape == (48, 64, 3)
    assert "OpcodeList3 cannot be read" in caplog.text


def test_an_opcode_list_of_another_type_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_dng(tmp_path / "a.dng", FLAT, opcodes={2: bytes(8), 3: bytes(8)})
    with tifffile.TiffFile(path) as tiff:
        offset = tiff.pages.first.tags[51022].offset
    data = bytearray(path.read_bytes())
    struct.pack_into("<HI", data, offset + 2, 4, 2)  # two LONGs
    value_offset = struct.unpack_from("<I", data, offset + 8)[0]
    struct.pack_into("<II", data, value_offset, 1 << 20, 1 << 30)
    path.write_bytes(data)
    assert read_image(path).shape == (48, 64, 3)
    assert "OpcodeList3 cannot be read" in caplog.text


@pytest.mark.parametrize("is_whole", [True, False])
@pytest.mark.parametrize(("kind", "n_bytes"), [(4, 4), (7, 1), (12, 8)], ids=["LONG", "bytes", "DOUBLE"])
def test_an_opcode_list_without_end_is_left_out(
    tmp_path: Path, kind: int, n_bytes: int, *, is_whole: bool, caplog: pytest.LogCaptureFixture
) -> None:
    shading = opcode_list(gain_map(np.full((2, 2, 1), 2, np.float32), area=(0, 0, 48, 64)))
    path = write_dng(tmp_path / "a.dng", FLAT, opcodes={2: shading, 3: bytes(8)})
    with tifffile.TiffFile(path) as tiff:
        offset = tiff.pages.first.tags[51022].offset
    data = bytearray(path.read_bytes())
    count = (96 << 20) // n_bytes
    struct.pack_into("<HI", data, offset + 2, kind, count)
    path.write_bytes(data)
    if is_whole:
        os.truncate(path, 1 << 27)  # a hole
    with bounded():
        photo = read_raw(path)
    assert "a.dng: its OpcodeList3 cannot be read" in caplog.text
    assert (f" {count} " if is_whole else "beyond the file's end") in caplog.text
    assert photo.corrections == ("GainMap",)


@pytest.mark.parametrize("date", ["9999:12:31 23:59:59", "0001:01:01 00:00:00", "2024:13:45 10:00:00"])
def test_a_year_no_photo_was_taken_in_is_not_stated(tmp_path: Path, date: str) -> None:
    exif = Image.Exif()
    exif.get_ifd(34665).update({36867: date, 37521: "999", 36881: "+14:00", 37386: IFDRational(6, 1)})
    Image.new("RGB", (64, 48)).save(tmp_path / "a.jpg", exif=exif)
    facts = read_photo_facts(tmp_path / "a.jpg")
    assert facts.taken is None
    assert facts.focal_length_mm == 6


def test_webp_and_mpo_are_captures(tmp_path: Path) -> None:
    levels = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    for view, shade in (("tele", levels), ("wide", levels // 2)):
        for folder, suffix in (("a", ".webp"), ("b", ".mpo")):
            (tmp_path / folder).mkdir(exist_ok=True)
            photo = Image.fromarray(shade)
            more = {"lossless": True} if suffix == ".webp" else {"save_all": True, "append_images": [photo]}
            photo.save(tmp_path / folder / f"{view}{suffix}", **more)
    found = find_captures(tmp_path)
    assert [capture.tele_path.name for capture in found.captures] == ["tele.webp", "tele.mpo"]
    assert found.problems == ()
    np.testing.assert_array_equal(np.rint(255 * read_image(tmp_path / "a" / "tele.webp")), levels)
    assert read_image(tmp_path / "b" / "tele.mpo").shape == (48, 64, 3)
    assert [shot.name for shot in find_board_shots(tmp_path)] == ["a", "b"]


@pytest.mark.parametrize(
    "names", [("x/tele.gif", "x/wide.gif"), ("x_tele.jxl", "x_wide.jxl"), ("tele/x.bmp", "wide/x.bmp"), ("x/a.psd",)]
)
def test_photos_of_an_unread_kind_are_named(tmp_path: Path, names: tuple[str, ...]) -> None:
    for name in (*names, "good/tele.png", "good/wide.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    found = find_captures(tmp_path)
    assert [capture.name for capture in found.captures] == ["good"]
    assert [problem.name for problem in found.problems] == ["x"]
    assert all(Path(name).name in found.problems[0].message for name in names)
    assert "are read" in found.problems[0].message


def test_a_film_beside_its_photo_is_passed_over(tmp_path: Path) -> None:
    for name in ("tele/a.jpg", "tele/a.mov", "wide/a.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    found = find_captures(tmp_path)
    assert [capture.name for capture in found.captures] == ["a"]
    assert found.problems == ()


def test_board_photos_of_an_unread_kind_are_named(tmp_path: Path) -> None:
    for name in ("x/tele.gif", "x/wide.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    (shot,) = find_board_shots(tmp_path)
    assert shot.tele_path is None
    assert shot.wide_path is not None
    assert "tele.gif cannot be read" in shot.notes[0]


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.dng", "a.webp"])
def test_a_photo_with_a_hole_of_a_terabyte_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    Image.new("RGB", (64, 48)).save(path, {"dng": "TIFF"}.get(name[2:]))
    os.truncate(path, 1 << 40)
    for read in (read_image, read_photo_facts, fingerprint):
        with (
            bounded(megabytes=50),
            pytest.raises(InputError, match=r"has 1099511627776 bytes; files of up to 1\.5"),
        ):
            read(path)


def test_two_photos_with_equal_holes_are_not_compared(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    for view in ("tele", "wide"):
        Image.new("RGB", (64, 48)).save(tmp_path / "one" / f"{view}.jpg")
        os.truncate(tmp_path / "one" / f"{view}.jpg", 1 << 40)
    with bounded(megabytes=50):
        assert len(find_captures(tmp_path).captures) == 1  # reading it says why it is left out


def test_a_jpeg_of_more_scans_than_encoders_make_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(progressive_jpeg(n_scans=64))
    assert read_image(path).shape == (64, 64, 3)
    path.write_bytes(progressive_jpeg(n_scans=65))
    with pytest.raises(InputError, match="more than 64 scans"):
        read_image(path)
    assert why_corrupt(path, read_photo_facts(path)) is not None


def test_what_comes_before_the_pixels_has_an_end(tmp_path: Path) -> None:
    """Pillow looks at each byte, each segment and each chunk of it: hours, for a hole that takes no space."""
    Image.new("RGB", (64, 48)).save(tmp_path / "a.jpg")
    Image.new("RGB", (64, 48)).save(tmp_path / "a.png")
    jpeg, png = (tmp_path / "a.jpg").read_bytes(), (tmp_path / "a.png").read_bytes()
    comment, chunk = b"\xff\xfe\0\2", bytes(4) + b"abCd" + struct.pack(">I", zlib.crc32(b"abCd"))
    strange = {
        "a hole.jpg": (jpeg[:200], "bytes lie between its segments"),
        "marks.jpg": (jpeg[:2] + b"\xff" * 70_000 + jpeg[2:], "bytes lie between its segments"),
        "segments.jpg": (jpeg[:2] + comment * 5000 + jpeg[2:], "more than 4096 segments"),
        "chunks.png": (png[:33] + chunk * 5000 + png[33:], "more than 4096 chunks"),
    }
    for name, (content, message) in strange.items():
        (tmp_path / name).write_bytes(content)
        if name == "a hole.jpg":
            os.truncate(tmp_path / name, 1 << 26)
        with bounded(seconds=2), pytest.raises(InputError, match=message):
            read_image(tmp_path / name)
        with bounded(seconds=2):
            assert read_photo_facts(tmp_path / name).hw is None
            assert why_corrupt(tmp_path / name, read_photo_facts(tmp_path / name)) is not None
    for name, content in (("b.jpg", jpeg[:2] + comment * 900 + jpeg[2:]), ("b.png", png[:33] + chunk * 900 + png[33:])):
        (tmp_path / name).write_bytes(content)
        assert read_image(tmp_path / name).shape == (48, 64, 3)


def test_a_film_behind_a_jpeg_has_no_scans(tmp_path: Path) -> None:
    """Phones append films and previews, which are full of bytes that look like scans."""
    path = tmp_path / "a.jpg"
    path.write_bytes(progressive_jpeg(n_scans=9) + 1000 * b"\xff\xda")
    assert read_image(path).shape == (64, 64, 3)
    # So are comments in it.
    path.write_bytes(
        b"\xff\xd8\xff\xfe" + struct.pack(">H", 2002) + 1000 * b"\xff\xda" + progressive_jpeg(n_scans=9)[2:]
    )
    assert read_image(path).shape == (64, 64, 3)


def test_a_roll_of_links_to_themselves_and_of_folders_without_end_is_looked_through(tmp_path: Path) -> None:
    roll = tmp_path / "roll"
    roll.mkdir()
    (roll / "a.jpg").symlink_to("a.jpg")
    (roll / "again").symlink_to(".")
    (roll / "itself").symlink_to("itself")
    (roll / Path(*["d"] * 60)).mkdir(parents=True)
    with bounded():
        plan = plan_import(roll, tmp_path / "captures", choice=LensChoice())
    told = {one.photo.path.name: one.reason for one in plan.unpaired}
    assert set(told) == {"a.jpg", "d"}
    assert "cannot be read" in told["a.jpg"]
    assert "40 levels deep" in told["d"]


@pytest.mark.parametrize("layout", ["{name}/{view}.jpg", "{name}_{view}.jpg", "{view}/{name}.jpg"])
def test_a_name_with_a_line_break_is_told_in_one_line(tmp_path: Path, layout: str) -> None:
    """Else it could write lines of its own: that all is well, or what to type next."""
    for name in ("good", "bad\nerror: all is lost"):
        for number, view in enumerate(("tele", "wide")):
            path = tmp_path / layout.format(name=name, view=view)
            path.parent.mkdir(exist_ok=True)
            Image.new("RGB", (64, 48), (90 * number, 0, 0)).save(path)
    found = find_captures(tmp_path)
    assert [capture.name for capture in found.captures] == ["good"]
    (problem,) = found.problems
    assert (problem.name, problem.message) == ("bad\\nerror: all is lost", "its name holds a line break; rename it")


def test_a_photo_of_a_roll_whose_name_has_a_line_break_is_told_in_one_line(tmp_path: Path) -> None:
    Image.new("RGB", (64, 48)).save(tmp_path / "a\nb.jpg")
    Image.new("RGB", (64, 48)).save(tmp_path / "c.jpg")
    plan = plan_import(tmp_path, tmp_path / "captures", choice=LensChoice())
    assert {one.photo.path.name: one.reason for one in plan.unpaired}["a\\nb.jpg"].startswith("its name holds")
