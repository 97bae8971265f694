"""What a training says it led to: by the tensors themselves, whatever the run folder is told of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from telewide.assets import BOX_WEIGHTS
from telewide.pages.run_page import next_steps, write_run_page
from telewide.recipe import load_recipe
from telewide.stages.run_folder import RunFolder
from telewide.stages.training_result import TrainingResult, read_result
from telewide.text import Invocation
from telewide.training.checkpoint import load_weights, save_weights

LOG = '{{"stage": "rehearsal", "stage_index": 0, "step": {}, "judgement": {{"clipped_px": {}}}}}\n'
TRAINED: Mapping[str, object] = {"stage": "rehearsal", "step": 20, "clipped_px": [0.35]}


def leave_training(run: RunFolder, training: Mapping[str, object], *, moved_by: float = 0.0) -> None:
    """Write the box's weights as a training leaves them, some of them moved, and a log that began at 0.4 px."""
    network, card = load_weights(BOX_WEIGHTS, device=torch.device("cpu"))
    with torch.no_grad():
        next(network.parameters()).add_(moved_by)
    run.train.mkdir(parents=True)
    save_weights(network, run.weights, card=replace(card, training=training))
    run.training_log.write_text(LOG.format(0, 0.4) + LOG.format(20, 0.35))


def test_a_training_without_a_better_step_says_that_the_box_stays(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    leave_training(run, {"stage": "rehearsal", "step": 0, "clipped_px": [0.4]})
    result = read_result(run)
    assert result is not None
    assert result.is_box
    assert "the network that comes with telewide stays, judged 0.400 px off" in result.told
    assert "more captures or more steps may" in result.told


def test_a_better_step_is_told_with_what_was_before(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    leave_training(run, TRAINED, moved_by=1e-3)
    result = read_result(run)
    assert result is not None
    assert not result.is_box
    assert result.told == "rehearsal, step 20, judged 0.350 px off, 0.400 px before the training"


@pytest.mark.parametrize("content", [b"", b"garbage", b"\xff" * 16, (2).to_bytes(8, "little") + b"[]"])
def test_weights_that_cannot_be_read_led_to_nothing(tmp_path: Path, content: bytes) -> None:
    run = RunFolder(tmp_path)
    assert read_result(run) is None
    run.train.mkdir(parents=True)
    run.weights.write_bytes(content)
    assert read_result(run) is None


def test_facts_of_another_kind_are_unknown(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    leave_training(run, {"step": "many", "clipped_px": ["?"]}, moved_by=1e-3)
    result = read_result(run)
    assert result is not None
    assert result.step is None
    assert math.isnan(result.off_px)


def test_the_page_says_what_a_training_led_to_and_hopes_for_no_more(tmp_path: Path) -> None:
    told = TrainingResult("rehearsal", 0, 0.4, is_box=True).told
    typed = Invocation("run", ("captures",), {"recipe": "quick"})
    steps = next_steps(tmp_path, recipe=load_recipe("quick"), invocation=typed, calls={}, is_box=True)
    (tmp_path / "log.jsonl").write_text(LOG.format(0, 0.4) + LOG.format(20, 0.45))
    page = write_run_page(
        tmp_path, (), names=(), log=tmp_path / "log.jsonl", summary="", next_steps=steps, facts={}, result=told
    )
    assert page is not None
    words = page.read_text(encoding="utf-8")
    assert told in words
    assert "judged, px off" in words
    assert "which may help" in words
