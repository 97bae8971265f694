"""The page in a browser: its pixels against the Python renderer's, clicks, keys, and widths."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bokeh.layered_world import reference_world
from pages.browser import page_in_browser
from pages.made_calibration import made_calibration
from pages.test_board_rig import page_of as rig_page_of
from PIL import Image

from telewide.bokeh.aperture import Aperture
from telewide.bokeh.focus import Focus
from telewide.bokeh.hidden import COUNT, JUMP
from telewide.bokeh.highlights import MAX_TIMES
from telewide.bokeh.render import radius_per_px_from_f_number, render_bokeh
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.pages.report import CaptureLink, NextStep, ReportRow, thumbnail, write_report
from telewide.pages.viewed import Metric, Opening, viewed_capture
from telewide.srgb import srgb_from_linear

SIDE = 96
SIDES = ("width", "height")
METRIC = Metric(scale_px_m=12.0, doffs_px=2.0, baseline_m=0.02)
DONE = "canvas[data-done='1']"
pytestmark = pytest.mark.slow


def world() -> tuple[FloatImage, FloatMap]:
    """Slanted ground, a wheel with thin spokes, a near post, and small lights."""
    truth = reference_world(SIDE)
    photo = np.clip(srgb_from_linear(truth.photo_linear()), 0, 1).astype(np.float32)
    return photo, (8 * truth.disparity_px()).astype(np.float32)


def page_of(tmp_path: Path, *, metric: Metric | None, opening: Opening | None = None) -> tuple[Path, dict[str, object]]:
    photo, disparity_px = world()
    maps = DisparityMap(disparity_px, np.full_like(disparity_px, 0.9), np.ones(disparity_px.shape, np.bool_))
    told = viewed_capture(photo, maps, others={"wide": photo[::-1]}, metric=metric, name="wheel", opening=opening)
    rows = [ReportRow(name, (thumbnail("tele", photo),), {"a rather long heading, px": 1.5}, told) for name in "ab"]
    command = "telewide depth " + "a/very/long/folder/name/" * 12
    steps = [NextStep("Next:", command, {name: f"{command} --only {name}" for name in "ab"}), NextStep("Then:", "all")]
    path = write_report(tmp_path / "report.html", rows, title="Page", next_steps=steps)
    return path, told


def pixels(page: Any) -> FloatImage:
    uri = page.evaluate("document.getElementById('picture').toDataURL('image/png')")
    return _decoded(uri)


def _decoded(uri: object) -> FloatImage:
    levels = np.asarray(Image.open(io.BytesIO(base64.b64decode(str(uri).split(",")[1]))).convert("RGB"))
    return levels.astype(np.float32) / 255


@contextmanager
def drawn_anew(page: Any) -> Iterator[None]:
    """Wait for the picture that the body asks for."""
    former = page.locator("canvas").get_attribute("data-drawing")
    yield
    page.wait_for_selector(f"canvas[data-done='1']:not([data-drawing='{former}'])", timeout=120_000)


def click(page: Any, x: int, y: int) -> None:
    box = page.locator("canvas").bounding_box()
    at = {"x": (x + 0.5) * box["width"] / SIDE, "y": (y + 0.5) * box["height"] / SIDE}
    with drawn_anew(page):
        page.locator("canvas").click(position=at)  # scrolls to it first


def turn(page: Any, name: str, value: int) -> None:
    with drawn_anew(page):
        page.locator(f"#{name}").fill(str(value))


def psnr(a: FloatImage, b: FloatImage) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def place_of(disparity_px: FloatMap, value_px: float) -> tuple[int, int]:
    y, x = np.unravel_index(np.abs(disparity_px - value_px).argmin(), disparity_px.shape)
    return int(x), int(y)


@pytest.mark.parametrize(("stop", "lights"), [(5, 2), (0, 0)])
def test_pixels_are_those_of_the_python_renderer(tmp_path: Path, stop: int, lights: int) -> None:
    """f/1.8 and f/1, focused near and far, with and without blades and recovered lights."""
    path, told = page_of(tmp_path, metric=METRIC)
    sharp = _decoded(told["pictures"]["tele"])  # type: ignore[index]
    _, disparity_px = world()
    per_px = radius_per_px_from_f_number(f_number=2 ** (stop / 6), baseline_m=METRIC.baseline_m)
    found = []
    with page_in_browser(path) as page:
        page.wait_for_selector(DONE, timeout=120_000)
        turn(page, "stop", stop)
        turn(page, "lights", lights)
        for focus_px, blades in ((disparity_px.max(), None), (disparity_px.min(), None), (disparity_px.min(), 6)):
            turn(page, "blades", blades or 4)
            x, y = place_of(disparity_px, focus_px)
            click(page, x, y)
            aperture = Aperture(blades=blades)
            expected = render_bokeh(
                sharp,
                disparity_px,
                focus_disparity_px=float(disparity_px[y, x]),
                radius_per_px=per_px,
                aperture=aperture,
                highlights=2**lights,
            )
            expected = np.clip(expected, 0, 1)
            found.append((psnr(pixels(page), expected), psnr(sharp, expected)))
    assert min(same for same, _ in found) >= 35, found
    assert min(same - blurred for same, blurred in found) > 6, found  # there was something to blur


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Any]:
    """The page with metres, drawn."""
    with page_in_browser(page_of(tmp_path, metric=METRIC)[0]) as page:
        page.wait_for_selector(DONE, timeout=120_000)
        yield page


def test_clicking_two_things_exchanges_their_sharpness(opened: Any) -> None:
    _, disparity_px = world()
    near, far = (disparity_px == disparity_px.max()), (disparity_px == disparity_px.min())
    inside = [cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0 for mask in (near, far)]

    def sharpness() -> list[float]:
        edges = cv2.Laplacian(pixels(opened).mean(axis=2), cv2.CV_32F)
        return [float(edges[mask].std()) for mask in inside]

    click(opened, *place_of(disparity_px, disparity_px.max()))
    near_sharp, far_blurred = sharpness()
    click(opened, *place_of(disparity_px, disparity_px.min()))
    near_blurred, far_sharp = sharpness()
    assert near_sharp > 1.3 * near_blurred
    assert far_sharp > 1.3 * far_blurred


def test_read_out_says_place_disparity_metres_and_confidence(opened: Any) -> None:
    _, disparity_px = world()
    x, y = place_of(disparity_px, disparity_px.max())
    click(opened, x, y)
    told = opened.inner_text("#readout")
    metres = METRIC.scale_px_m / (float(disparity_px[y, x]) + METRIC.doffs_px)
    assert told == f"x {x}, y {y} · {disparity_px[y, x]:.1f} px · {metres:.2f} m · confidence 90 %"
    assert opened.inner_text("#extent") == "From 1.20 m to 6.00 m."


def test_it_opens_with_the_bokeh_that_was_made(tmp_path: Path) -> None:
    """The first picture is the renderer's, of a blur no step of a slider stands for; a turned slider then counts."""
    _, disparity_px = world()
    focus = Focus(float(disparity_px.min()), *place_of(disparity_px, disparity_px.min()))
    opening = Opening(focus, 1.13, f_number=2.2, aperture=Aperture(blades=6), lights=5.0)
    path, told = page_of(tmp_path, metric=None, opening=opening)
    sharp = _decoded(told["pictures"]["tele"])  # type: ignore[index]
    expected = render_bokeh(
        sharp,
        disparity_px,
        focus_disparity_px=focus.disparity_px,
        radius_per_px=1.13,
        aperture=Aperture(blades=6),
        highlights=5.0,
    )
    with page_in_browser(path) as page:
        page.wait_for_selector(DONE, timeout=120_000)
        assert psnr(pixels(page), np.clip(expected, 0, 1)) > 38
        place = f"x {focus.x_px}, y {focus.y_px} \N{MIDDLE DOT} {disparity_px[focus.y_px, focus.x_px]:.1f} px"
        assert page.inner_text("#readout").startswith(place)
        words = [page.inner_text(f"#{name}") for name in ("number", "bladesWord", "lightsWord")]
        assert words == ["f/2.2", "6", "\N{MULTIPLICATION SIGN} 5"]
        turn(page, "stop", 12)
        assert page.inner_text("#number") == "f/4.0"
        assert page.inner_text("#lightsWord") == words[2]


