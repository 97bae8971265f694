"""The page about a calibration: whole and offline, with every number it was given, and words for every verdict."""

from __future__ import annotations

import dataclasses
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from pages.made_calibration import CHECKS, DROPPED_REASON, made_calibration

from telewide.calibration.checks import Evidence, quality_of
from telewide.calibration.quality import Check
from telewide.calibration.result import Calibration
from telewide.pages.board_rig import board_rig_page
from telewide.pages.report import NextStep
from telewide.pages.rig_page import scan_lines_picture, write_rig_page

VOID = {"meta", "img", "br"}


class Outline(HTMLParser):
    """Tags, attributes and text, and whether every tag is closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def page_of(path: Path, calibration: Calibration, *, has_pair: bool = True) -> Outline:
    grey = np.full((60, 80, 3), 0.5, np.float32)
    content = board_rig_page(
        calibration,
        facts={"board": "chessboard <9x6>"},
        next_steps=[NextStep("Train:", "telewide train captures/")],
        rectified=("shot_01", grey, grey) if has_pair else None,
    )
    write_rig_page(path, content)
    outline = Outline()
    outline.feed(path.read_text(encoding="utf-8"))
    assert outline.open == []
    return outline


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Outline:
    return page_of(tmp_path_factory.mktemp("page") / "rig_report.html", made_calibration())


def test_every_section_finds_the_checks_that_judge_it() -> None:
    """By words in the names of the checks that a calibration makes: none of them may change alone."""
    made = made_calibration()
    stds = (made.tele_std, made.wide_std)
    evidence = Evidence(made.views, made.rig, made.half_rigs, np.full(50, 0.2), stds, made.transform_std, 1.0)
    names = [check.name for check in quality_of(evidence).checks]
    judged_by = [word for section in board_rig_page(made, facts={}).sections for word in section.judged_by]
    assert judged_by
    assert [word for word in judged_by if not any(word in name for name in names)] == []


def headings(page: Outline) -> list[str]:
    return re.findall(r"\n([A-Z][a-z ]+)\n", page.text)


def test_the_page_fetches_and_runs_nothing(tmp_path: Path) -> None:
    path = tmp_path / "rig_report.html"
    outline = page_of(path, made_calibration())
    names = {tag for tag, _ in outline.tags}
    assert "script" not in names
    assert not names & {"link", "iframe", "object"}
    sources = [a.get("src") or a.get("href") for tag, a in outline.tags if "src" in a or "href" in a]
    assert sources
    assert all(str(source).startswith("data:image/") for source in sources)
    assert not re.search(r"https?://|url\(|@import", path.read_text(encoding="utf-8"))
    assert path.stat().st_size < 1_000_000


def test_each_check_is_shown_with_its_mark_and_what_to_do(page: Outline) -> None:
    for check in CHECKS:
        assert check.name in page.text
        assert check.advice in page.text
        assert check.limit_words in page.text
    assert re.search(r"12 shots\s*at least 8 shots", page.text)
    assert re.search(r"41 %\s*at least 60 %", page.text)
    marks = [attributes["class"] for tag, attributes in page.tags if tag == "span"]
    assert {"mark pass", "mark warn"} <= set(marks)
    assert page.text.count(CHECKS[1].advice) == 2  # in the table, and as the next thing to do


def test_every_photo_has_a_bar_and_the_one_left_out_says_why(page: Outline) -> None:
    for number in range(12):
        assert page.text.count(f"shot_{number:02d}") >= 2
    bars = [attributes["class"] for tag, attributes in page.tags if tag == "rect" and "bar" in str(attributes["class"])]
    assert bars.count("bar out") == 1
    assert DROPPED_REASON in page.text


def test_the_numbers_of_the_rig_are_there(page: Outline) -> None:
    for words in ("3000.0 ± 1.5 px", "1000.0 ± 0.4 px", "12.00 ± 0.05 mm", "+0.0500 ± 0.0100", "0.42", "0.70 tele px"):
        assert words in page.text


def test_a_coefficient_that_was_held_is_said_to_be_fixed(page: Outline) -> None:
    assert "fixed at 0" in page.text
    assert "0.0000 ±" not in page.text
    assert "± 0.0000" not in page.text


def test_depth_table_is_the_formula(page: Outline) -> None:
    own_px = 0.15 / 0.6745  # of the epipolar error; the halves say 0.3 / 2 / sqrt(2), which is less
    for depth_m in (0.5, 1.0, 2.0):
        error_mm = 1e3 * depth_m**2 * own_px / (3000.0 * 0.012)
        assert f"± {error_mm:.1f} mm ({error_mm / depth_m / 1e3:.1%})" in page.text


@pytest.mark.parametrize(("verdict", "words"), [("good", "Good"), ("usable", "Usable"), ("insufficient", "Not good")])
def test_the_verdict_leads(tmp_path: Path, verdict: str, words: str) -> None:
    fail = (Check("joint views", "fail", 2, 8, "Take ten more photos with both lenses."),)
    calibration = made_calibration(verdict=verdict, checks=fail if verdict == "insufficient" else ())  # type: ignore[arg-type]
    outline = page_of(tmp_path / "r.html", calibration)
    verdicts = [str(a["class"]) for tag, a in outline.tags if tag == "p" and "verdict" in str(a.get("class"))]
    assert verdicts == [f"verdict {verdict}"]
    assert words in outline.text[: outline.text.index("What next")]


def test_a_rig_of_unknown_scale_promises_no_metres(tmp_path: Path) -> None:
    text = page_of(tmp_path / "r.html", made_calibration(is_scale_known=False)).text
    assert "not known in metres" in text
    assert " mm" not in text


def test_a_poor_calibration_still_gives_a_page(tmp_path: Path) -> None:
    """Two shots, no halves, no held-out error, a view of which nothing is known."""
    calibration = made_calibration(n_shots=2, verdict="insufficient")
    nan = float("nan")
    quality = dataclasses.replace(
        calibration.quality, epipolar_p50_px=nan, epipolar_p90_px=nan, epipolar_p99_px=nan, cross_validation_px=nan
    )
    lost = dataclasses.replace(
        calibration.views[0],
        is_used=False,
        rms_px=nan,
        tilt_deg=nan,
        distance_m=nan,
        residuals_px=np.full((54, 2), nan),
    )
    poor = dataclasses.replace(calibration, quality=quality, half_rigs=None, views=(lost, *calibration.views[1:]))
    path = tmp_path / "r.html"
    outline = page_of(path, poor, has_pair=False)
    assert "Too few photos of both lenses" in outline.text
    assert "A rectified pair" not in outline.text
    assert "nan" not in re.sub(r"base64,[^\"]*", "", path.read_text(encoding="utf-8")).lower()


def test_scan_lines_cross_both_views() -> None:
    rng = np.random.default_rng(1)
    tele, wide = rng.random((2, 540, 720, 3)).astype(np.float32)
    picture = scan_lines_picture(tele, wide)
    is_kept = np.isclose(picture[:, :720], tele).all(axis=(1, 2))
    assert 8 <= (~is_kept).sum() <= 30
    np.testing.assert_array_equal(picture[is_kept][:, -720:], wide[is_kept])
    assert not np.isclose(picture[~is_kept][:, -720:], wide[~is_kept]).all(axis=(1, 2)).any()
