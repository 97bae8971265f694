"""``telewide train`` begins with the weights it was told to: steps too small to move any leave those in the result.

Oracles: the file of the box, and the network built anew from the seed.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from telewide.assets import BOX_WEIGHTS
from telewide.cli import main
from telewide.matching.networks import build_network
from telewide.simulate.captures import write_captures

SETTINGS = (
    *("train.stages=0", "train.rehearsal.steps=1", "train.rehearsal.least_steps=1", "train.rehearsal.rehearsed=1"),
    *("train.rehearsal.captured=0", "train.rehearsal.learning_rate=1e-12", "train.crop_hw=[64, 96]"),
    *("working_width_px=144", "window_px=[-8, 32]"),
)


@pytest.mark.slow
@pytest.mark.parametrize(("start", "is_box"), [("box", True), ("scratch", False)])
def test_a_training_begins_with_the_box_or_from_scratch(start: str, is_box: bool, tmp_path: Path) -> None:
    write_captures(tmp_path / "captures", count=2, seed=1, hw=(96, 144), factor=2)
    settings = tuple(word for setting in SETTINGS for word in ("--set", setting))
    asked = (
        "--recipe",
        "quick",
        "--device",
        "cpu",
        "--seed",
        "3",
        "--quiet",
        "--out",
        str(tmp_path / "run"),
        *settings,
    )
    with pytest.raises(SystemExit) as left:
        main(("train", str(tmp_path / "captures"), *asked, "--from", start))
    assert not left.value.code
    found = load_file(tmp_path / "run" / "train" / "weights.safetensors")
    built, box = build_network("guided", seed=3).state_dict(), load_file(BOX_WEIGHTS)
    assert is_close(found, box) == is_box
    assert is_close(found, built) != is_box


def is_close(found: dict[str, torch.Tensor], expected: dict[str, torch.Tensor]) -> bool:
    return all(torch.allclose(found[name], expected[name], rtol=0, atol=1e-8) for name in expected)


def test_a_start_that_is_neither_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(("train", "--from", "boxes"))
    assert left.value.code == 2
    assert "Did you mean box?" in capsys.readouterr().err
