"""Rows of the two views: the vertical misfit left in this shot, fitted and taken out.

Focus breathing and image stabilisation leave ``vertical_px = y_ref - y_src = a + b (x_src - cx) + c (y_ref - cy)``: an
offset, a roll, a change of scale. Written in x of src and y of ref, the law is the resampling map itself, without an
inverse: ``corrected(x, y) = src(x, y - a - b (x - cx) - c (y - cy))``. Only rows move; the disparity is left alone.
Letters: N matches, H W image; (cx, cy) = centre of the image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from telewide.geometry.arrays import BoolMap, FloatImage
from telewide.points.matches import Matches

MIN_MATCHES = 20
"""Fewer matches than this cannot carry a fit of three numbers."""
NEGLIGIBLE_PX = 0.1
"""A misfit that stays below this everywhere is not worth a resampling."""
MIN_SLOPE_SPAN = 0.15
"""Share of the image's side that the middle 90 % of the matches must span before a slope along it is fitted."""
_SOFT_PX = 0.3
_LARGEST_SLOPE = 0.05
_WHOLLY = 0.999  # of a resampled mask


@dataclass(frozen=True)
class VerticalFit:
    """The vertical misfit of one shot.

    Attributes:
        offset_px: a, the misfit at the image's centre.
        slope_x: b, px per px along x (a roll of src).
        slope_y: c, px per px along y (a difference of scale).
        n: number of matches it was fitted to.
        residual_before_px: median absolute vertical misfit of those matches; NaN without matches.
        residual_after_px: what the fit leaves of it.
        hw: height and width of the views.
        is_fitted: False where the matches were too few and the fit is the identity.
    """

    offset_px: float
    slope_x: float
    slope_y: float
    n: int
    residual_before_px: float
    residual_after_px: float
    hw: tuple[int, int]
    is_fitted: bool

    @property
    def largest_misfit_px(self) -> float:
        """The largest absolute misfit in a corner of the image."""
        reach_x, reach_y = (self.hw[1] - 1) / 2, (self.hw[0] - 1) / 2
        return abs(self.offset_px) + abs(self.slope_x) * reach_x + abs(self.slope_y) * reach_y

    def misfit_px(self, src_x_px: NDArray[np.float64], ref_y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """``y_ref - y_src`` that the fit states for a column of src and a row of ref."""
        centre_y, centre_x = (self.hw[0] - 1) / 2, (self.hw[1] - 1) / 2
        return np.asarray(self.offset_px + self.slope_x * (src_x_px - centre_x) + self.slope_y * (ref_y_px - centre_y))


def fit_vertical(matches: Matches, *, hw: tuple[int, int]) -> VerticalFit:
    """Fit the vertical misfit robustly (soft-L1 at 0.3 px).

    A slope is fitted only along a side of which the matches span enough.

    Args:
        matches: N consistent matches, those meant for fitting.
        hw: height and width of the views.

    Returns:
        The fit; the identity where the misfit is below 0.1 px everywhere, and, marked so, for fewer than 20 matches.
    """
    identity = _identity(matches, hw=hw)
    if len(matches) < MIN_MATCHES:
        return identity
    centre_y, centre_x = (hw[0] - 1) / 2, (hw[1] - 1) / 2
    design = np.column_stack([np.ones(len(matches)), matches.src_px[:, 0] - centre_x, matches.ref_px[:, 1] - centre_y])
    low, high = np.percentile(design[:, 1:], (5, 95), axis=0)
    spans = (high - low) >= MIN_SLOPE_SPAN * np.array([hw[1], hw[0]])
    used = np.array([True, *spans])
    vertical = matches.vertical_px
    start = np.array([np.median(vertical), 0.0, 0.0])[used]
    solved = least_squares(
        lambda law: design[:, used] @ law - vertical,
        start,
        jac=lambda _law: design[:, used],
        loss="soft_l1",
        f_scale=_SOFT_PX,
        x_scale="jac",
    )
    law = np.zeros(3)
    law[used] = solved.x
    law[1:] = np.clip(law[1:], -_LARGEST_SLOPE, _LARGEST_SLOPE)
    after_px = float(np.median(np.abs(vertical - design @ law)))
    fit = replace(
        identity,
        offset_px=float(law[0]),
        slope_x=float(law[1]),
        slope_y=float(law[2]),
        residual_after_px=after_px,
        is_fitted=True,
    )
    if fit.largest_misfit_px < NEGLIGIBLE_PX:
        return replace(identity, is_fitted=True)
    return fit


def _identity(matches: Matches, *, hw: tuple[int, int]) -> VerticalFit:
    before_px = float(np.median(np.abs(matches.vertical_px))) if len(matches) else float("nan")
    return VerticalFit(
        offset_px=0.0,
        slope_x=0.0,
        slope_y=0.0,
        n=len(matches),
        residual_before_px=before_px,
        residual_after_px=before_px,
        hw=hw,
        is_fitted=False,
    )


def apply_vertical(src: FloatImage, fit: VerticalFit) -> FloatImage:
    """Resample src once so that its rows agree with ref.

    Args:
        src: (H, W, 3) or (H, W) float32 in [0, 1].
        fit: what :func:`fit_vertical` found for views of this size.

    Returns:
        The same shape, float32 in [0, 1]; src itself where the fit is the identity.
    """
    if fit.offset_px == 0 and fit.slope_x == 0 and fit.slope_y == 0:
        return src
    height, width = src.shape[:2]
    x_px, y_px = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    from_y_px = y_px - fit.misfit_px(x_px, y_px)
    moved = cv2.remap(
        src,
        x_px.astype(np.float32),
        from_y_px.astype(np.float32),
        cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(np.clip(moved, 0.0, 1.0), dtype=np.float32)


def apply_vertical_to_mask(valid_src: BoolMap, fit: VerticalFit) -> BoolMap:
    """Carry a mask of src into the view that :func:`apply_vertical` returns; what is mixed with the unknown is unknown.

    Args:
        valid_src: (H, W) bool.
        fit: the fit applied to src.

    Returns:
        (H, W) bool.
    """
    moved = apply_vertical(valid_src.astype(np.float32), fit)
    return np.asarray(moved > _WHOLLY)


def corrected_matches(matches: Matches, fit: VerticalFit) -> Matches:
    """Carry the src points into the view that :func:`apply_vertical` returns.

    Solves ``y' - misfit(x, y') = y_src`` for the new row y'.

    Args:
        matches: N matches of ref and the src as it was.
        fit: the fit applied to src.

    Returns:
        The same matches with corrected src points.
    """
    centre_y = (fit.hw[0] - 1) / 2
    x_px = matches.src_px[:, 0]
    at_centre_px = fit.misfit_px(x_px, np.full(len(matches), centre_y))
    y_px = (matches.src_px[:, 1] + at_centre_px - fit.slope_y * centre_y) / (1.0 - fit.slope_y)
    return Matches(matches.ref_px, np.column_stack([x_px, y_px]))
