"""What the page holds of a capture comes back from it as it was, and no more of it than may be mailed."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from telewide.bokeh.aperture import Aperture
from telewide.bokeh.focus import Focus
from telewide.bokeh.hidden import COUNT, JUMP, sort_by_level
from telewide.bokeh.render import radius_per_px_from_f_number
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.pages.report import ReportRow, thumbnail, write_report
from telewide.pages.run_page import CAPTURES_A_PAGE, MOST_WITHOUT_INDEX, write_run_page
from telewide.pages.viewed import LONGEST_PX, STEPS, Metric, Opening, viewed_capture

BOX = np.s_[20:40, 30:60]


def scene(*, times: int = 1) -> tuple[FloatImage, DisparityMap]:
    """A near red box before a green wall; a stripe is not measured, a corner unknown."""
    photo = np.zeros((60 * times, 90 * times, 3), np.float32)
    photo[..., 1] = 0.5
    box = tuple(slice(s.start * times, s.stop * times) for s in BOX)
    photo[box] = (0.8, 0.1, 0.1)
    disparity_px = np.tile(np.linspace(4, 6, 90 * times, dtype=np.float32), (60 * times, 1))
    disparity_px[box] = 20.0
    disparity_px[:3, :3] = np.nan
    valid = np.ones(disparity_px.shape, np.bool_)
    valid[50:55] = False
    return photo, DisparityMap(disparity_px, np.full(disparity_px.shape, 0.6, np.float32), valid)


def levels_of(uri: object) -> np.ndarray:
    assert isinstance(uri, str)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.split(",")[1]))).convert("RGB"))


def told_of(*, metric: Metric | None = None, times: int = 1) -> dict[str, object]:
    photo, disparity = scene(times=times)
    return viewed_capture(photo, disparity, others={"wide": photo}, metric=metric, name="one </script> & two")


def test_disparity_and_confidence_come_back_from_the_map() -> None:
    told, (_, disparity) = told_of(), scene()
    red, green, blue = (levels_of(told["map"])[..., k].astype(int) for k in range(3))
    lowest_px, step_px = told["mapSteps"]  # type: ignore[misc]
    seen_px = lowest_px + (256 * red + green) * step_px
    known = np.isfinite(disparity.disparity_px)
    assert step_px < 1.1 * (20 - 4) / STEPS
    np.testing.assert_allclose(seen_px[known], disparity.disparity_px[known], atol=0.51 * step_px)
    np.testing.assert_array_equal(blue == 255, ~known)
    np.testing.assert_array_equal(blue == 0, ~disparity.valid & known)
    measured = known & disparity.valid
    np.testing.assert_allclose((blue[measured] - 1) / 253, 0.6, atol=0.012)


@pytest.mark.parametrize(("low_px", "high_px"), [(-0.73, 0.61), (3.04, 41.27), (-80.2, 210.9), (12.34, 12.34)])
def test_the_page_and_the_command_round_disparity_alike(
    rng: np.random.Generator, low_px: float, high_px: float
) -> None:
    """Rounded to the page's steps first and to tenths then, each value is as Python prints it at once."""
    disparity_px = rng.uniform(low_px, high_px, (80, 120)).astype(np.float32)
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), np.ones(disparity_px.shape, np.bool_))
    told = viewed_capture(np.zeros((80, 120, 3), np.float32), maps, others={}, metric=None, name="one")
    red, green, _ = np.moveaxis(levels_of(told["map"]).astype(int), 2, 0)
    lowest_px, step_px = told["mapSteps"]  # type: ignore[misc]
    seen_px = lowest_px + (256 * red + green) * step_px
    is_tie = np.abs(disparity_px.astype(float) * 10 % 1 - 0.5) < 1e-4
    printed = [[f"{value:.1f}" for value in values[~is_tie]] for values in (seen_px, disparity_px)]
    assert [word.replace("-0.0", "0.0") for word in printed[0]] == [word.replace("-0.0", "0.0") for word in printed[1]]


