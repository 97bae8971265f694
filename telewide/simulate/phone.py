"""A simulated phone: photos of a board and of still lifes as two unequal lenses would have taken them, not rectified.

Both lenses distort, stand askew and a centimetre apart; in every shot autofocus and stabilisation move the wide one a
little, and its colours differ. What `telewide calibrate` is to find stands in ``truth/rig.json``, the disparity on each
tele photo in ``captures/<name>/truth.pfm``, and what of it wide does not see in ``truth/hidden/<name>.png``.

A still life is rendered in the rectified frame and looked up from the photos; a board is looked up ray by ray.
Letters: N points, H W photo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from telewide.capture.images import write_image
from telewide.capture.pfm import write_pfm
from telewide.errors import UsageError
from telewide.files import write_text
from telewide.geometry.arrays import FloatArray, FloatMap
from telewide.geometry.grids import dense_map
from telewide.geometry.rectification import RectifiedGeometry, rectified_geometry
from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.simulate.degrade import Degradation, degrade
from telewide.simulate.layers import render_pair
from telewide.simulate.still_life import still_life
from telewide.text import json_text

TELE_SHARE, WIDE_SHARE = 80 / 36, 27 / 36
"""Focal length over the photo's width: 80 and 27 mm equivalent."""
BASELINE_M = 0.012
NEAREST_M, FARTHEST_M = 0.65, 4.0
BOARD_CORNERS, BOARD_SQUARE_M = (9, 6), 0.025
"""Inner corners along x and y: the board chessboard_9x6."""
_SUPERSAMPLING = 3
_CURTAIN = (0.36, 0.35, 0.33)
_PLACE_ERROR_SQUARES = 1e-3


def phone_rig(
    rng: np.random.Generator, *, hw: tuple[int, int], baseline_m: float = BASELINE_M, is_vertical: bool = False
) -> StereoRig:
    """Draw a phone: both photos of one size, the tele lens seeing a third of what the wide one sees.

    Args:
        rng: source of all draws.
        hw: height and width of both photos.
        baseline_m: from one lens to the other, along the picture plane.
        is_vertical: whether the lenses stand above one another.
    """
    height, width = hw

    def camera(share: float, k1: float) -> Camera:
        f_px = share * width * float(rng.uniform(0.98, 1.02))
        cx, cy = (width - 1) / 2 + rng.normal(0, 0.01 * width), (height - 1) / 2 + rng.normal(0, 0.01 * width)
        K = np.array([[f_px, 0.0, cx], [0.0, f_px, cy], [0.0, 0.0, 1.0]])
        return Camera(hw, K, np.array([k1, 0.0, 0.0, 0.0, 0.0]))

    tele, wide = camera(TELE_SHARE, 0.08), camera(WIDE_SHARE, -0.06)
    angle_rad = float(rng.normal(0, 0.1)) + (math.pi / 2 if is_vertical else 0.0)
    to_wide_m = -baseline_m * np.array([math.cos(angle_rad), math.sin(angle_rad), 0.02])
    turn_rad = rng.normal(0, math.radians(0.6), 3)
    return StereoRig(tele, wide, rigid_transform(rotation=turn_rad, translation=to_wide_m))


