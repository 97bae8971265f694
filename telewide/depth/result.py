"""Result of one capture once its disparity is known: the map, the camera and, where the scale is known, metres.

``depth_m = f_px * baseline_m / (disparity_px + doffs_px)``, z along ref's optical axis, on the photo as it was given.
Nothing is invented: without a focal length there is no K, without a baseline no depth in metres.
Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from telewide.capture.facts import CaptureFacts
from telewide.depth.precision import DepthPrecision, depth_std_m, disparity_std_px
from telewide.drawing import upright, upright_mask
from telewide.geometry.arrays import FloatArray, FloatMap
from telewide.geometry.rig import StereoRig
from telewide.geometry.stereo import DisparityMap, depth_from_disparity

FARTHEST_M = 1000.0
"""A depth beyond is unknown: of lenses a centimetre apart, it is a disparity of hundredths of a pixel."""


@dataclass(frozen=True)
class DepthResult:
    """The answer for one capture.

    Attributes:
        name: of the capture.
        disparity: px of the ref photo, with its confidence and what was measured.
        K: (3, 3) float64 intrinsics of the ref photo, px; None where the focal length is not known.
        baseline_m: distance of the two lenses, m; None where not known.
        depth_m: (H, W) float32, m, NaN where unknown or beyond `FARTHEST_M`; None where K or the baseline is not known.
        depth_std_m: (H, W) float32, m, standard deviation of the depth, NaN where unknown; None without a rig.
        distortion: (n,) OpenCV coefficients of the ref photo; None where not known, empty where there is none.
        doffs_px: ``cx_src - cx_ref``, px; of the mirrored views where wide stands to the left of tele.
        rotated_deg: how far the photos were turned counter-clockwise before they were given (multiple of 90).
            The maps have that orientation; :func:`stood_upright` turns them back, as files and pictures have them.
    """

    name: str
    disparity: DisparityMap
    K: FloatArray | None = None
    baseline_m: float | None = None
    depth_m: FloatMap | None = None
    depth_std_m: FloatMap | None = None
    distortion: FloatArray | None = None
    doffs_px: float = 0.0
    rotated_deg: int = 0

    @property
    def disparity_at(self) -> Callable[[float], float] | None:
        """Function from a depth, m, to its disparity, px; None where metres are not known."""
        if self.depth_m is None or self.K is None or self.baseline_m is None:
            return None
        f_times_baseline = float(self.K[0, 0]) * self.baseline_m
        return lambda depth_m: f_times_baseline / depth_m - self.doffs_px


def depth_result(name: str, disparity: DisparityMap, *, facts: CaptureFacts | None = None) -> DepthResult:
    """Put a disparity map together with what is known of the cameras.

    The principal point is taken at the centre of the photo, ``((W - 1) / 2, (H - 1) / 2)``: the facts do not state it.

    Args:
        name: of the capture.
        disparity: (H, W) maps, px of the ref photo.
        facts: what ``captures.yaml`` states: focal length in px of the ref photo, baseline in m, doffs in px of the
            photos as given. Where wide stands to the left, the disparity is ``x_src - x_ref``, that of mirrored views.

    Returns:
        The result; metric only where focal length and baseline are both known.
    """
    if facts is None:
        return DepthResult(name=name, disparity=disparity)
    doffs_px = (facts.doffs_px or 0.0) * (-1 if facts.wide_side == "left" else 1)
    depth_m = None
    if facts.f_px is not None and facts.baseline_m is not None:
        depth_m = _within_range(
            depth_from_disparity(
                disparity.disparity_px, f_px=facts.f_px, baseline_m=facts.baseline_m, doffs_px=doffs_px
            )
        )
    return DepthResult(
        name=name,
        disparity=disparity if depth_m is None else _in_front(disparity, depth_m),
        K=None if facts.f_px is None else _centred_intrinsics(facts.f_px, hw=disparity.disparity_px.shape),
        baseline_m=facts.baseline_m,
        depth_m=depth_m,
        doffs_px=doffs_px,
        rotated_deg=facts.rotated_deg,
    )


def depth_result_of_rig(
    name: str,
    disparity: DisparityMap,
    *,
    rig: StereoRig,
    precision: DepthPrecision | None = None,
    matched_scale: float = 1.0,
) -> DepthResult:
    """Put a disparity map on the tele photo together with the rig it was rectified by.

    ``depth_m = K[0, 0] baseline_m / disparity_px`` along tele's optical axis; its standard deviation by
    `telewide.depth.precision`.

    Args:
        name: of the capture.
        disparity: (H, W) maps on the tele photo, as `telewide.depth.unrectify.disparity_on_tele` brings them.
        rig: the two cameras, tele at the size of the map.
        precision: what all depths of the shot share; None for an exact rig that nothing moved. Where it does not know
            how sure the matches are, the deviation is that of the rest, the least it can be.
        matched_scale: px of the views that were matched for one px of the tele photo (`RectifiedGeometry.scale`).

    Returns:
        The result; metric only where the rig's scale is known.
    """
    precision = precision or DepthPrecision()
    f_px = float(rig.tele.K[0, 0])
    result = DepthResult(name=name, disparity=disparity, K=rig.tele.K, distortion=rig.tele.distortion)
    if not rig.is_scale_known:
        return result
    depth_m = _within_range(depth_from_disparity(disparity.disparity_px, f_px=f_px, baseline_m=rig.baseline_m))
    of = precision.confidence_std
    std_m = depth_std_m(
        depth_m,
        np.zeros_like(depth_m) if of is None else disparity_std_px(disparity, of=of, scale=matched_scale),
        f_px=f_px,
        baseline_m=rig.baseline_m,
        precision=precision,
    )
    in_front = _in_front(disparity, depth_m)
    return replace(result, disparity=in_front, baseline_m=rig.baseline_m, depth_m=depth_m, depth_std_m=std_m)


def stood_upright(result: DepthResult) -> DepthResult:
    """Turn the maps of a result, and its camera, as people see the photo.

    On a photo that is turned by a quarter, disparities run along its columns; their sizes, and depth, stay as they are.

    Args:
        result: of photos turned by ``rotated_deg``; without distortion where that is not 0.

    Returns:
        The same of the upright photo, with ``rotated_deg`` 0.
    """
    turned_deg = result.rotated_deg
    if turned_deg == 0:
        return result
    maps, hw = result.disparity, result.disparity.disparity_px.shape
    depth_m, std_m = (
        None if each is None else upright(each, rotated_deg=turned_deg) for each in (result.depth_m, result.depth_std_m)
    )
    return replace(
        result,
        disparity=DisparityMap(
            upright(maps.disparity_px, rotated_deg=turned_deg),
            upright(maps.confidence, rotated_deg=turned_deg),
            upright_mask(maps.valid, rotated_deg=turned_deg),
        ),
        K=None if result.K is None else _upright_intrinsics(result.K, hw=(hw[0], hw[1]), rotated_deg=turned_deg),
        depth_m=depth_m,
        depth_std_m=std_m,
        rotated_deg=0,
    )


def _upright_intrinsics(K: FloatArray, *, hw: tuple[int, int], rotated_deg: int) -> FloatArray:
    """Intrinsics after clockwise quarter turns, each of which takes (x, y) to (H - 1 - y, x)."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    height, width = hw
    for _ in range(rotated_deg // 90):
        fx, fy, cx, cy = fy, fx, height - 1 - cy, cx
        height, width = width, height
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _within_range(depth_m: FloatMap) -> FloatMap:
    return np.where(depth_m <= FARTHEST_M, depth_m, np.float32(np.nan))


def _in_front(disparity: DisparityMap, depth_m: FloatMap) -> DisparityMap:
    """Mark as not measured what lies too far to tell, or beyond infinity: mismatched, or the lens had shifted."""
    return replace(disparity, valid=disparity.valid & np.isfinite(depth_m))


def _centred_intrinsics(f_px: float, *, hw: tuple[int, ...]) -> FloatArray:
    cx, cy = (hw[1] - 1) / 2, (hw[0] - 1) / 2
    return np.array([[f_px, 0.0, cx], [0.0, f_px, cy], [0.0, 0.0, 1.0]])
