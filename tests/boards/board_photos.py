"""Photos of boards with exact corners: the printed pattern under a homography, each pixel the mean of many samples."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.boards.board import Board, board_points_m
from telewide.boards.pattern import black_rectangles_m
from telewide.srgb import srgb_from_linear

UNIT_M = 0.0005
"""Every edge of the boards drawn here lies on a multiple of it, so that the raster of a pattern is exact."""
PAPER_MARGIN_M = 0.02
BLACK, WHITE, TABLE = 0.02, 0.75, 0.2
"""Linear light."""


def pattern_raster(board: Board) -> NDArray[np.float64]:
    """The sheet of paper, one sample per UNIT_M."""
    margin = round(PAPER_MARGIN_M / UNIT_M)
    width, height = (round(length_m / UNIT_M) for length_m in board.wh_m)
    raster = np.full((height + 2 * margin, width + 2 * margin), WHITE)
    for x, y, w, h in np.rint(black_rectangles_m(board) / UNIT_M).astype(int):
        raster[margin + y : margin + y + h, margin + x : margin + x + w] = BLACK
    return raster


def pattern_points_m(board: Board) -> NDArray[np.float64]:
    """Corners by id in the pattern's frame, whose origin is the top left of what is printed."""
    inside_m = 0.0 if board.kind == "aruco_grid" else board.square_m
    return board_points_m(board)[:, :2] + inside_m


def px_from_pattern(
    board: Board,
    *,
    hw: tuple[int, int],
    f_px: float,
    distance_m: float,
    tilt_deg: tuple[float, float] = (0, 0),
    turn_deg: float = 0,
    offset_m: tuple[float, float] = (0, 0),
) -> NDArray[np.float64]:
    """Homography of a pinhole camera that looks at the middle of a board."""
    K = np.array([[f_px, 0, (hw[1] - 1) / 2], [0, f_px, (hw[0] - 1) / 2], [0, 0, 1]])
    tilt = cv2.Rodrigues(np.radians([*tilt_deg, 0.0]))[0] @ cv2.Rodrigues(np.radians([0.0, 0.0, turn_deg]))[0]
    middle_m = np.array([*board.wh_m, 0.0]) / 2
    translation_m = np.array([*offset_m, distance_m]) - tilt @ middle_m
    return K @ np.column_stack([tilt[:, :2], translation_m])


def projected(homography: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    image = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return image[:, :2] / image[:, 2:]


def board_photo(
    board: Board,
    homography: NDArray[np.float64],
    *,
    hw: tuple[int, int],
    blur_px: float = 0.7,
    noise: float = 0.0,
    seed: int = 0,
    samples: int = 4,
) -> NDArray[np.uint8]:
    """Photo of a board: area samples, the lens's blur, the sRGB curve, then noise.

    Args:
        homography: pixels from the pattern in metres.
        hw: size of the photo.
        blur_px: standard deviation of a Gaussian.
        noise: standard deviation, grey levels.
        seed: of the noise.
        samples: along each side of a pixel.
    """
    raster = pattern_raster(board)
    pattern_from_px = np.linalg.inv(homography)
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    photo = np.zeros(hw)
    y, x = np.mgrid[: hw[0], : hw[1]].astype(np.float64)
    for dy in steps:
        for dx in steps:
            X, Y, W = (row[0] * (x + dx) + row[1] * (y + dy) + row[2] for row in pattern_from_px)
            column = np.floor((X / W + PAPER_MARGIN_M) / UNIT_M).astype(np.int64)
            line = np.floor((Y / W + PAPER_MARGIN_M) / UNIT_M).astype(np.int64)
            inside = (column >= 0) & (line >= 0) & (column < raster.shape[1]) & (line < raster.shape[0])
            photo += np.where(inside, raster[line * inside, column * inside], TABLE)
    blurred = cv2.GaussianBlur(photo / samples**2, (0, 0), blur_px)
    levels = 255 * srgb_from_linear(blurred.astype(np.float32)).astype(np.float64)
    levels += np.random.default_rng(seed).normal(0, noise, hw) if noise else 0
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
