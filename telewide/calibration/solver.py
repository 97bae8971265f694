"""From the corners of a board in many shots to a rig.

Each lens is solved alone, from every view it has; then the two lenses against each other, from the corners both see;
then everything at once. Letters: S shots; N corners of the board.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from telewide.boards.shots import DetectedShot
from telewide.calibration.checks import LEAST_BASELINE_M, Evidence, quality_of
from telewide.calibration.distortion import ASPECT, BELIEVED, CX, CY, N_LENS, F, n_coefficients
from telewide.calibration.exchanged_lenses import WIDER
from telewide.calibration.extrinsics import (
    Agreement,
    agreement,
    first_rig,
    joint_shots,
    settled_rig,
    solve_together,
    used_views,
)
from telewide.calibration.intrinsics import LensFit, fit_lens
from telewide.calibration.model_selection import free_numbers, raised_models
from telewide.calibration.problem import RIG, Problem, State
from telewide.calibration.result import Calibration, CameraStd, TransformStd
from telewide.calibration.sightings import MIN_VIEWS, Gathered, gather, square_px
from telewide.calibration.uncertainty import Uncertainty, uncertainty
from telewide.calibration.validation import rig_of, validate
from telewide.calibration.views import view_results
from telewide.errors import InputError
from telewide.geometry.arrays import FloatArray

_ROUNDS = 4
_CONTRADICTS_SQUARES = 0.25
"""Joint shots whose typical error exceeds this part of a square in every second shot show no common rig."""


@dataclass(frozen=True)
class _Solution:
    problem: Problem
    state: State
    agreed: Agreement

    @property
    def baseline_m(self) -> float:
        return float(np.linalg.norm(self.state.rig_t))


@dataclass(frozen=True)
class _First:
    """A solution, the views it was found from, and which numbers of it were fitted."""

    gathered: Gathered
    solution: _Solution
    free: NDArray[np.bool_]


def calibrate_rig(
    shots: Sequence[DetectedShot], *, board_points_m: FloatArray, is_scale_known: bool = True, seed: int = 0
) -> Calibration:
    """Calibrate two lenses that photographed a board, together or alone.

    Args:
        shots: corners by shot; the lenses may differ in photo size and focal length, and see different corners.
        board_points_m: (N, 3) corners in the board's frame by their id, z = 0.
        is_scale_known: False where the board was not measured.
        seed: of the choice of views that are held out.

    Returns:
        The calibration; ``quality.verdict`` says whether it can be used, ``quality.checks`` what to photograph next.

    Raises:
        InputError: no rig can be had: too few views, shots that contradict each other, lenses exchanged.
    """
    rng = np.random.default_rng(seed)
    first = _first_solution(shots, board_m=board_points_m, set_aside={}, rng=rng)
    if is_scale_known:
        first = _of_two_lenses(shots, first, board_m=board_points_m, rng=rng)
    gathered, solution = first.gathered, first.solution
    free = raised_models(solution.problem, solution.state, free=first.free, rng=rng)
    problem, state = solve_together(solution.problem, solution.state, free=free)
    solution = replace(solution, problem=problem, state=state)
    sure = uncertainty(solution.problem, solution.state, free=_doubted(free))
    validation = validate(solution.problem, solution.state, free=free, rng=rng)
    sizes = {"tele_hw": gathered.views[0].hw, "wide_hw": gathered.views[1].hw}
    rig = rig_of(solution.state, **sizes, is_scale_known=is_scale_known)
    halves = [rig_of(half, **sizes, is_scale_known=is_scale_known) for half in validation.halves or ()]
    views = view_results(shots, gathered, solution.agreed, state=solution.state, board_m=board_points_m)
    evidence = Evidence(
        views=views,
        rig=rig,
        half_rigs=(halves[0], halves[1]) if halves else None,
        epipolar_px=validation.epipolar_px,
        stds=(_camera_std(sure, solution.state, lens=0), _camera_std(sure, solution.state, lens=1)),
        transform_std=_transform_std(sure, solution.state),
        excess=sure.excess,
    )
    return _calibration(evidence)


def _calibration(evidence: Evidence) -> Calibration:
    return Calibration(
        rig=evidence.rig,
        tele_std=evidence.stds[0],
        wide_std=evidence.stds[1],
        transform_std=evidence.transform_std,
        views=evidence.views,
        half_rigs=evidence.half_rigs,
        quality=quality_of(evidence),
    )


def _first_solution(
    shots: Sequence[DetectedShot],
    *,
    board_m: FloatArray,
    set_aside: Mapping[tuple[int, int], str],
    rng: np.random.Generator,
) -> _First:
    gathered = gather(shots, board_points_m=board_m, set_aside=set_aside)
    fits = [fit_lens(views, board_m=board_m, n_shots=len(shots), rng=rng) for views in gathered.views]
    free = np.concatenate([fits[0].free, fits[1].free, np.ones(6, dtype=bool)])
    _refuse_exchanged(fits, gathered)
    return _First(gathered, _solved(fits, gathered, board_m=board_m, free=free), free)


def _of_two_lenses(
    shots: Sequence[DetectedShot], first: _First, *, board_m: FloatArray, rng: np.random.Generator
) -> _First:
    """Tell shots of two lenses from those of one lens twice, where some of the shots contradict the others.

    A phone that gives an enlarged piece of its wide photo as tele does so for some of the shots: those agree with each
    other as well as the true ones do, but on lenses that stand in one place.

    Returns:
        The solution from the shots of two lenses, the others set aside with that reason; the first where the shots that
        contradict it have no solution of their own, or one that tells no more.
    """
    taking_part = _tele_views(first, is_used=True)
    if len(_tele_views(first, is_used=False)) < MIN_VIEWS:
        return first
    try:
        aside = dict.fromkeys(taking_part, "")
        second = _first_solution(shots, board_m=board_m, set_aside=aside, rng=rng.spawn(1)[0])
    except InputError:  # they contradict each other too
        return first
    one_lens, two_lenses = sorted((first, second), key=lambda each: each.solution.baseline_m)
    if not one_lens.solution.baseline_m < LEAST_BASELINE_M <= two_lenses.solution.baseline_m:
        return first
    reason = (
        f"the same lens twice: tele and wide stand {one_lens.solution.baseline_m * 1e3:.1f} mm apart in these shots, "
        f"{two_lenses.solution.baseline_m * 1e3:.1f} mm in the others; the phone gave an enlarged piece of its wide "
        "photo as tele, as it does near and in dim light"
    )
    twice = dict.fromkeys(_tele_views(one_lens, is_used=True), reason)
    return _first_solution(shots, board_m=board_m, set_aside=twice, rng=rng)


def _tele_views(found: _First, *, is_used: bool) -> list[tuple[int, int]]:
    """Tele views of joint shots that take part, or do not, by shot index and lens index."""
    tele, wide = found.gathered.views
    used = found.solution.agreed.is_used(0)
    return [(int(shot), 0) for shot in tele.shot if used[shot] == is_used and shot in wide.shot]


def _doubted(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The fitted numbers, and those that were held because the photos do not tell them, which makes others unsure."""
    return free | free_numbers(BELIEVED, lens=0) | free_numbers(BELIEVED, lens=1)


