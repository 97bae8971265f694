"""A training on worlds alone ends, goes on where it was stopped with the same result, and refuses another recipe; the
weights that come with the program state such a training, as its own reader tells.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from telewide.assets import BOX_WEIGHTS
from telewide.capture.formats import PHOTO_SUFFIXES, UNREAD_SUFFIXES
from telewide.errors import InputError, UsageError
from telewide.recipe import Recipe, load_recipe
from telewide.stages import box
from telewide.stages.box import train_box
from telewide.training import world_samples
from telewide.training.stages import Stage
from telewide.training.weights_card import read_card

SETTINGS = ("network=lite", "train.crop_hw=[64, 96]", "train.rehearsal.rehearsed=2", "train.judge_every_steps=2")


class Quiet:
    """Tells nobody; stops the training where it is told to."""

    def __init__(self, *, stop_at: int | None = None) -> None:
        self.lines: list[str] = []
        self._stop_at = stop_at

    def stage_started(self, stage: Stage, *, first_step: int) -> None: ...

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        if step == self._stop_at:
            signal_interrupt()

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None: ...

    def stage_finished(self, stage: Stage, *, network: object, judgement: Mapping[str, float]) -> None: ...

    def said(self, message: str) -> None:
        self.lines.append(message)


def signal_interrupt() -> None:
    import signal

    signal.raise_signal(signal.SIGINT)


@pytest.fixture(autouse=True)
def _small_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world_samples, "SIZE_OF_CROPS", 1.25)
    monkeypatch.setattr(world_samples, "PALETTE_SIZE", 6)
    monkeypatch.setattr(world_samples, "KEPT_WORLDS", 2)
    monkeypatch.setattr(box, "JUDGED_STEPS", 1)
    monkeypatch.setattr(box, "SHEET_ROWS", 1)
    # In this process, where the sizes above hold.
    monkeypatch.setattr(box, "workers_for", lambda device: 0)


def recipe(steps: int = 4, *more: str) -> Recipe:
    lengths = (f"train.rehearsal.steps={steps}", f"train.rehearsal.least_steps={steps}")
    return load_recipe("box", settings=(*SETTINGS, *lengths, *more))


def test_a_stopped_training_ends_as_one_that_was_not(tmp_path: Path) -> None:
    whole = train_box(recipe(), run=tmp_path / "whole", fresh=False, device="cpu", observer=Quiet())
    with pytest.raises(KeyboardInterrupt):
        train_box(recipe(), run=tmp_path / "cut", fresh=False, device="cpu", observer=Quiet(stop_at=3))
    observer = Quiet()
    resumed = train_box(recipe(), run=tmp_path / "cut", fresh=False, device="cpu", observer=observer)
    assert any("resuming rehearsal at step 3" in line for line in observer.lines)
    first, second = load_file(whole.weights), load_file(resumed.weights)
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert read_card(whole.weights).recipe["train"]["worlds"] is True
    assert (tmp_path / "whole" / "train" / "rehearsal.png").is_file()


def test_a_training_whose_time_is_up_goes_on_as_one_that_was_not_stopped(tmp_path: Path) -> None:
    whole = train_box(recipe(3), run=tmp_path / "whole", fresh=False, device="cpu", observer=Quiet())
    for step in (1, 2):
        cut = train_box(
            recipe(3), run=tmp_path / "cut", fresh=False, device="cpu", observer=Quiet(), deadline_s=time.monotonic()
        )
        assert not cut.is_finished
        assert read_card(cut.weights).training["step"] == step
    end = train_box(recipe(3), run=tmp_path / "cut", fresh=False, device="cpu", observer=Quiet(), deadline_s=math.inf)
    assert end.is_finished
    first, second = load_file(whole.weights), load_file(end.weights)
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_another_recipe_does_not_go_on_with_it(tmp_path: Path) -> None:
    train_box(recipe(2), run=tmp_path, fresh=False, device="cpu", observer=Quiet())
    with pytest.raises(UsageError, match="seed"):
        train_box(recipe(2, "seed=9"), run=tmp_path, fresh=False, device="cpu", observer=Quiet())


def test_no_link_is_followed_out_of_the_run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    canary = tmp_path / "canary"
    canary.mkdir()
    (canary / "training.json").write_text("precious")
    (tmp_path / "given").mkdir()
    (tmp_path / "given" / "train").symlink_to(canary)
    with pytest.raises(InputError, match="train is a link"):
        train_box(recipe(2), run=tmp_path / "given", fresh=True, device="cpu", observer=Quiet())
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").symlink_to(canary)
    with pytest.raises(UsageError, match="run is a link"):
        train_box(recipe(2), run=None, fresh=True, device="cpu", observer=Quiet())
    assert [path.name for path in canary.iterdir()] == ["training.json"]
    assert (canary / "training.json").read_text() == "precious"


def texts_in(value: object) -> list[str]:
    """All names and texts in plain data."""
    if isinstance(value, Mapping):
        return [text for name, held in value.items() for text in (str(name), *texts_in(held))]
    if isinstance(value, list | tuple):
        return [text for held in value for text in texts_in(held)]
    return [value] if isinstance(value, str) else []


def test_the_weights_in_the_box_say_where_they_come_from() -> None:
    card = read_card(BOX_WEIGHTS)
    for name in ("commit", "device", "hours", "history", "judged_on"):
        assert str(card.training.get(name) or "").strip(), name
    assert re.search(r"\b[0-9a-f]{7,40}\b", str(card.training["commit"]))
    assert card.network == load_recipe("box").network
    assert BOX_WEIGHTS.stat().st_size <= 12_000_000


def test_the_weights_in_the_box_saw_worlds_alone_and_name_no_photo() -> None:
    card = read_card(BOX_WEIGHTS)
    train = card.recipe["train"]
    assert isinstance(train, Mapping)
    assert train["worlds"] is True
    assert card.searched_window is None
    stages = [section for section in train.values() if isinstance(section, Mapping) and "rehearsed" in section]
    assert sum(stage["steps"] > 0 and stage["rehearsed"] > 0 for stage in stages) == 1
    assert {(stage["captured"], stage["retaken"]) for stage in stages} == {(0, 0)}
    # Nor does any text in the card: no file of a photo, no folder.
    suffixes = "|".join(re.escape(suffix) for suffix in PHOTO_SUFFIXES | UNREAD_SUFFIXES)
    named = re.compile(rf"({suffixes})\b|\w/\w|\\", re.IGNORECASE)
    assert not [text for text in texts_in([card.recipe, card.training]) if named.search(text)]