def test_a_lamp_off_the_focus_shows_the_blades_with_their_roundness_and_turn(tmp_path: Path) -> None:
    """Five of them, so that those turned to the other side look different."""
    photo = np.zeros((SIDE, SIDE, 3), np.float32)
    photo[62:67, 62:67] = 1.0
    disparity_px = np.zeros((SIDE, SIDE), np.float32)
    disparity_px[:8, :8] = 12.0
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), np.ones(disparity_px.shape, np.bool_))
    asked = Aperture(blades=5, curvature=0.5, rotation_deg=18)
    opening = Opening(Focus(12.0, 4, 4), 1.0, f_number=2.0, aperture=asked)
    told = viewed_capture(photo, maps, others={}, metric=None, name="lamp", opening=opening)
    row = ReportRow("lamp", (thumbnail("tele", photo),), {}, told)
    path = write_report(tmp_path / "report.html", [row], title="Page", next_steps=[])
    with page_in_browser(path) as page:
        page.wait_for_selector(DONE, timeout=120_000)
        shown = pixels(page)
    asked_for, *others = (
        render_bokeh(photo, disparity_px, focus_disparity_px=12.0, radius_per_px=1.0, aperture=aperture)
        for aperture in (asked, replace(asked, curvature=0.0), replace(asked, rotation_deg=-18))
    )
    assert psnr(shown, asked_for) > 42
    # Share of the way from another opening's picture to the one asked for: 1 there, 0 where the page ignores the word.
    ways = [float(np.sum((shown - other) * (asked_for - other)) / np.sum((asked_for - other) ** 2)) for other in others]
    np.testing.assert_allclose(ways, 1, atol=0.3)