def _refuse_exchanged(fits: Sequence[LensFit], gathered: Gathered) -> None:
    both = zip(fits, gathered.views, strict=True)
    tangents = [float(np.hypot(*views.hw) / 2 / fit.lens[F]) for fit, views in both]
    if tangents[0] > WIDER * tangents[1]:
        angles = 2 * np.degrees(np.arctan(tangents))
        raise InputError(
            f"the tele photos show more ({angles[0]:.0f} degrees across) than the wide ones ({angles[1]:.0f})",
            hint="the photos of the two lenses were exchanged: put those of the longer lens under tele",
        )


def _solved(fits: Sequence[LensFit], gathered: Gathered, *, board_m: FloatArray, free: NDArray[np.bool_]) -> _Solution:
    """Everything at once, from the views that agree; sorted anew until the same ones agree."""
    problem = Problem(
        board_m,
        gathered.views,
        (fits[0].sigma_px, fits[1].sigma_px),
        *(np.stack([fit.prior[k] for fit in fits]) for k in (0, 1)),
    )
    _refuse_without_joint(problem, fits)
    state = settled_rig(
        _fitting_alone(problem, fits), first_rig(_fitting_alone(problem, fits), fits[0].state, fits[1].state)
    )
    agreed = agreement(problem, state)
    _refuse_contradiction(problem, agreed)
    for _ in range(_ROUNDS):
        used, state = solve_together(used_views(problem, agreed), agreed.state, free=free)
        problem = replace(problem, sigma_px=used.sigma_px)
        before, agreed = agreed, agreement(problem, state)
        if all(np.array_equal(before.is_used(lens), agreed.is_used(lens)) for lens in (0, 1)):
            break
    return _Solution(used, state, replace(before, state=_state_of_all(agreed, state, before)))