def write_phone(
    folder: Path,
    *,
    captures: int,
    boards: int = 14,
    seed: int = 0,
    width: int = 960,
    moves: bool = True,
    cast: bool = True,
    depths_m: Sequence[tuple[float, float]] = ((NEAREST_M, FARTHEST_M),),
) -> StereoRig:
    """Write ``boards/`` and ``captures/`` of a simulated phone.

    Args:
        folder: made when it is not there.
        captures: number of still lifes.
        boards: number of shots of the board, by both lenses.
        seed: the same seed writes the same pictures.
        width: of all photos, px; they are 3 : 2.
        moves: whether the wide lens moves in every shot; the same things are photographed either way.
        cast: whether the colours of wide differ.
        depths_m: about the nearest and the farthest of a still life; they take turns.

    Returns:
        The phone as it is when nothing moves.

    Raises:
        UsageError: a number out of range.
        TelewideError: the folder cannot be written.
    """
    _check(captures=captures, boards=boards, width=width, depths_m=depths_m)
    board_seed, capture_seed, rig_seed = np.random.SeedSequence(seed).spawn(3)
    rig = phone_rig(np.random.default_rng(rig_seed), hw=(width * 2 // 3, width))
    for number, child in enumerate(board_seed.spawn(boards)):
        rng = np.random.default_rng(child)
        tele_from_board = board_pose(rng, rig, number=number)
        place = folder / "boards" / f"{number:03d}"
        for name, camera, camera_from_tele in lenses_of(rig):
            photo = _photo_of_board(camera, camera_from_tele @ tele_from_board)
            write_image(place / f"{name}.jpg", _developed(photo, rng, is_wide=name == "wide", cast=cast), quality=95)
    for number, child in enumerate(capture_seed.spawn(captures)):
        rng = np.random.default_rng(child)
        moved = randomly_moved(rng, rig)  # drawn in any case: what is drawn after it stays the same
        place = folder / "captures" / f"{number:03d}"
        hidden = _write_still_life(
            place, rng, moved if moves else rig, depths_m=depths_m[number % len(depths_m)], cast=cast
        )
        write_image(folder / "truth" / "hidden" / f"{place.name}.png", hidden)
    write_text(folder / "truth" / "rig.json", json_text(rig_truth(rig), indent=2) + "\n")
    return rig


def rig_truth(rig: StereoRig) -> dict[str, object]:
    """Content of ``truth/rig.json`` for a phone at rest."""
    return {
        "baseline_m": rig.baseline_m,
        "f_tele_px": rig.tele.f_px,
        "f_wide_px": rig.wide.f_px,
        "asymmetry": rig.asymmetry,
        "wide_from_tele": rig.wide_from_tele.tolist(),
        "square_m": BOARD_SQUARE_M,
    }


def _check(*, captures: int, boards: int, width: int, depths_m: Sequence[tuple[float, float]]) -> None:
    if captures < 1 or boards < 0 or width < 320:
        raise UsageError(
            f"captures {captures}, boards {boards}, width {width}: at least 1 capture and 320 px were expected"
        )
    if not depths_m or not all(0 < near_m < far_m for near_m, far_m in depths_m):
        raise UsageError(f"depths {depths_m}: a nearer and a farther one were expected, in metres")


def lenses_of(rig: StereoRig) -> tuple[tuple[str, Camera, FloatArray], ...]:
    """Name, camera and (4, 4) camera_from_tele of both lenses."""
    return ("tele", rig.tele, np.eye(4)), ("wide", rig.wide, rig.wide_from_tele)


def board_pose(rng: np.random.Generator, rig: StereoRig, *, number: int) -> FloatArray:
    """(4, 4) tele from board: tilted by 15 to 40 degrees in changing directions, filling about half of tele."""
    size_m = np.array(BOARD_CORNERS) * BOARD_SQUARE_M
    fill = float(rng.uniform(0.5, 0.7))
    distance_m = rig.tele.f_px * size_m[0] / (fill * rig.tele.hw[1])
    direction = 2 * math.pi * (number + float(rng.uniform(0, 1))) * 0.382
    tilt_rad = math.radians(float(rng.uniform(15, 40)))
    turn = rigid_transform(
        rotation=tilt_rad * np.array([math.cos(direction), math.sin(direction), 0.0]), translation=np.zeros(3)
    )
    roll = rigid_transform(rotation=np.array([0.0, 0.0, float(rng.normal(0, 0.12))]), translation=np.zeros(3))
    reach_m = 0.5 * (1 - fill) * rig.tele.hw[1] * distance_m / rig.tele.f_px
    at_m = np.array([rng.uniform(-1, 1) * reach_m, rng.uniform(-1, 1) * reach_m * 0.6, distance_m])
    centre_from_board = rigid_transform(
        rotation=np.zeros(3), translation=np.append(-size_m / 2 + BOARD_SQUARE_M / 2, 0.0)
    )
    tele_from_centre = rigid_transform(rotation=np.zeros(3), translation=at_m) @ turn @ roll
    return np.asarray(tele_from_centre @ centre_from_board)


def _photo_of_board(camera: Camera, camera_from_board: FloatArray) -> FloatMap:
    """Look the board's plane up along the ray of every sample of the photo; (H, W, 3) sRGB."""
    fine = camera.resized((camera.hw[0] * _SUPERSAMPLING, camera.hw[1] * _SUPERSAMPLING))
    plane_from_pixel = np.linalg.inv(camera_from_board[:3, [0, 1, 3]])

    def in_squares(points_px: FloatArray) -> FloatArray:
        rays = np.column_stack([fine.normalised(points_px), np.ones(len(points_px))])
        on_plane = rays @ plane_from_pixel.T
        return np.asarray(on_plane[:, :2] / on_plane[:, 2:] / BOARD_SQUARE_M)

    x, y = dense_map(in_squares, hw=fine.hw, max_error_px=_PLACE_ERROR_SQUARES)
    columns, rows = BOARD_CORNERS
    is_paper = (x > -2) & (x < columns + 1) & (y > -2) & (y < rows + 1)
    is_board = (x > -1) & (x < columns) & (y > -1) & (y < rows)
    is_black = is_board & ((np.floor(x) + np.floor(y)) % 2 == 0)
    grey = np.where(is_black, 0.12, np.where(is_paper, 0.9, 0.42)).astype(np.float32)
    small = cv2.resize(grey, (camera.hw[1], camera.hw[0]), interpolation=cv2.INTER_AREA)
    return np.dstack([small, small * np.float32(0.98), small * np.float32(0.95)])


def _write_still_life(
    folder: Path, rng: np.random.Generator, rig: StereoRig, *, depths_m: tuple[float, float], cast: bool
) -> FloatMap:
    """Write a capture; (H, W) of its tele photo, 1 where wide does not see what tele sees."""
    geometry = rectified_geometry(rig)
    gain, (near_m, far_m) = geometry.f_px * rig.baseline_m, depths_m
    scene = still_life(rng, hw=geometry.hw, disparity_window_px=(gain / far_m, gain / near_m))
    views = render_pair(scene)
    tele = _looked_up(views.ref, geometry, lens="tele")
    wide = _looked_up(views.src, geometry, lens="wide")
    write_image(folder / "tele.jpg", _developed(tele, rng, is_wide=False, cast=cast), quality=95)
    write_image(folder / "wide.jpg", _developed(wide, rng, is_wide=True, cast=cast), quality=95)
    write_pfm(folder / "truth.pfm", _truth_on_tele(views.disparity_px, geometry))
    return _seen_by_tele(views.occluded.astype(np.float32), geometry)


def randomly_moved(rng: np.random.Generator, rig: StereoRig) -> StereoRig:
    """Move a rig as a shot does: stabilisation shifts wide in its picture plane, focus changes its focal length."""
    K = rig.wide.K.copy()
    K[:2, :2] *= 1 + rng.normal(0, 0.002)
    K[:2, 2] += rng.normal(0, 0.0004, 2) * rig.wide.hw[1]
    return replace(rig, wide=replace(rig.wide, K=K))


def _looked_up(view: FloatMap, geometry: RectifiedGeometry, *, lens: str) -> FloatMap:
    """A photo out of its rectified view; around what the view holds hangs a grey curtain."""
    rig = geometry.rig
    camera, mapping = (rig.tele, geometry.ref_from_tele) if lens == "tele" else (rig.wide, geometry.src_from_wide)
    fine = camera.resized((camera.hw[0] * _SUPERSAMPLING, camera.hw[1] * _SUPERSAMPLING))

    def from_fine(points_px: FloatArray) -> FloatArray:
        return mapping((points_px + 0.5) / _SUPERSAMPLING - 0.5)

    map_x, map_y = dense_map(from_fine, hw=fine.hw)
    samples = cv2.remap(view, map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=_CURTAIN)
    return np.asarray(cv2.resize(samples, (camera.hw[1], camera.hw[0]), interpolation=cv2.INTER_AREA), np.float32)


def _truth_on_tele(disparity_px: FloatMap, geometry: RectifiedGeometry) -> FloatMap:
    """``K[0, 0] baseline / z`` of every pixel of the tele photo, of the surface nearest to its centre."""
    rows, columns = np.indices(geometry.hw)
    ratio = geometry.tele_depth_per_rectified_depth(np.column_stack([columns.ravel(), rows.ravel()]))
    gain = geometry.rig.tele.K[0, 0] / geometry.f_px
    return _seen_by_tele((disparity_px * gain / ratio.reshape(geometry.hw)).astype(np.float32), geometry)


def _seen_by_tele(of_ref: FloatMap, geometry: RectifiedGeometry) -> FloatMap:
    """A map of the rectified ref, of the sample nearest to the centre of each pixel of the tele photo."""
    map_x, map_y = dense_map(geometry.ref_from_tele, hw=geometry.rig.tele.hw)
    return np.asarray(cv2.remap(of_ref, map_x, map_y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE))


def _developed(photo: FloatMap, rng: np.random.Generator, *, is_wide: bool, cast: bool) -> FloatMap:
    drawn = np.exp(rng.normal(0.0, 0.03) + rng.normal(0.0, 0.05, 3)) if is_wide else np.ones(3)
    gain = drawn if cast else np.ones(3)
    damage = Degradation(noise_std=0.006 if is_wide else 0.003, gain=(float(gain[0]), float(gain[1]), float(gain[2])))
    return degrade(np.clip(photo, 0, 1), damage, rng=rng)
