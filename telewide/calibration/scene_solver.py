"""A rig without a board, from matches of ordinary captures: what EXIF says is the prior, the matches say the rest.

Solved jointly over all captures: wide's rotation, its focal length against tele's, both principal points, one
coefficient of radial distortion of each lens, the direction of the baseline; and for each capture what autofocus and
stabilisation moved. The length of the baseline is never seen, and the zero of disparity hardly: the standard deviations
say so.
Without the distortion, small as it is once a phone has corrected its photos, the principal point and the baseline would
take it up, and the zero with them.
Letters: S captures, N matches of one capture, K parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.scene_rig import (
    DIRECTIONS,
    FocalPrior,
    SceneRig,
    SceneStd,
    Side,
    SideSource,
    place_words,
    scene_notes,
    stated_baseline_std_m,
    wide_centre,
)
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rectification import rectifying_rotation
from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.points.epipolar import across_in_wide, epipolar_misfit_px, matching_unit_px, rectified_points
from telewide.points.matches import Matches
from telewide.points.robust import RobustFit, fit_robustly, numeric_jacobian

MIN_SCENES = 3
"""Fewer captures than this carry no rig."""
MIN_SCENE_MATCHES = 40
"""A capture with fewer matches than this has no say."""
_MAX_SCENE_MATCHES = 300
_MAX_MATCHES_AT_FIRST = 60
_MAX_SCENES_AT_FIRST = 8
_ROTATION_PRIOR_RAD = float(np.radians(2.0))
_OUT_OF_PLANE_PRIOR_RAD = 0.1
_AZIMUTH_PRIOR_RAD = 2.0
_MOST_ELEVATION_RAD = 0.5
_CENTRE_PRIOR_SHARE = 0.01
_SHOT_PRIOR = (4.0, 0.003, 0.005)
_DISTORTION_PRIOR = 0.02
"""Of k1: several times what a phone leaves in photos it corrected; lenses that bend more outvote it."""
_N_GLOBAL = 13
_UNDISTORTION_STEPS = 4
_N_SHOT = 3
_FAR_SHARE = 0.5
_CONTRADICTING_DEG, _SURE_DIRECTION_DEG = 60.0, 10.0
_AZIMUTHS_DEG = (0.0, 45.0, 90.0, 135.0)


@dataclass(frozen=True)
class _Scenes:
    """Data the solution is fitted to: matches of all captures in a row, photo sizes, priors.

    Attributes:
        matches: N of all captures.
        scene: (N,) number of each match's capture, from 0.
        tele_hw: size of tele's photos.
        wide_hw: size of wide's photos.
        focal: priors of the focal lengths.
        azimuth_rad: direction of the baseline in tele's picture plane to begin with.
    """

    matches: Matches
    scene: NDArray[np.intp]
    tele_hw: tuple[int, int]
    wide_hw: tuple[int, int]
    focal: FocalPrior
    azimuth_rad: float = 0.0

    @property
    def n(self) -> int:
        """Number of captures."""
        return int(self.scene.max()) + 1 if len(self.scene) else 0

    @property
    def prior_std(self) -> FloatArray:
        """(K,) of the rig's parameters, then of each capture's."""
        unit_px = matching_unit_px(self.tele_hw)
        centre_px = _CENTRE_PRIOR_SHARE * max(self.wide_hw)
        offset_px, roll_rad, scale = _SHOT_PRIOR
        rig = [*[_ROTATION_PRIOR_RAD] * 3, self.focal.tele_std_share, self.focal.ratio_std_share, centre_px, centre_px]
        direction = [_AZIMUTH_PRIOR_RAD, _OUT_OF_PLANE_PRIOR_RAD]
        lenses = [_DISTORTION_PRIOR, _DISTORTION_PRIOR, *[_CENTRE_PRIOR_SHARE * max(self.tele_hw)] * 2]
        return np.array([*rig, *direction, *lenses, *[offset_px * unit_px, roll_rad, scale] * self.n])

    def rig(self, x: FloatArray) -> StereoRig:
        """The rig of parameters.

        Rotation (3), log of tele's f, log of the ratio, wide's centre (2, px), azimuth and elevation (rad), radial
        distortion k1 of tele and of wide, tele's centre (2, px).
        """
        tele_f = self.focal.tele_f_px * float(np.exp(x[3]))
        wide_f = self.focal.wide_f_px * float(np.exp(x[3] - x[4]))
        tele = Camera(self.tele_hw, _intrinsics(tele_f, self.tele_hw, x[11:13]), _radial(x[9]))
        wide = Camera(self.wide_hw, _intrinsics(wide_f, self.wide_hw, x[5:7]), _radial(x[10]))
        azimuth = self.azimuth_rad + x[7]
        # A step that tries too much must not turn the baseline towards the scene, where nothing can be rectified.
        elevation = _MOST_ELEVATION_RAD * np.tanh(x[8] / _MOST_ELEVATION_RAD)
        across = np.cos(elevation)
        centre = np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])
        turn = rigid_transform(rotation=x[:3], translation=np.zeros(3))[:3, :3]
        return StereoRig(tele, wide, rigid_transform(rotation=turn, translation=-turn @ centre), is_scale_known=False)

    def residuals(self, x: FloatArray) -> FloatArray:
        """(N,) misfits with each capture's offset across the baseline (px), roll (rad) and log of the focal scale.

        What :func:`telewide.points.epipolar.moved_rig` does to the rig is undone to the points instead.
        """
        rig = self.rig(x[:_N_GLOBAL])
        offset_px, roll_rad, log_scale = x[_N_GLOBAL:].reshape(-1, _N_SHOT)[self.scene].T
        shift_px = offset_px[:, None] / rig.asymmetry * across_in_wide(rig)
        wide = _undistorted(self.matches.src_px + shift_px, rig.wide) * np.exp(-log_scale)[:, None]
        cos, sin = np.cos(roll_rad), np.sin(roll_rad)
        unrolled = np.column_stack([cos * wide[:, 0] + sin * wide[:, 1], cos * wide[:, 1] - sin * wide[:, 0]])
        tele = _undistorted(self.matches.ref_px, rig.tele)
        return epipolar_misfit_px(tele, unrolled, wide_from_tele=rig.wide_from_tele, f_px=rig.tele.f_px)

    def jacobian(self, x: FloatArray) -> FloatArray:
        """(N, K); a capture's own columns are zero in the others' rows, so all captures are stepped at once."""
        step = 1e-3 * self.prior_std
        J = np.zeros((len(self.matches), len(x)))
        rows = np.arange(len(self.matches))
        for k in range(_N_GLOBAL + _N_SHOT):
            is_own = k >= _N_GLOBAL
            move = np.zeros(len(x))
            move[k :: _N_SHOT if is_own else len(x)] = step[k]
            slope = (self.residuals(x + move) - self.residuals(x - move)) / (2 * step[k])
            J[rows, k + _N_SHOT * self.scene if is_own else k] = slope
        return J


def first_rig(*, tele_hw: tuple[int, int], wide_hw: tuple[int, int], focal: FocalPrior) -> StereoRig:
    """Guess a rig from focal lengths alone: no turn, wide to the right; good enough to match photos by.

    Args:
        tele_hw: height and width of tele's photos.
        wide_hw: height and width of wide's photos.
        focal: focal lengths.

    Returns:
        The rig, without a scale.
    """
    nothing = Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    return _Scenes(
        matches=nothing, scene=np.zeros(0, dtype=np.intp), tele_hw=tele_hw, wide_hw=wide_hw, focal=focal
    ).rig(np.zeros(_N_GLOBAL))


def rig_from_scenes(
    scenes: Sequence[Matches],
    *,
    tele_hw: tuple[int, int],
    wide_hw: tuple[int, int],
    focal: FocalPrior,
    baseline_m: float | None = None,
    wide_side: Side | None = None,
    seed: int = 0,
) -> SceneRig:
    """Solve for a rig jointly over the matches of all captures.

    Args:
        scenes: S captures' matches, of photos as captured and of one size.
        tele_hw: height and width of tele's photos.
        wide_hw: height and width of wide's photos.
        focal: what is known of the focal lengths.
        baseline_m: distance of the lenses where it is stated; None leaves the scale open. Its standard deviation is
            that of :func:`stated_baseline_std_m`.
        wide_side: the side of tele on which wide stands, as seen from behind the phone with the photos upright:
            matches alone hardly tell one side from the other; None takes the likelier.
        seed: of the choice among many matches.

    Returns:
        The rig, with standard deviations.

    Raises:
        InputError: fewer than three captures have matches enough.
        UsageError: wide is stated on a side, and matches show that it stands neither there nor opposite.
    """
    rng = np.random.default_rng(seed)
    telling = tuple(_drawn(m, rng) for m in scenes if len(m) >= MIN_SCENE_MATCHES)
    if len(telling) < MIN_SCENES:
        raise InputError(
            f"a rig without a board needs {MIN_SCENES} captures with {MIN_SCENE_MATCHES} matches, found {len(telling)}",
            hint="photograph more scenes with texture at several distances, or calibrate with a board",
        )
    matches, scene = _in_a_row([_drawn(m, rng) for m in telling])
    few, few_scene = _in_a_row([_drawn(m, rng, at_most=_MAX_MATCHES_AT_FIRST) for m in telling[:_MAX_SCENES_AT_FIRST]])
    begun = _Scenes(matches=few, scene=few_scene, tele_hw=tele_hw, wide_hw=wide_hw, focal=focal)
    tried = []
    for azimuth_rad in np.radians(_AZIMUTHS_DEG):
        fit = _solved(replace(begun, azimuth_rad=float(azimuth_rad)))
        tried.append((fit.cost, float(azimuth_rad), fit.x[:_N_GLOBAL]))
    _, azimuth_rad, x_rig = min(tried, key=lambda candidate: candidate[0])
    solving = replace(begun, matches=matches, scene=scene, azimuth_rad=azimuth_rad)
    return _described(_solved(solving, x_rig=x_rig), solving, baseline_m=baseline_m, wide_side=wide_side)


def _solved(scenes: _Scenes, *, x_rig: FloatArray | None = None) -> RobustFit:
    start = np.zeros(_N_GLOBAL + _N_SHOT * scenes.n)
    if x_rig is not None:
        start[:_N_GLOBAL] = x_rig
    return fit_robustly(
        scenes.residuals,
        start,
        prior_std=scenes.prior_std,
        jacobian=scenes.jacobian,
        unit_px=matching_unit_px(scenes.tele_hw),
    )


def _described(fit: RobustFit, scenes: _Scenes, *, baseline_m: float | None, wide_side: Side | None) -> SceneRig:
    solved = scenes.rig(fit.x)
    zero_px = _zero_std_px(fit, scenes)
    is_backward, is_seen = _is_backward(solved, scenes, zero_px=zero_px)
    side_source: SideSource = "seen" if is_seen else "guessed"
    if wide_side is not None:
        is_opposite = _is_opposite(solved, wide_side, direction_std_rad=float(fit.std[7]))
        side_source = "contradicted" if is_seen and is_opposite != is_backward else "stated"
        is_backward = is_opposite
    transform = solved.wide_from_tele.copy()
    transform[:3, 3] *= (-1.0 if is_backward else 1.0) * (1.0 if baseline_m is None else baseline_m)
    rig, shift_px = _brought_in_front(StereoRig(solved.tele, solved.wide, transform, baseline_m is not None), scenes)
    std = SceneStd(
        tele_f_share=float(fit.std[3]),
        ratio_share=float(fit.std[4]),
        wide_centre_px=fit.std[5:7],
        rotation_rad=fit.std[:3],
        direction_rad=fit.std[7:9],
        distortion=fit.std[9:11],
        tele_centre_px=fit.std[11:13],
        zero_px=float(np.hypot(zero_px, shift_px)),
        baseline_m=0.0 if baseline_m is None else stated_baseline_std_m(baseline_m),
    )
    found = SceneRig(rig=rig, std=std, n_scenes=scenes.n, side_source=side_source, focal=scenes.focal)
    return replace(found, notes=tuple(scene_notes(found)))


def _is_opposite(rig: StereoRig, wide_side: Side, *, direction_std_rad: float) -> bool:
    """Whether the baseline's sign is to be turned for wide to stand on a side that was stated."""
    in_plane = wide_centre(rig)[:2]
    along = float(in_plane @ DIRECTIONS[wide_side] / max(float(np.linalg.norm(in_plane)), 1e-12))
    is_sure = np.degrees(direction_std_rad) < _SURE_DIRECTION_DEG
    if is_sure and abs(along) < np.cos(np.radians(_CONTRADICTING_DEG)):
        angle_deg = np.degrees(np.arctan2(abs(in_plane[1]), abs(in_plane[0])))
        raise UsageError(
            f"wide is stated to stand {place_words(wide_side)} tele, but matches show the line through the lenses "
            f"{angle_deg:.0f} degrees from the photos' rows",
            hint="name the side as seen from behind the phone, held so that the photos are upright",
        )
    return along < 0


