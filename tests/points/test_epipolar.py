"""Misfits of matches against a rig whose every number is written out."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.points.epipolar import epipolar_misfit_px, moved_rig, vertical_misfit_px

FloatArray = NDArray[np.float64]
DOWN = np.array([0.0, 1.0])


def plain_rig(*, f_tele_px: float = 1200.0, f_wide_px: float = 400.0) -> StereoRig:
    """Wide stands 10 mm to the right of tele, both look the same way."""
    tele, wide = (
        Camera((600, 800), np.array([[f, 0, 399.5], [0, f, 299.5], [0, 0, 1.0]]), np.zeros(0))
        for f in (f_tele_px, f_wide_px)
    )
    return StereoRig(tele, wide, rigid_transform(rotation=np.zeros(3), translation=np.array([-0.01, 0, 0])))


def seen(rig: StereoRig) -> tuple[FloatArray, FloatArray]:
    points_m = np.random.default_rng(0).uniform((-0.2, -0.15, 1), (0.2, 0.15, 3), (50, 3))
    R, t = rig.wide_from_tele[:3, :3], rig.wide_from_tele[:3, 3]
    return rig.tele.project(points_m), rig.wide.project(points_m @ R.T + t)


def test_true_matches_have_no_misfit() -> None:
    rig = plain_rig()
    tele_px, wide_px = seen(rig)
    np.testing.assert_allclose(vertical_misfit_px(tele_px, wide_px, rig=rig), 0, atol=1e-6)


def test_a_point_of_tele_that_lies_lower_has_a_positive_misfit() -> None:
    """``y_tele - y_wide`` in tele's pixels: two of tele are two, two of wide are minus six."""
    rig = plain_rig()
    tele_px, wide_px = seen(rig)
    np.testing.assert_allclose(vertical_misfit_px(tele_px + 2 * DOWN, wide_px, rig=rig), 2, atol=1e-6)
    np.testing.assert_allclose(vertical_misfit_px(tele_px, wide_px + 2 * DOWN, rig=rig), -6, atol=1e-6)


def test_the_distance_from_the_epipolar_line_is_the_vertical_misfit() -> None:
    rig = plain_rig()
    tele_px, wide_px = seen(rig)
    misfit_px = epipolar_misfit_px(
        rig.tele.normalised(tele_px + 1.5 * DOWN),
        rig.wide.normalised(wide_px),
        wide_from_tele=rig.wide_from_tele,
        f_px=rig.tele.f_px,
    )
    assert np.abs(misfit_px) == pytest.approx(1.5, abs=1e-3)


def test_an_offset_of_the_rig_takes_the_misfit_out() -> None:
    rig = plain_rig()
    tele_px, wide_px = seen(rig)
    moved = moved_rig(rig, offset_px=6.0)
    np.testing.assert_allclose(vertical_misfit_px(tele_px, wide_px - 2 * DOWN, rig=moved), 0, atol=1e-6)
