"""Quality of a calibration: figures, checks with advice, a verdict.

Epipolar errors are distances, in tele pixels, between a corner in the tele photo and the line on which the wide photo
and the rig say it lies; held-out ones come from rigs that were solved without that shot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from telewide.geometry.arrays import FloatArray

Status = Literal["pass", "warn", "fail"]
Verdict = Literal["good", "usable", "insufficient"]
Bound = Literal["at least", "at most", ""]
_USUAL_SIDE_PX = 4032
SHARE = "share"
"""The unit of a value that is a share of something, and told in per cent."""


@dataclass(frozen=True)
class Check:
    """One question asked of a calibration.

    Attributes:
        name: what was looked at, lower case words: "joint views".
        status: how it went.
        value: what was found; NaN where it could not be found out.
        limit: what would have passed.
        advice: what was found and what to photograph next, one or two sentences for people; "" on a pass.
        unit: of value and limit: "tele px", "photos", "share" for what is told in per cent; "" where there is none.
        bound: on which side of the limit a value passes; "" where the file it was read from does not say.
    """

    name: str
    status: Status
    value: float
    limit: float
    advice: str
    unit: str = ""
    bound: Bound = ""

    @property
    def found_words(self) -> str:
        """Words for what was found, with its unit: "0.12 tele px"."""
        return _with_unit(self.value, self.unit) if math.isfinite(self.value) else "unknown"

    @property
    def limit_words(self) -> str:
        """Words for what passes, with its unit: "at most 0.3 tele px"."""
        return f"{self.bound or 'limit'} {_with_unit(self.limit, self.unit)}" if math.isfinite(self.limit) else ""


@dataclass(frozen=True)
class CalibrationQuality:
    """Figures of a calibration's quality.

    Attributes:
        tele_rms_px: RMS distance of corner and reprojection over the used tele views, tele px.
        wide_rms_px: likewise of the wide views, wide px.
        epipolar_p50_px: median held-out epipolar error, tele px; NaN where too few joint views were there to hold out.
        epipolar_p90_px: its 90th percentile.
        epipolar_p99_px: its 99th percentile.
        cross_validation_px: RMS over the tele frame, in tele px, of how differently two rigs, one from the odd and one
            from the even views, carry a point at the boards' median distance to the wide photo; NaN likewise.
        checks: all checks, the passed ones too.
        verdict: "good" if all passed, "insufficient" if one failed.
    """

    tele_rms_px: float
    wide_rms_px: float
    epipolar_p50_px: float
    epipolar_p90_px: float
    epipolar_p99_px: float
    cross_validation_px: float
    checks: tuple[Check, ...]
    verdict: Verdict


def larger_than_usual(hw: tuple[int, int]) -> float:
    """Say how many times larger a photo is than those that limits in px are meant for, 12 megapixels; 1 for smaller.

    Shake, focus and processing blur a share of the picture: 50 megapixels show the same error with twice the px.
    """
    return max(1.0, max(hw) / _USUAL_SIDE_PX)


def epipolar_percentiles_px(errors_px: FloatArray) -> tuple[float, float, float]:
    """50th, 90th and 99th percentile of held-out errors (N,); NaN where nothing was held out."""
    p50, p90, p99 = np.percentile(errors_px, (50, 90, 99)) if len(errors_px) else (math.nan,) * 3
    return float(p50), float(p90), float(p99)


def verdict_of(checks: Sequence[Check]) -> Verdict:
    """Sum the checks up: all passed is good, one failed is insufficient."""
    if any(check.status == "fail" for check in checks):
        return "insufficient"
    return "good" if all(check.status == "pass" for check in checks) else "usable"


def at_least(name: str, value: float, limits: tuple[float, float], *, advice: str, unit: str = "") -> Check:
    """Ask whether a value is large enough.

    Args:
        name: of the question.
        value: what was found.
        limits: from the first on it passes, below the second it fails.
        advice: what to do where it does not pass.
        unit: of value and limits.
    """
    status: Status = "pass" if value >= limits[0] else "fail" if value < limits[1] else "warn"
    return _check(name, status, value, limits[0], advice=advice, unit=unit, bound="at least")


def at_most(name: str, value: float, limits: tuple[float, float], *, advice: str, unit: str = "") -> Check:
    """Ask whether a value is small enough.

    Args:
        name: of the question.
        value: what was found.
        limits: up to the first it passes, above the second it fails.
        advice: what to do where it does not pass.
        unit: of value and limits.
    """
    status: Status = "pass" if value <= limits[0] else "fail" if value > limits[1] else "warn"
    return _check(name, status, value, limits[0], advice=advice, unit=unit, bound="at most")


def _check(name: str, status: Status, value: float, limit: float, *, advice: str, unit: str, bound: Bound) -> Check:
    return Check(
        name=name,
        status=status,
        value=float(value),
        limit=float(limit),
        advice="" if status == "pass" else advice,
        unit=unit,
        bound=bound,
    )


def _with_unit(value: float, unit: str) -> str:
    if unit == SHARE:
        return f"{_figure(100 * value)} %"
    return f"{_figure(value)} {unit}".rstrip()


def _figure(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