def test_keys_move_the_focus_and_turn_the_aperture(opened: Any) -> None:
    """By a hundredth of the shorter side, with Shift by ten; the border holds it."""
    click(opened, SIDE // 2, SIDE // 2)
    opened.locator("canvas").focus()
    places = []
    for key in ("ArrowLeft", "Shift+ArrowLeft", "ArrowDown", "Shift+ArrowUp", *("Shift+ArrowRight",) * 9):
        opened.keyboard.press(key)
        found = re.match(r"x (\d+), y (\d+) ", opened.inner_text("#readout"))
        assert found is not None
        places.append((int(found[1]) - SIDE // 2, int(found[2]) - SIDE // 2))
    assert places[:4] == [(-1, 0), (-11, 0), (-11, 1), (-11, -9)]
    assert places[-1] == (SIDE - 1 - SIDE // 2, -9)
    assert "Shift" in opened.inner_text(".hint.aperture")
    opened.locator("#stop").focus()
    opened.keyboard.press("End")
    assert opened.inner_text("#number") == "f/16.0"
    opened.locator("#lights").focus()
    opened.keyboard.press("End")
    assert opened.inner_text("#lightsWord") == f"\N{MULTIPLICATION SIGN} {MAX_TIMES:g}"
    opened.wait_for_selector(DONE, timeout=120_000)
    outline = opened.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid"


def test_each_view_says_what_to_do_in_it(opened: Any) -> None:
    told = {}
    for view in ("focus", "around", "compare"):
        opened.click(f"#views button[value={view}]")
        told[view] = opened.locator(".side .hint:visible:not(#madeBy)").all_inner_texts()
    assert [len(hints) for hints in told.values()] == [1, 1, 1]
    assert [hints[0].split()[0] for hints in told.values()] == ["Click", "Drag", "Drag"]


def test_looking_around_moves_what_is_near_against_what_is_far(opened: Any) -> None:
    _, disparity_px = world()
    click(opened, *place_of(disparity_px, disparity_px.min()))
    with drawn_anew(opened):
        opened.click("#views button[value=around]")
    straight = pixels(opened)
    box = opened.locator("canvas").bounding_box()
    opened.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    opened.mouse.down()
    with drawn_anew(opened):
        opened.mouse.move(box["x"] + box["width"] - 1, box["y"] + box["height"] / 2, steps=5)
    opened.mouse.up()
    assert opened.evaluate("getSelection().type") != "Range"
    apart = np.abs(pixels(opened) - straight).mean(axis=2)
    far = cv2.erode((disparity_px == disparity_px.min()).astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    assert apart[far].mean() < 0.01 < apart[disparity_px == disparity_px.max()].mean()


def test_comparing_shows_two_pictures_that_meet_where_the_slider_stands(opened: Any) -> None:
    opened.click("#views button[value=compare]")
    assert opened.locator("#left option").all_inner_texts() == ["tele", "wide", "disparity"]
    opened.select_option("#right", "wide")
    opened.locator("#divider").fill("25")
    assert opened.evaluate("getComputedStyle(document.getElementById('over')).clipPath") == "inset(0px 75% 0px 0px)"
    sources = opened.evaluate("['over', 'under'].map((id) => document.getElementById(id).src)")
    assert sources[0] != sources[1]


def test_arrow_keys_are_those_of_the_view_that_was_chosen(opened: Any) -> None:
    opened.click("#views button[value=compare]")
    opened.keyboard.press("ArrowRight")
    assert opened.locator("#divider").input_value() == "50.5"
    opened.click("#views button[value=focus]")
    before = opened.inner_text("#readout")
    with drawn_anew(opened):
        opened.keyboard.press("ArrowRight")
    assert opened.inner_text("#readout") != before


@pytest.mark.parametrize("view", ["tele", "disparity"])
def test_dragging_anywhere_on_the_picture_moves_the_line_and_selects_nothing(opened: Any, view: str) -> None:
    """At the top of the picture, far from the slider's handle; let go, it stays; the keys go on from there."""
    opened.click("#views button[value=compare]")
    opened.select_option("#left", view)
    box = opened.locator(".stage").bounding_box()

    def line() -> float:
        over = opened.locator("#over").evaluate("(e) => getComputedStyle(e).clipPath")
        return 100 - float(over.split("px ")[1].split("%")[0])

    opened.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.1 * box["height"])
    opened.mouse.down()
    for share in (0.6, 0.4, 0.2):
        opened.mouse.move(box["x"] + share * box["width"], box["y"] + 0.3 * box["height"], steps=4)
        assert line() == pytest.approx(100 * share, abs=0.6)
    opened.mouse.move(box["x"] - 40, box["y"] + 0.3 * box["height"])
    assert line() == 0, "beyond the picture it is held"
    opened.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.9 * box["height"])
    opened.mouse.up()
    opened.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.3 * box["height"])
    assert line() == pytest.approx(30, abs=0.6)
    assert opened.evaluate("getSelection().type") != "Range"
    opened.keyboard.press("ArrowRight")
    assert line() == pytest.approx(30.5, abs=0.6)


def test_a_finger_wipes_too_and_scrolls_by_going_down(tmp_path: Path) -> None:
    """Moved by the browser's own touches, which it keeps to itself where a page does not forbid it."""
    path, _ = page_of(tmp_path, metric=None)
    with page_in_browser(path, wh=(390, 844), has_touch=True) as page:
        page.wait_for_selector(DONE, timeout=120_000)
        page.click("#views button[value=compare]")
        box = page.locator(".stage").bounding_box()
        touch = page.context.new_cdp_session(page)

        def drag(to: tuple[float, float]) -> float:
            for step in range(9):
                x, y = (box[a] + box[s] * (0.5 + (t - 0.5) * step / 8) for a, s, t in zip("xy", SIDES, to, strict=True))
                kind = "touchMove" if step else "touchStart"
                touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y}]})
            touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
            page.wait_for_timeout(300)
            return float(page.evaluate("scrollY"))

        assert drag((0.9, 0.5)) == 0
        assert page.evaluate("Number(document.getElementById('divider').value)") == pytest.approx(90, abs=1)
        assert drag((0.5, 0.1)) > 50


