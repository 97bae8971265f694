"""The rectified view of a rig: its rotation, its size, and where points of the photos lie in it.

One orthogonal matrix ``rect_from_tele`` turns tele's frame so that wide lies on the positive x axis:

    rect_from_tele @ tele_from_wide's translation = (baseline_m, 0, 0)

It is, in this order: a quarter turn counter-clockwise where the baseline is rather vertical, a mirror where wide is on
the other side (its determinant is then -1), and the smallest rotation that does the rest. Both rectified views have
this frame and the focal length of tele, scaled by the working size; a mirrored baseline needs no formula of its own:

    disparity_px = x_ref - x_src = f_px * baseline_m / z_rect_m - doffs_px,    doffs_px = cx_src - cx_ref

The canvas holds the whole tele photo, and to its left a margin of the largest disparity, so that what src sees of
tele's border is not lost; in the margin ref sees nothing.
Pixel (0, 0) is the centre of the top-left pixel. Letters: N points; Q ``rect_from_tele``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from telewide.errors import InputError
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import Camera, StereoRig
from telewide.ranges import MAX_CANVAS

MARGIN_SHARE = 1 / 16
"""Margin for the disparities, of the width of the tele photo: 12 mm of baseline, 27 degrees of view, 0.4 m."""
MAX_TILT_DEG = 45.0
"""Largest angle of the baseline to the picture plane."""
_MAX_VIEW_DEG = 75.0  # between the optical axis of a rectified view and the border of the tele photo
_BORDER_POINTS = 256  # on each side of the photo: the border is curved by distortion
_SAME_SHAPE = 0.01
_WHOLE_PX = 1e-3  # a canvas this much larger than whole pixels is rounded down


@dataclass(frozen=True)
class RectifiedGeometry:
    """Where the points of two photos lie in their rectified views, and back.

    Attributes:
        rig: the two cameras, at the sizes of the photos.
        hw: height and width of both rectified views.
        f_px: focal length of both, px.
        rect_from_tele: (3, 3) orthogonal, determinant -1 where the views are mirrored.
        ref_centre_px: (2,) principal point of the rectified ref; src's lies ``doffs_px`` further to the right.
        doffs_px: ``cx_src - cx_ref``, px.
        margin_px: columns at the left that only src sees.
    """

    rig: StereoRig
    hw: tuple[int, int]
    f_px: float
    rect_from_tele: FloatArray
    ref_centre_px: FloatArray
    doffs_px: float
    margin_px: int

    @property
    def scale(self) -> float:
        """Pixels of the rectified views for one pixel of the tele photo."""
        return self.f_px / self.rig.tele.f_px

    @property
    def src_centre_px(self) -> FloatArray:
        """(2,) principal point of the rectified src."""
        return np.asarray(self.ref_centre_px + np.array([self.doffs_px, 0.0]))

    @property
    def wide_from_rect(self) -> FloatArray:
        """(3, 3) orthogonal: directions of the rectified frame in wide's."""
        tele_from_rect = self.rect_from_tele.T
        wide_from_tele = self.rig.wide_from_tele[:3, :3]
        return np.asarray(wide_from_tele @ tele_from_rect)

    def ref_from_tele(self, points_px: FloatArray) -> FloatArray:
        """Points (N, 2) of the tele photo in the rectified ref, px."""
        return self._rectified(self.rig.tele.normalised(points_px), self.rect_from_tele, self.ref_centre_px)

    def tele_from_ref(self, points_px: FloatArray) -> FloatArray:
        """Points (N, 2) of the rectified ref in the tele photo, px."""
        return self.rig.tele.project(self._rays(points_px, self.ref_centre_px) @ self.rect_from_tele)

    def src_from_wide(self, points_px: FloatArray) -> FloatArray:
        """Points (N, 2) of the wide photo in the rectified src, px."""
        return self._rectified(self.rig.wide.normalised(points_px), self.wide_from_rect.T, self.src_centre_px)

    def wide_from_src(self, points_px: FloatArray) -> FloatArray:
        """Points (N, 2) of the rectified src in the wide photo, px."""
        return self.rig.wide.project(self._rays(points_px, self.src_centre_px) @ self.wide_from_rect.T)

    def tele_depth_per_rectified_depth(self, points_px: FloatArray) -> FloatArray:
        """Ratio of the depths of one surface point along the two optical axes, tele's and the rectified one.

        A point on the ray ``r = ((x - cx) / f, (y - cy) / f, 1)`` of the rectified frame at the depth ``z_rect`` has
        the depth ``z_rect (Q^T r)_z`` in tele's frame: not the same unless only the picture plane was turned.

        Args:
            points_px: (N, 2) px of the rectified ref.

        Returns:
            (N,) ``z_tele / z_rect``.
        """
        return np.asarray(self._rays(points_px, self.ref_centre_px) @ self.rect_from_tele[:, 2])

    def _rays(self, points_px: FloatArray, centre_px: FloatArray) -> FloatArray:
        points = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
        return np.column_stack([(points - centre_px) / self.f_px, np.ones(len(points))])

    def _rectified(self, normalised: FloatArray, rect_from_camera: FloatArray, centre_px: FloatArray) -> FloatArray:
        rays = np.column_stack([normalised, np.ones(len(normalised))]) @ rect_from_camera.T
        return np.asarray(self.f_px * rays[:, :2] / rays[:, 2:] + centre_px)


