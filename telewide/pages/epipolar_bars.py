"""The held-out row errors of a rig, as bars for the pages about it."""

from __future__ import annotations

from markupsafe import Markup

from telewide.calibration.quality import CalibrationQuality
from telewide.pages.charts import Bar, bar_list


def epipolar_bars(quality: CalibrationQuality, *, caption: str) -> Markup:
    """Draw the held-out row errors of a rig, with the limit for 90 % of them where one is set."""
    bars = [
        Bar("median", quality.epipolar_p50_px),
        Bar("90 % are below", quality.epipolar_p90_px),
        Bar("99 % are below", quality.epipolar_p99_px),
    ]
    limit = epipolar_limit_px(quality)
    dashed = "" if limit is None else " Dashed: limit for 90 %."
    return bar_list(bars, unit="tele px", caption=caption + dashed, limit=limit)


def epipolar_limit_px(quality: CalibrationQuality) -> float | None:
    """Limit that 90 % of the held-out row errors are to stay below, tele px; None where no check says."""
    return next((check.limit for check in quality.checks if "epipolar" in check.name), None)