def test_comparing_reads_the_place_under_the_pointer(opened: Any) -> None:
    """The map says what the click in the photo says; the wide photo has its points elsewhere and says nothing."""
    _, disparity_px = world()
    x, y = place_of(disparity_px, disparity_px.max())
    opened.click("#views button[value=compare]")
    box = opened.locator(".stage").bounding_box()
    at = [box[a] + (k + 0.5) * box[side] / SIDE for a, k, side in zip("xy", (x, y), SIDES, strict=True)]
    told = {}
    for view in ("disparity", "wide"):
        for side in ("left", "right"):
            opened.select_option(f"#{side}", view)
        opened.mouse.move(*at)
        told[view] = opened.inner_text("#readout")
    metres = METRIC.scale_px_m / (float(disparity_px[y, x]) + METRIC.doffs_px)
    assert told["disparity"] == f"x {x}, y {y} · {disparity_px[y, x]:.1f} px · {metres:.2f} m · confidence 90 %"
    assert told["wide"] == "Distances are read over tele, bokeh and disparity."


def test_depth_edges_are_drawn_where_depth_jumps(opened: Any) -> None:
    """Orange on the near side of each jump by more than the renderer takes for one surface, and nowhere else."""
    _, disparity_px = world()
    before = pixels(opened)
    with drawn_anew(opened):
        opened.check("#edges")
    shown = pixels(opened)
    is_orange = np.abs(shown - [1.0, 0.45, 0.1]).max(axis=2) < 0.01
    assert not (np.abs(before - [1.0, 0.45, 0.1]).max(axis=2) < 0.01).any()
    step_px = (disparity_px.max() - disparity_px.min()) / (COUNT - 1)
    around = np.ones((3, 3), np.uint8)
    drop_px = disparity_px - cv2.erode(disparity_px, around)
    assert is_orange[
        np.asarray(drop_px > (JUMP + 2) * step_px) & _beside_in_row(disparity_px, (JUMP + 2) * step_px)
    ].all()
    assert is_orange.sum() > 100
    assert not is_orange[drop_px < (JUMP - 1) * step_px].any()
    opened.uncheck("#edges")
    opened.wait_for_selector(DONE, timeout=120_000)
    np.testing.assert_allclose(pixels(opened), before, atol=0.02)


