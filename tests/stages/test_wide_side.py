"""Rectified photos whose wide lens stands to the left of tele: stated or found, the result is that of its mirror."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import telewide
from telewide.capture.facts import CaptureFacts
from telewide.capture.images import read_image, write_image
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.cli import main
from telewide.simulate.captures import write_captures

ZERO_PX = 12.0
"""Disparity of infinity, over all of the scene's: metres are known, and all is in front of the cameras."""


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("side") / "right"
    write_captures(folder, count=1, seed=3, hw=(144, 216), factor=2)
    (folder / "captures.yaml").write_text(f"rectified: true\nf_px: 500.0\nbaseline_m: 0.012\ndoffs_px: {ZERO_PX}\n")
    return folder


def mirrored(right: Path, folder: Path, *, stated: str) -> Path:
    """The same scene by a phone whose wide lens stands on the other side: disparities and doffs change sign."""
    shutil.copytree(right, folder)
    for path in folder.glob("*/*.png"):
        write_image(path, read_image(path)[:, ::-1])
    for path in folder.glob("*/truth.pfm"):
        write_pfm(path, -read_pfm(path)[:, ::-1])
    (folder / "captures.yaml").write_text(f"rectified: true\nf_px: 500.0\nbaseline_m: 0.012\n{stated}\n")
    return folder


def depth_of(captures: Path, run: Path) -> dict[str, np.ndarray]:
    with pytest.raises(SystemExit) as left:
        main(["depth", str(captures), "--run", str(run), "--method", "sgm", "--bokeh", "--focus", "near", "--quiet"])
    assert not left.value.code
    with np.load(run / "depth" / "000" / "depth.npz") as kept:
        return dict(kept)


@pytest.mark.parametrize("side", ["wide_side: left\n", ""])
def test_the_depth_of_mirrored_photos_is_mirrored(
    right: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], side: str
) -> None:
    """Stated, or found: by the stated zero of disparity all of it would lie behind the cameras."""
    expected = depth_of(right, tmp_path / "right")
    left = mirrored(right, tmp_path / "left", stated=f"{side}doffs_px: {-ZERO_PX}")
    capsys.readouterr()
    found = depth_of(left, tmp_path / "run")
    apart_px = np.abs(found["disparity"] - expected["disparity"][:, ::-1])
    assert np.median(apart_px) < 0.01
    assert (apart_px < 1).mean() > 0.98
    assert np.isfinite(found["depth_m"]).mean() > 0.95
    assert float(found["doffs_px"]) == ZERO_PX
    assert ("wide is taken to stand to the left" in capsys.readouterr().err) == (not side)
    numbers = [
        json.loads((run / "depth" / "000" / "depth.json").read_text())["numbers"]
        for run in (tmp_path / "right", tmp_path / "run")
    ]
    assert numbers[1]["EPE_px"] == pytest.approx(numbers[0]["EPE_px"], abs=0.1)
    assert numbers[1]["focus_m"] == pytest.approx(numbers[0]["focus_m"], rel=0.05)


def test_in_python_it_is_the_same(right: Path, tmp_path: Path) -> None:
    left = mirrored(right, tmp_path / "left", stated="")
    facts = CaptureFacts(rectified=True, wide_side="left")
    depth = telewide.estimate_depth(telewide.read_pair(left / "000"), facts=facts)
    truth_px = -read_pfm(left / "000" / "truth.pfm")
    assert np.nanmedian(np.abs(depth.disparity.disparity_px - truth_px)) < 0.5
