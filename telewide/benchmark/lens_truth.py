"""Pictures that a real aperture took, as ``telewide simulate --thin-lens`` renders them. Letters: H W image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel, PositiveFloat, model_validator

from telewide.capture.images import read_image
from telewide.depth.nearest import fill_unknown
from telewide.errors import InputError
from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap
from telewide.records import read_json

EDGE_JUMP_PX = 2.0
EDGE_BAND_PX = 8


class _Facts(BaseModel):
    """Content of ``bokeh*.json``; what else it holds does not count."""

    focus_disparity_px: PositiveFloat
    focus_distance_m: PositiveFloat | None = None
    aperture_radius_m: PositiveFloat | None = None
    radius_per_px: PositiveFloat | None = None

    @model_validator(mode="after")
    def _states_an_aperture(self) -> _Facts:
        if self.radius_per_px is None and (self.focus_distance_m is None or self.aperture_radius_m is None):
            raise ValueError("radius_per_px, or focus_distance_m and aperture_radius_m")
        return self


@dataclass(frozen=True)
class LensTruth:
    """A picture through an aperture.

    Attributes:
        name: of its files.
        picture: (H, W, 3) sRGB.
        focus_disparity_px: the true disparity where it is focused.
        radius_per_px: radius of the disk per px of true disparity away from that; None where metres tell.
        focus_distance_m: of the focus along the optical axis; None where metres are not known.
        aperture_radius_m: of the opening; None likewise.
    """

    name: str
    picture: FloatImage
    focus_disparity_px: float
    radius_per_px: float | None = None
    focus_distance_m: float | None = None
    aperture_radius_m: float | None = None

    def lens(self, *, f_px: float | None, baseline_m: float | None = None) -> float | None:
        """Radius of the disk per px of disparity, ``A / B``; None where neither metres nor a radius are known.

        Args:
            f_px: focal length of the photo; None where it is not known.
            baseline_m: distance of the lenses that the disparity is of; None for that of the true one, ``d z / f``.
        """
        if self.aperture_radius_m is None or self.focus_distance_m is None or f_px is None:
            return self.radius_per_px
        true_baseline_m = self.focus_disparity_px * self.focus_distance_m / f_px
        return self.aperture_radius_m / (true_baseline_m if baseline_m is None else baseline_m)


def read_lens_truths(captures_root: Path, name: str) -> tuple[LensTruth, ...]:
    """Read the pictures that lie in ``truth/`` beside the captures, ``bokeh*.png`` with a JSON each; none is fine.

    Args:
        captures_root: folder of the captures.
        name: of the capture.

    Raises:
        InputError: one is corrupt.
    """
    folder = captures_root.parent / "truth" / name
    truths = []
    for facts_path in sorted(folder.glob("bokeh*.json")):
        try:
            facts = _Facts.model_validate(read_json(facts_path))
        except ValueError as error:
            raise InputError(f"{facts_path} does not state what the picture is focused on, and the aperture") from error
        picture = read_image(facts_path.with_suffix(".png"))
        truths.append(LensTruth(facts_path.stem, picture, **facts.model_dump()))
    return tuple(truths)


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
