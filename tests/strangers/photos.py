"""Photos, disparities and camera rolls that strangers hand over."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import tifffile
from capture.dng import gain_map, opcode_list, warp, write_dng
from capture.strange_bytes import looped_tiff, overwrite_tag, png_of_size, progressive_jpeg
from PIL import Image
from strangers.inputs import Plant, Tried, Variant, each, one
from strangers.world import HW

PLAIN_WARP = warp((1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
IMPORT = "import roll imported"


def tele(name: str, content: bytes | Callable[[Path], object], *, hole: int | None = None) -> Plant:
    """Put another photo in the place of the first capture's; a hole makes it so long without taking space."""

    def plant(root: Path) -> None:
        folder = root / "captures" / "000"
        (folder / "tele.png").unlink()
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        else:
            content(folder / name)
        if hole is not None:
            os.truncate(folder / name, hole)

    return plant


def in_roll(name: str, content: bytes) -> Plant:
    return lambda root: (root / "roll" / name).write_bytes(content)


def dng(**options: object) -> Callable[[Path], object]:
    mosaic = np.full(HW, 0.25, np.float32)
    return lambda path: write_dng(path, mosaic, **options)  # type: ignore[arg-type]


def list_of_longs(path: Path) -> None:
    """A DNG whose OpcodeList3 is stated to be two numbers."""
    write_dng(path, np.full(HW, 0.25, np.float32), opcodes={3: bytes(8)})
    with tifffile.TiffFile(path) as tiff:
        offset = tiff.pages.first.tags[51022].offset
    data = bytearray(path.read_bytes())
    struct.pack_into("<HI", data, offset + 2, 4, 2)
    path.write_bytes(data)


def list_without_end(path: Path) -> None:
    list_of_longs(path)
    with tifffile.TiffFile(path) as tiff:
        offset = tiff.pages.first.tags[51022].offset
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, offset + 4, 250_000_000)
    path.write_bytes(data)
    os.truncate(path, 1 << 30)


def grey_of_26000(path: Path) -> None:
    tifffile.imwrite(path, np.zeros((8, 8), np.uint16), compression="zlib")
    overwrite_tag(path, 256, 26_000)
    overwrite_tag(path, 257, 26_000)


def tags_in_one_place(path: Path) -> None:
    """3000 tags of 2 MB each, all of the same bytes, before the picture's own."""
    Image.new("RGB", (HW[1], HW[0])).save(path, "TIFF")
    data = bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, first)
    entries = [bytes(data[first + 2 + 12 * at : first + 14 + 12 * at]) for at in range(count)]
    entries += [struct.pack("<HHII", 60_000 + number, 7, 1 << 21, 8) for number in range(3000)]
    struct.pack_into("<I", data, 4, len(data))
    data += struct.pack("<H", len(entries)) + b"".join(entries) + bytes(4)
    path.write_bytes(data + bytes(1 << 21))


def strips_without_end(path: Path) -> None:
    Image.new("RGB", (HW[1], HW[0])).save(path, "TIFF")
    with tifffile.TiffFile(path) as tiff:
        offset = tiff.pages.first.tags[273].offset
    data = bytearray(path.read_bytes())
    struct.pack_into("<HII", data, offset + 2, 4, 250_000_000, 8)
    path.write_bytes(data)
    os.truncate(path, 1 << 30)


def exif_photo(texts: dict[int, object], below: dict[int, object]) -> bytes:
    exif, stream = Image.Exif(), BytesIO()
    exif.update(texts)
    exif.get_ifd(34665).update(below)
    Image.fromarray(np.random.default_rng(3).integers(0, 255, (*HW, 3), dtype=np.uint8)).save(stream, "JPEG", exif=exif)
    return stream.getvalue()


def truth(head: bytes, *, hole: int | None = None) -> Plant:
    def plant(root: Path) -> None:
        path = root / "captures" / "000" / "truth.pfm"
        path.write_bytes(head)
        if hole is not None:
            os.truncate(path, hole)

    return plant


def named(name: str) -> Plant:
    return lambda root: (root / "captures" / "000").rename(root / "captures" / name)


def gifs(root: Path) -> None:
    (root / "captures" / "002").mkdir()
    for view in ("tele", "wide"):
        Image.new("L", (HW[1], HW[0])).save(root / "captures" / "002" / f"{view}.gif")


def plain(kind: str) -> bytes:
    stream = BytesIO()
    Image.new("RGB", (HW[1], HW[0])).save(stream, kind)
    return stream.getvalue()


def packed_png(pixels: int) -> bytes:
    """A chunk of text of so many bytes in next to none (a bomb of the iTXt chunk)."""
    chunk = b"zTXtComment\0\0" + zlib.compress(bytes(pixels), 9)
    whole = plain("PNG")
    return whole[:33] + struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) + whole[33:]


