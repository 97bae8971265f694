"""A folder as people have it, which strangers' files are put into: captures, a camera roll, a rig, a trained run.

captures/000 001    two pairs, rectified, with truth.pfm
roll/               two photos of one moment by two lenses
phone.yaml          a rig
run/                a finished training of two captures, and their depth
canary/             a file of every name that telewide writes; nothing may change in it
"""

from __future__ import annotations

import shutil
from pathlib import Path

from PIL import Image

from telewide.cli import main
from telewide.simulate.captures import write_captures

HW = (96, 128)
TINY = (
    "--quiet --recipe quick --set train.rehearsal.steps=10 --set train.crop_hw=[64,64] --set train.photometric.steps=0 "
    "--set train.rehearsal.rehearsed=1 --set train.rehearsal.retaken=0"
)
DEPTH = "depth captures --method sgm"
TRAIN = f"train captures --out run {TINY}"
NAMES_WRITTEN = (
    *("tele.png", "wide.png", "tele.jpg", "pair.json", "shot.json", "matches.npz", "disparity_0_32.pfm", "run.json"),
    *("state.pt", "weights.safetensors", "training.json", "log.jsonl", "rehearsal.png", "rehearsal.safetensors"),
    *("disparity.pfm", "disparity.png", "depth.npz", "depth.json", "preview.png", "bokeh.jpg", "report.html"),
    *("rig.yaml", "telewide.onnx", "board.pdf"),
)


def write_world(root: Path, *, rig: Path) -> None:
    """Write all of it but the run folder.

    Args:
        root: an empty folder.
        rig: a rig file.
    """
    write_captures(root / "captures", count=2, seed=1, hw=HW, factor=2)
    (root / "roll").mkdir()
    for number, (view, focal_mm) in enumerate((("tele", 9.0), ("wide", 4.5))):
        exif = Image.Exif()
        exif.get_ifd(34665).update({36867: f"2024:05:06 07:08:0{number}", 37386: focal_mm, 41989: round(6 * focal_mm)})
        with Image.open(root / "captures" / "000" / f"{view}.png") as photo:
            photo.save(root / "roll" / f"{number}00.jpg", exif=exif)
    shutil.copyfile(rig, root / "phone.yaml")
    (root / "canary").mkdir()
    for name in NAMES_WRITTEN:
        (root / "canary" / name).write_text(f"precious {name}")


def write_run() -> None:
    """Train, and compute depth, in the current folder."""
    for command in (TRAIN, f"{DEPTH} --quiet"):
        try:
            main(command.split())
        except SystemExit as left:
            if left.code not in {0, 4}:
                raise
    shutil.copyfile("run/train/weights.safetensors", "w.safetensors")


def state_of(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Content, and time of the last change, of each file of a folder."""
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}