def rectified_geometry(
    rig: StereoRig,
    *,
    working_width_px: int | None = None,
    disparity_margin_px: int | None = None,
    doffs_px: float = 0.0,
) -> RectifiedGeometry:
    """Lay out the rectified views of a rig.

    Args:
        rig: the two cameras, at the sizes of the photos.
        working_width_px: width of the rectified views, margin included; None, or more than there is, for one pixel of
            tele each.
        disparity_margin_px: largest disparity whose partner in src is kept, px of the rectified views; None for
            `MARGIN_SHARE` of the width.
        doffs_px: ``cx_src - cx_ref``, px of the rectified views; what is to be taken off every disparity.

    Returns:
        The layout; the same for the same rig and options.

    Raises:
        InputError: the cameras cannot be rectified: no baseline, it points into the picture, or they do not face one
            way.
    """
    rect_from_tele = rectifying_rotation(rig)
    border = rig.tele.normalised(_border_px(rig.tele.hw))
    rays = np.column_stack([border, np.ones(len(border))]) @ rect_from_tele.T
    _check_facing(rig, rays, rect_from_tele)
    low_xy, high_xy = (edge(rays[:, :2] / rays[:, 2:], axis=0) for edge in (np.min, np.max))
    full_width_px = float(high_xy[0] - low_xy[0]) * rig.tele.f_px
    share, known_px = (MARGIN_SHARE, 0) if disparity_margin_px is None else (0.0, disparity_margin_px)
    fitting = math.inf if working_width_px is None else (working_width_px - known_px) / (full_width_px * (1 + share))
    if fitting <= 0:
        raise ValueError(f"a working width of {working_width_px} px has no room beside a margin of {known_px} px")
    f_px = rig.tele.f_px * min(1.0, fitting)
    extent_px = (high_xy - low_xy) * f_px
    shown_wh = np.ceil(extent_px - _WHOLE_PX)
    margin_px = known_px + math.floor(extent_px[0] * share + _WHOLE_PX)
    centre_px = np.array([margin_px, 0]) - 0.5 - low_xy * f_px + np.maximum(shown_wh - extent_px, 0) / 2
    check_canvas(shown_wh, rig)
    hw = (int(shown_wh[1]), int(shown_wh[0]) + margin_px)
    return RectifiedGeometry(
        rig=rig,
        hw=hw,
        f_px=f_px,
        rect_from_tele=rect_from_tele,
        ref_centre_px=centre_px,
        doffs_px=float(doffs_px),
        margin_px=margin_px,
    )


def rectifying_rotation(rig: StereoRig) -> FloatArray:
    """Turn tele's frame so that wide lies on the positive x axis, by as little as that takes.

    Args:
        rig: the two cameras.

    Returns:
        (3, 3) ``rect_from_tele``, orthogonal; its determinant is -1 where it mirrors.

    Raises:
        InputError: the lenses stand at one place, or one behind the other.
    """
    baseline_m = -rig.wide_from_tele[:3, :3].T @ rig.wide_from_tele[:3, 3]  # wide's place in tele's frame
    length_m = float(np.linalg.norm(baseline_m))
    if not (np.isfinite(length_m) and length_m > 0):
        raise InputError("the rig has no baseline: both lenses stand at one place, so no depth can be seen")
    direction = baseline_m / length_m
    tilt_deg = math.degrees(math.asin(min(1.0, abs(float(direction[2])))))
    if tilt_deg > MAX_TILT_DEG:
        raise InputError(
            f"the baseline of the rig points {tilt_deg:.0f} degrees out of the picture plane; up to {MAX_TILT_DEG:.0f} "
            "can be rectified",
            hint="calibrate again: two lenses of one phone stand beside each other",
        )
    upright = np.eye(3)
    if abs(direction[1]) > abs(direction[0]):
        upright[:2, :2] = [[0, 1], [-1, 0]]  # a quarter turn counter-clockwise, as seen in the picture
    if (upright @ direction)[0] < 0:
        upright = np.diag([-1.0, 1.0, 1.0]) @ upright
    return np.asarray(_smallest_rotation_to_x(upright @ direction) @ upright)


def rig_at_sizes(rig: StereoRig, *, tele_hw: tuple[int, int], wide_hw: tuple[int, int]) -> StereoRig:
    """Fit a rig to photos that were resized since it was calibrated.

    Args:
        rig: as calibrated.
        tele_hw: size of the tele photo.
        wide_hw: size of the wide photo.

    Returns:
        The rig for photos of these sizes.

    Raises:
        InputError: a photo has another shape than the camera's: it was turned or cropped.
    """
    _refuse_turned({"tele": (rig.tele, tele_hw), "wide": (rig.wide, wide_hw)})
    tele, wide = _camera_at_size("tele", rig.tele, tele_hw), _camera_at_size("wide", rig.wide, wide_hw)
    return replace(rig, tele=tele, wide=wide)


