"""``telewide train`` begins with the weights it was told to: steps too small to move any leave those in the result.

Oracles: the file of the box, and the network built anew from the seed; of a training that is stopped in time, its own
record of where it stands.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from telewide.assets import BOX_WEIGHTS
from telewide.cli import main
from telewide.matching.networks import build_network
from telewide.simulate.captures import write_captures
from telewide.training.weights_card import read_card

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


@pytest.mark.slow
def test_a_training_stops_when_its_minutes_are_over_and_says_how_to_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sizes = ("train.crop_hw=[64, 96]", "train.rehearsal.steps=50", "train.rehearsal.rehearsed=1", "network=lite")
    settings = tuple(word for setting in sizes for word in ("--set", setting))
    asked = ("--recipe", "box", "--device", "cpu", "--out", str(tmp_path / "run"), *settings, "--minutes", "0.001")
    for words in (("--fresh",), ()):
        with pytest.raises(SystemExit) as left:
            main(("train", *asked, *words, "--json"))
        assert not left.value.code
        shown = capsys.readouterr()
        assert json.loads(shown.out)["is_finished"] is False
        said = re.sub(r"\s+", " ", shown.err)  # a narrow terminal breaks lines
        (again,) = re.findall(r"stopped after 0.001 min; to continue: telewide (.*)", said)
        assert "--fresh" not in again
        assert "--minutes 0.001" in again
    assert read_card(tmp_path / "run" / "train" / "weights.safetensors").training["step"] == 2


@pytest.mark.parametrize("minutes", ["0", "-3", "nan"])
def test_minutes_that_are_none_are_refused(
    minutes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(("train", "--recipe", "box", "--minutes", minutes))
    assert left.value.code == 2
    assert f"{minutes} minutes; a number above 0 was expected" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_worlds_alone_are_not_what_a_run_of_captures_trains_on(
    repo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would go on for hours, and look at none of them."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(("run", str(repo / "examples" / "captures"), "--recipe", "box"))
    assert left.value.code == 2
    assert "telewide train --recipe box" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
