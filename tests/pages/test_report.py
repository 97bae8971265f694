"""The report is one file that needs nothing else: well formed, escaped, offline, with the numbers given."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.pages.curves import Curve, curve_svg
from telewide.pages.report import NextStep, ReportRow, thumbnail, write_report

VOID = {"meta", "img", "link", "br"}
SELF_CLOSED = {"line", "polyline"}


class Outline(HTMLParser):
    """Collects tags with their attributes and the text, and whether every tag is closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        assert tag in SELF_CLOSED

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def outline_of(path: Path) -> Outline:
    outline = Outline()
    outline.feed(path.read_text(encoding="utf-8"))
    assert outline.open == []
    return outline


@pytest.fixture
def image(rng: np.random.Generator) -> np.ndarray:
    """A smooth colour picture."""
    noise = rng.random((150, 300, 3)).astype(np.float32)
    return np.clip(cv2.GaussianBlur(noise, (0, 0), 8) * 3 - 1, 0, 1).astype(np.float32)


@pytest.fixture
def report(tmp_path: Path, image: np.ndarray) -> Path:
    """A report with all its sections."""
    rows = [
        ReportRow(
            f"lake <{n}>",
            (thumbnail("tele", image, link=f"depth/a b {n}/preview.png"), thumbnail("bokeh", image)),
            {"error px": 0.25 * n, "matches": 100 + n, "verdict": "good & sharp"},
        )
        for n in (1, 2, 4)
    ]
    steps = np.arange(500.0)
    return write_report(
        tmp_path / "report.html",
        rows,
        title="Lake & hills",
        summary="<script>alert(1)</script>",
        curves=[Curve("loss", steps, np.exp(-steps / 100), ((0, "first"), (250, "second")))],
        next_steps=[NextStep("Use your own.", "telewide depth <captures> && echo done")],
        facts={"version": "0.1"},
    )


def test_report_is_well_formed_and_has_no_scripts(report: Path) -> None:
    tags = [tag for tag, _ in outline_of(report).tags]
    assert "script" not in tags
    assert {"h1", "table", "svg", "pre", "dl", "img"} <= set(tags)


def test_report_fetches_nothing(report: Path) -> None:
    outline = outline_of(report)
    sources = [attributes["src"] or "" for _, attributes in outline.tags if "src" in attributes]
    assert sources
    assert all(source.startswith("data:image/jpeg;base64,") for source in sources)
    links = [attributes["href"] or "" for _, attributes in outline.tags if "href" in attributes]
    assert links[0] == "depth/a%20b%201/preview.png"
    page = report.read_text(encoding="utf-8")
    assert not re.search(r"https?://|url\(|@import", page)
    assert "default-src 'none'" in page


def test_report_follows_the_readers_colours(report: Path) -> None:
    assert "prefers-color-scheme: dark" in report.read_text(encoding="utf-8")


def test_report_shows_words_as_given(report: Path) -> None:
    text = "".join(outline_of(report).text)
    for words in ("Lake & hills", "lake <2>", "good & sharp", "<script>alert(1)</script>", "<captures> && echo done"):
        assert words in text


def test_table_holds_the_numbers_and_their_median(report: Path) -> None:
    text = outline_of(report).text
    assert [text.count(number) for number in ("0.250", "0.500", "1.00", "101", "102", "104")] == [1, 2, 1, 1, 2, 1]


def test_thumbnails_are_small_jpegs_of_the_picture(report: Path, image: np.ndarray) -> None:
    encoded = re.findall(r"base64,([^\"]+)", report.read_text(encoding="utf-8"))[0]
    bgr = cv2.imdecode(np.frombuffer(base64.b64decode(encoded), np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(bgr[..., ::-1] / 255 - image).mean() < 0.02
    large = np.zeros((1200, 2400, 3), np.float32)
    assert thumbnail("large", large).wh == (480, 240)
    assert thumbnail("small", image).wh == (300, 150)


def test_an_empty_report_has_no_empty_sections(tmp_path: Path) -> None:
    outline = outline_of(write_report(tmp_path / "r.html", [], title="none"))
    assert "h2" not in [tag for tag, _ in outline.tags]


def points_of(svg: str) -> np.ndarray:
    match = re.search(r'points="([^"]+)"', svg)
    assert match is not None
    return np.array([[float(number) for number in point.split(",")] for point in match[1].split()])


def test_curve_is_affine_in_its_values() -> None:
    steps = np.arange(0.0, 50.0)
    values = np.sin(steps / 7) + 3
    points = points_of(curve_svg(Curve("loss", steps, values)))
    for drawn, given, sign in ((points[:, 0], steps, 1), (points[:, 1], values, -1)):
        slope, offset = np.polyfit(given, drawn, 1)
        assert slope * sign > 0
        np.testing.assert_allclose(drawn, slope * given + offset, atol=0.06)  # written to 0.1


def test_a_first_spike_does_not_flatten_the_curve() -> None:
    steps = np.arange(100.0)
    values = np.exp(-steps / 30)
    calm = points_of(curve_svg(Curve("loss", steps, values)))
    values[0] = 80
    spiky = points_of(curve_svg(Curve("loss", steps, values)))
    assert np.ptp(spiky[1:, 1]) > 0.9 * np.ptp(calm[1:, 1])
    assert spiky[0, 1] >= 0


def test_long_curves_stay_light() -> None:
    steps = np.arange(200_000.0)
    svg = curve_svg(Curve("loss", steps, 1 / (steps + 10)))
    assert len(svg) < 12_000


@pytest.mark.parametrize(("steps", "values"), [([], []), ([1.0], [2.0]), ([0.0, 1.0, 2.0], [np.nan, np.inf, 1.0])])
def test_no_curve_without_two_points(steps: list[float], values: list[float]) -> None:
    assert curve_svg(Curve("loss", steps, values)) == ""


def test_a_constant_curve_is_drawn() -> None:
    points = points_of(curve_svg(Curve("loss", [0.0, 1.0, 2.0], [0.0, 0.0, 0.0])))
    assert np.isfinite(points).all()
    assert np.ptp(points[:, 1]) == 0