def _zero_std_px(fit: RobustFit, scenes: _Scenes) -> float:
    """Spread of the disparity at infinity in the photo's middle, from the covariance of the rig's parameters."""
    middle = (np.array(scenes.tele_hw[::-1], dtype=np.float64) - 1) / 2
    rig = scenes.rig(fit.x)
    ray = rig.wide_from_tele[:3, :3] @ np.append(rig.tele.normalised(middle[None])[0], 1.0)
    at_infinity = rig.wide.project(ray[None])

    def disparity_px(x: FloatArray) -> FloatArray:
        tele, wide = rectified_points(middle[None], at_infinity, rig=scenes.rig(x))
        return np.asarray(rig.tele.f_px * (tele[:, 0] - wide[:, 0]))

    x = fit.x[:_N_GLOBAL]
    J = numeric_jacobian(disparity_px, x, step=1e-3 * scenes.prior_std[:_N_GLOBAL])[0]
    return float(np.sqrt(J @ fit.covariance[:_N_GLOBAL, :_N_GLOBAL] @ J))


def _disparity_px(rig: StereoRig, scenes: _Scenes) -> FloatArray:
    tele, wide = rectified_points(scenes.matches.ref_px, scenes.matches.src_px, rig=rig)
    return np.asarray(rig.tele.f_px * (tele[:, 0] - wide[:, 0]))


