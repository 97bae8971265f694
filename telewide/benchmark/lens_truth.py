"""Pictures that a real aperture took, and a plain blur to compare with.

``telewide simulate --world rooms --thin-lens`` renders such pictures. Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel, PositiveFloat

from telewide.bokeh.render import LARGEST_RADIUS_SHARE
from telewide.capture.images import read_image
from telewide.depth.edges import fill_unknown
from telewide.errors import InputError
from telewide.files import is_file
from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap
from telewide.records import read_json
from telewide.srgb import linear_from_srgb, srgb_from_linear

EDGE_JUMP_PX = 2.0
EDGE_BAND_PX = 8
_LEVELS = 32
_LEAST_SIGMA_PX = 0.2


class _Facts(BaseModel):
    """Content of ``bokeh.json``; what else it holds does not count."""

    focus_distance_m: PositiveFloat
    focus_disparity_px: PositiveFloat
    aperture_radius_m: PositiveFloat


@dataclass(frozen=True)
class LensTruth:
    """A picture through an aperture.

    Attributes:
        picture: (H, W, 3) sRGB.
        focus_distance_m: where it is focused, along the optical axis.
        focus_disparity_px: the true disparity there.
        aperture_radius_m: of the opening.
    """

    picture: FloatImage
    focus_distance_m: float
    focus_disparity_px: float
    aperture_radius_m: float

    def baseline_m(self, f_px: float) -> float:
        """Distance of the lenses that the true disparity is of: ``d z / f``.

        Args:
            f_px: focal length of the photo.
        """
        return self.focus_disparity_px * self.focus_distance_m / f_px


def read_lens_truth(captures_root: Path, name: str) -> LensTruth | None:
    """Read the picture that lies in ``truth/`` beside the captures; None where there is none.

    Args:
        captures_root: folder of the captures.
        name: of the capture.

    Raises:
        InputError: it is damaged.
    """
    folder = captures_root.parent / "truth" / name
    facts_path = folder / "bokeh.json"
    if not is_file(facts_path):
        return None
    try:
        facts = _Facts.model_validate(read_json(facts_path))
    except ValueError as error:
        raise InputError(f"{facts_path} does not state what the picture is focused on, and the aperture") from error
    picture = read_image(folder / "bokeh.png")
    return LensTruth(picture, facts.focus_distance_m, facts.focus_disparity_px, facts.aperture_radius_m)


def blurred_by_depth(image_srgb: FloatImage, disparity_px: FloatMap, *, focus_px: float, k: float) -> FloatImage:
    """Blur every pixel by a Gaussian of its own disk's spread, in linear light: what bokeh is without layers.

    Args:
        image_srgb: (H, W, 3) float32.
        disparity_px: (H, W) float32, px; NaN is filled from its nearest neighbour.
        focus_px: the disparity that stays sharp.
        k: radius of the disk per px of disparity.
    """
    light = linear_from_srgb(image_srgb)
    cap_px = min(disparity_px.shape) * LARGEST_RADIUS_SHARE
    sigma_px = (
        np.minimum(np.abs(fill_unknown(disparity_px) - focus_px) * k, cap_px) / 2
    )  # a disk's spread along an axis
    level = np.digitize(sigma_px, np.linspace(0, float(sigma_px.max()) + 1e-6, _LEVELS + 1))
    blurred = light.copy()
    for i in np.unique(level):
        own = level == i
        sigma = float(sigma_px[own].mean())
        if sigma > _LEAST_SIGMA_PX:
            blurred[own] = cv2.GaussianBlur(light, (0, 0), sigma)[own]
    return srgb_from_linear(blurred)


def edge_band(truth_px: FloatMap, *, k: float) -> BoolMap:
    """Mark what lies within 8 px of a jump of the true blur radius by more than 2 px.

    Args:
        truth_px: (H, W) true disparity, px; where it is not known is no edge.
        k: radius of the disk per px of disparity.
    """
    radius_px = np.asarray(fill_unknown(truth_px) * np.float32(k), dtype=np.float32)
    square = np.ones((3, 3), np.uint8)
    jump = cv2.dilate(radius_px, square) - cv2.erode(radius_px, square) > EDGE_JUMP_PX
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * EDGE_BAND_PX + 1, 2 * EDGE_BAND_PX + 1))
    return np.asarray(cv2.dilate(jump.astype(np.uint8), disk) > 0)
