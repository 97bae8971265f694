"""A simulated phone in rendered rooms: photos of a board and of furnished rooms, through a sensor, to DNG or JPEG.

Written is what `telewide.simulate.phone` writes, from a ray tracer in place of painted layers: perspective, shadows and
occlusion are exact for both lenses, and so are ``captures/<name>/truth.pfm``, ``truth/rig.json`` and, where it is asked
for, what apertures see, ``truth/<name>/bokeh-<focus>-<aperture>.png``. Letters: H W photo.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from telewide.capture.images import write_image
from telewide.capture.pfm import write_pfm
from telewide.errors import UsageError
from telewide.files import write_text
from telewide.geometry.arrays import FloatArray, FloatImage, FloatMap
from telewide.geometry.rig import Camera, StereoRig
from telewide.simulate.apertures import FOCUSES
from telewide.simulate.dng import ExifFacts, write_dng, write_jpeg
from telewide.simulate.phone import (
    BOARD_CORNERS,
    BOARD_SQUARE_M,
    board_pose,
    lenses_of,
    phone_rig,
    randomly_moved,
    rig_truth,
)
from telewide.simulate.room_furniture import bare_room, random_room
from telewide.simulate.room_paint import chessboard
from telewide.simulate.room_render import ApertureSetting, RoomTracer
from telewide.simulate.room_scene import Room, Solid
from telewide.simulate.sensor import Sensor, developed, expose, phone_sensor
from telewide.srgb import srgb_from_linear
from telewide.text import json_text

LEAST_BASELINE_M, LARGEST_BASELINE_M = 0.010, 0.015
DEFAULT_SAMPLES = 6
"""Rays per pixel and light."""
BOKEH_F_NUMBERS = {"small": 4.0, "medium": 2.8, "large": 2.0}
"""Of the 50 mm lens whose openings the pictures through an aperture have."""
_BOKEH_SAMPLES = 20
"""Times as many rays as the photo's, divided by the f-number: a wide opening sees more that differs."""
_POSE_TRIES = 30
_LEAST_WIDTH_PX = 96
_FOCAL_MM = {"tele": (9.0, 80.0), "wide": (5.6, 27.0)}
"""Physical and of equal field on 36 x 24 mm."""
_FOCUS_ERROR = 0.03
_FIRST_SHOT = datetime(2026, 6, 1, 10, 0, tzinfo=UTC)
_WHITE_BALANCE_STD = 0.03
_WHITE_SHARE = 0.97
"""So much of the tele photo is darker than white."""


@dataclass(frozen=True)
class RoomShots:
    """Options of photographs of rooms.

    Attributes:
        width: of all photos, px; they are 3 : 2.
        samples: rays per pixel and light.
        is_vertical: whether the lenses stand above one another; None lets the seed say.
        is_raw: DNG instead of JPEG.
        has_bokeh: whether to render what three apertures see, focused on three distances: 60 times a photo's work.
    """

    width: int = 720
    samples: int = DEFAULT_SAMPLES
    is_vertical: bool | None = None
    is_raw: bool = False
    has_bokeh: bool = False


@dataclass(frozen=True)
class _Phone:
    """The phone and how it writes."""

    rig: StereoRig
    sensors: dict[str, Sensor]
    how: RoomShots


@dataclass(frozen=True)
class _Shot:
    """One press of the button: where its photos go, the rig of that moment, its number, its draws."""

    folder: Path
    rig: StereoRig
    number: int
    rng: np.random.Generator


def write_rooms(
    folder: Path,
    *,
    captures: int,
    boards: int = 20,
    seed: int = 0,
    how: RoomShots | None = None,
    tick: Callable[[], None] | None = None,
) -> StereoRig:
    """Write ``boards/``, ``captures/`` and ``truth/`` of a simulated phone in rendered rooms.

    Args:
        folder: made when it is not there.
        captures: number of rooms.
        boards: number of shots of the board, by both lenses.
        seed: the same seed writes the same pictures.
        how: size and kind of the photos.
        tick: called after every shot.

    Returns:
        The phone as it is when nothing moves.

    Raises:
        UsageError: a number out of range.
        MissingPartError: mitsuba is not installed.
        TelewideError: the folder cannot be written.
    """
    how = how or RoomShots()
    _check(captures=captures, boards=boards, how=how)
    tick = tick or (lambda: None)
    board_seed, capture_seed, rig_seed = np.random.SeedSequence(seed).spawn(3)
    phone = _random_phone(np.random.default_rng(rig_seed), how)
    empty = bare_room(np.random.default_rng(board_seed))
    for number, child in enumerate(board_seed.spawn(boards)):
        shot = _Shot(folder / "boards" / f"{number:03d}", phone.rig, number, np.random.default_rng(child))
        _photograph_board(phone, shot, empty)
        tick()
    moved: dict[str, StereoRig] = {}
    for number, child in enumerate(capture_seed.spawn(captures)):
        rng = np.random.default_rng(child)
        name = f"{number:03d}"
        moved[name] = randomly_moved(rng, phone.rig)
        shot = _Shot(folder / "captures" / name, moved[name], boards + number, rng)
        _photograph_room(phone, shot, truth=folder / "truth")
        tick()
    write_text(folder / "truth" / "rig.json", json_text(_rig_truth(phone.rig, moved), indent=2) + "\n")
    return phone.rig


