"""Spots of light are pictures of the lens' opening, upright behind the focus and upside down before it."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.bokeh.aperture import DISK, QUARTERS, Aperture, spot_of
from telewide.bokeh.lens import spread_light
from telewide.errors import UsageError


def spot(radius_px: float, aperture: Aperture, *, size: int = 81) -> np.ndarray:
    """What a point in the middle becomes, with the middle at 0."""
    light = np.zeros((size, size, 3), np.float32)
    light[size // 2, size // 2] = 1
    return spread_light(light, np.full((size, size), radius_px, np.float32), aperture=aperture)[..., 0]


def farthest_deg(shown: np.ndarray) -> float:
    """Direction, clockwise from the top, in which a spot reaches farthest."""
    y, x = np.nonzero(shown > 0.5 * shown.max())
    y, x = y - shown.shape[0] // 2, x - shown.shape[1] // 2
    far = np.hypot(x, y).argmax()
    return float(np.degrees(np.arctan2(x[far], -y[far])))


@pytest.mark.parametrize("blades", [5, 6, 7, 9])
@pytest.mark.parametrize("curvature", [0.0, 0.5, 1.0])
def test_every_opening_has_the_area_of_its_disk(blades: int, curvature: float) -> None:
    aperture = Aperture(blades=blades, curvature=curvature, rotation_deg=13.0)
    side = np.linspace(-1.6, 1.6, 801)
    inside = aperture.contains(side[:, None], side[None])
    assert inside.mean() * 3.2**2 == pytest.approx(np.pi, rel=0.01)
    radius = np.hypot(side[:, None], side[None])[inside]
    assert radius.max() == pytest.approx(aperture.reach, abs=0.01)
    assert sum(aperture.share_of(quarter) for quarter in QUARTERS) == pytest.approx(1)


def test_round_blades_make_a_disk() -> None:
    side = np.linspace(-1.2, 1.2, 101)
    round_blades = Aperture(blades=7, curvature=1.0)
    np.testing.assert_array_equal(
        round_blades.contains(side[:, None], side[None]), DISK.contains(side[:, None], side[None])
    )


@pytest.mark.parametrize("rotation_deg", [0.0, 30.0])
def test_corners_point_where_they_are_turned_to_behind_the_focus(rotation_deg: float) -> None:
    five = Aperture(blades=5, rotation_deg=rotation_deg)
    behind, before = spot(-7.0, five), spot(7.0, five)
    assert (farthest_deg(behind) - rotation_deg + 36) % 72 - 36 == pytest.approx(0, abs=9)
    np.testing.assert_allclose(before, behind[::-1, ::-1], atol=1e-6)
    # A pentagon is no picture of itself upside down.
    assert np.abs(before - behind).sum() > 0.1


def test_quarters_make_the_whole() -> None:
    for aperture in (DISK, Aperture(blades=5, rotation_deg=20.0)):
        for radius in (-6.3, 2.0):
            whole = spot_of(radius, None, aperture=aperture)
            total = np.zeros_like(whole.kernel)
            for quarter in QUARTERS:
                part = spot_of(radius, quarter, aperture=aperture)
                top, left = (w - p for w, p in zip(whole.anchor_xy[::-1], part.anchor_xy[::-1], strict=True))
                rows, columns = (slice(at, at + size) for at, size in zip((top, left), part.kernel.shape, strict=True))
                total[rows, columns] += part.kernel * aperture.share_of(quarter)
            np.testing.assert_allclose(total, whole.kernel, atol=1e-3)


@pytest.mark.parametrize(
    "wrong", [{"blades": 2}, {"blades": 99}, {"blades": 6, "curvature": 1.5}, {"blades": 6, "rotation_deg": np.nan}]
)
def test_openings_that_no_lens_has_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="expected"):
        Aperture(**wrong)
