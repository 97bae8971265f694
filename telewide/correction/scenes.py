"""A rig without a board, from matches of ordinary captures: what EXIF says is the prior, the matches say the rest.

Solved jointly over all captures: wide's rotation, its focal length against tele's, its principal point, the direction
of the baseline; and for each capture what autofocus and stabilisation moved. Lens distortion is taken as corrected by
the phone. The length of the baseline is never seen, and the zero of disparity hardly: the standard deviations say so.
Letters: S captures, N matches of one capture, K parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from telewide.correction.epipolar import epipolar_misfit_px, matching_unit_px, moved_rig, rectified_points
from telewide.correction.matches import Matches
from telewide.correction.robust import RobustFit, fit_robustly, numeric_jacobian
from telewide.errors import InputError
from telewide.geometry.rig import Camera, StereoRig, rigid_transform

FloatArray = NDArray[np.float64]

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
_CENTRE_PRIOR_SHARE = 0.01
_SHOT_PRIOR = (4.0, 0.003, 0.005)
_N_GLOBAL = 9
_N_SHOT = 3
_AZIMUTHS_DEG = (0.0, 45.0, 90.0, 135.0)


@dataclass(frozen=True)
class FocalPrior:
    """What is known of the focal lengths before any match is looked at.

    Attributes:
        tele_f_px: of tele, px of its photos.
        wide_f_px: of wide, px of its photos.
        tele_std_share: standard deviation over the value.
        ratio_std_share: standard deviation of ``tele_f / wide_f`` over the value.
    """

    tele_f_px: float
    wide_f_px: float
    tele_std_share: float = 0.05
    ratio_std_share: float = 0.05


@dataclass(frozen=True)
class SceneStd:
    """Standard deviations of a rig from scenes.

    Attributes:
        tele_f_share: of tele's focal length, over its value; that of EXIF, as matches do not show it.
        ratio_share: of the ratio of the focal lengths, over its value.
        wide_centre_px: (2,) of wide's principal point, px of its photos.
        rotation_rad: (3,) of wide's rotation.
        direction_rad: (2,) of the baseline's direction: in the picture plane, and out of it.
        zero_px: of the zero of disparity, tele px.
    """

    tele_f_share: float
    ratio_share: float
    wide_centre_px: FloatArray
    rotation_rad: FloatArray
    direction_rad: FloatArray
    zero_px: float


@dataclass(frozen=True)
class SceneRig:
    """A rig from scenes.

    Attributes:
        rig: the rig; its scale is known only where the baseline was stated.
        std: how sure it is.
        n_scenes: captures that had a say.
        notes: what a person should know.
    """

    rig: StereoRig
    std: SceneStd
    n_scenes: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Scenes:
    """What the solution is fitted to: matches, photo sizes, priors."""

    matches: tuple[Matches, ...]
    tele_hw: tuple[int, int]
    wide_hw: tuple[int, int]
    focal: FocalPrior
    azimuth_rad: float

    @property
    def prior_std(self) -> FloatArray:
        unit_px = matching_unit_px(self.tele_hw)
        centre_px = _CENTRE_PRIOR_SHARE * max(self.wide_hw)
        offset_px, roll_rad, scale = _SHOT_PRIOR
        rig = [*[_ROTATION_PRIOR_RAD] * 3, self.focal.tele_std_share, self.focal.ratio_std_share, centre_px, centre_px]
        direction = [_AZIMUTH_PRIOR_RAD, _OUT_OF_PLANE_PRIOR_RAD]
        return np.array([*rig, *direction, *[offset_px * unit_px, roll_rad, scale] * len(self.matches)])

    def rig(self, x: FloatArray) -> StereoRig:
        """Rotation (3), log of tele's f, log of the ratio, wide's centre (2, px), azimuth and elevation (rad)."""
        tele_f = self.focal.tele_f_px * float(np.exp(x[3]))
        wide_f = self.focal.wide_f_px * float(np.exp(x[3] - x[4]))
        tele = Camera(self.tele_hw, _intrinsics(tele_f, self.tele_hw, np.zeros(2)), np.zeros(0))
        wide = Camera(self.wide_hw, _intrinsics(wide_f, self.wide_hw, x[5:7]), np.zeros(0))
        azimuth, elevation = self.azimuth_rad + x[7], x[8]
        across = np.cos(elevation)
        centre = np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])
        turn = rigid_transform(rotation=x[:3], translation=np.zeros(3))[:3, :3]
        return StereoRig(tele, wide, rigid_transform(rotation=turn, translation=-turn @ centre), is_scale_known=False)

    def misfit_px(self, x_rig: FloatArray, x_shot: FloatArray, scene: int) -> FloatArray:
        """Misfit of one capture's matches: offset across the baseline (px), roll (rad), log of the focal scale."""
        rig = moved_rig(
            self.rig(x_rig),
            offset_px=float(x_shot[0]),
            scale=float(np.exp(x_shot[2])),
            rotation_vector=np.array([0.0, 0.0, x_shot[1]]),
        )
        matches = self.matches[scene]
        tele, wide = (_pinhole(p, c.K) for p, c in ((matches.ref_px, rig.tele), (matches.src_px, rig.wide)))
        return epipolar_misfit_px(tele, wide, wide_from_tele=rig.wide_from_tele, f_px=rig.tele.f_px)

    def residuals(self, x: FloatArray) -> FloatArray:
        return np.concatenate([self.misfit_px(x[:_N_GLOBAL], self.of_shot(x, s), s) for s in range(len(self.matches))])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """The rig's columns are full, a capture's own are zero elsewhere."""
        step = 1e-3 * self.prior_std
        J = np.zeros((sum(len(m) for m in self.matches), len(x)))
        row = 0
        for scene, matches in enumerate(self.matches):
            at = [*range(_N_GLOBAL), *range(_N_GLOBAL + _N_SHOT * scene, _N_GLOBAL + _N_SHOT * (scene + 1))]

            def of_scene(part: FloatArray, scene: int = scene) -> FloatArray:
                return self.misfit_px(part[:_N_GLOBAL], part[_N_GLOBAL:], scene)

            J[row : row + len(matches), at] = numeric_jacobian(of_scene, x[at], step=step[at])
            row += len(matches)
        return J

    def of_shot(self, x: FloatArray, scene: int) -> FloatArray:
        return x[_N_GLOBAL + _N_SHOT * scene : _N_GLOBAL + _N_SHOT * (scene + 1)]


