"""Photos of a chessboard, drawn: two pinholes of known geometry, a flat board, light blur, nothing else."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.capture.images import write_image
from telewide.geometry.rig import Camera, StereoRig, rigid_transform

COLUMNS, ROWS, SQUARE_M = 9, 6, 0.025
TEXTURE_PX = 48  # a square of the texture
SUPERSAMPLED = 3


def drawn_rig() -> StereoRig:
    """Focal lengths 1450 and 500 px, 13 mm apart, of unequal photo sizes."""
    tele = Camera((480, 640), np.array([[1450.0, 0, 323.0], [0, 1450.0, 236.0], [0, 0, 1]]), np.zeros(0))
    wide = Camera((450, 600), np.array([[500.0, 0, 297.0], [0, 500.0, 228.0], [0, 0, 1]]), np.zeros(0))
    turned = rigid_transform(rotation=np.array([0.004, -0.006, 0.003]), translation=np.array([0.013, 0.0005, 0.0002]))
    return StereoRig(tele, wide, turned)


def write_board_photos(folder: Path, *, count: int, seed: int = 0) -> Path:
    """Write ``<shot>/tele.png`` and ``<shot>/wide.png`` of a board held in many ways, all of it in both photos."""
    rng = np.random.default_rng(seed)
    rig = drawn_rig()
    for number in range(count):
        pose = _pose(rng, distance_m=(0.75, 0.95, 1.2)[number % 3], rig=rig)
        for name, camera, from_board in (("tele", rig.tele, pose), ("wide", rig.wide, rig.wide_from_tele @ pose)):
            write_image(folder / f"shot_{number:02d}" / f"{name}.png", photo_of_board(camera, from_board))
    return folder


def photo_of_board(camera: Camera, camera_from_board: NDArray[np.float64]) -> NDArray[np.float32]:
    """Draw the board as a pinhole sees it, each pixel the mean over its area."""
    squares = np.indices((ROWS + 1, COLUMNS + 1)).sum(axis=0) % 2
    texture = cv2.resize(
        squares.astype(np.float32), None, fx=TEXTURE_PX, fy=TEXTURE_PX, interpolation=cv2.INTER_NEAREST
    )
    texture = 0.08 + 0.8 * cv2.copyMakeBorder(texture, *[TEXTURE_PX] * 4, cv2.BORDER_CONSTANT, value=1.0)
    # The first inner corner is the corner of four squares, two squares from the texture's border.
    board_from_texture = np.array([[SQUARE_M / TEXTURE_PX, 0, 0], [0, SQUARE_M / TEXTURE_PX, 0], [0, 0, 1]]) @ np.array(
        [[1.0, 0, 0.5 - 2 * TEXTURE_PX], [0, 1.0, 0.5 - 2 * TEXTURE_PX], [0, 0, 1]]
    )
    fine_K = np.diag([SUPERSAMPLED, SUPERSAMPLED, 1.0]) @ camera.K
    fine_K[:2, 2] += (SUPERSAMPLED - 1) / 2
    photo_from_texture = fine_K @ camera_from_board[:3, [0, 1, 3]] @ board_from_texture
    fine_wh = (camera.hw[1] * SUPERSAMPLED, camera.hw[0] * SUPERSAMPLED)
    fine = cv2.warpPerspective(texture, photo_from_texture, fine_wh, flags=cv2.INTER_LINEAR, borderValue=0.35)
    photo = cv2.resize(fine, camera.hw[::-1], interpolation=cv2.INTER_AREA)
    grey = cv2.GaussianBlur(photo, (0, 0), 0.6)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.float32)


def _pose(rng: np.random.Generator, *, distance_m: float, rig: StereoRig) -> NDArray[np.float64]:
    """A pose, tilted and turned, whose board lies wholly in the tele photo."""
    corners_m = SQUARE_M * np.array([[-1.0, -1, 0], [COLUMNS, -1, 0], [COLUMNS, ROWS, 0], [-1, ROWS, 0]])
    middle_m = SQUARE_M * np.array([(COLUMNS - 1) / 2, (ROWS - 1) / 2, 0])
    while True:
        tilt = rng.uniform(-1, 1, 3) * (0.75, 0.75, 0.25)
        place_m = np.array([*rng.uniform(-0.15, 0.15, 2), 1.0]) * distance_m
        pose = rigid_transform(rotation=tilt, translation=place_m)
        pose[:3, 3] -= pose[:3, :3] @ middle_m
        seen_px = rig.tele.project(corners_m @ pose[:3, :3].T + pose[:3, 3])
        if ((seen_px > 4) & (seen_px < np.array(rig.tele.hw[::-1]) - 5)).all():
            return pose
