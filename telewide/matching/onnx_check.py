"""An ONNX model beside the network it was made from: the same maps, and how long each takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from telewide.matching.onnx_model import INPUTS, OnnxNetwork
from telewide.matching.window import Window
from telewide.simulate.degrade import Degradation, degrade
from telewide.simulate.scene import random_scene, render_pair

TOLERANCE = 1e-3
"""Largest difference from torch: of disparity, px; of confidence and of the probability of being hidden."""
_TURNS = 3
Maps = list[NDArray[np.float32]]


@dataclass(frozen=True)
class OnnxComparison:
    """A model's maps against torch's, for one pair of views.

    Attributes:
        hw: height and width of the views, px.
        differing: share of the pixels at which a map differs by more than ``TOLERANCE``, or holds what is no number.
        torch_s: time of torch, the best of some turns.
        onnxruntime_s: likewise of onnxruntime, with as many threads.
        threads: of either.
    """

    hw: tuple[int, int]
    differing: float
    torch_s: float
    onnxruntime_s: float
    threads: int


def compare_onnx(path: Path, model: OnnxNetwork, *, hw: tuple[int, int]) -> OnnxComparison:
    """Run a model and the network it was made from on a rendered pair, by turns.

    Args:
        path: the model; onnxruntime is installed.
        model: the network, in eval mode.
        hw: height and width of the pair, px.

    Returns:
        The differences and both times.
    """
    import onnxruntime

    threads = torch.get_num_threads()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    ref, src = example_views(hw, model.window)

    @torch.inference_mode()
    def by_torch() -> Maps:
        return [map_.numpy() for map_ in model(torch.from_numpy(ref), torch.from_numpy(src))]

    def by_onnxruntime() -> Maps:
        return [np.asarray(map_) for map_ in session.run(None, dict(zip(INPUTS, (ref, src), strict=True)))]

    runs = (by_torch, by_onnxruntime)
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(_TURNS):
        for run, taken_s in zip(runs, seconds, strict=True):
            taken_s.append(_seconds(run))
    agrees = np.all([np.abs(a - b) <= TOLERANCE for a, b in zip(*(run() for run in runs), strict=True)], axis=0)
    return OnnxComparison(
        hw=hw,
        differing=float(1 - agrees.mean()),
        torch_s=min(seconds[0]),
        onnxruntime_s=min(seconds[1]),
        threads=threads,
    )


def example_views(hw: tuple[int, int], window: Window) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(1, 3, H, W) each: a rendered pair whose disparities fill a window, its src view twice as coarse."""
    rng = np.random.default_rng(0)
    pair = render_pair(random_scene(rng, hw=hw, disparity_window_px=window))
    views = pair.ref, degrade(pair.src, Degradation(factor=2.0), rng=rng)
    ref, src = (np.ascontiguousarray(view.transpose(2, 0, 1)[None], dtype=np.float32) for view in views)
    return ref, src


def _seconds(run: Callable[[], Maps]) -> float:
    begun_s = time.perf_counter()
    run()
    return time.perf_counter() - begun_s