def first_rig(*, tele_hw: tuple[int, int], wide_hw: tuple[int, int], focal: FocalPrior) -> StereoRig:
    """Guess a rig from focal lengths alone: no turn, wide to the right; good enough to match photos by.

    Args:
        tele_hw: height and width of tele's photos.
        wide_hw: height and width of wide's photos.
        focal: focal lengths.

    Returns:
        The rig, without a scale.
    """
    return _Scenes((), tele_hw, wide_hw, focal, 0.0).rig(np.zeros(_N_GLOBAL))


def rig_from_scenes(
    scenes: Sequence[Matches],
    *,
    tele_hw: tuple[int, int],
    wide_hw: tuple[int, int],
    focal: FocalPrior,
    baseline_m: float | None = None,
    seed: int = 0,
) -> SceneRig:
    """Solve for a rig jointly over the matches of all captures.

    Args:
        scenes: S captures' matches, of photos as captured and of one size.
        tele_hw: height and width of tele's photos.
        wide_hw: height and width of wide's photos.
        focal: what is known of the focal lengths.
        baseline_m: distance of the lenses where it is known; None leaves the scale open.
        seed: of the choice among many matches.

    Returns:
        The rig, with standard deviations.

    Raises:
        InputError: fewer than three captures have matches enough.
    """
    rng = np.random.default_rng(seed)
    telling = tuple(_drawn(m, rng) for m in scenes if len(m) >= MIN_SCENE_MATCHES)
    if len(telling) < MIN_SCENES:
        raise InputError(
            f"a rig without a board needs {MIN_SCENES} captures with {MIN_SCENE_MATCHES} matches, found {len(telling)}",
            hint="photograph more scenes with texture at several distances, or calibrate with a board",
        )
    few = tuple(_drawn(m, rng, at_most=_MAX_MATCHES_AT_FIRST) for m in telling[:_MAX_SCENES_AT_FIRST])
    azimuths_rad = [float(azimuth) for azimuth in np.radians(_AZIMUTHS_DEG)]
    tried = [_solved(_Scenes(few, tele_hw, wide_hw, focal, azimuth_rad)) for azimuth_rad in azimuths_rad]
    best = min(tried, key=lambda fit: fit.cost)
    scenes_of_all = _Scenes(telling, tele_hw, wide_hw, focal, azimuths_rad[tried.index(best)])
    return _described(_solved(scenes_of_all, x_rig=best.x[:_N_GLOBAL]), scenes_of_all, baseline_m=baseline_m)