def board_in(room: Room, tele_from_board: FloatArray) -> Room:
    """A room with the board `chessboard_9x6` held before the phone.

    Args:
        room: where.
        tele_from_board: (4, 4); the board's corner 0 at the origin, x along its columns, z into the paper, m.
    """
    texture = chessboard(corners=BOARD_CORNERS)
    half_m = np.array([texture.shape[1], texture.shape[0]]) / 16 * BOARD_SQUARE_M / 2
    middle_m = (np.array(BOARD_CORNERS) - 1) / 2 * BOARD_SQUARE_M
    # The rectangle's own z points at the phone, and its y up the board.
    board_from_rectangle = np.diag([half_m[0], -half_m[1], -1.0, 1.0])
    board_from_rectangle[:2, 3] = middle_m
    world_from_rectangle = room.world_from_tele @ tele_from_board @ board_from_rectangle
    return room.with_solid(Solid("rectangle", world_from_rectangle, texture, has_hard_edges=True))


def _check(*, captures: int, boards: int, how: RoomShots) -> None:
    if captures < 0 or boards < 0 or captures + boards < 1:
        raise UsageError(f"captures {captures}, boards {boards}: one shot or more was expected")
    if how.width < _LEAST_WIDTH_PX or how.samples < 1:
        raise UsageError(
            f"width {how.width}, samples {how.samples}: {_LEAST_WIDTH_PX} px and 1 ray per pixel or more were expected"
        )


