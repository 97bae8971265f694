"""Validation of a calibration on photos it was not made from.

Letters: J joint shots; N corners; (h, w) a grid over the tele photo.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from telewide.calibration.bundle import solve_bundle
from telewide.calibration.distortion import camera_of
from telewide.calibration.extrinsics import epipolar_errors_px, joint_shots
from telewide.calibration.problem import Problem, State
from telewide.geometry.arrays import BoolArray, FloatArray
from telewide.geometry.rig import Camera, StereoRig, rigid_transform

GRID_HW = (12, 16)
"""Rows and columns of the grid on which two rigs are compared."""
_FOLDS = 5
_MIN_TO_HOLD_OUT = 4
_MIN_TO_HALVE = 6


@dataclass(frozen=True)
class Validation:
    """Errors on what was held out.

    Attributes:
        epipolar_px: (n,) held-out epipolar errors of all corners seen by both, tele px; empty with too few shots.
        halves: states from the odd and from the even shots; None with too few.
    """

    epipolar_px: FloatArray
    halves: tuple[State, State] | None


def validate(problem: Problem, state: State, *, free: BoolArray, rng: np.random.Generator) -> Validation:
    """Solve again without a fifth of the joint shots each, and from the odd and from the even shots.

    Args:
        problem: the views that took part.
        state: the solution from all of them.
        free: (30,) which shared numbers were fitted.
        rng: deals the shots into fifths.

    Returns:
        Errors on the shots left out, and the two half solutions.
    """
    joint = np.flatnonzero(joint_shots(problem))
    n_shots = len(state.pose_t)
    epipolar = [np.zeros(0)]
    if len(joint) >= _MIN_TO_HOLD_OUT:
        for out in np.array_split(rng.permutation(joint), min(_FOLDS, len(joint))):
            is_out = np.isin(np.arange(n_shots), out)
            solved = solve_bundle(problem.of_shots(~is_out), state, free=free)
            epipolar.append(epipolar_errors_px(problem.of_shots(is_out), solved))
    halves = None
    if len(joint) >= _MIN_TO_HALVE:
        odd = _odd_shots(problem, n_shots=n_shots)
        halves = (
            solve_bundle(problem.of_shots(odd), state, free=free),
            solve_bundle(problem.of_shots(~odd), state, free=free),
        )
    return Validation(np.concatenate(epipolar), halves)


def _odd_shots(problem: Problem, *, n_shots: int) -> BoolArray:
    """Every second joint shot and every second shot of each lens alone."""
    joint = np.zeros(n_shots, dtype=bool)
    found = joint_shots(problem)
    joint[: len(found)] = found
    odd = np.zeros(n_shots, dtype=bool)
    odd[np.flatnonzero(joint)[::2]] = True
    for views in problem.both:
        odd[views.shot[~joint[views.shot]][::2]] = True
    return odd


def rig_of(state: State, *, tele_hw: tuple[int, int], wide_hw: tuple[int, int], is_scale_known: bool) -> StereoRig:
    """The rig that a state is."""
    return StereoRig(
        tele=camera_of(state.lenses[0], hw=tele_hw),
        wide=camera_of(state.lenses[1], hw=wide_hw),
        wide_from_tele=rigid_transform(rotation=state.rig_R, translation=state.rig_t),
        is_scale_known=is_scale_known,
    )


def tele_grid_px(camera: Camera, *, grid_hw: tuple[int, int]) -> FloatArray:
    """Points (h * w, 2) px evenly spread over a camera's photo, row by row, half a step from its border."""
    ys, xs = ((np.arange(n) + 0.5) / n * size - 0.5 for n, size in zip(grid_hw, camera.hw, strict=True))
    return np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)


def difference_px(first: StereoRig, second: StereoRig, *, distance_m: float, grid_hw: tuple[int, int]) -> FloatArray:
    """Difference in how two rigs carry points of the tele photo to the wide photo.

    Args:
        first: a rig.
        second: another rig of the same photo sizes.
        distance_m: depth at which the points are taken.
        grid_hw: rows and columns of points over the tele photo.

    Returns:
        (h, w, 2) second less first, tele px: pixels of the wide photo times the asymmetry.
    """
    points_px = tele_grid_px(first.tele, grid_hw=grid_hw)
    in_wide = [_carried(rig, points_px, distance_m=distance_m) for rig in (first, second)]
    return np.asarray(((in_wide[1] - in_wide[0]) * first.asymmetry).reshape(*grid_hw, 2))


def _carried(rig: StereoRig, points_px: FloatArray, *, distance_m: float) -> FloatArray:
    rays = rig.tele.normalised(points_px)
    points_m = np.column_stack([rays, np.ones(len(rays))]) * distance_m
    return rig.wide.project(points_m @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3])
