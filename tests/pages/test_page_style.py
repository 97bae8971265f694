"""Colours of the pages can be read by those who see little contrast (WCAG 2.2, AA), in light and in dark."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from telewide.srgb import linear_from_srgb

TEXT_CONTRAST, PART_CONTRAST = 4.5, 3.0


def schemes(repo: Path) -> list[dict[str, str]]:
    """Variables of the light and the dark colours, those of the rig page among them."""
    folder = repo / "telewide" / "pages" / "templates"
    text = "".join((folder / name).read_text(encoding="utf-8") for name in ("page.css", "rig.css"))
    dark = re.findall(r"@media \(prefers-color-scheme: dark\) \{\s*:root \{([^}]*)\}", text)
    light = re.findall(r"^:root \{([^}]*)\}", text, re.MULTILINE)
    return [dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", "".join(blocks))) for blocks in (light, dark)]


def luminance(colour: str) -> float:
    red, green, blue = (float(linear_from_srgb(int(colour[k : k + 2], 16) / 255)) for k in (1, 3, 5))
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("at", [0, 1])
def test_words_and_marks_stand_out_from_the_ground(repo: Path, at: int) -> None:
    colours = schemes(repo)[at]
    words = {"ink", "faint", "curve", "good", "warn", "bad"}
    assert words | {"ground", "focus", "second"} <= set(colours)
    weak = {name: contrast(colours[name], colours["ground"]) for name in words}
    assert {name: value for name, value in weak.items() if value < TEXT_CONTRAST} == {}
    assert contrast(colours["focus"], colours["ground"]) >= PART_CONTRAST
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