def _random_phone(rng: np.random.Generator, how: RoomShots) -> _Phone:
    baseline_m, is_vertical = float(rng.uniform(LEAST_BASELINE_M, LARGEST_BASELINE_M)), bool(rng.random() < 0.5)
    if how.is_vertical is not None:
        is_vertical = how.is_vertical
    hw = (how.width * 2 // 3 // 2 * 2, how.width // 2 * 2)  # a mosaic has even sides
    rig = phone_rig(rng, hw=hw, baseline_m=baseline_m, is_vertical=is_vertical)
    tele = phone_sensor(rng, is_wide=False)
    return _Phone(
        rig, {"tele": tele, "wide": phone_sensor(rng, is_wide=True, white_balance_std=_WHITE_BALANCE_STD)}, how
    )


def _photograph_board(phone: _Phone, shot: _Shot, room: Room) -> None:
    tele_from_board = _pose_in_sight(shot)
    tracer = RoomTracer(board_in(room, tele_from_board))
    lights = _lights_of(tracer, shot, room.world_from_tele, samples=phone.how.samples)
    _write_photos(phone, shot, lights, focus_m=float(np.linalg.norm(tele_from_board[:3, 3])))


def _pose_in_sight(shot: _Shot) -> FloatArray:
    """A pose of the board that tele sees whole, as who photographs takes care of; the last of some tries."""
    rows, columns = np.mgrid[-1 : BOARD_CORNERS[1] + 1, -1 : BOARD_CORNERS[0] + 1] * BOARD_SQUARE_M
    edge_m = np.column_stack([columns.ravel(), rows.ravel(), np.zeros(rows.size), np.ones(rows.size)])
    last = np.array([shot.rig.tele.hw[1], shot.rig.tele.hw[0]]) - 1
    for _ in range(_POSE_TRIES):
        pose = board_pose(shot.rng, shot.rig, number=shot.number)
        places_px = shot.rig.tele.project((edge_m @ pose.T)[:, :3])
        if np.all((places_px >= 0) & (places_px <= last)):
            break
    return pose


def _photograph_room(phone: _Phone, shot: _Shot, *, truth: Path) -> None:
    room = random_room(shot.rng)
    tracer = RoomTracer(room)
    depth_m = tracer.depth_m(shot.rig.tele, room.world_from_tele)
    lights = _lights_of(tracer, shot, room.world_from_tele, samples=phone.how.samples)
    middle_m = float(depth_m[depth_m.shape[0] // 2, depth_m.shape[1] // 2])
    exposure = _write_photos(phone, shot, lights, focus_m=middle_m)
    disparity_px = shot.rig.tele.K[0, 0] * shot.rig.baseline_m / depth_m
    write_pfm(shot.folder / "truth.pfm", disparity_px.astype(np.float32))
    hidden = tracer.is_hidden(shot.rig, room.world_from_tele, depth_m=depth_m)
    write_image(truth / "hidden" / f"{shot.folder.name}.png", hidden.astype(np.float32))
    if phone.how.has_bokeh:
        world = _Seen(tracer, room.world_from_tele, samples=phone.how.samples, exposure=exposure)
        _write_bokeh(world, shot, truth=truth / shot.folder.name, depth_m=depth_m)


def _lights_of(tracer: RoomTracer, shot: _Shot, world_from_tele: FloatArray, *, samples: int) -> dict[str, FloatImage]:
    """Light that falls on both sensors, linear."""
    light = {}
    for name, camera, camera_from_tele in lenses_of(shot.rig):
        tele_from_camera = np.linalg.inv(camera_from_tele)
        seed = int(shot.rng.integers(2**31))
        light[name] = tracer.photo(camera, world_from_tele @ tele_from_camera, samples=samples, seed=seed)
    return light


def _write_photos(phone: _Phone, shot: _Shot, lights: dict[str, FloatImage], *, focus_m: float) -> float:
    """Expose and write both photos; the factor that makes white 1 in the tele photo before its sensor."""
    gain = 1 / max(float(np.quantile(lights["tele"].max(axis=2), _WHITE_SHARE)), 1e-9)
    stated_m = focus_m * math.exp(float(shot.rng.normal(0, _FOCUS_ERROR)))
    for name, light in lights.items():
        focal_mm, f35_mm = _FOCAL_MM[name]
        taken = _FIRST_SHOT + timedelta(minutes=shot.number)
        facts = ExifFacts(
            make="Telewide",
            model="Simulated Phone",
            focal_length_mm=focal_mm,
            f35_mm=f35_mm,
            taken=taken,
            subject_distance_m=stated_m,
        )
        frame = expose(light * np.float32(gain), phone.sensors[name], rng=shot.rng)
        if phone.how.is_raw:
            write_dng(shot.folder / f"{name}.dng", frame, facts=facts)
        else:
            write_jpeg(shot.folder / f"{name}.jpg", developed(frame), facts=facts)
    return gain * phone.sensors["tele"].exposure


@dataclass(frozen=True)
class _Seen:
    """A room before the tele lens: rays per pixel of its photo, and the factor that its light is exposed by."""

    tracer: RoomTracer
    world_from_tele: FloatArray
    samples: int
    exposure: float


def _write_bokeh(seen: _Seen, shot: _Shot, *, truth: Path, depth_m: FloatMap) -> None:
    """The tele photo as a 50 mm lens of three apertures at its place would blur it, focused on three distances."""
    for focus, percentile in FOCUSES.items():
        focus_m = float(np.percentile(depth_m, 100 - percentile))
        for name, f_number in BOKEH_F_NUMBERS.items():
            aperture = ApertureSetting(radius_m=0.050 / f_number / 2, focus_distance_m=focus_m)
            light = seen.tracer.photo(
                shot.rig.tele,
                seen.world_from_tele,
                samples=round(seen.samples * _BOKEH_SAMPLES / f_number),
                seed=int(shot.rng.integers(2**31)),
                aperture=aperture,
            )
            path = truth / f"bokeh-{focus}-{name}.png"
            write_image(path, srgb_from_linear(np.clip(light * np.float32(seen.exposure), 0, 1)))
            facts = {
                "focus_distance_m": focus_m,
                "aperture_radius_m": aperture.radius_m,
                "f_number_of_50mm": f_number,
                "focus_disparity_px": shot.rig.tele.K[0, 0] * shot.rig.baseline_m / focus_m,
            }
            write_text(path.with_suffix(".json"), json_text(facts, indent=2) + "\n")


def _rig_truth(rig: StereoRig, moved: dict[str, StereoRig]) -> dict[str, object]:
    return {
        **rig_truth(rig),
        "tele": _camera_truth(rig.tele),
        "wide": _camera_truth(rig.wide),
        "shots": {name: {"wide": _camera_truth(shot.wide)} for name, shot in moved.items()},
    }


def _camera_truth(camera: Camera) -> dict[str, object]:
    return {"hw": list(camera.hw), "K": camera.K.tolist(), "distortion": camera.distortion.tolist()}
