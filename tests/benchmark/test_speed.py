"""Peak memory against arrays of known size; a line of figures for every matcher."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from pathlib import Path

import pytest

from telewide.assets import BOX_WEIGHTS
from telewide.benchmark.memory import SGM, MemoryCase, measure_peak, peak_resident_bytes
from telewide.benchmark.report import write_report_json
from telewide.benchmark.speed import SpeedOptions, measure_speed, speed_table
from telewide.errors import TelewideError, UsageError
from telewide.training.weights_card import read_card
from telewide.training.world_samples import STEPS_A_WORLD

TINY = SpeedOptions(
    device="cpu",
    repeats=1,
    warm_up=0,
    crop_hw=(128, 192),
    crop_window=(0, 64),  # narrower ones are trained in float32
    image_hw=(64, 96),
    image_window=(0, 32),
    world_hw=(64, 96),
)


def test_peak_of_this_process_never_falls() -> None:
    before = peak_resident_bytes()
    block = bytearray(64 << 20)
    block[:: 1 << 12] = b"x" * len(block[:: 1 << 12])
    assert peak_resident_bytes() >= before
    assert before > 1 << 20


def test_where_the_system_does_not_tell_the_peak_it_is_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("telewide.benchmark.memory._STATUS", Path("nowhere"))
    assert peak_resident_bytes() > 1 << 20
    monkeypatch.setitem(sys.modules, "resource", None)  # as on Windows
    assert peak_resident_bytes() == 0


def test_larger_pictures_take_more_memory() -> None:
    # Made large on purpose: a child must not be charged with the memory of the process that started it.
    ballast = bytearray(b"x") * (600 << 20)
    small, large = (
        measure_peak(MemoryCase(SGM, "-", hw, (0, 64), "cpu")).process_bytes for hw in ((64, 96), (320, 640))
    )
    assert len(ballast) > 0
    volume_bytes = 2 * 64 * 320 * 640
    assert 0 < small < volume_bytes < large < 600 << 20


def test_a_child_that_fails_is_told() -> None:
    with pytest.raises(TelewideError, match="memory of sgm"):
        measure_peak(MemoryCase(SGM, "-", (64, 96), (0, 1), "cpu"))


@pytest.mark.parametrize("options", [SpeedOptions(matchers=("best",)), SpeedOptions(repeats=0)])
def test_wrong_options_are_refused(options: SpeedOptions) -> None:
    with pytest.raises(UsageError):
        measure_speed(options, tell=lambda _: None)


@pytest.mark.slow
def test_a_matcher_may_be_called_as_the_option_method_calls_it() -> None:
    once = dataclasses.replace(TINY, matchers=("network", "sgm", read_card(BOX_WEIGHTS).network))
    names = [row["matcher"] for row in measure_speed(once, tell=lambda _: None).rows]
    assert list(dict.fromkeys(names)) == [read_card(BOX_WEIGHTS).network, SGM]
    with pytest.raises(UsageError, match="unknown matcher 'netwrk'") as caught:
        measure_speed(dataclasses.replace(TINY, matchers=("netwrk",)), tell=lambda _: None)
    assert {"sgm", "network", "guided"} <= set(re.findall(r"[\w-]+", str(caught.value.hint)))


def test_worlds_give_pairs_no_faster_than_they_are_cast_and_damaged() -> None:
    report = measure_speed(dataclasses.replace(TINY, matchers=(SGM,)), tell=lambda _: None)
    (worlds,) = report.further["worlds"]
    seconds = worlds["cast"]["median_s"] / STEPS_A_WORLD + worlds["damage"]["median_s"] / 4
    assert worlds["pairs_per_s"] == pytest.approx(1 / seconds)
    assert worlds["taken_per_s"] == {}
    assert f"{worlds['pairs_per_s']:.2f} pairs/s of 64x96" in speed_table(report)


@pytest.mark.slow
def test_every_matcher_gets_a_line(tmp_path: Path) -> None:
    from telewide.benchmark.networks import available_precisions
    from telewide.matching.inference import choose_device
    from telewide.matching.networks import NETWORKS

    report = measure_speed(TINY, tell=lambda _: None)
    precisions = available_precisions(choose_device("cpu"))
    expected = [(SGM, "-"), *((name, precision) for name in NETWORKS for precision in precisions)]
    assert [(row["matcher"], row["precision"]) for row in report.rows] == expected
    assert len(speed_table(report).splitlines()) == 2 + len(expected) + 2
    (worlds,) = report.further["worlds"]
    steps = {" ".join(variant): row["training_step"] for variant, row in zip(expected, report.rows, strict=True)}
    for name, pairs_per_s in worlds["taken_per_s"].items():
        assert pairs_per_s == pytest.approx(2 * (128 * 192) / (64 * 96) / steps[name]["median_s"])
    write_report_json(report, tmp_path / "speed.json")
    content = json.loads((tmp_path / "speed.json").read_text())
    assert content["machine"]["device"] == "cpu"
    for row in content["rows"]:
        assert row["inference"]["repeats"] == 1
        assert row["megapixels_per_s"] == pytest.approx(64 * 96 / 1e6 / row["inference"]["median_s"])
        assert (row["training_step"] is None) == (row["matcher"] == SGM)
        assert row["peak_memory_bytes"] > 0
        assert row["peak_gpu_bytes"] is None
