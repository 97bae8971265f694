"""A folder of the user's own rectified captures whose truth is known: ``tele``, ``wide`` and ``truth.pfm``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from telewide.benchmark.datasets.truth import StereoTruth
from telewide.capture.pair import Capture, find_captures, read_pair, read_truth
from telewide.errors import UsageError


def captures_with_truth(root: Path) -> tuple[str, ...]:
    """List the captures of a folder that have a truth, sorted."""
    return tuple(sorted(capture.name for capture in find_captures(root).captures if capture.truth_path is not None))


def read_capture_with_truth(root: Path, name: str) -> StereoTruth:
    """Read one capture: tele as the left view, wide, enlarged to its size, as the right one.

    Args:
        root: folder of the captures.
        name: of the capture.

    Raises:
        UsageError: there is no such capture, or it has no truth.
        InputError: a file cannot be read, or the truth has another size than tele.
    """
    captures = find_captures(root)
    capture = next((found for found in captures.captures if found.name == name), None)
    if capture is None:
        known = ", ".join(found.name for found in captures.captures)
        raise UsageError(f"{root} has no capture {name}", hint=f"known captures: {known}")
    pair = read_pair(capture, facts=captures.facts)
    disparity_px = read_truth(capture, hw=(pair.tele.shape[0], pair.tele.shape[1]))
    if disparity_px is None:
        raise UsageError(f"capture {name} in {root} has no truth; {_truth_name(capture)} was expected")
    if captures.facts.wide_side == "left":  # the pair is mirrored, the truth is of the photos as given
        disparity_px = -disparity_px[:, ::-1]
    return StereoTruth(pair.tele, pair.wide, np.asarray(disparity_px, dtype=np.float32))


def _truth_name(capture: Capture) -> Path:
    return capture.tele_path.with_name("truth.pfm")
