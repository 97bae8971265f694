"""Speed and memory of each matcher, all side by side in one run, and of the worlds that networks are trained on.

A training step is timed on crops, inference on a picture of the size of the real pairs; both on a rendered pair.
Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np

from telewide.assets import BOX_WEIGHTS
from telewide.benchmark.memory import SGM, MemoryCase, MemoryPeak, measure_peak
from telewide.benchmark.report import BenchmarkReport, describe_machine, markdown_table, number
from telewide.benchmark.timing import Timing, time_side_by_side
from telewide.cores import Device
from telewide.errors import UsageError
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import Window
from telewide.simulate.degrade import Degradation, degrade
from telewide.simulate.scene import random_scene, render_pair
from telewide.training.samples import Sample

Tell = Callable[[str], None]

NO_PRECISION = "-"
_FACTOR = 3.0
_MIB = 1 << 20


@dataclass(frozen=True)
class SpeedOptions:
    """Options of the timing: what runs, and how often.

    Attributes:
        matchers: sgm and networks by name, or ``network`` for the one that comes with telewide; empty for all.
        device: auto, cpu or cuda.
        repeats: timed turns.
        warm_up: turns before them.
        batch: crops of a training step.
        crop_hw: height and width of the crops.
        crop_window: disparities of a training step's volume, px.
        image_hw: height and width of the picture.
        image_window: disparities of an inference, px.
        world_hw: height and width of crops of cast worlds.
    """

    matchers: tuple[str, ...] = ()
    device: Device = "auto"
    repeats: int = 7
    warm_up: int = 2
    batch: int = 2
    crop_hw: tuple[int, int] = (256, 384)
    crop_window: Window = (0, 80)
    image_hw: tuple[int, int] = (640, 1280)
    image_window: Window = (0, 64)
    world_hw: tuple[int, int] = (256, 512)


NETWORK = "network"
"""As `--method` calls it: the network that comes with telewide."""
Variant = tuple[str, str]
"""A matcher and the precision it computes in."""
Key = TypeVar("Key")


def measure_speed(options: SpeedOptions, *, tell: Tell) -> BenchmarkReport:
    """Time a training step and an inference of every matcher, and measure the peak memory of the inference.

    Args:
        options: what and how often.
        tell: hears how far it is.

    Returns:
        A row for each matcher and precision, and a further one for worlds.

    Raises:
        UsageError: a matcher that does not exist.
        MissingPartError: cuda was asked for and is not there.
    """
    from telewide.benchmark.networks import describe_device, synchroniser, world_cases
    from telewide.matching.inference import choose_device

    if options.repeats < 1 or options.warm_up < 0:
        raise UsageError(f"{options.repeats} repeats, {options.warm_up} to warm up: at least 1 and 0 were expected")
    device = choose_device(options.device)
    variants = _variants(options)
    machine = describe_machine() | describe_device(device)
    tell(f"peak memory of {len(variants)} inferences, each in a process of its own")
    peaks = {variant: measure_peak(_memory_case(variant, options)) for variant in variants}

    def timed(cases: Mapping[Key, Callable[[], None]]) -> dict[Key, Timing]:
        wait = synchroniser(device)
        return time_side_by_side(cases, repeats=options.repeats, warm_up=options.warm_up, synchronise=wait)

    tell("training steps")
    steps = timed(_training_cases(variants, options))
    tell("inference")
    inferences = timed(_inference_cases(variants, options))
    megapixels = options.image_hw[0] * options.image_hw[1] / 1e6
    rows = tuple(_row(v, steps.get(v), inferences[v], peaks[v], megapixels=megapixels) for v in variants)
    tell("worlds")
    worlds = _worlds_row(timed(world_cases(options.world_hw, device=device)), steps, options)
    return BenchmarkReport("speed", asdict(options), rows, machine=machine, further={"worlds": (worlds,)})


def speed_table(report: BenchmarkReport) -> str:
    """Set a speed report in Markdown: median (interquartile range), one line for each matcher and precision."""
    headings = ("matcher", "precision", "training step s", "inference s", "Mpx/s", "peak MiB", "GPU MiB")
    (worlds,) = report.further["worlds"]
    return f"{markdown_table(headings, [_line(row) for row in report.rows])}\n\n{_worlds_line(worlds)}"


def _worlds_row(
    timings: Mapping[str, Timing], steps: Mapping[Variant, Timing], options: SpeedOptions
) -> dict[str, object]:
    """Pairs of views a second that worlds give, and that a training step of each matcher takes, all of one size."""
    from telewide.benchmark.networks import WORLD_PAIRS
    from telewide.training.world_samples import STEPS_A_WORLD

    share = options.crop_hw[0] * options.crop_hw[1] / (options.world_hw[0] * options.world_hw[1])
    pair_s = timings["cast"].median_s / STEPS_A_WORLD + timings["damage"].median_s / WORLD_PAIRS
    return {
        "crop_hw": options.world_hw,
        "cast": asdict(timings["cast"]),
        "damage": asdict(timings["damage"]),
        "pairs_per_s": 1 / pair_s,
        "taken_per_s": {" ".join(variant): options.batch * share / step.median_s for variant, step in steps.items()},
    }


def _worlds_line(row: Mapping[str, Any]) -> str:
    height, width = row["crop_hw"]
    taken = ", ".join(f"{name} {pairs:.2f}" for name, pairs in row["taken_per_s"].items())
    return (
        f"Worlds give {row['pairs_per_s']:.2f} pairs/s of {height}x{width} (one is cast in "
        f"{row['cast']['median_s']:.3f} s); training takes, in pairs/s of that size: {taken or '-'}"
    )


def _variants(options: SpeedOptions) -> list[Variant]:
    from telewide.benchmark.networks import available_precisions
    from telewide.matching.inference import choose_device
    from telewide.matching.networks import NETWORKS
    from telewide.training.weights_card import read_card

    known = (SGM, *NETWORKS)
    matchers = [read_card(BOX_WEIGHTS).network if name == NETWORK else name for name in options.matchers]
    for name in matchers:
        if name not in known:
            hint = f"known matchers: {', '.join(known)}, and {NETWORK} for the one that comes with telewide"
            raise UsageError(f"unknown matcher {name!r}", hint=hint)
    precisions = available_precisions(choose_device(options.device))
    return [
        (name, precision)
        for name in dict.fromkeys(matchers) or known
        for precision in ((NO_PRECISION,) if name == SGM else precisions)
    ]


def _memory_case(variant: Variant, options: SpeedOptions) -> MemoryCase:
    return MemoryCase(*variant, options.image_hw, options.image_window, options.device)


def _training_cases(variants: list[Variant], options: SpeedOptions) -> dict[Variant, Callable[[], None]]:
    from telewide.benchmark.networks import training_case
    from telewide.matching.inference import choose_device

    device = choose_device(options.device)
    samples = [_sample(options.crop_hw, options.crop_window, seed=seed) for seed in range(options.batch)]
    return {
        (name, precision): training_case(name, samples, window=options.crop_window, device=device, precision=precision)
        for name, precision in variants
        if name != SGM
    }


def _inference_cases(variants: list[Variant], options: SpeedOptions) -> dict[Variant, Callable[[], None]]:
    sample = _sample(options.image_hw, options.image_window, seed=0)
    return {variant: _inference_case(variant, sample, options) for variant in variants}


def _inference_case(variant: Variant, sample: Sample, options: SpeedOptions) -> Callable[[], None]:
    name, precision = variant
    if name == SGM:

        def match() -> None:
            match_semiglobal(sample.ref, sample.src, window=options.image_window)

        return match
    from telewide.benchmark.networks import inference_case
    from telewide.matching.inference import choose_device

    views, device = (sample.ref, sample.src), choose_device(options.device)
    return inference_case(name, views, window=options.image_window, device=device, precision=precision)


def _sample(hw: tuple[int, int], window: Window, *, seed: int) -> Sample:
    """A rendered pair whose disparities fill the window, its src view as soft as a wide lens' is."""
    rng = np.random.default_rng(seed)
    pair = render_pair(random_scene(rng, hw=hw, disparity_window_px=window))
    return Sample(pair.ref, degrade(pair.src, Degradation(factor=_FACTOR), rng=rng), pair.disparity_px)


def _row(
    variant: Variant, step: Timing | None, inference: Timing, peak: MemoryPeak, *, megapixels: float
) -> dict[str, object]:
    return {
        "matcher": variant[0],
        "precision": variant[1],
        "training_step": None if step is None else asdict(step),
        "inference": asdict(inference),
        "megapixels_per_s": megapixels / inference.median_s,
        "peak_memory_bytes": peak.process_bytes,
        "peak_gpu_bytes": peak.gpu_bytes,
    }


def _line(row: Mapping[str, object]) -> list[str]:
    return [
        str(row["matcher"]),
        str(row["precision"]),
        _seconds(row["training_step"]),
        _seconds(row["inference"]),
        number(row["megapixels_per_s"], ".2f"),
        _mib(row["peak_memory_bytes"]),
        _mib(row["peak_gpu_bytes"]),
    ]


def _seconds(timing: object) -> str:
    if not isinstance(timing, Mapping):
        return "-"
    return f"{timing['median_s']:.3f} ({timing['q3_s'] - timing['q1_s']:.3f})"


def _mib(size_bytes: object) -> str:
    return f"{size_bytes / _MIB:.0f}" if isinstance(size_bytes, int) else "-"
