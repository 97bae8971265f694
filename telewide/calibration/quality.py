"""What a calibration is worth: figures, checks with advice, a verdict.

Epipolar errors are distances, in tele pixels, between a corner in the tele photo and the line on which the wide photo
and the rig say it lies; held-out ones come from rigs that were solved without that shot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Status = Literal["pass", "warn", "fail"]
Verdict = Literal["good", "usable", "insufficient"]


@dataclass(frozen=True)
class Check:
    """One question asked of a calibration.

    Attributes:
        name: what was looked at, lower case words: "joint views".
        status: how it went.
        value: what was found; NaN where it could not be found out.
        limit: what would have passed.
        advice: what was found and what to photograph next, one or two sentences for people; "" on a pass.
    """

    name: str
    status: Status
    value: float
    limit: float
    advice: str


@dataclass(frozen=True)
class CalibrationQuality:
    """How good a calibration is.

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


def verdict_of(checks: Sequence[Check]) -> Verdict:
    """Sum the checks up: all passed is good, one failed is insufficient."""
    if any(check.status == "fail" for check in checks):
        return "insufficient"
    return "good" if all(check.status == "pass" for check in checks) else "usable"