def _is_backward(rig: StereoRig, scenes: _Scenes, *, zero_px: float) -> tuple[bool, bool]:
    """Whether the baseline's sign is to be turned, and whether that can be told at all.

    All disparities are positive in front of the cameras, and something is usually twice as far as something else. Where
    the zero is not known well enough to say so, what is lower in the photos is taken to be nearer: a guess. That all
    disparities have one sign is not enough: phones were seen whose zero lies six standard deviations away.
    """
    disparity_px = _disparity_px(rig, scenes)
    low_px, high_px = np.percentile(disparity_px, (5, 95))
    near_px, far_px = (low_px, high_px) if -low_px > high_px else (high_px, low_px)
    if abs(low_px + high_px) > 2 * zero_px and abs(far_px) < _FAR_SHARE * abs(near_px):
        return bool(-low_px > high_px), True
    nearer_below = [
        np.corrcoef(disparity_px[scenes.scene == s], scenes.matches.ref_px[scenes.scene == s, 1])[0, 1]
        for s in range(scenes.n)
    ]
    return bool(np.nanmean(nearer_below) < 0), False


def _brought_in_front(rig: StereoRig, scenes: _Scenes) -> tuple[StereoRig, float]:
    """Shift wide's principal point along the baseline until nothing lies beyond infinity; the shift in tele px."""
    shift_px = -min(0.0, float(np.percentile(_disparity_px(rig, scenes), 1)))
    along = (rig.wide_from_tele[:3, :3] @ rectifying_rotation(rig)[0])[:2]
    K = rig.wide.K.copy()
    K[:2, 2] += shift_px / rig.asymmetry * along / np.linalg.norm(along)
    return replace(rig, wide=replace(rig.wide, K=K)), shift_px


