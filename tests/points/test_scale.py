"""The factor between two views, against factors and damages that were put in."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from textures import textured

from telewide.capture.images import read_image
from telewide.correction.asymmetry import compare_factors
from telewide.geometry.arrays import FloatImage
from telewide.points.scale import estimate_scale
from telewide.simulate.degrade import Degradation, degrade_small


@pytest.fixture(scope="module")
def scene() -> FloatImage:
    return textured(np.random.default_rng(3), hw=(720, 960))


def wide_of(
    tele: FloatImage, *, factor: float, turn_deg: float = 0.0, shift_px: FloatImage | None = None
) -> FloatImage:
    """What a lens of a shorter focal length shows: all of tele, smaller, turned, amid something else."""
    height, width = tele.shape[:2]
    out_wh = (420, 320)
    small = textured(np.random.default_rng(9), hw=out_wh[::-1])
    turn = np.deg2rad(turn_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) / factor
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    shift = np.array([212.3, 155.8]) - rotation @ centre
    soft = cv2.GaussianBlur(tele, (0, 0), 0.35 * factor)
    matrix = np.column_stack([rotation, shift])
    seen = cv2.warpAffine(soft, matrix, out_wh, flags=cv2.INTER_CUBIC)
    mask = cv2.warpAffine(np.ones(tele.shape[:2], np.float32), matrix, out_wh)
    return np.asarray(np.where(mask[..., None] > 0.99, seen, small), dtype=np.float32)


@pytest.mark.parametrize(("factor", "turn_deg"), [(3.0, -1.5), (4.37, 90.0)])
def test_the_factor_of_unrectified_photos_is_found(scene: FloatImage, factor: float, turn_deg: float) -> None:
    found = estimate_scale(scene, wide_of(scene, factor=factor, turn_deg=turn_deg))
    assert found is not None
    assert found.factor == pytest.approx(factor, rel=0.005)
    assert found.rotation_deg == pytest.approx(turn_deg, abs=0.3)
    assert abs(found.factor - factor) < max(5 * found.factor_std, 0.0015 * factor)


@pytest.mark.parametrize(
    "factor", [2.0, pytest.param(4.0, marks=pytest.mark.slow), pytest.param(6.0, marks=pytest.mark.slow), 8.0]
)
def test_the_factor_of_damaged_views_is_found(scene: FloatImage, factor: float) -> None:
    big = cv2.resize(scene, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_CUBIC) if factor > 4 else scene
    damage = Degradation(factor=factor, noise_std=0.005, gain=(0.8, 1.0, 1.1))
    small = degrade_small(big, damage, rng=np.random.default_rng(0))
    found = estimate_scale(big, small)
    assert found is not None
    assert found.factor == pytest.approx(big.shape[1] / small.shape[1], rel=0.005)


def test_parallax_does_not_pass_for_scale(scene: FloatImage) -> None:
    # near things, moved along x by the baseline, lie mostly to the right
    x = np.arange(scene.shape[1])
    near = (np.random.default_rng(5).random(24) < np.linspace(0.1, 0.9, 24)).repeat(scene.shape[1] // 24)
    shift_px = np.where(near, 24.0, 0.0)
    grid_x, grid_y = np.meshgrid((x + shift_px).astype(np.float32), np.arange(scene.shape[0], dtype=np.float32))
    seen = cv2.remap(scene, grid_x, grid_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    found = estimate_scale(scene, wide_of(seen, factor=3.0))
    assert found is not None
    assert found.factor == pytest.approx(3.0, rel=0.005)


def test_two_scenes_have_no_factor(scene: FloatImage) -> None:
    other = textured(np.random.default_rng(11), hw=(300, 400))
    assert estimate_scale(scene, other) is None
    assert estimate_scale(scene, np.full((300, 400, 3), 0.5, dtype=np.float32)) is None


@pytest.mark.slow
def test_a_real_phone(data_root: Path) -> None:
    folder = data_root / "phone_tele_wide_exif"
    tele, wide = (read_image(next(folder.glob(f"*{view}*.jpg"))) for view in ("tele", "wide"))
    found = estimate_scale(tele, wide)
    assert found is not None
    assert found.factor == pytest.approx(1.956, rel=0.005)
    assert compare_factors(matches=found.factor, exif=52 / 26).statements == ()
