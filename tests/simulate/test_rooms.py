"""Rendered rooms: what they say of depth, cameras and light is what the photos show."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.boards.board import board_points_m, load_board
from telewide.boards.detection import detect_board
from telewide.capture.images import read_image
from telewide.capture.pfm import read_pfm
from telewide.cli.app import app
from telewide.errors import MissingPartError, UsageError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.simulate.phone import lenses_of, phone_rig
from telewide.simulate.room_furniture import bare_room, random_room
from telewide.simulate.room_paint import chessboard
from telewide.simulate.room_render import ApertureSetting, RoomTracer
from telewide.simulate.room_scene import Room, light, panel
from telewide.simulate.rooms import BOKEH_F_NUMBERS, RoomShots, board_in, write_rooms
from telewide.srgb import srgb_from_linear


@pytest.fixture(scope="module")
def mitsuba() -> None:
    """The test is skipped where the ray tracer is missing."""
    pytest.importorskip("mitsuba", reason="needs the extra simulate")


@pytest.fixture
def rig() -> StereoRig:
    return phone_rig(np.random.default_rng(1), hw=(80, 120), baseline_m=0.012)


def wall_room(*, distance_m: float, turn_deg: float = 0.0) -> Room:
    """A chessboard wall alone, lit from behind the phone."""
    normal = (float(np.sin(np.radians(turn_deg))), 0.0, -float(np.cos(np.radians(turn_deg))))
    wall = panel((0.0, 0.0, distance_m), normal, chessboard(corners=(29, 29)), half_size_m=(4.0, 4.0))
    lamp = light((0.0, -1.0, -1.0), (0.0, 0.3, 1.0), half_size_m=(0.2, 0.2), radiance=(20.0, 20.0, 20.0))
    return Room((wall,), (lamp,), (0.0, 0.0, 0.0), np.eye(4))


@pytest.mark.usefixtures("mitsuba")
def test_depth_of_a_plane_is_that_of_its_equation(rig: StereoRig) -> None:
    normal = np.array([np.sin(np.radians(25)), 0.0, -np.cos(np.radians(25))])
    depth_m = RoomTracer(wall_room(distance_m=2.0, turn_deg=25)).depth_m(rig.wide, np.eye(4))
    y_px, x_px = np.indices(rig.wide.hw)
    rays = np.column_stack([rig.wide.normalised(np.column_stack([x_px.ravel(), y_px.ravel()])), np.ones(x_px.size)])
    expected_m = (normal @ [0.0, 0.0, 2.0]) / (rays @ normal)
    np.testing.assert_allclose(depth_m.ravel(), expected_m, rtol=2e-6)


@pytest.mark.usefixtures("mitsuba")
def test_a_ray_that_meets_nothing_has_no_depth() -> None:
    camera = Camera((20, 30), np.array([[20.0, 0, 14.5], [0, 20.0, 9.5], [0, 0, 1]]), np.zeros(5))
    behind = rigid_transform(rotation=np.array([0.0, np.pi, 0.0]), translation=np.zeros(3))
    assert np.isnan(RoomTracer(wall_room(distance_m=2.0)).depth_m(camera, behind)).all()


@pytest.mark.usefixtures("mitsuba")
@pytest.mark.parametrize("lens", ["tele", "wide"])
def test_the_corners_of_a_board_lie_where_the_camera_projects_them(lens: str) -> None:
    rig = phone_rig(np.random.default_rng(3), hw=(240, 360))
    strong = replace(rig.wide, distortion=np.array([-0.15, 0.03, 0.001, -0.001, 0.0]))
    camera = {"tele": rig.tele, "wide": strong}[lens]
    room = bare_room(np.random.default_rng(1))
    distance_m = {"tele": 0.75, "wide": 0.3}[lens]
    tele_from_board = rigid_transform(
        rotation=np.array([0.3, -0.4, 0.1]), translation=np.array([-0.09, -0.06, distance_m])
    )
    picture = RoomTracer(board_in(room, tele_from_board)).photo(camera, room.world_from_tele, samples=6, seed=1)
    grey = cv2.cvtColor(srgb_from_linear(picture / np.quantile(picture, 0.98)).clip(0, 1), cv2.COLOR_RGB2GRAY)
    board = load_board("chessboard_9x6")
    view = detect_board((grey * 255).astype(np.uint8), board=board)
    assert view is not None
    points_m = board_points_m(board)[view.ids] * (0.025 / board.square_m)
    expected_px = camera.project(points_m @ tele_from_board[:3, :3].T + tele_from_board[:3, 3])
    # Half a turn of this board looks the same.
    off_px = min(
        float(np.sqrt(np.mean((view.points_px - there) ** 2) * 2)) for there in (expected_px, expected_px[::-1])
    )
    assert len(view.ids) == board.n_corners
    assert off_px < 0.1


@pytest.mark.usefixtures("mitsuba")
def test_true_depth_lays_wide_upon_tele() -> None:
    rig = phone_rig(np.random.default_rng(1), hw=(160, 240), baseline_m=0.012)
    room = random_room(np.random.default_rng(2))
    tracer = RoomTracer(room)
    tele, wide = (
        tracer.photo(camera, room.world_from_tele @ np.linalg.inv(from_tele), samples=4, seed=1)
        for _, camera, from_tele in lenses_of(rig)
    )
    depth_m = tracer.depth_m(rig.tele, room.world_from_tele)
    assert 0.5 < np.quantile(depth_m, 0.01) < 1.0
    assert 3.0 < depth_m.max() < 4.1
    blurred = cv2.GaussianBlur(tele, (0, 0), 1.5)  # about what wide resolves
    off = [
        np.median(np.abs(wide_upon_tele(wide, rig, depth) - blurred))
        for depth in (depth_m, np.full_like(depth_m, 100.0), depth_m * 0.8)
    ]
    assert off[0] < 0.6 * off[1]
    assert off[0] < 0.9 * off[2]
    is_hidden = tracer.is_hidden(rig, room.world_from_tele, depth_m=depth_m)
    assert 0.002 < is_hidden.mean() < 0.2
    # Hidden are places beside an edge, where the depth jumps.
    nearest_m = cv2.erode(depth_m, np.ones((9, 9), np.uint8))
    assert np.mean(nearest_m[is_hidden] < 0.97 * depth_m[is_hidden]) > 0.9


def wide_upon_tele(wide: FloatMap, rig: StereoRig, depth_m: FloatMap) -> FloatMap:
    """Colour that wide sees at the place of every pixel of tele."""
    y_px, x_px = np.indices(rig.tele.hw)
    normalised = rig.tele.normalised(np.column_stack([x_px.ravel(), y_px.ravel()]))
    points_m = np.column_stack([normalised, np.ones(len(normalised))]) * depth_m.reshape(-1, 1)
    there = rig.wide.project(points_m @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3])
    grid = there.reshape(*rig.tele.hw, 2).astype(np.float32)
    return np.asarray(cv2.remap(wide, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR), np.float32)


@pytest.mark.usefixtures("mitsuba")
def test_an_aperture_is_sharp_where_it_is_focused(rig: StereoRig) -> None:
    tracer = RoomTracer(wall_room(distance_m=2.0))

    def contrast(focus_m: float | None) -> float:
        aperture = None if focus_m is None else ApertureSetting(radius_m=0.0125, focus_distance_m=focus_m)
        picture = tracer.photo(rig.tele, np.eye(4), samples=16, seed=1, aperture=aperture)
        return float(picture.std() / picture.mean())

    assert contrast(2.0) == pytest.approx(contrast(None), rel=0.05)
    assert contrast(0.2) < 0.5 * contrast(None)


@pytest.mark.usefixtures("mitsuba")
def test_lamps_cast_shadows_and_no_place_is_black(rig: StereoRig) -> None:
    room = random_room(np.random.default_rng(4))
    lit = RoomTracer(room).photo(rig.wide, room.world_from_tele, samples=4, seed=1)
    empty = replace(room, solids=tuple(solid for solid in room.solids if solid.shape == "rectangle"))
    brightness = lit.max(axis=2)
    assert np.mean(brightness < 0.02 * np.median(brightness)) < 0.01
    assert brightness.max() < 20 * np.median(brightness)
    bare = RoomTracer(empty).photo(rig.wide, room.world_from_tele, samples=4, seed=1)
    assert np.mean(lit < 0.8 * bare) > 0.1


@pytest.mark.usefixtures("mitsuba")
def test_the_same_seed_writes_the_same_pictures(tmp_path: Path) -> None:
    for name, seed in (("first", 5), ("again", 5), ("other", 6)):
        write_rooms(tmp_path / name, captures=0, boards=1, seed=seed, how=RoomShots(width=96, samples=2))
    photos = [(tmp_path / name / "boards" / "000" / "wide.jpg").read_bytes() for name in ("first", "again", "other")]
    assert photos[0] == photos[1] != photos[2]


@pytest.mark.usefixtures("mitsuba")
def test_a_phone_is_written_with_all_that_is_true_of_it(tmp_path: Path) -> None:
    ticks: list[int] = []
    how = RoomShots(width=96, samples=2, is_vertical=True, is_raw=True, has_bokeh=True)
    write_rooms(tmp_path, captures=1, boards=1, seed=1, how=how, tick=lambda: ticks.append(1))
    assert len(ticks) == 2
    for shot in ("boards/000", "captures/000"):
        for lens in ("tele", "wide"):
            photo = read_image(tmp_path / shot / f"{lens}.dng")
            assert photo.shape == (64, 96, 3)
            assert 0.1 < photo.mean() < 0.9
    truth = json.loads((tmp_path / "truth" / "rig.json").read_text())
    x_m, y_m = np.array(truth["wide_from_tele"])[:2, 3]
    assert abs(y_m) > 2 * abs(x_m)
    assert 0.0099 < truth["baseline_m"] < 0.0151
    assert 2.8 < truth["asymmetry"] < 3.15
    assert truth["shots"]["000"]["wide"]["K"] != truth["wide"]["K"]
    disparity_px = read_pfm(tmp_path / "captures" / "000" / "truth.pfm")
    facts = {path.stem: json.loads(path.read_text()) for path in (tmp_path / "truth" / "000").glob("bokeh-*.json")}
    assert set(facts) == {f"bokeh-{focus}-{size}" for focus in ("far", "mid", "near") for size in BOKEH_F_NUMBERS}
    for name, bokeh in facts.items():
        assert disparity_px.min() <= bokeh["focus_disparity_px"] <= disparity_px.max()
        assert bokeh["focus_disparity_px"] * bokeh["focus_distance_m"] == pytest.approx(
            truth["tele"]["K"][0][0] * truth["baseline_m"]
        )
        assert 2 * bokeh["aperture_radius_m"] * BOKEH_F_NUMBERS[name.rpartition("-")[2]] == pytest.approx(0.050)
        assert read_image(tmp_path / "truth" / "000" / f"{name}.png").shape == (64, 96, 3)
    assert facts["bokeh-far-large"]["focus_distance_m"] > facts["bokeh-near-large"]["focus_distance_m"]
    assert read_image(tmp_path / "truth" / "hidden" / "000.png").shape[:2] == (64, 96)


def test_without_the_ray_tracer_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(MissingPartError) as caught:
        app(["simulate", str(tmp_path / "out"), "--world", "rooms", "--width", "96"], standalone_mode=False)
    assert caught.value.exit_code == 5
    assert "pip install -c constraints.txt -e '.[simulate]'" in (caught.value.hint or "")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--world", "moon"), "moon"),
        (("--phone", "--world", "rooms"), "rooms"),
        (("--samples", "4"), "--samples"),
        (("--world", "rooms", "--factor", "2"), "--factor"),
        (("--boards", "3"), "--boards"),
        (("--world", "rooms", "--lenses", "behind"), "behind"),
        (("--world", "rooms", "--samples", "0"), "samples 0"),
        (("--world", "rooms", "--width", "40"), "width 40"),
        (("--world", "rooms", "--captures", "0", "--boards", "0"), "captures 0"),
    ],
)
def test_what_no_world_can_do_is_refused(words: tuple[str, ...], named: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=named):
        app(["simulate", str(tmp_path / "out"), *words], standalone_mode=False)
    assert not (tmp_path / "out").exists()
