"""The timed work of networks: one inference and one training step, in float32 and in bf16; and that of their worlds.

Weights are drawn anew, since speed does not depend on them.
Letters: H W image.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
import torch

from telewide.geometry.arrays import FloatImage
from telewide.matching.inference import choose_device, full_precision, has_fast_bf16, match_with_network
from telewide.matching.networks import build_network
from telewide.matching.window import VOLUME_STEP_PX, Window
from telewide.training.checkpoint import new_state
from telewide.training.data import collate
from telewide.training.loop import Training, take_step
from telewide.training.options import StageOptions, TrainOptions
from telewide.training.processes import Processes
from telewide.training.samples import Sample, SampleSource
from telewide.training.stages import Stage
from telewide.training.world_samples import LARGEST_FACTOR, PLANES, WorldCrop, damaged_crops, worlds_for

FLOAT32, BF16 = "float32", "bf16"
_STAGE = "rehearsal"
WORLD_PAIRS = 4
"""Pairs that are damaged together, as in a step of the recipe box."""


def available_precisions(device: torch.device) -> tuple[str, ...]:
    """Precisions a network is timed in: bf16 only where the device computes in it."""
    return (FLOAT32, BF16) if has_fast_bf16(device) else (FLOAT32,)


def computing_in(precision: str) -> AbstractContextManager[None]:
    """Compute in float32 or in bf16 within the block."""
    return full_precision() if precision == FLOAT32 else nullcontext()


def inference_case(
    network_name: str, views: tuple[FloatImage, FloatImage], *, window: Window, device: torch.device, precision: str
) -> Callable[[], None]:
    """Bind one inference: two views in memory to disparity, confidence and validity in memory.

    Args:
        network_name: which network.
        views: (ref, src), each (H, W, 3) in [0, 1].
        window: disparities searched, px.
        device: to compute on.
        precision: float32 or bf16.
    """
    network = build_network(network_name).to(device).eval()

    def match() -> None:
        with computing_in(precision):
            match_with_network(*views, network=network, window=window)

    return match


def training_case(
    network_name: str, samples: list[Sample], *, window: Window, device: torch.device, precision: str
) -> Callable[[], None]:
    """Bind one step of the training loop: forward, supervised loss, backward, Adam, running average.

    Args:
        network_name: which network.
        samples: the crops of one batch.
        window: disparities of the volume, px.
        device: to compute on.
        precision: float32 or bf16.
    """
    state = new_state(network_name, seed=0, device=device)
    state.network.train()
    crop_hw = (samples[0].ref.shape[0], samples[0].ref.shape[1])
    stage = Stage(_STAGE, 0, StageOptions(steps=1_000_000, rehearsed=len(samples)))
    training = Training(
        folder=Path(),
        options=TrainOptions(crop_hw=crop_hw),
        source=SampleSource(captures=(), crop_hw=crop_hw, window_px=window),
        judge=lambda _network: {},
        seed=0,
        network_name=network_name,
        recipe={},
        device=device,
        processes=Processes(),
        workers=0,
    )
    batch = collate(samples, n_rehearsed=len(samples)).to(device)

    def step() -> None:
        with computing_in(precision):
            take_step(state, batch, stage, training=training)
        state.step += 1

    return step


def world_cases(crop_hw: tuple[int, int], *, device: torch.device) -> dict[str, Callable[[], None]]:
    """Bind what a training does with worlds: ``cast`` one, and cut and ``damage`` some pairs of crops.

    Args:
        crop_hw: height and width of the crops; a world is larger.
        device: where worlds are cast and damaged.
    """
    worlds = worlds_for((0,), crop_hw=crop_hw, crops=1, mine=1, device=device)
    numbers, seeds = itertools.count(), itertools.count()
    window = (0, PLANES[-1] * VOLUME_STEP_PX)

    def cut() -> WorldCrop:
        return worlds.crop(0, 0, rng=np.random.default_rng(0), window=window)

    def damage() -> None:
        rngs = [np.random.default_rng(next(seeds)) for _ in range(WORLD_PAIRS)]
        damaged_crops([cut() for _ in rngs], rngs, factors=(1.0, LARGEST_FACTOR))

    cut()  # so that its world is cast
    return {"cast": lambda: _ignore(worlds.cast(next(numbers))), "damage": damage}


def _ignore(_: object) -> None:
    pass


def synchroniser(device: torch.device) -> Callable[[], None]:
    """A function that waits until the device has finished."""
    if device.type == "cuda":
        return lambda: torch.cuda.synchronize(device)
    return lambda: None


def device_type(device_name: str) -> str:
    """Type of the device that a name stands for: cpu or cuda."""
    return choose_device(device_name).type


def device_facts(device_name: str) -> dict[str, object]:
    """State what the networks compute on, by the name of the device."""
    return describe_device(choose_device(device_name))


def describe_device(device: torch.device) -> dict[str, object]:
    """State what the networks compute on."""
    facts: dict[str, object] = {"device": device.type, "threads": torch.get_num_threads()}
    if device.type == "cuda":
        facts |= {
            "gpu": torch.cuda.get_device_name(device),
            "cuda": torch.version.cuda,
            "cudnn": torch.backends.cudnn.version(),
            "float32_convolutions_in_tf32": torch.backends.cudnn.allow_tf32,
        }
    return facts


def gpu_peak_bytes(device_name: str) -> int | None:
    """Most memory torch has held on the GPU so far; None on a processor."""
    device = choose_device(device_name)
    return int(torch.cuda.max_memory_allocated(device)) if device.type == "cuda" else None