def _refuse_turned(views: dict[str, tuple[Camera, tuple[int, int]]]) -> None:
    """Say of photos in portrait and a calibration in landscape, or the reverse, that this is what is wrong."""
    turned = [name for name, (camera, hw) in views.items() if _is_turned(camera, hw)]
    if not turned:
        return
    camera, hw = views[turned[0]]
    sizes = f"{turned[0]} is {_size(hw)}, the rig was made with {_size(camera.hw)}"
    if len(turned) == len(views):
        raise InputError(
            f"both photos are turned by 90 degrees against the calibration: {sizes}",
            hint="hold the phone as for the photos the rig was made from, or make another rig from photos taken so",
        )
    (other,) = views.keys() - set(turned)
    raise InputError(
        f"the {turned[0]} photo is turned by 90 degrees against the {other} photo and against the calibration: {sizes}",
        hint=f"photograph both in one position of the phone, or turn {turned[0]} back without loss, as {other} lies",
    )


def _is_turned(camera: Camera, hw: tuple[int, int]) -> bool:
    """Whether a photo has the camera's shape with width and height exchanged, at any size."""
    is_square = abs(camera.hw[0] / camera.hw[1] - 1) < _SAME_SHAPE
    return not is_square and abs(hw[0] / camera.hw[1] - hw[1] / camera.hw[0]) < _SAME_SHAPE


def _size(hw: tuple[int, int]) -> str:
    return f"{hw[1]} x {hw[0]} px"


def _camera_at_size(name: str, camera: Camera, hw: tuple[int, int]) -> Camera:
    if tuple(hw) == tuple(camera.hw):
        return camera
    scales = sorted((hw[0] / camera.hw[0], hw[1] / camera.hw[1]))
    # Both sides are the same multiple but for rounding to whole pixels.
    if (scales[1] - scales[0]) * max(camera.hw) > 1.5 * max(1.0, scales[1]):
        raise InputError(
            f"the {name} photo is {_size(hw)}; the rig was calibrated with photos of {_size(camera.hw)}",
            hint="use photos as they were taken, uncropped, and the rig of the same phone; for rectified photos state "
            "rectified: true in captures.yaml, and no rig is looked for",
        )
    return camera.resized((int(hw[0]), int(hw[1])))


def _smallest_rotation_to_x(direction: FloatArray) -> FloatArray:
    """Rotation about ``direction x e_x`` that takes a unit vector to e_x (Rodrigues, with 1 + cos below)."""
    axis = np.cross(direction, [1.0, 0.0, 0.0])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + float(direction[0])))


def _border_px(hw: tuple[int, int]) -> FloatArray:
    """Points on the outer edges of the outer pixels."""
    along = np.linspace(0, 1, _BORDER_POINTS)
    x, y = along * hw[1] - 0.5, along * hw[0] - 0.5
    sides = [(x, np.full_like(x, -0.5)), (x, np.full_like(x, hw[0] - 0.5))]
    sides += [(np.full_like(y, -0.5), y), (np.full_like(y, hw[1] - 0.5), y)]
    return np.concatenate([np.column_stack(side) for side in sides])


def check_canvas(shown_wh: FloatArray, rig: StereoRig) -> None:
    """Refuse a view that takes far more pixels than tele's photo has: no rig of these photos asks for it.

    Args:
        shown_wh: width and height of the view, px; not finite where a distortion cannot be undone.
        rig: which asks for it.

    Raises:
        InputError: it is too large.
    """
    if not np.isfinite(shown_wh).all():
        raise InputError("the distortion of tele cannot be undone at the border of its photo", hint="calibrate again")
    if not shown_wh.prod() <= MAX_CANVAS * math.prod(rig.tele.hw):
        raise InputError(
            f"the rectified views of this rig would have {shown_wh[0]:.0f} x {shown_wh[1]:.0f} px, its tele photo has "
            f"{rig.tele.hw[1]} x {rig.tele.hw[0]}",
            hint="calibrate again",
        )


def _check_facing(rig: StereoRig, border_rays: FloatArray, rect_from_tele: FloatArray) -> None:
    """Refuse a tele photo that is seen at a grazing angle, or from behind, by one of the rectified views."""
    if not np.isfinite(border_rays).all():
        raise InputError("the distortion of tele cannot be undone at the border of its photo", hint="calibrate again")
    wide_from_tele = rig.wide_from_tele[:3, :3]
    tele_from_rect = rect_from_tele.T
    wide_rays = border_rays @ (wide_from_tele @ tele_from_rect).T
    lengths = np.linalg.norm(border_rays, axis=1)
    if min((rays[:, 2] / lengths).min() for rays in (border_rays, wide_rays)) < math.cos(math.radians(_MAX_VIEW_DEG)):
        raise InputError(
            "the rig cannot be rectified: tele and wide do not both face across the baseline", hint="calibrate again"
        )
