"""The judge between steps, stages and matchers: sparse matches that nothing was fitted to and no crop has shown.

A match found in both directions says where a point of tele lies in wide. The share of matches a disparity map misses by
more than 1 px is comparable over matchers, losses and stages, and needs no ground truth.
Letters: N matches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.capture.pair import Capture, PairReader
from telewide.geometry.stereo import DisparityMap, FloatMap
from telewide.matching.inference import match_with_network
from telewide.matching.networks import StereoNetwork
from telewide.matching.volume import Window

Points = NDArray[np.float64]


@dataclass(frozen=True)
class HeldOut:
    """One capture with the matches kept for judging.

    Attributes:
        capture: corrected pair.
        ref_px: (N, 2) points (x, y) of tele.
        disparity_px: (N,) ``x_tele - x_wide`` of the matches.
    """

    capture: Capture
    ref_px: Points
    disparity_px: NDArray[np.float64]


def match_errors_px(disparity_px: FloatMap, held_out: HeldOut) -> NDArray[np.float64]:
    """Absolute error of a disparity map at the matches, bilinear in between: (N,) px."""
    xy = held_out.ref_px.astype(np.float32)
    sampled = cv2.remap(
        disparity_px, xy[:, :1], xy[:, 1:], interpolation=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.abs(sampled[:, 0].astype(np.float64) - held_out.disparity_px)


def summarise_errors(errors_px: NDArray[np.float64]) -> dict[str, float]:
    """Shares of matches off by more than 1 and 3 px, and the mean error; NaN without matches."""
    if not errors_px.size:
        return {"off_1px": math.nan, "off_3px": math.nan, "mean_px": math.nan, "matches": 0.0}
    return {
        "off_1px": float((errors_px > 1).mean()),
        "off_3px": float((errors_px > 3).mean()),
        "mean_px": float(errors_px.mean()),
        "matches": float(errors_px.size),
    }


def judge_matcher(
    matcher: Callable[[FloatMap, FloatMap], DisparityMap], held_out: Sequence[HeldOut], *, reader: PairReader
) -> dict[str, float]:
    """Run a matcher on the held-out captures and ask their matches; every match counts the same."""
    errors = []
    for item in held_out:
        pair = reader.read(item.capture)
        errors.append(match_errors_px(matcher(pair.tele, pair.wide).disparity_px, item))
    return summarise_errors(np.concatenate(errors) if errors else np.empty(0))


def network_judge(
    held_out: Sequence[HeldOut], *, window: Window, reader: PairReader
) -> Callable[[StereoNetwork], dict[str, float]]:
    """Bind the held-out captures into a judge for the training loop."""

    def judge(network: StereoNetwork) -> dict[str, float]:
        def match(ref: FloatMap, src: FloatMap) -> DisparityMap:
            return match_with_network(ref, src, network=network, window=window)

        return judge_matcher(match, held_out, reader=reader)

    return judge
