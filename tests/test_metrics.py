"""Metrics against closed forms."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from telewide.metrics import bad_pixel_share, density, end_point_error_px, psnr_db, three_pixel_error


def test_end_point_error_is_the_mean_of_known_pixels() -> None:
    truth = np.array([[10, np.nan, -4, 0]], np.float32)
    estimate = np.array([[11, 99, -7, 0]], np.float32)
    assert end_point_error_px(estimate, truth) == pytest.approx(4 / 3)
    assert end_point_error_px(estimate, truth, mask=np.array([[True, True, False, True]])) == pytest.approx(0.5)
    assert np.isnan(end_point_error_px(np.full_like(truth, np.nan), truth))


def test_three_pixel_error_needs_both_thresholds() -> None:
    truth = np.array([[10, 10, 100, 100, -100, np.nan, 10]], np.float32)
    estimate = np.array([[13, 13.5, 104.5, 106, -94, 0, np.nan]], np.float32)
    # fine: 3.0 px; 4.5 px of 100. wrong: 3.5 px of 10, 6 px of 100, 6 px of -100, no estimate.
    assert three_pixel_error(estimate, truth) == pytest.approx(4 / 6)
    assert three_pixel_error(truth, truth) == 0


def test_three_pixel_error_is_mirrored_with_the_sign(rng: np.random.Generator) -> None:
    truth = rng.uniform(-80, 80, (20, 30)).astype(np.float32)
    estimate = truth + rng.normal(0, 4, truth.shape).astype(np.float32)
    assert three_pixel_error(estimate, truth) == three_pixel_error(-estimate, -truth)
    assert three_pixel_error(estimate, truth) <= (np.abs(estimate - truth) > 3.0).mean()


def test_bad_input() -> None:
    known = np.zeros((2, 3), np.float32)
    with pytest.raises(ValueError, match="one shape"):
        end_point_error_px(known, known[:1])
    with pytest.raises(ValueError, match="known truth"):
        three_pixel_error(known, np.full_like(known, np.nan))
    with pytest.raises(ValueError, match="mask must be bool"):
        three_pixel_error(known, known, mask=known)  # type: ignore[arg-type]


def test_bad_pixels_and_density() -> None:
    truth = np.array([[10, 10, 10, 10, np.nan]], np.float32)
    estimate = np.array([[11, 11.5, 12.5, np.nan, 0]], np.float32)
    assert bad_pixel_share(estimate, truth, threshold_px=1) == pytest.approx(3 / 4)
    assert bad_pixel_share(estimate, truth, threshold_px=2) == pytest.approx(2 / 4)
    assert density(estimate, truth) == pytest.approx(3 / 4)


def test_psnr(rng: np.random.Generator) -> None:
    picture = rng.random((6, 7, 3), dtype=np.float32)
    assert psnr_db(picture + np.float32(0.1), picture) == pytest.approx(20, abs=1e-3)
    noisy = np.clip(picture + rng.normal(0, 0.05, picture.shape), 0, 1).astype(np.float32)
    assert psnr_db(noisy, picture) == pytest.approx(cv2.PSNR(noisy, picture, 1.0), abs=1e-3)
    assert psnr_db(picture, picture) == np.inf
    mask = np.zeros((6, 7), np.bool_)
    mask[0] = True
    noisy[1:] = 0
    assert psnr_db(noisy, picture, mask=mask) == pytest.approx(cv2.PSNR(noisy[:1], picture[:1], 1.0), abs=1e-3)
    with pytest.raises(ValueError, match="no pixel counts"):
        psnr_db(picture, picture, mask=np.zeros((6, 7), np.bool_))