def _solved(scenes: _Scenes, *, x_rig: FloatArray | None = None) -> RobustFit:
    start = np.zeros(_N_GLOBAL + _N_SHOT * len(scenes.matches))
    if x_rig is not None:
        start[:_N_GLOBAL] = x_rig
    return fit_robustly(
        scenes.residuals,
        start,
        prior_std=scenes.prior_std,
        jacobian=scenes.jacobian,
        unit_px=matching_unit_px(scenes.tele_hw),
    )


def _described(fit: RobustFit, scenes: _Scenes, *, baseline_m: float | None) -> SceneRig:
    rig = scenes.rig(fit.x)
    std = fit.std
    zero_px = _zero_std_px(fit, scenes)
    is_backward, is_sure = _is_backward(rig, scenes, zero_px=zero_px)
    transform = rig.wide_from_tele.copy()
    transform[:3, 3] *= (-1.0 if is_backward else 1.0) * (1.0 if baseline_m is None else baseline_m)
    notes = []
    if not is_sure:
        notes.append("on which side of tele wide stands could not be told: where near and far look exchanged, it did")
    if zero_px > 1.0:
        notes.append(f"the zero of disparity is known to {zero_px:.0f} px only: pin it with a known distance")
    if baseline_m is None:
        notes.append("the baseline is not known: depth is relative")
    return SceneRig(
        rig=StereoRig(rig.tele, rig.wide, transform, is_scale_known=baseline_m is not None),
        std=SceneStd(
            tele_f_share=float(std[3]),
            ratio_share=float(std[4]),
            wide_centre_px=std[5:7],
            rotation_rad=std[:3],
            direction_rad=std[7:9],
            zero_px=zero_px,
        ),
        n_scenes=len(scenes.matches),
        notes=tuple(notes),
    )


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


def _is_backward(rig: StereoRig, scenes: _Scenes, *, zero_px: float) -> tuple[bool, bool]:
    """Whether most points would lie behind the cameras, and whether that can be told at all."""
    matches = Matches(*(np.concatenate([getattr(m, side) for m in scenes.matches]) for side in ("ref_px", "src_px")))
    tele, wide = rectified_points(matches.ref_px, matches.src_px, rig=rig)
    low_px, high_px = np.percentile(rig.tele.f_px * (tele[:, 0] - wide[:, 0]), (5, 95))
    # in front of the cameras all disparities are positive
    return bool(-low_px > high_px), bool(abs(low_px + high_px) > 2 * zero_px)


def _drawn(matches: Matches, rng: np.random.Generator, *, at_most: int = _MAX_SCENE_MATCHES) -> Matches:
    return matches.select(np.sort(rng.permutation(len(matches))[:at_most]))


def _intrinsics(f_px: float, hw: tuple[int, int], centre_shift_px: FloatArray) -> FloatArray:
    centre = (np.array([hw[1], hw[0]]) - 1) / 2 + centre_shift_px
    return np.array([[f_px, 0.0, centre[0]], [0.0, f_px, centre[1]], [0.0, 0.0, 1.0]])


def _pinhole(points_px: FloatArray, K: FloatArray) -> FloatArray:
    return np.asarray((points_px - K[:2, 2]) / np.diag(K)[:2])
