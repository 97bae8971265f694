"""What a bokeh picture is focused on: points, words, and the subject of simulated scenes; and that it is told."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from bokeh.layered_world import reference_world

from telewide.bokeh.focus import Focus, find_focus, named_distance_m, named_focus, named_point
from telewide.bokeh.picture import BokehOptions, bokeh_picture, bokeh_preview, focus_note
from telewide.capture.pfm import read_pfm
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.simulate.captures import write_captures
from telewide.srgb import srgb_from_linear


def found_px(disparity_px: FloatMap, confidence: FloatMap, *, focus: str) -> float:
    return find_focus(disparity_px, confidence, focus=focus).disparity_px


@pytest.fixture
def scene_px() -> np.ndarray:
    """A wall at -3 px, a person in the middle at 12 px, a branch in the corner at 30 px."""
    disparity_px = np.full((120, 160), -3.0, np.float32)
    disparity_px[30:, 60:100] = 12.0
    disparity_px[:30, :40] = 30.0
    return disparity_px


def test_a_photo_on_its_side_is_blurred_as_one_held_upright(scene_px: np.ndarray, rng: np.random.Generator) -> None:
    """The default strength is a share of the longer side, whichever that is."""
    photo = rng.random((*scene_px.shape, 3), dtype=np.float32)
    pictures = []
    for turns in (0, 1):
        turned_px, turned = (np.ascontiguousarray(np.rot90(values, turns)) for values in (scene_px, photo))
        disparity = DisparityMap(turned_px, np.ones_like(turned_px), np.ones(turned_px.shape, np.bool_))
        focus = Focus(12.0, 0, 0)
        pictures.append(bokeh_picture(turned.copy, disparity, options=BokehOptions(), baseline_m=None, focus=focus))
    np.testing.assert_allclose(np.rot90(pictures[0]), pictures[1], atol=0.02)


@pytest.mark.parametrize("options", [BokehOptions(strength_px=16.0), BokehOptions(f_number=4.0), BokehOptions()])
def test_a_preview_is_the_picture_made_smaller(options: BokehOptions) -> None:
    world = reference_world(384)
    photo, disparity_px = np.clip(srgb_from_linear(world.photo_linear()), 0, 1), 40 * world.disparity_px()
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), np.ones(disparity_px.shape, np.bool_))
    focus = find_focus(disparity_px, maps.confidence, focus="auto")
    whole = bokeh_picture(lambda: photo, maps, options=options, baseline_m=0.012, focus=focus)
    small = bokeh_preview(photo, maps, options=options, baseline_m=0.012, focus=focus)
    assert small.shape == (96, 96, 3)
    expected = cv2.resize(whole, (96, 96), interpolation=cv2.INTER_AREA)
    assert -10 * np.log10(np.mean((small - expected) ** 2)) > 33


def test_focus_words_name_the_surfaces(scene_px: np.ndarray, rng: np.random.Generator) -> None:
    noisy_px = scene_px + rng.normal(0, 0.1, scene_px.shape).astype(np.float32)
    confidence = np.ones_like(noisy_px)
    noisy_px[50:60, 70:80], confidence[50:60, 70:80] = 55.0, 0.1  # a mistake that knows it is one
    noisy_px[::17, ::13] = np.nan
    assert found_px(noisy_px, confidence, focus="auto") == pytest.approx(12, abs=0.3)
    assert found_px(noisy_px, confidence, focus="near") == pytest.approx(30, abs=0.5)
    assert found_px(noisy_px, confidence, focus=" FAR ") == pytest.approx(-3, abs=0.5)
    assert np.isfinite(found_px(noisy_px, np.zeros_like(confidence), focus="auto"))


@pytest.mark.parametrize("word", ["auto", "near", "far"])
def test_focus_on_one_distance_is_that_distance(word: str) -> None:
    assert found_px(np.full((30, 40), -7.5, np.float32), np.ones((30, 40), np.float32), focus=word) == -7.5


def test_focus_point_is_the_surface_under_it(scene_px: np.ndarray) -> None:
    confidence = np.ones_like(scene_px)
    for point, expected in (("80,60", 12), ("60, 30", 12), ("59,30", -3), ("0,0", 30), ("159,119", -3), ("-0.4,5", 30)):
        assert found_px(scene_px, confidence, focus=point) == expected
    scene_px[60, 80] = np.nan
    assert found_px(scene_px, confidence, focus="80,60") == 12


@pytest.mark.parametrize("focus", ["160,5", "5,120", "-1,5", "5,-1", "1e9,4"])
def test_focus_outside_the_photo_is_a_usage_error(scene_px: np.ndarray, focus: str) -> None:
    with pytest.raises(UsageError, match="160 x 120"):
        found_px(scene_px, np.ones_like(scene_px), focus=focus)


def test_a_distance_is_the_plane_at_it(scene_px: np.ndarray) -> None:
    confidence = np.ones_like(scene_px)
    focus = find_focus(scene_px, confidence, focus="2.5 m", disparity_at_m=lambda depth_m: 30 / depth_m)
    assert focus.disparity_px == pytest.approx(12)
    assert scene_px[focus.y_px, focus.x_px] == 12
    with pytest.raises(UsageError, match="metres are not known"):
        find_focus(scene_px, confidence, focus="2.5m")


@pytest.mark.parametrize(("focus", "metres"), [("80cm", 0.8), (" 12.5 CM ", 0.125), ("250cm", 2.5), ("2.5m", 2.5)])
def test_a_distance_may_be_in_centimetres(focus: str, metres: float) -> None:
    assert named_distance_m(focus) == pytest.approx(metres)
    assert named_point(focus, hw=None) is None


@pytest.mark.parametrize("focus", ["50m", "0.1m", "4m"])
def test_a_distance_at_which_nothing_is_says_so_and_contradicts_itself_in_nothing(
    scene_px: np.ndarray, focus: str
) -> None:
    """Behind everything, before everything, and between the person and the wall."""
    found = find_focus(scene_px, np.ones_like(scene_px), focus=focus, disparity_at_m=lambda depth_m: 30 / depth_m - 8)
    assert not found.is_on_surface
    note = focus_note("000", found, place_px=found.disparity_px, depth_m=1.5, options=BokehOptions(focus=focus))
    assert f"focused {focus[:-1]} m away, where nothing is" in note
    assert f"nearest to that is x {found.x_px}, y {found.y_px}, 1.50 m away" in note


def test_a_named_distance_is_told_as_that_of_the_sharp_plane(scene_px: np.ndarray) -> None:
    """The surface lies 0.7 px off, near enough to be sharp, and 1.84 m away by its own disparity."""
    f_px_m = float(scene_px.max()) * 1.84
    found = find_focus(scene_px, np.ones_like(scene_px), focus="1.8m", disparity_at_m=lambda depth_m: f_px_m / depth_m)
    assert found.is_on_surface
    place_px = f_px_m / 1.84
    note = focus_note("000", found, place_px=place_px, depth_m=1.84, options=BokehOptions(focus="1.8m"))
    sharp, _, surface = note.partition(";")
    assert sharp == "000: the bokeh was focused 1.8 m away"
    assert surface == f" nearest to that is x {found.x_px}, y {found.y_px}, 1.84 m away, disparity {place_px:.1f} px"


@pytest.mark.parametrize("focus", ["0m", "0.0 m", "0cm"])
def test_a_distance_of_nothing_is_a_usage_error(scene_px: np.ndarray, focus: str) -> None:
    with pytest.raises(UsageError, match="above 0 m"):
        find_focus(scene_px, np.ones_like(scene_px), focus=focus, disparity_at_m=lambda depth_m: depth_m)


@pytest.mark.parametrize(
    "focus", ["", "nearest", "-2m", "1,2m", "m", "cm", "80c m", "80mm", "12", "1,2,3", "a,b", "nan,3", "3,inf"]
)
def test_unreadable_focus_is_a_usage_error(scene_px: np.ndarray, focus: str) -> None:
    with pytest.raises(UsageError, match="X,Y"):
        found_px(scene_px, np.ones_like(scene_px), focus=focus)


@pytest.mark.parametrize(
    ("focus", "meant"), [("1.8", "1.8m"), (" 2 ", "2m"), ("80", "80cm, or 80m"), ("1,8m", "1.8m"), ("1.8mm", None)]
)
def test_a_bare_number_is_asked_for_its_unit(scene_px: np.ndarray, focus: str, meant: str | None) -> None:
    with pytest.raises(UsageError, match="X,Y") as refusal:
        found_px(scene_px, np.ones_like(scene_px), focus=focus)
    assert refusal.value.hint == (meant and f"did you mean {meant}?")


def test_a_map_alone_knows_no_place_of_exif(scene_px: np.ndarray) -> None:
    with pytest.raises(UsageError, match="no EXIF"):
        find_focus(scene_px, np.ones_like(scene_px), focus="AF")
    assert named_focus("near", (0.5, 0.5), hw=(10, 10)) == "near"


def test_focus_without_any_disparity_is_refused() -> None:
    with pytest.raises(InputError, match="no known value"):
        found_px(np.full((9, 9), np.nan, np.float32), np.ones((9, 9), np.float32), focus="auto")


# The subject


def test_auto_takes_what_stands_before_the_wall_though_the_wall_is_larger_and_flatter() -> None:
    """A round object in the middle spreads over many disparities, the wall lies at a single one."""
    y, x = np.mgrid[-1:1:120j, -1.5:1.5:180j]
    disparity_px = np.full(x.shape, 6.0, np.float32)
    radius = np.hypot(x, y)
    ball = radius < 0.35
    disparity_px[ball] = 30 + 8 * np.sqrt(0.35**2 - radius[ball] ** 2)
    disparity_px[100:] = np.linspace(20, 45, 20)[:, None]  # the floor, nearer still, but not in the middle
    focus = find_focus(disparity_px, np.ones_like(disparity_px), focus="auto")
    assert 29.5 < focus.disparity_px < 33
    assert ball[focus.y_px, focus.x_px]
    assert abs(disparity_px[focus.y_px, focus.x_px] - focus.disparity_px) < 0.5
    assert focus.sharp_px is not None
    assert focus.sharp_px[0] < 30.7, "to the rim of the ball"
    assert focus.sharp_px[1] > 32.3, "and to its front"


def test_auto_keeps_the_whole_subject_sharp_and_blurs_the_rest(rng: np.random.Generator) -> None:
    y, x = np.mgrid[-1:1:120j, -1.5:1.5:180j]
    ball = np.hypot(x, y) < 0.5
    disparity_px = np.where(ball, 30 + 4 * np.sqrt(np.maximum(0.25 - x**2 - y**2, 0)), 6).astype(np.float32)
    photo = rng.random((*ball.shape, 3), dtype=np.float32)
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), np.ones(ball.shape, np.bool_))
    picture = bokeh_picture(lambda: photo, maps, options=BokehOptions(strength_px=8.0), baseline_m=None)
    well_inside = np.hypot(x, y) < 0.4
    np.testing.assert_allclose(picture[well_inside], photo[well_inside], atol=1e-4)
    assert picture[~ball].std() < 0.5 * photo[~ball].std()


def test_auto_takes_the_wall_where_nothing_large_stands_before_it() -> None:
    disparity_px = np.full((120, 180), 6.0, np.float32)
    disparity_px[:, 88:91] = 40.0  # a rod
    disparity_px[80:, :30] = 30.0  # a box in the corner
    focus = find_focus(disparity_px, np.ones_like(disparity_px), focus="auto")
    assert focus == Focus(6.0, 91, 59, sharp_px=(6.0, 6.0))


def test_auto_does_not_take_what_is_not_trusted(rng: np.random.Generator) -> None:
    disparity_px = np.full((120, 180), 6.0, np.float32)
    confidence = np.ones_like(disparity_px)
    disparity_px[40:80, 60:120], confidence[40:80, 60:120] = rng.uniform(20, 40, (40, 60)), 0.2
    focus = find_focus(disparity_px, confidence, focus="auto")
    assert focus.disparity_px == 6.0
    assert confidence[focus.y_px, focus.x_px] == 1


def table(*, hw: tuple[int, int] = (160, 240)) -> tuple[np.ndarray, np.ndarray]:
    """Disparity of a set table seen from above, before a bookshelf at 3.4 to 3.7 m; rows and columns from -1 to 1."""
    y, x = np.meshgrid(np.linspace(-1, 1, hw[0]), np.linspace(-1, 1, hw[1]), indexing="ij")
    ground_m = np.where(y > -0.1, 0.36 / np.maximum(0.16 + 0.3 * (y + 0.1), 1e-3), 9.0)
    shelf_m = np.where(np.sin(25 * x) > 0.3, 3.4, 3.7)
    return np.where(ground_m < 2.0, ground_m, shelf_m), np.stack([y, x])


@pytest.mark.parametrize("foot_m", [0.7, 0.9, 1.2])
@pytest.mark.parametrize("kind", ["vase", "box", "ball"])
@pytest.mark.parametrize("centre", [(0.05, 0.0), (0.35, -0.3), (0.4, 0.3)], ids=["central", "left", "right"])
def test_auto_takes_the_thing_on_the_table_and_no_bookshelf_behind_it(
    foot_m: float, kind: str, centre: tuple[float, float], rng: np.random.Generator
) -> None:
    """It covers most of the central third, or stands beside and below it, as people place things."""
    depth_m, (y, x) = table()
    v, u = (y - centre[0]) / 0.55, (x - centre[1]) / 0.32
    inside = {"vase": np.abs(u) < 0.55 + 0.4 * np.cos(2.2 * v - 1), "box": np.abs(u) < 0.9, "ball": u**2 + v**2 < 1}[
        kind
    ]
    thing = inside & (np.abs(v) < 1)
    depth_m = np.where(thing, foot_m - 0.05 * np.sqrt(np.maximum(1 - u**2, 0)), depth_m)
    disparity_px = (18 / depth_m + rng.normal(0, 0.05, depth_m.shape)).astype(np.float32)
    focus = find_focus(disparity_px, np.ones_like(disparity_px), focus="auto")
    assert thing[focus.y_px, focus.x_px]
    assert focus.sharp_px is not None
    is_sharp = (disparity_px >= focus.sharp_px[0] - 0.3) & (disparity_px <= focus.sharp_px[1] + 0.3)
    assert is_sharp[thing].mean() > 0.9
    assert is_sharp[depth_m > 3].mean() == 0


def test_auto_finds_the_subject_of_simulated_still_lifes(tmp_path: Path) -> None:
    """Where most of the middle of the photo stands clearly before the wall, the wall is not what is sharp."""
    n_judged = 0
    for folder in write_captures(tmp_path, count=4, seed=2, hw=(128, 192)):
        truth_px = read_pfm(folder / "truth.pfm")
        middle_px = truth_px[50:78, 76:116]
        wall_px, nearest_px = np.nanpercentile(truth_px, (1, 99))
        before_px = wall_px + 0.25 * (nearest_px - wall_px)
        if np.nanmean(middle_px > before_px) < 0.6:
            continue
        n_judged += 1
        focus = find_focus(truth_px, np.ones_like(truth_px), focus="auto")
        assert focus.disparity_px > before_px
    assert n_judged >= 2


def test_the_place_lies_on_the_plane_of_focus(scene_px: np.ndarray) -> None:
    confidence = np.ones_like(scene_px)
    for word in ("auto", "near", "far", "20,10", "150,100"):
        focus = find_focus(scene_px, confidence, focus=word)
        assert scene_px[focus.y_px, focus.x_px] == pytest.approx(focus.disparity_px, abs=0.5)
    point = find_focus(scene_px, confidence, focus="150,100")
    assert (point.x_px, point.y_px) == (150, 100)


def test_surfaces_and_distances_are_looked_for_where_something_was_measured(scene_px: np.ndarray) -> None:
    """Filled-in pixels that are nearer than all others, and as far away as is asked for, are passed by."""
    filled_px, valid = scene_px.copy(), np.ones(scene_px.shape, bool)
    filled_px[:5], valid[:5] = scene_px.max() + 20, False
    confidence = np.ones_like(scene_px)
    measured = find_focus(scene_px, confidence, focus="near")
    passed = find_focus(filled_px, confidence, focus="near", valid=valid)
    assert passed.disparity_px == pytest.approx(measured.disparity_px, abs=0.1)
    placed = find_focus(filled_px, confidence, focus="1m", disparity_at_m=lambda _: 99.0, valid=valid)
    assert valid[passed.y_px, passed.x_px]
    assert valid[placed.y_px, placed.x_px]
    assert find_focus(filled_px, confidence, focus="near", valid=np.zeros_like(valid)).y_px < 5


def test_what_is_sharp_is_told_with_its_place_distance_and_how_to_change_it() -> None:
    note = focus_note("000", Focus(12.1, 80, 60), place_px=12.34, depth_m=1.5, options=BokehOptions())
    for words in ("000", "x 80, y 60", "1.50 m", "12.3 px", "`focus`"):
        assert words in note
    pointed = focus_note("000", Focus(12.1, 80, 60), place_px=12.34, depth_m=None, options=BokehOptions(focus="80,60"))
    assert " m away" not in pointed
    assert "`focus`" not in pointed


@pytest.mark.parametrize(
    ("std_m", "told"),
    [
        (None, ", 0.30 m away"),
        (0.012, ", 0.30 ± 0.012 m away"),
        (0.14, ", 0.30 ± 0.14 m away"),
        (0.19, ", at a distance the rig hardly knows; `distance` X,Y,M would tell"),
        (float("nan"), ", at a distance the rig hardly knows; `distance` X,Y,M would tell"),
    ],
)
def test_how_sure_a_distance_is_stands_beside_it(std_m: float | None, told: str) -> None:
    note = focus_note("000", Focus(12.1, 80, 60), place_px=12.34, depth_m=0.3, std_m=std_m, options=BokehOptions())
    assert note.startswith(f"000: the bokeh was focused on x 80, y 60{told}, disparity 12.3 px")