def test_large_photos_are_made_smaller_and_their_disparities_with_them() -> None:
    small, large = told_of(), told_of(times=20)
    assert max(large["wh"]) == LONGEST_PX  # type: ignore[type-var]
    photo_px = large["photoPx"]
    assert photo_px == pytest.approx(1800 / LONGEST_PX)
    np.testing.assert_allclose(np.array(large["levelEnds"]) * photo_px, small["levelEnds"], rtol=0.02)  # type: ignore[operator]


def test_the_page_opens_with_the_bokeh_that_was_made() -> None:
    """On a page of another size than the photo: the same place, the same blur, the same lights."""
    photo, disparity = scene(times=20)
    focus = Focus(20.0, 900, 600, sharp_px=(19.0, 21.0))
    aperture = Aperture(blades=7, curvature=0.3, rotation_deg=180)
    opening = Opening(focus, 0.7, f_number=2.8, aperture=aperture, lights=9.0)
    told = viewed_capture(photo, disparity, others={}, metric=None, name="one", opening=opening)
    scale = LONGEST_PX / photo.shape[1]
    assert told["focus"] == [600, 400]
    assert told["opensAt"] == [900, 600, 20.0]
    np.testing.assert_allclose([told["focusPx"], *told["sharpPx"]], np.array([20.0, 19.0, 21.0]) * scale)  # type: ignore[misc]
    assert [told[name] for name in ("radiusPerPx", "fNumber", "lights")] == [0.7, 2.8, 9.0]
    assert [told[name] for name in ("blades", "curvature", "turnRad")] == [7, 0.3, np.pi]


def test_a_blur_given_in_pixels_opens_as_the_f_number_that_blurs_so() -> None:
    photo, disparity = scene()
    metric = Metric(scale_px_m=12.0, doffs_px=2.0, baseline_m=0.02)
    opening = Opening(Focus(20.0, 40, 30), radius_per_px_from_f_number(f_number=4.0, baseline_m=0.02))
    told = viewed_capture(photo, disparity, others={}, metric=metric, name="one", opening=opening)
    assert told["fNumber"] == pytest.approx(4.0)


def test_behind_the_box_the_wall_goes_on() -> None:
    photo, disparity = scene()
    levels = sort_by_level(photo, disparity.disparity_px)
    assert levels.level[BOX].min() == levels.level.max() == COUNT - 1
    behind = levels.hidden_level[BOX]
    assert behind[[0, -1]].max() < levels.level[19].max() + JUMP
    np.testing.assert_allclose(levels.hidden[BOX][0], photo[10, 30:60], atol=1e-6)
    far = levels.level < 10
    np.testing.assert_array_equal(levels.hidden_level[far], levels.level[far])
    np.testing.assert_array_equal(levels.hidden[far], photo[far])


def test_a_flat_scene_has_levels() -> None:
    flat: FloatMap = np.full((20, 30), 3.0, np.float32)
    levels = sort_by_level(np.zeros((20, 30, 3), np.float32), flat)
    assert np.ptp(levels.level) == 0
    assert levels.ends_px[0] < levels.ends_px[1]


class Scripts(HTMLParser):
    """Scripts with their attributes and texts, and every address."""

    def __init__(self) -> None:
        super().__init__()
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for name, value in attrs if name in {"src", "href", "action", "srcset"}]
        assert not [name for name, _ in attrs if name.startswith("on")]
        if tag == "script":
            self.scripts.append((dict(attrs), ""))

    def handle_data(self, data: str) -> None:
        if self.scripts and self.cdata_elem == "script":
            attributes, text = self.scripts[-1]
            self.scripts[-1] = (attributes, text + data)


def page_of(tmp_path: Path, told: dict[str, object]) -> tuple[str, Scripts]:
    photo, _ = scene()
    row = ReportRow(str(told["name"]), (thumbnail("tele", photo),), {}, told)
    path = write_report(tmp_path / "report.html", [row], title="t")
    text = path.read_text(encoding="utf-8")
    found = Scripts()
    found.feed(text)
    return text, found