LOOPED = {f"tele.{suffix}": tele(f"tele.{suffix}", looped_tiff()) for suffix in ("tif", "dng", "nef")}
UNKNOWN_TRUTH = b"Pf\n128 96\n-1.0\n" + np.full(HW, np.inf, "<f4").tobytes()
TERABYTE = {
    f"tele.{suffix}": tele(f"tele.{suffix}", plain(kind), hole=1 << 40)
    for suffix, kind in (("jpg", "JPEG"), ("png", "PNG"), ("dng", "TIFF"))
}
ESCAPES = {271: "maker\x1b]0;owned\x07", 272: "model\x9b2J\x7f"}

TRIED = (
    Tried("TIFF of 26 bytes whose next directory is itself, as .tif, .dng and .nef", each(LOOPED), 0, "skipped: 000"),
    Tried("the same in a camera roll", one(in_roll("a.dng", looped_tiff()), IMPORT), 0, "a.dng"),
    Tried("EXIF make and model with escapes", one(in_roll("x.jpg", exif_photo(ESCAPES, {37386: 4.5})), IMPORT), 0),
    Tried(
        "photos and a capture whose names hold escapes",
        (
            Variant("a capture", named("a\x1b]0;owned\x07\x9b2J")),
            Variant("a photo", in_roll("a\x1b[2J\x07.jpg", b"none"), IMPORT),
        ),
        0,
    ),
    Tried(
        "a capture whose name holds a line break", one(named("a\nerror: all is lost")), 0, r"a\nerror: all is lost: its"
    ),
    Tried(
        "PNG whose header states 60000 x 60000 px", one(tele("tele.png", png_of_size(60_000, 60_000))), 0, "too large"
    ),
    Tried("PNG of 200000 x 40 px", one(tele("tele.png", png_of_size(200_000, 40))), 0, "which no photo has"),
    Tried("grey TIFF of 16 bits that states 26000 x 26000 px", one(tele("tele.tif", grey_of_26000)), 0, "too large"),
    Tried(
        "DNG with a GainMap of 1 x 2 000 000",
        one(
            tele(
                "tele.dng",
                dng(opcodes={3: opcode_list(gain_map(np.ones((1, 2_000_000, 1), np.float32), area=(0, 0, *HW)))}),
            )
        ),
        0,
        "a GainMap of 1 x 2000000 x 1 gains",
    ),
    Tried(
        "DNG with 1000 distortions",
        one(tele("tele.dng", dng(opcodes={3: opcode_list(*[PLAIN_WARP] * 1000)}))),
        0,
        "a list of 1000 opcodes",
    ),
    Tried(
        "DNG whose OpcodeList3 is of type LONG", one(tele("tele.dng", list_of_longs)), 0, "OpcodeList3 cannot be read"
    ),
    Tried("TIFF with 3000 tags of 2 MB each, all in one place", one(tele("tele.tif", tags_in_one_place)), 0),
    Tried(
        "DNG with an OpcodeList3 of 250 million numbers",
        one(tele("tele.dng", list_without_end)),
        0,
        "OpcodeList3 cannot be read (it holds 250000000 numbers",
    ),
    Tried(
        "TIFF whose strips lie in 250 million places", one(tele("tele.tif", strips_without_end)), 0, "tag 273 states"
    ),
    Tried("JPEG, PNG or DNG of a terabyte that takes no space", each(TERABYTE), 0, "files of up to 1.5 GiB are read"),
    Tried("JPEG of 20 000 scans", one(tele("tele.jpg", progressive_jpeg(n_scans=20_000))), 0, "more than 64 scans"),
    Tried("PNG whose text unpacks to 256 MB", one(tele("tele.png", packed_png(1 << 28))), 0),
    Tried(
        "EXIF of the year 9999 with sub-seconds, in a camera roll",
        one(
            in_roll("x.jpg", exif_photo({}, {36867: "9999:12:31 23:59:59", 37521: "999", 36881: "+14:00", 37386: 6.0})),
            IMPORT,
        ),
        0,
    ),
    Tried("a pipe in a camera roll", one(lambda root: os.mkfifo(root / "roll" / "b.jpg"), IMPORT), 0, "pipe"),
    Tried(
        "a pipe in the place of a photo",
        one(tele("tele.jpg", lambda path: os.mkfifo(path))),
        0,
    ),
    Tried(
        "truth.pfm of a terabyte that takes no space",
        one(truth(b"Pf\n20000 20000\n-1.0\n", hole=1 << 40)),
        0,
        "files of up to 1.5 GiB are read",
    ),
    Tried(
        "truth.pfm of 20000 x 20000 px that takes no space",
        one(truth(b"Pf\n20000 20000\n-1.0\n", hole=20_000 * 20_000 * 4 + 20)),
        0,
        "larger than the disparities of any photo",
    ),
    Tried("truth.pfm that knows nothing", one(truth(UNKNOWN_TRUTH)), 0, "knows no disparity"),
    Tried("two .gif beside two good captures", one(gifs), 0, "tele.gif, wide.gif cannot be read"),
)
