"""The page about a rig: can it be trusted, why, and what to photograph next. One file that opens offline.

What a rig from photos of a board shows is in `board_rig`, what one from captures shows in `scenes_rig`. Every figure
says in its caption what good looks like, for readers who calibrate once a year.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from telewide.calibration.quality import CalibrationQuality, Check
from telewide.drawing import fitted_wh, scaled_image
from telewide.geometry.arrays import FloatMap
from telewide.pages.page import html_part, write_page
from telewide.pages.report import NextStep, thumbnail

RectifiedViews = tuple[str, FloatMap, FloatMap]
"""Name, tele and wide of a rectified pair of one size, (H, W, 3) RGB in [0, 1]."""

_SCAN_LINES = 15
_VIEW_WIDTH_PX = 720
_VERDICTS = {
    "good": "Good: every check passed.",
    "insufficient": "Not good enough: depth from this rig cannot be trusted. Below is what to photograph next.",
}


@dataclass(frozen=True)
class Section:
    """A part of the page with its heading.

    Attributes:
        heading: a few words.
        content: HTML; without any the section is left out.
        css_class: of the box around the content.
        judged_by: words in the names of the checks that judge what is shown.
    """

    heading: str
    content: Markup
    css_class: str = ""
    judged_by: tuple[str, ...] = ()

    def outcome(self, checks: Sequence[Check]) -> str | None:
        """Worst outcome of the checks that judge it; None where none does."""
        outcomes = {check.status for check in checks if any(word in check.name for word in self.judged_by)}
        return next((status for status in ("fail", "warn", "pass") if status in outcomes), None)


@dataclass(frozen=True)
class RigPage:
    """Content of the page.

    Attributes:
        title: name of the page.
        heading: its first line.
        usable: verdict on a rig that is usable, with warnings.
        quality: what the rig is worth.
        summary: the most telling figures.
        sections: in their order.
        next_steps: commands worth running now.
        facts: where it comes from: photos, version.
    """

    title: str
    heading: str
    usable: str
    quality: CalibrationQuality
    summary: str
    sections: Sequence[Section]
    next_steps: Sequence[NextStep]
    facts: Mapping[str, str]


def write_rig_page(path: Path, page: RigPage) -> Path:
    """Write the page as one HTML file.

    Args:
        path: of the file.
        page: what to show.

    Returns:
        The path.
    """
    checks, verdict = page.quality.checks, page.quality.verdict
    worst_first = sorted((check for check in checks if check.advice), key=lambda check: check.status != "fail")
    return write_page(
        path,
        "rig.html.j2",
        title=page.title,
        page=page,
        verdict=_VERDICTS.get(verdict, page.usable),
        advice=[check.advice for check in worst_first],
    )


def rectified_section(rectified: RectifiedViews | None, *, missing: Markup) -> Section:
    """Show a rectified pair with lines across both views.

    Args:
        rectified: the pair, or None.
        missing: what is said without one.
    """
    heading = "A rectified pair"
    if rectified is None:
        return Section(heading, missing)
    name, tele, wide = rectified
    label = f"tele and wide of {name} after rectification. Good: whatever lies on a line in one lies on it in the other"
    picture = thumbnail(label, scan_lines_picture(tele, wide), longest_px=2 * _VIEW_WIDTH_PX + 8)
    return Section(heading, html_part("picture", picture=picture, name=name))


def scan_lines_picture(tele: FloatMap, wide: FloatMap) -> FloatMap:
    """Put a rectified pair side by side with lines across both: what lies on a line in one must lie on it in the other.

    Args:
        tele: (H, W, 3) RGB in [0, 1].
        wide: (H, W, 3) likewise.

    Returns:
        (h, 2 w + gap, 3) RGB in [0, 1], as large as it is shown.
    """
    wh = fitted_wh((tele.shape[1], tele.shape[0]), box_wh=(_VIEW_WIDTH_PX, _VIEW_WIDTH_PX))
    shown = [scaled_image(np.nan_to_num(view), wh=wh) for view in (tele, wide)]
    gap = np.zeros((wh[1], 8, 3), dtype=np.float32)
    picture = np.concatenate([shown[0], gap, shown[1]], axis=1)
    rows = np.linspace(0, wh[1], _SCAN_LINES + 2)[1:-1].astype(int)
    picture[rows] = 0.1 * picture[rows] + 0.9 * np.array([1.0, 0.45, 0.1], dtype=np.float32)
    return picture.astype(np.float32)