def test_the_policy_names_the_one_script_and_nothing_is_fetched(tmp_path: Path) -> None:
    text, found = page_of(tmp_path, told_of())
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', text)
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy[1].split(";"))
    assert rules["default-src"] == "'none'"
    assert set(rules) == {"default-src", "img-src", "style-src", "script-src"}
    (run,) = (content for attributes, content in found.scripts if "type" not in attributes)
    digest = base64.b64encode(hashlib.sha256(run.encode()).digest()).decode()
    assert rules["script-src"] == f"'sha256-{digest}'"
    assert all(address.startswith("data:image/") for address in found.addresses)
    assert not re.search(r"https?://|url\(|@import|\beval\b|innerHTML", text)


def test_names_of_captures_break_out_of_nothing(tmp_path: Path) -> None:
    _, found = page_of(tmp_path, told_of())
    ((attributes, content),) = (each for each in found.scripts if "type" in each[0])
    assert json.loads(content)["name"] == attributes["data-scene"] == "one </script> & two"


def test_a_capture_of_twelve_megapixels_takes_less_than_six_megabytes(rng: np.random.Generator) -> None:
    """Noise on everything is the worst that a photo and a matcher can do."""
    hw = (900, 1200)
    photo = np.clip(cv2.resize(rng.random((90, 120, 3)), hw[::-1]) + rng.normal(0, 0.03, (*hw, 3)), 0, 1)
    disparity_px = np.tile(np.linspace(4, 60, hw[1]), (hw[0], 1)) + rng.normal(0, 0.2, hw)
    maps = DisparityMap(disparity_px.astype(np.float32), rng.random(hw).astype(np.float32), np.ones(hw, np.bool_))
    views = {name: photo.astype(np.float32) for name in ("wide", "bokeh", "tele, corrected", "wide, corrected")}
    told = viewed_capture(photo.astype(np.float32), maps, others=views, metric=None, name="one")
    assert len(json.dumps(told)) < 6e6


def rows(names: list[str]) -> list[ReportRow]:
    photo, _ = scene()
    return [ReportRow(name, (thumbnail("tele", photo),)) for name in names]


def pages(tmp_path: Path, names: list[str]) -> Path | None:
    return write_run_page(
        tmp_path, rows(names), names=names, log=tmp_path / "none", summary="", next_steps=(), facts={}
    )


def test_many_captures_are_shown_on_several_pages_that_lead_to_each_other(tmp_path: Path) -> None:
    names = [f"{k:03d}" for k in range(2 * CAPTURES_A_PAGE + 1)]
    assert pages(tmp_path, names) == tmp_path / "report.html"
    texts = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    assert set(texts) == {"report.html", "report-2.html", "report-3.html"}
    for number, text in enumerate(texts[name] for name in sorted(texts, key=lambda n: (len(n), n))):
        assert all(f'href="{name}"' in text for name in texts)
        shown = re.findall(r"<h3>(\d+)</h3>", text)
        links = re.findall(r'<a href="(report[-\d]*.html)?#capture-(\d+)">(\d+)</a>', text)
        assert [name for _, _, name in links] == names, "an index of all, each with its place"
        for file, at, name in links:
            assert at == name
            assert f'id="capture-{name}"' in (texts[file] if file else text)
        assert shown == names[number * CAPTURES_A_PAGE : (number + 1) * CAPTURES_A_PAGE]


def test_an_index_is_only_of_more_captures_than_the_strip_shows(tmp_path: Path) -> None:
    for count, has_index in ((MOST_WITHOUT_INDEX, False), (MOST_WITHOUT_INDEX + 1, True)):
        page = pages(tmp_path, [f"{k:03d}" for k in range(count)])
        assert page is not None
        assert ("#capture-000" in page.read_text(encoding="utf-8")) == has_index


@pytest.mark.parametrize("content", ["<html>my own notes</html>", ""])
def test_a_page_of_somebody_else_stays(tmp_path: Path, content: str) -> None:
    (tmp_path / "report.html").write_text(content)
    assert pages(tmp_path, ["one"]) is None
    assert (tmp_path / "report.html").read_text() == content


def test_an_own_page_is_written_again(tmp_path: Path) -> None:
    assert pages(tmp_path, ["one"]) == pages(tmp_path, ["two"])
    assert "two" in (tmp_path / "report.html").read_text()