def _in_a_row(scenes: Sequence[Matches]) -> tuple[Matches, NDArray[np.intp]]:
    ref_px, src_px = np.concatenate([m.ref_px for m in scenes]), np.concatenate([m.src_px for m in scenes])
    return Matches(ref_px, src_px), np.repeat(np.arange(len(scenes)), [len(m) for m in scenes])


def _drawn(matches: Matches, rng: np.random.Generator, *, at_most: int = _MAX_SCENE_MATCHES) -> Matches:
    return matches.select(np.sort(rng.permutation(len(matches))[:at_most]))


def _intrinsics(f_px: float, hw: tuple[int, int], centre_shift_px: FloatArray) -> FloatArray:
    centre = (np.array([hw[1], hw[0]]) - 1) / 2 + centre_shift_px
    return np.array([[f_px, 0.0, centre[0]], [0.0, f_px, centre[1]], [0.0, 0.0, 1.0]])


def _radial(k1: float) -> FloatArray:
    return np.array([k1, 0.0, 0.0, 0.0])


def _undistorted(points_px: FloatArray, camera: Camera) -> FloatArray:
    """Do what ``Camera.normalised`` does for a lens with k1 alone, fast: ``x = x_d / (1 + k1 |x|^2)``."""
    distorted = (points_px - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    points = distorted
    for _ in range(_UNDISTORTION_STEPS):
        points = distorted / (1 + camera.distortion[0] * np.sum(points**2, axis=1, keepdims=True))
    return np.asarray(points)