def _beside_in_row(disparity_px: FloatMap, least_px: float) -> np.ndarray:
    """Whether the neighbour on the left or on the right is farther by so much."""
    falls = np.zeros(disparity_px.shape, np.bool_)
    falls[:, :-1] |= disparity_px[:, :-1] - disparity_px[:, 1:] > least_px
    falls[:, 1:] |= disparity_px[:, 1:] - disparity_px[:, :-1] > least_px
    return falls


def test_the_strip_changes_the_capture(opened: Any) -> None:
    """What next goes with it."""
    assert [call[-8:] for call in opened.locator("#next code").all_inner_texts()] == ["--only a", "all"]
    second = opened.locator("#strip button").nth(1)
    second.click()
    opened.wait_for_selector("#strip button:nth-child(2)[aria-current=true]")
    assert opened.locator("#strip [aria-current=true]").count() == 1
    assert [call[-8:] for call in opened.locator("#next code").all_inner_texts()] == ["--only b", "all"]


def test_the_index_leads_to_captures_and_their_notes(tmp_path: Path) -> None:
    """A name that an address has to spell out; a link from another page; a note that is no markup."""
    photo, disparity_px = world()
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), np.ones(disparity_px.shape, np.bool_))
    names = ["a", "Caf\u00e9 & b/c #1", "left"]
    rows = []
    for name in names:
        told = viewed_capture(photo, maps, others={}, metric=None, name=name)
        notes, made = (f"see `rig` <b>{name}</b>",), f"Matched by {name}."
        rows.append(ReportRow(name, (thumbnail("tele", photo),), {}, told, notes=notes, made_by=made))
    index = [CaptureLink(name) for name in names]
    path = write_report(tmp_path / "report.html", rows, title="Page", index=index)
    with page_in_browser(path) as page:
        page.wait_for_selector(DONE, timeout=120_000)
        for name in (names[1], names[2], names[1]):
            with drawn_anew(page):
                page.click(f".index a:has-text('{name}')")
            assert page.inner_text("#name") == name
            assert page.locator(".index a[aria-current=true]").all_inner_texts() == [name]
            assert page.inner_text("#notes") == f"see --rig <b>{name}</b>"
            assert page.inner_text("#madeBy") == f"Matched by {name}."
            if name == names[2]:
                page.locator("#strip button").first.click()
                page.wait_for_selector("#name:text-is('a')")
                page.wait_for_selector(DONE, timeout=120_000)
        address = page.url
        page.goto("about:blank")
        page.goto(address)
        page.wait_for_selector(DONE, timeout=120_000)
        assert page.inner_text("#name") == names[1]
        page.goto(path.as_uri())


