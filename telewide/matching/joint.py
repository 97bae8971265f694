"""A network and semi-global matching together: each knows what the other does not.

The network says how likely every disparity is, on cells of 4x4 px: it knows what things look like through the wide
lens, and what continues behind what. Semi-global matching adds that to its own costs, and decides at full size, along
the photo's edges. Its levels are whole pixels, so the fraction comes from the network where the two agree, and from the
views themselves where they show it.
Letters: D planes, H W image, h w cells of 4x4 px.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.filling import guided_mean
from telewide.matching.semiglobal import Doubt, match_to_levels
from telewide.matching.subpixel import refine_subpixel
from telewide.matching.window import VOLUME_STEP_PX, Window

if TYPE_CHECKING:
    from telewide.matching.networks import StereoNetwork

# Chosen on the validation scenes of Middlebury 2006: half or three times the weight is as good or little worse.
_SURPRISE_COST = 5.0  # for each unit of -log p, on the scale of semi-global matching's costs
_MOST_SURPRISE = 8.0  # the network's word against a plane counts no more than this
_AGREEMENT_PX = 1.0


def match_jointly(
    ref: FloatMap, src: FloatMap, *, network: StereoNetwork, window: Window, valid: ValidMasks | None = None
) -> DisparityMap:
    """Match two views by both.

    Args:
        ref: (H, W, 3) sharp view, [0, 1].
        src: (H, W, 3) other view of the same size, in ref's colours.
        network: trained.
        window: disparities ``[d_min, d_max)``, px.
        valid: where the photos reach; None where they fill the views.

    Returns:
        As of :func:`~telewide.matching.semiglobal.match_to_levels`.

    Raises:
        ValueError: the views differ in size, or the window does not fit the volume.
    """
    from telewide.matching.inference import match_with_volume

    of_network, surprise_Dhw = match_with_volume(ref, src, network=network, window=window)
    doubt = _doubt(surprise_Dhw, hw=(ref.shape[0], ref.shape[1]), window=window)
    decided = match_to_levels(ref, src, window=window, doubt=doubt, valid=valid)
    gap_px = of_network.disparity_px - decided.disparity_px
    fraction_px = guided_mean(gap_px, ref, where=np.abs(gap_px) < _AGREEMENT_PX)
    disparity_px = refine_subpixel(ref, src, decided.disparity_px + fraction_px, confidence=decided.confidence)
    return DisparityMap(disparity_px, decided.confidence, decided.valid)


def _doubt(surprise_Dhw: NDArray[np.float32], *, hw: tuple[int, int], window: Window) -> Doubt:
    """The cost of each disparity, between the planes and between the cells by interpolation."""
    cost_Dhw = _SURPRISE_COST * np.minimum(surprise_Dhw, _MOST_SURPRISE)
    last = len(cost_Dhw) - 1
    cells_h, cells_w = cost_Dhw.shape[1:]

    def doubt(disparity_px: int) -> NDArray[np.uint16]:
        plane, beyond = divmod(disparity_px - window[0], VOLUME_STEP_PX)
        share = beyond / VOLUME_STEP_PX
        cost_hw = (1 - share) * cost_Dhw[plane] + share * cost_Dhw[min(plane + 1, last)]
        whole = cv2.resize(cost_hw, (cells_w * VOLUME_STEP_PX, cells_h * VOLUME_STEP_PX))
        return np.asarray(np.round(whole[: hw[0], : hw[1]]), dtype=np.uint16)

    return doubt