def _state_of_all(agreed: Agreement, state: State, used: Agreement) -> State:
    """The solution's poses for the shots that took part, the best placement for the others."""
    took_part = used.is_used(0) | used.is_used(1)
    return replace(
        state,
        pose_R=np.where(took_part[:, None, None], state.pose_R, agreed.state.pose_R),
        pose_t=np.where(took_part[:, None], state.pose_t, agreed.state.pose_t),
    )


def _fitting_alone(problem: Problem, fits: Sequence[LensFit]) -> Problem:
    tele, wide = (views.only(fit.is_used) for views, fit in zip(problem.views, fits, strict=True) if views is not None)
    return replace(problem, views=(tele, wide))


def _refuse_without_joint(problem: Problem, fits: Sequence[LensFit]) -> None:
    if joint_shots(problem).any() and joint_shots(_fitting_alone(problem, fits)).any():
        return
    raise InputError(
        "no shot shows the board in both the tele and the wide photo, so how the lenses stand to each other is unknown",
        hint="take 15 to 25 shots with both lenses at once, the board filling the tele photo, tilted to all sides",
    )


def _refuse_contradiction(problem: Problem, agreed: Agreement) -> None:
    """Stop where the two photos of most shots do not belong together."""
    candidates = agreed.alone[0] & agreed.alone[1]
    if candidates.sum() < 2:
        return
    squares = np.zeros(len(candidates))
    for lens, views in enumerate(problem.both):
        for shot, points_px, seen in zip(views.shot, views.points_px, views.is_seen, strict=True):
            squares[shot] = np.fmax(squares[shot], agreed.together_px[lens][shot] / square_px(points_px[seen]))
    typical = float(np.median(squares[candidates]))
    if typical > _CONTRADICTS_SQUARES:
        raise InputError(
            f"the tele and wide photos of most of the {candidates.sum()} joint shots contradict each other: with any "
            f"one rig, half of them are off by more than {typical:.1f} squares",
            hint="check that tele and wide photos of one shot carry the same name, and that nothing moved between them",
        )


def _camera_std(sure: Uncertainty, state: State, *, lens: int) -> CameraStd:
    std = np.sqrt(np.maximum(np.diag(sure.covariance), 0))[lens * N_LENS : (lens + 1) * N_LENS]
    n = n_coefficients(state.lenses[lens])
    return CameraStd(float(std[F]), float(std[CX]), float(std[CY]), std[4 : 4 + n].copy(), aspect=float(std[ASPECT]))


def _transform_std(sure: Uncertainty, state: State) -> TransformStd:
    covariance = sure.covariance[RIG, RIG]
    std = np.sqrt(np.maximum(np.diag(covariance), 0))
    along = state.rig_t / max(float(np.linalg.norm(state.rig_t)), 1e-300)
    baseline_m = float(np.sqrt(max(float(along @ covariance[3:, 3:] @ along), 0.0)))
    return TransformStd(np.degrees(std[:3]), std[3:], baseline_m, covariance.copy())