def test_a_table_of_many_captures_stays_within_the_width_of_a_phone(tmp_path: Path) -> None:
    """Its heading, which is hidden there and read aloud, made the page wider than the screen."""
    headings = [*(f"figure number {n}, px of the photograph" for n in range(8)), "matching, s"]
    rows = [ReportRow(f"{n:03}", numbers=dict.fromkeys(headings, 0.5 + n)) for n in range(12)]
    path = write_report(tmp_path / "report.html", rows, title="Page")
    with page_in_browser(path, wh=(390, 844)) as page:
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.evaluate("document.querySelector('.scroll').scrollWidth") <= 390
        last = page.locator("tbody td").last
        assert last.is_visible()
        assert "matching, s" in last.evaluate("(e) => getComputedStyle(e, '::before').content")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_cut_off_at_the_width_of_a_phone(tmp_path: Path, scheme: str) -> None:
    path, _ = page_of(tmp_path, metric=None)
    with page_in_browser(path, wh=(390, 844), color_scheme=scheme, has_touch=True) as page:
        page.wait_for_selector(DONE, timeout=120_000)
        page.locator("canvas").tap(position={"x": 60, "y": 60})
        assert "confidence" in page.inner_text("#readout")
        assert "not known" in page.inner_text("#extent")
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        cut = page.evaluate(
            "[...document.querySelectorAll('td, th, pre, dd, button, p, label')].filter((e) => e.scrollWidth >"
            " e.clientWidth + 1 && e.closest('thead') === null && getComputedStyle(e).display !== 'inline')"
            ".map((e) => e.outerHTML.slice(0, 80))"
        )
        assert cut == []


def test_without_scripts_the_pictures_are_there(tmp_path: Path) -> None:
    path, _ = page_of(tmp_path, metric=METRIC)
    with page_in_browser(path, java_script_enabled=False) as page:
        assert page.locator(".static img").first.is_visible()
        assert not page.locator("#viewer").is_visible()


@pytest.mark.parametrize("width_px", [390, 1280])
def test_the_rig_report_is_not_cut_off_either(tmp_path: Path, width_px: int) -> None:
    """Its column of advice stood outside of a phone's screen."""
    rig_page_of(tmp_path / "rig.html", made_calibration())
    with page_in_browser(tmp_path / "rig.html", wh=(width_px, 844)) as page:
        assert page.evaluate("document.documentElement.scrollWidth") == width_px
        advice = page.locator("td[data-label=advice]:not(:empty)").first
        box = advice.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width_px
        assert page.evaluate("[...document.querySelectorAll('.scroll')].every((e) => e.scrollWidth <= e.clientWidth)")


def test_printed_it_shows_the_pictures_and_no_controls(opened: Any) -> None:
    opened.emulate_media(media="print")
    assert opened.locator(".static img").first.is_visible()
    assert not opened.locator("#viewer").is_visible()
