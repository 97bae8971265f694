"""More that strangers may hand over: what an attacker would think of next."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import tifffile
import torch
from capture.dng import write_dng
from PIL import Image
from safetensors.torch import load_file, save_file
from strangers.inputs import Plant, Tried, each, one
from strangers.photos import IMPORT, dng, named, plain, tele, truth
from strangers.records import DEPTH_JSON, PAIR, RUN, WEIGHTS, record, rig, vouched, written
from strangers.world import DEPTH, HW, TINY

from telewide.ranges import MAX_FILE_BYTES


def both(name: str, write: Callable[[Path, int], object]) -> Plant:
    """Two other photos in the place of the first capture's."""

    def plant(root: Path) -> None:
        for number, view in enumerate(("tele", "wide")):
            (root / "captures/000" / f"{view}.png").unlink()
            write(root / "captures/000" / f"{view}.{name}", number)

    return plant


def noise(hw: tuple[int, int], seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (*hw, 3), dtype=np.uint8)


def squares(path: Path, number: int) -> None:
    """Two boards of 5000 squares: each corner looks like each."""
    y, x = np.mgrid[:400, :600]
    Image.fromarray((255 * ((x // 7 + number * 3 + y // 7) % 2)).astype(np.uint8)).save(path)


def flat_tiff(value: float, dtype: type) -> Callable[[Path], object]:
    return lambda path: tifffile.imwrite(path, np.full((*HW, 3), value, dtype))


def dng_tag(code: int, kind: int, values: bytes) -> Callable[[Path], object]:
    """A DNG one tag of which says something else; its values lie at the end."""

    def write(path: Path) -> None:
        write_dng(path, np.full(HW, 0.25, np.float32))
        with tifffile.TiffFile(path) as tiff:
            offset = tiff.pages.first.tags[code].offset
        data = bytearray(path.read_bytes())
        size = {3: 2, 4: 4, 5: 8, 10: 8, 1: 1}[kind]
        struct.pack_into("<HI", data, offset + 2, kind, len(values) // size)
        if len(values) <= 4:
            data[offset + 8 : offset + 12] = values.ljust(4, b"\0")
        else:
            struct.pack_into("<I", data, offset + 8, len(data))
            data += values
        path.write_bytes(data)

    return write


def profile(content: bytes) -> bytes:
    stream = BytesIO()
    Image.fromarray(noise(HW, 1)).save(stream, "PNG", icc_profile=content)
    return stream.getvalue()


def frames(path: Path) -> None:
    pictures = [Image.fromarray(noise((48, 64), number)) for number in range(300)]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], lossless=True)


def weights(change: Callable[[torch.Tensor], torch.Tensor]) -> Plant:
    """Weights of the run, all changed alike."""

    def plant(root: Path) -> None:
        from safetensors import safe_open

        with safe_open(root / "w.safetensors", "pt") as stored:
            metadata = stored.metadata()
        tensors = {name: change(tensor) for name, tensor in load_file(root / "w.safetensors").items()}
        save_file(tensors, root / "w.safetensors", metadata=metadata)

    return plant


def kept_arrays(**changes: np.ndarray) -> Plant:
    """A depth.npz of other arrays, which depth.json vouches for."""

    def plant(root: Path) -> None:
        with np.load(root / "run/depth/000/depth.npz") as stored:
            arrays = {**stored, **changes}
        stream = BytesIO()
        np.savez(stream, **arrays)
        vouched(stream.getvalue())(root)

    return plant


def kept_pair(**changes: object) -> Plant:
    """A pair.json that says something else; the depth of the pair is to be computed."""

    def plant(root: Path) -> None:
        record(PAIR, lambda content: content.update(changes))(root)
        for path in (root / "run/depth/000").iterdir():
            path.unlink()

    return plant


def source_of(name: str) -> Plant:
    return record(DEPTH_JSON, lambda content: content.update(source=name))


def filled_with_much(tensor: torch.Tensor) -> torch.Tensor:
    return torch.full_like(tensor, 1e38) if tensor.is_floating_point() else tensor


def surfaces(content: bytes) -> Plant:
    def plant(root: Path) -> None:
        for folder in (root / "run/pairs").iterdir():
            for path in folder.glob("disparity_*"):
                path.write_bytes(content)

    return plant


def cameras(**changes: object) -> Plant:
    return rig(lambda content: [content[view].update(changes) for view in ("tele", "wide")])


def pose(**changes: object) -> Plant:
    return rig(lambda content: content["wide_from_tele"].update(changes))


def many(root: Path) -> None:
    """A roll of 3000 photos of one second."""
    content = (root / "roll" / "000.jpg").read_bytes()
    for number in range(3000):
        (root / "roll" / f"n{number}.jpg").write_bytes(content + number.to_bytes(2, "big"))


def marks(points: str, wh: str = "[128, 96]") -> Plant:
    planes = f"planes: {{wall: {points}}}"
    edges = f"edges: {{edge: {{line: {points}, near: left}}}}"
    return written("marks.yaml", f'format: 1\nphoto_wh: {wh}\ncaptures:\n  "000": {{{planes}, {edges}}}\n')


MARKS = {
    "1e300": marks("[[0, 0], [1.0e+300, 0], [0, 1.0e+300]]"),
    "NaN": marks("[[0, 0], [.nan, 0], [0, .inf]]"),
    "1e9": marks("[[0, 0], [1.0e+9, 0], [0, 1.0e+9]]"),
    "-1e9": marks("[[-1.0e+9, -1.0e+9], [1.0e+9, 0], [0, 1.0e+9]]"),
    "a photo of 1 px": marks("[[0, 0], [10, 0], [0, 10]]", wh="[1, 1]"),
}
STRANGE_NAMES = ("--help", "$(touch nowhere)", "<b>", "a" * 250, "'; x", "\u202eb", "%s%n{0}", "run.json")
RIGGED = f"{DEPTH} --rig phone.yaml"
NAN, INF = float("nan"), float("inf")
HOLES = {
    "TIFF": tele("tele.tif", plain("TIFF"), hole=MAX_FILE_BYTES - 1),
    "DNG": tele("tele.dng", dng(), hole=MAX_FILE_BYTES - 1),
}
TURNED = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]

TRIED = (
    Tried("TIFF or DNG of 1.5 GiB that takes no space", each(HOLES), 0),
    Tried(
        "a link to /dev/zero or into /proc in the place of a photo",
        each(
            {
                place: tele("tele.jpg", lambda path, place=place: path.symlink_to(place))  # type: ignore[misc]
                for place in ("/dev/zero", "/proc/kmsg", "/proc/self/mem", "/dev/stdin")
            }
        ),
        0,
        "skipped: 000",
    ),
    Tried(
        "two photos of noise, 3000 x 2000 px",
        one(both("png", lambda path, n: Image.fromarray(noise((2000, 3000), n)).save(path))),
        0,
        "skipped: 000",
    ),
    Tried("two pictures of 5000 equal squares", one(both("png", squares)), 0),
    Tried(
        "TIFF of numbers that are no colours (NaN, infinity, 64 bits, complex)",
        each(
            {
                "NaN": tele("tele.tif", flat_tiff(NAN, np.float32)),
                "infinity": tele("tele.tif", flat_tiff(INF, np.float32)),
                "64 bits": tele("tele.tif", flat_tiff(3, np.uint64)),
                "complex": tele("tele.tif", flat_tiff(3, np.complex64)),
            }
        ),
        0,
        "skipped: 000",
    ),
    Tried(
        "PNG with a colour profile that is none",
        each(
            {
                "noise": tele("tele.png", profile(b"x" * 3000)),
                "a head": tele(
                    "tele.png",
                    profile(
                        (1 << 30).to_bytes(4, "big")
                        + b"lcms\x02\x10\0\0mntrRGB XYZ "
                        + bytes(104)
                        + b"\xff\xff\xff\xff"
                    ),
                ),
                "64 MB": tele("tele.png", profile(bytes(1 << 26))),
            }
        ),
        0,
    ),
    Tried("WebP of 300 pictures", one(tele("tele.webp", frames)), 0),
    Tried(
        "DNG whose white is black, whose neutral is 0, whose matrix is 0, whose mosaic is 0 wide",
        each(
            {
                "white": tele("tele.dng", dng_tag(50717, 3, struct.pack("<H", 0))),
                "black": tele("tele.dng", dng_tag(50714, 3, struct.pack("<H", 65535))),
                "neutral": tele("tele.dng", dng_tag(50728, 5, bytes(24))),
                "matrix": tele("tele.dng", dng_tag(50721, 10, bytes(72))),
                "mosaic": tele("tele.dng", dng_tag(33421, 3, bytes(4))),
                "pattern": tele("tele.dng", dng_tag(33422, 1, b"\xff\xff\xff\xff")),
            }
        ),
        0,
    ),
    Tried(
        "truth.pfm of no numbers, of -1e38, of a scale of 0 or 1e400",
        each(
            {
                "NaN": truth(b"Pf\n128 96\n-1.0\n" + np.full(HW, np.nan, "<f4").tobytes()),
                "-1e38": truth(b"Pf\n128 96\n-1.0\n" + np.full(HW, -1e38, "<f4").tobytes()),
                "scale 0": truth(b"Pf\n128 96\n0\n" + bytes(4 * 96 * 128)),
                "scale 1e400": truth(b"Pf\n128 96\n-1e400\n" + bytes(4 * 96 * 128)),
                "in colour": truth(b"PF\n128 96\n-1\n" + bytes(12 * 96 * 128)),
                "long head": truth(b"Pf\n" + b" " * (1 << 22)),
                "negative": truth(b"Pf\n-128 -96\n-1\n" + bytes(4 * 96 * 128)),
            }
        ),
        0,
    ),
    Tried(
        "captures named like options, commands, pages and places",
        each({name: named(name) for name in STRANGE_NAMES}, f"{DEPTH} --bokeh"),
        0,
    ),
    Tried("the same, run", each({name: named(name) for name in ("--help", "<img src=x onerror=alert(1)>")}, RUN), 0),
    Tried("a camera roll of 3000 photos of one second", one(many, IMPORT), 0),
    Tried(
        "a rig whose lenses look apart, stand in line, or bend the picture beyond itself",
        each(
            {
                "apart": pose(rotation=TURNED),
                "in line": pose(translation_m=[0.0, 0.0, 0.01]),
                "bent": cameras(distortion=[1e6, -1e6, 0.5, 0.5]),
                "bent back": cameras(distortion=[-5.0, 3.0, 0.0, 0.0]),
                "bent to nothing": cameras(distortion=[0.0, 0.0, 0.0, 0.0, 0.0, -1e6, 1e6, 1e6]),
                "far centre": cameras(cx_px=11_000.0, cy_px=-11_000.0),
                "tiny focal": cameras(fx_px=1e-3, fy_px=1e-3),
                "65536": cameras(width_px=65_536, height_px=65_536, fx_px=60_000.0, fy_px=60_000.0),
            },
            RIGGED,
        ),
        3,
    ),
    Tried("weights that are 0", one(weights(torch.zeros_like), WEIGHTS), 0),
    Tried(
        "weights that are 1e38", one(weights(filled_with_much), WEIGHTS), 3, "the disparity map holds no known value"
    ),
    Tried(
        "a recipe that learns at a rate of 1e30",
        one(lambda root: None, f"train captures --out other {TINY} --set train.rehearsal.learning_rate=1.0e+30"),
        4,
        "is not a number at step",
    ),
    Tried(
        "pair.json with a scale of 0, -1, 1e-300 or 1e300",
        each({str(scale): kept_pair(scale=scale) for scale in (0.0, -1.0, 1e-300, 1e300)}),
        0,
    ),
    Tried("pair.json with no blur that any lens has", one(kept_pair(blur={"factors": [1e9, 1e9]})), 0),
    Tried(
        "depth.npz of other sizes and numbers, which depth.json vouches for",
        each(
            {
                "10 x 10": kept_arrays(disparity=np.ones((10, 10), np.float32)),
                "empty": kept_arrays(disparity=np.ones((0, 0), np.float32)),
                "NaN": kept_arrays(disparity=np.full(HW, NAN, np.float32)),
                "infinity": kept_arrays(disparity=np.full(HW, INF, np.float32)),
                "complex": kept_arrays(disparity=np.full(HW, 1j, np.complex64)),
                "texts": kept_arrays(disparity=np.full(HW, "a")),
                "a flat row": kept_arrays(disparity=np.ones(96 * 128, np.float32)),
            },
            f"{DEPTH} --bokeh",
        ),
        0,
    ),
    Tried(
        "marks of 1e300, NaN or 1e9 px, or on a photo of 1 px, benchmark marks",
        each(MARKS, "benchmark marks captures --marks marks.yaml"),
        3,
        "marks.yaml",
    ),
    Tried(
        "marks on a photo of 1e9 px",
        one(
            marks("[[0, 0], [10, 0], [0, 10]]", wh="[1000000000, 1000000000]"),
            "benchmark marks captures --marks marks.yaml",
        ),
        3,
        "its marks were made on a photo of",
    ),
    Tried(
        "surfaces that are garbage, run",
        one(surfaces(b"Pf\n128 96\n-1.0\n" + np.full(HW, 1e30, "<f4").tobytes()), RUN),
        0,
    ),
    Tried(
        "depth.json whose source is a device, no name, or a name of 5000 letters",
        each({f"{n}": source_of(source) for n, source in enumerate(("/dev/zero", "a\0b", "x" * 5000))}),
        0,
    ),
    Tried(
        "run.json whose commands are numbers, texts, or a million",
        each(
            {
                "numbers": written("run/run.json", json.dumps({"format": 1, "commands": 7})),
                "texts": written("run/run.json", json.dumps({"format": 1, "commands": {"depth": "x", "train": [1]}})),
                "many": written(
                    "run/run.json", json.dumps({"format": 1, "commands": {str(n): {} for n in range(100_000)}})
                ),
            },
            RUN,
        ),
        0,
    ),
)
