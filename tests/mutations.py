"""Whole files of every kind that telewide reads, mutations of them with a fixed seed, and who reads them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from capture.dng import gain_map, opcode_list, vignette, warp, write_dng
from PIL import Image, features
from PIL.TiffImagePlugin import IFDRational
from rigs import phone

from telewide.boards.board import load_board
from telewide.calibration.quality import CalibrationQuality, Check
from telewide.calibration.rig_file import RigFacts, StoredRig, read_rig, write_stored_rig
from telewide.capture.exif import read_photo_facts
from telewide.capture.facts import read_facts
from telewide.capture.images import read_image
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.correction.blur import BlurEstimate
from telewide.correction.verdict import PairReport
from telewide.depth.formats.numpy_archive import read_result
from telewide.geometry.rectification import rectified_geometry
from telewide.recipe import load_recipe
from telewide.records import checked, read_json
from telewide.text import json_text
from telewide.training.log import read_log
from telewide.yaml_files import read_yaml

HW = (48, 64)
Read = Callable[[Path], object]


@dataclass(frozen=True)
class Kind:
    """Files of one kind: whole ones by their names, and what reads them."""

    files: dict[str, bytes]
    read: Read
    is_text: bool = False


_NUMBERS = (
    b"0",
    b"-1",
    b"1e400",
    b"nan",
    b"Infinity",
    b"9" * 30,
    b"9" * 5000,
    b"1e-300",
    b"-0.0",
    b"[]",
    b"''",
    b"null",
)
_WORDS = (
    b"[" * 2000,
    b"{" * 50,
    b"*a",
    b"&a ",
    b"!!int ",
    b"!!python/none ",
    b"\x00",
    b"\xff\xfe",
    b"\t",
    b"\n",
    b": ",
    b"- ",
)
_EDGES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def mutated(content: bytes, rng: np.random.Generator, *, is_text: bool) -> bytes:
    """Make one to four small changes: bits, edge values, pieces cut or doubled; of a text also numbers and words."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        kind = int(rng.integers(0, 9 if is_text else 7))
        # Half of the changes in the first 200 bytes, where headers are; some at the end, where zip has its index.
        near = int(rng.integers(0, 3))
        first = 0 if near < 2 else max(0, len(data) - 300)
        last = min(len(data), 200) if near == 0 else len(data)
        at = int(rng.integers(first, max(last, first + 1)))
        size = int(rng.integers(1, 40))
        if kind == 0 and at < len(data):
            data[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            data[at : at + 4] = int(rng.choice(_EDGES)).to_bytes(4, "little" if rng.integers(0, 2) else "big")
        elif kind == 2:
            data[at : at + 2] = (int(rng.choice(_EDGES)) & 0xFFFF).to_bytes(
                2, "little" if rng.integers(0, 2) else "big"
            )
        elif kind == 3:
            del data[at : at + size]
        elif kind == 4:
            data[at:at] = data[at : at + size]
        elif kind == 5:
            data[at : at + size] = rng.bytes(size)
        elif kind == 6 and rng.integers(0, 4) == 0:
            del data[at:]
        elif kind == 7:
            numbers = list(re.finditer(rb"-?\d[\d.e+-]*", data))
            if numbers:
                found = numbers[int(rng.integers(0, len(numbers)))]
                data[found.start() : found.end()] = _NUMBERS[int(rng.integers(0, len(_NUMBERS)))]
        elif kind == 8:
            data[at:at] = _WORDS[int(rng.integers(0, len(_WORDS)))]
    return bytes(data)


def kinds(folder: Path) -> dict[str, Kind]:
    """All kinds; what needs a file to be made is made in a folder."""
    return {
        "pictures": Kind(_pictures(), read_image),
        "EXIF": Kind(_with_exif(), read_photo_facts),
        "DNG": Kind(_dngs(folder), _read_dng),
        "YAML": Kind(_yaml(folder), _read_yaml, is_text=True),
        "JSON": Kind(_json(), _read_json, is_text=True),
        "PFM": Kind(_pfm(folder), read_pfm),
        "NPZ": Kind(_npz(), lambda path: read_result(path, name="one")),
        "weights": Kind(_weights(folder), _read_weights),
        "state": Kind(_state(folder), _read_state),
    }


def _levels() -> np.ndarray:
    y, x = np.mgrid[: HW[0], : HW[1]]
    return np.dstack([2 * x + y, 255 - 3 * x, 40 + 4 * y]).astype(np.uint8)


def _exif() -> Image.Exif:
    exif = Image.Exif()
    exif[271], exif[272], exif[274], exif[306] = "Maker", "Phone 1", 6, "2024:05:06 07:08:09"
    exif.get_ifd(34665).update(
        {
            **{36867: "2024:05:06 07:08:09", 37521: "123", 36881: "+02:00", 37386: IFDRational(627, 100)},
            **{41989: 77, 41988: IFDRational(1, 1), 37382: IFDRational(5, 2)},
        }
    )
    return exif


def _pictures() -> dict[str, bytes]:
    photo, files = Image.fromarray(_levels()), {}
    formats = {"jpg": "JPEG", "png": "PNG", "tif": "TIFF", "webp": "WEBP", "mpo": "MPO"}
    formats |= {"avif": "AVIF"} if features.check("avif") else {}
    for suffix, name in formats.items():
        stream = BytesIO()
        photo.save(stream, name)
        files[f"a.{suffix}"] = stream.getvalue()
    deep = _levels().astype(np.uint16) * 257
    for name, suffix, options in (
        ("deep.png", ".png", []),
        ("deep.tif", ".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 8]),
        ("lzw.tif", ".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 5]),
    ):
        files[name] = cv2.imencode(suffix, deep, options)[1].tobytes()
    return files


def _with_exif() -> dict[str, bytes]:
    photo, files = Image.fromarray(_levels()), {}
    for suffix, name in (("jpg", "JPEG"), ("png", "PNG"), ("webp", "WEBP"), ("tif", "TIFF")):
        stream = BytesIO()
        photo.save(stream, name, exif=_exif())
        files[f"a.{suffix}"] = stream.getvalue()
    return files


def _dngs(folder: Path) -> dict[str, bytes]:
    mosaic = np.full(HW, 0.25, np.float32)
    shading = gain_map(np.ones((3, 4, 1), np.float32), area=(0, 0, *HW))
    lists = {
        2: opcode_list(shading),
        3: opcode_list(warp((1.0, 0.01, 0.0, 0.0, 0.0, 0.0)), vignette((0.1, 0, 0, 0, 0))),
    }
    path = write_dng(
        folder / "a.dng",
        mosaic,
        opcodes=lists,
        crop=(2, 2, 40, 60),
        exposure_ev=0.5,
        texts={271: "Maker", 272: "Phone 1"},
    )
    content = path.read_bytes()
    return {"a.dng": content, "a.tif": content, "a.nef": content}


def _read_dng(path: Path) -> None:
    read_photo_facts(path)
    read_image(path)


def _yaml(folder: Path) -> dict[str, bytes]:
    quality = CalibrationQuality(
        0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(Check("name", "pass", 1.0, 2.0, ""),), verdict="good"
    )
    write_stored_rig(folder / "rig.yaml", StoredRig(phone(), None, None, None, quality, RigFacts(notes=("a note",))))
    return {
        "rig.yaml": (folder / "rig.yaml").read_bytes(),
        "captures.yaml": b"format: 1\nrectified: true\nasymmetry: 3.0\nreference: tele\nf_px: 900.5\nnotes: a & b\n",
        "recipe.yaml": b"seed: 3\nwindow_px: [0, 64]\ntrain:\n  rehearsal: {steps: 10, rehearsed: 2}\n",
        "set.txt": b"train.rehearsal={steps: 10, rehearsed: 2}",
        "board.yaml": b"format: 1\nkind: chessboard\ncolumns: 9\nrows: 6\nsquare_m: 0.025\npaper: A4\n",
    }


def _read_yaml(path: Path) -> None:
    if path.name == "rig.yaml":
        rectified_geometry(read_rig(path).rig, working_width_px=256)
    elif path.name == "captures.yaml":
        read_facts(path)
    elif path.name == "recipe.yaml":
        load_recipe(str(path))
    elif path.name == "set.txt":
        load_recipe("quick", settings=[path.read_text(errors="replace")])
    else:
        load_board(str(path))
        read_yaml(path)


_REPORT = PairReport("one", 70, 0.1, 0.0, 0.2, None, (1.0, 1.1, 0.9), 3.0, 40.0, "usable", ("a reason",))
_BLUR = BlurEstimate((1.0, 0.5), 0.3, (0.1, float("nan")), 0.2, 12)


def _json() -> dict[str, bytes]:
    line = {"stage": "rehearsal", "stage_index": 0, "step": 10, "losses": {"photometric": 0.5}, "seconds": 1.25}
    judged = {"stage": "rehearsal", "stage_index": 0, "step": 20, "judgement": {"off_1px": 0.5, "mean_px": None}}
    return {
        "report.json": json_text(vars(_REPORT)).encode(),
        "blur.json": json_text(vars(_BLUR)).encode(),
        "log.jsonl": f"{json_text(line)}\n{json_text(judged)}\n".encode(),
    }


def _read_json(path: Path) -> None:
    if path.name == "log.jsonl":
        for line in read_log(path):
            sum(line.losses.values(), start=0.0)
        return
    content = read_json(path)
    try:
        checked(content, PairReport if path.name == "report.json" else BlurEstimate)
    except ValueError:
        return  # its readers make it again


def _pfm(folder: Path) -> dict[str, bytes]:
    write_pfm(folder / "a.pfm", np.arange(12, dtype=np.float32).reshape(3, 4))
    return {"a.pfm": (folder / "a.pfm").read_bytes()}


def _npz() -> dict[str, bytes]:
    files = {}
    for name, save in (("depth.npz", np.savez), ("packed.npz", np.savez_compressed)):
        stream = BytesIO()
        disparity_px = np.linspace(0, 9, 12, dtype=np.float32).reshape(3, 4)
        maps = {"disparity": disparity_px, "confidence": disparity_px / 9, "depth_m": disparity_px + 1}
        camera = {"K": np.eye(3), "baseline_m": np.array(0.012), "doffs_px": np.array(1.0)}
        save(stream, valid=disparity_px > 3, **maps, **camera)
        files[name] = stream.getvalue()
    return files


def _weights(folder: Path) -> dict[str, bytes]:
    from telewide.matching.networks import build_network
    from telewide.training.checkpoint import save_weights
    from telewide.training.weights_card import WeightsCard

    path = folder / "w.safetensors"
    save_weights(build_network("lite"), path, card=WeightsCard("lite", (0, 64), {"seed": 3}, {"step": 7}))
    return {path.name: path.read_bytes()}


def _read_weights(path: Path) -> None:
    import torch

    from telewide.training.checkpoint import load_weights

    load_weights(path, device=torch.device("cpu"))


def _state(folder: Path) -> dict[str, bytes]:
    import torch

    from telewide.training.checkpoint import new_state, save_state

    path = folder / "state.pt"
    state = new_state("lite", seed=1, device=torch.device("cpu"))
    sum(parameter.square().sum() for parameter in state.network.parameters()).backward()
    state.optimiser.step()
    save_state(state, path)
    return {path.name: path.read_bytes()}


def _read_state(path: Path) -> None:
    import torch

    from telewide.training.checkpoint import load_state
    from telewide.training.stages import plan_stages

    plan = plan_stages(load_recipe("quick").train)
    load_state(path, network_name="lite", device=torch.device("cpu"), plan=plan)
