"""Find the markers of a board in a photo, and from them its corners to a fraction of a pixel.

Of a board with markers any part may be out of the photo or covered. Marker i of the board is the one numbered
``first_marker + i``; its corners go clockwise from the top left.
Letters: M markers found; N corners.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.boards.board import Board, board_points_m
from telewide.boards.chessboard import FoundCorners, distance_to_next_edge_px
from telewide.boards.pattern import aruco_dictionary, marker_origins_m
from telewide.boards.pyramid import Level
from telewide.boards.subpixel import refine_quads, refine_saddles
from telewide.geometry.arrays import ByteImage, FloatArray

_SMALLEST_MARKER_PX = 10.0  # below this a marker's cells are under 2 px
_LARGE_ENOUGH_PX = 24.0  # markers of this side are all found; a larger picture would add none
_MISPLACED = 0.5  # of a marker's side: farther from where the others put it, it is another's; distortion is less
_MIN_MARKERS = 2  # one alone may be chance: a texture that looks like a marker
_MIN_SHARE_IN_PLACE = 0.6  # of the numbers found; on a board of another layout half of them may agree
_WINDOW_SHARE = 0.5  # radius of a refinement window over the distance to the next edge
_MARKER_SHARE = 0.7  # likewise over the distance to the marker's black
_CELL_SHARE = 0.8  # half length of an edge profile over the width of a cell and of the gap
_LONGEST_PROFILE_PX = 14.0
_NEIGHBOURS = 4  # markers that say where a corner is


@dataclass(frozen=True)
class FoundMarkers:
    """Markers in a photo.

    Attributes:
        markers: (M,) int64 place on the board, from 0, ascending.
        quads_px: (M, 4, 2) their corners.
    """

    markers: NDArray[np.int64]
    quads_px: FloatArray


def find_marker_board(grey_u8: ByteImage, levels: Iterable[Level], *, board: Board) -> FoundCorners | None:
    """Find a board with markers.

    Args:
        grey_u8: (H, W) uint8, the photo.
        levels: its pyramid, the smallest first; no more of it is made than is needed.
        board: of kind charuco or aruco_grid.

    Returns:
        The corners that can be seen, or None where there is no such board.

    Raises:
        InputError: OpenCV has no such markers.
    """
    best: FoundMarkers | None = None
    for level in levels:
        found = _consistent(_find_markers(level, board), board)
        if found is not None and (best is None or len(found.markers) >= len(best.markers)):
            best = found
            if _smallest_side_px(level.from_photo_px(found.quads_px)) >= _LARGE_ENOUGH_PX:
                break
    if best is None:
        return None
    corners = _saddles(grey_u8, best, board) if board.kind == "charuco" else _quads(grey_u8, best, board)
    return corners if len(corners.ids) else None


def _find_markers(level: Level, board: Board) -> FoundMarkers:
    longest_px = max(level.grey_u8.shape)
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = 4 * _SMALLEST_MARKER_PX / longest_px
    parameters.maxMarkerPerimeterRate = 8.0  # one marker may be larger than the photo is wide
    # The first window is for the small markers of a level, the last for the large ones.
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeStep = 5, 16
    parameters.adaptiveThreshWinSizeMax = 5 + 16 * 3
    detector = cv2.aruco.ArucoDetector(aruco_dictionary(board), parameters)
    quads, numbers, _ = detector.detectMarkers(level.grey_u8)
    if numbers is None or len(numbers) == 0:
        return FoundMarkers(np.zeros(0, np.int64), np.zeros((0, 4, 2)))
    markers = np.asarray(numbers, dtype=np.int64).ravel() - board.first_marker
    quads_px = level.to_photo_px(np.asarray(quads, dtype=np.float64).reshape(-1, 4, 2))
    is_known = (markers >= 0) & (markers < board.n_markers)
    return FoundMarkers(markers[is_known], quads_px[is_known])


def _consistent(found: FoundMarkers, board: Board) -> FoundMarkers | None:
    """The markers that lie on one board, none twice; None where they do not make one."""
    if not len(found.markers):
        return None
    corners_m = _marker_corners_m(board)[found.markers]
    homography = _homography(corners_m.reshape(-1, 2), found.quads_px.reshape(-1, 2))
    if homography is None:
        return None
    misplaced_px = np.linalg.norm(_projected(homography, corners_m) - found.quads_px, axis=-1).max(axis=1)
    is_in_place = misplaced_px < np.maximum(_MISPLACED * _sides_px(found.quads_px).mean(axis=1), 2.0)
    kept = [i for i in np.argsort(misplaced_px) if is_in_place[i]]
    markers, first = np.unique(found.markers[kept], return_index=True)
    if len(markers) < max(_MIN_MARKERS, _MIN_SHARE_IN_PLACE * len(np.unique(found.markers))):
        return None
    return FoundMarkers(markers, found.quads_px[np.asarray(kept, dtype=np.int64)[first]])


def _saddles(grey_u8: ByteImage, found: FoundMarkers, board: Board) -> FoundCorners:
    """Inner corners of a charuco, started from the nearest markers and fitted in the photo."""
    inner_m = board_points_m(board)[:, :2] + board.square_m
    ids, starts_px, steps_px, clear_px = [], [], [], []
    for corner_id in _ids_beside(found, board):
        at_m = inner_m[corner_id]
        local = _local_homography(found, board, at_m)
        if local is None:
            continue
        step_m, clear_m = board.square_m, (board.square_m - (board.marker_m or 0.0)) / 2
        around_m = at_m + step_m * np.array([[0, 0], [0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]])
        around_px = _projected(local, around_m)
        markers_px = _projected(local, at_m + clear_m * np.array([[1, 1], [-1, -1], [1, -1], [-1, 1]]))
        ids.append(corner_id)
        starts_px.append(around_px[0])
        steps_px.append((around_px[1] - around_px[2], around_px[3] - around_px[4]))
        clear_px.append(np.linalg.norm(markers_px - around_px[0], axis=1).min())
    if not ids:
        return FoundCorners(np.zeros(0, np.int64), np.zeros((0, 2)))
    steps = np.array(steps_px)
    half_px = np.minimum(
        _WINDOW_SHARE * distance_to_next_edge_px(steps[:, 0], steps[:, 1]), _MARKER_SHARE * np.array(clear_px)
    )
    edges_rad = np.arctan2(steps[..., 1], steps[..., 0])
    refined = refine_saddles(grey_u8, np.array(starts_px), edges_rad=edges_rad, half_px=half_px)
    return FoundCorners(np.array(ids, dtype=np.int64)[refined.is_good], refined.points_px[refined.is_good])


def _quads(grey_u8: ByteImage, found: FoundMarkers, board: Board) -> FoundCorners:
    """Corners of the markers of an aruco_grid, from lines through their sides."""
    cells = aruco_dictionary(board).markerSize + 2
    clear = min(1 / cells, (board.gap_m or 0.0) / board.square_m)
    half_px = np.clip(_CELL_SHARE * clear * _sides_px(found.quads_px).min(axis=1), 1.0, _LONGEST_PROFILE_PX)
    refined = refine_quads(grey_u8, found.quads_px, half_px=half_px)
    ids = (4 * found.markers[:, None] + np.arange(4)).ravel()
    return FoundCorners(ids[refined.is_good], refined.points_px[refined.is_good])


def _ids_beside(found: FoundMarkers, board: Board) -> list[int]:
    """Inner corners that touch a square whose marker was found."""
    columns = board.columns - 1
    squares = np.rint((marker_origins_m(board)[found.markers] / board.square_m) - 0.25).astype(np.int64)
    ids: set[int] = set()
    for x, y in squares:
        for corner_x, corner_y in ((x - 1, y - 1), (x, y - 1), (x - 1, y), (x, y)):
            if 0 <= corner_x < columns and 0 <= corner_y < board.rows - 1:
                ids.add(int(corner_y * columns + corner_x))
    return sorted(ids)


def _local_homography(found: FoundMarkers, board: Board, at_m: FloatArray) -> FloatArray | None:
    """Pattern to photo from the nearest markers: a lens's distortion is small over so little."""
    corners_m = _marker_corners_m(board)[found.markers]
    distance_m = np.linalg.norm(corners_m.mean(axis=1) - at_m, axis=1)
    nearest = np.argsort(distance_m, kind="stable")[:_NEIGHBOURS]
    # Those that touch the corner, and others only as long as they are not much farther.
    nearest = nearest[distance_m[nearest] <= max(2.5 * distance_m[nearest[0]], 1e-9)]
    local = cv2.findHomography(corners_m[nearest].reshape(-1, 2), found.quads_px[nearest].reshape(-1, 2))[0]
    return None if local is None else np.asarray(local, dtype=np.float64)


def _marker_corners_m(board: Board) -> FloatArray:
    """(n_markers, 4, 2) corners of the markers, pattern frame."""
    side_m = board.square_m if board.kind == "aruco_grid" else (board.marker_m or 0.0)
    return marker_origins_m(board)[:, None] + side_m * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)


def _homography(from_m: FloatArray, to_px: FloatArray) -> FloatArray | None:
    """Homography that most points agree on, found with a fixed seed."""
    scale_px = float(np.ptp(to_px, axis=0).max())
    cv2.setRNGSeed(0)
    homography = cv2.findHomography(from_m, to_px, cv2.RANSAC, max(3.0, 0.02 * scale_px))[0]
    return None if homography is None else np.asarray(homography, dtype=np.float64)


def _projected(homography: FloatArray, points: FloatArray) -> FloatArray:
    image = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ homography.T
    return np.asarray(image[..., :2] / image[..., 2:], dtype=np.float64)


def _sides_px(quads_px: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(quads_px - np.roll(quads_px, 1, axis=1), axis=-1), dtype=np.float64)


def _smallest_side_px(quads_px: FloatArray) -> float:
    return float(_sides_px(quads_px).min())
