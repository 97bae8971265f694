"""Bokeh of a capture with a rig, against that of a larger photo of the same painted plane; kept depth against fresh."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from rig_worlds import phone_rig, photos_of_a_plane, seen_points

from telewide.bokeh.picture import BokehOptions
from telewide.bokeh.render import render_bokeh
from telewide.capture.images import read_image, write_image
from telewide.capture.pair import Capture, CaptureFacts
from telewide.depth.precision import DepthPrecision
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rectification import rectified_geometry
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.window import Window
from telewide.metrics import psnr_db
from telewide.points.held_out import HeldOut
from telewide.stages.beyond_frame import zero_by_matches
from telewide.stages.capture_depth import DepthOutcome, depth_of_capture
from telewide.stages.photo_depth import ShotGeometry

RIG = phone_rig(width_px=400)
GEOMETRY = rectified_geometry(RIG)
DEPTH_M = 1.5
MARGIN_PX = 24
BOKEH = BokehOptions(focus="9m", strength_px=9.0, kinds=("tif",))
NO_MATCHES = np.zeros((0, 2)), np.zeros(0)


@pytest.fixture(scope="module")
def larger() -> tuple[np.ndarray, np.ndarray]:
    """What tele would see with a larger sensor, and what wide sees, of a plane at 1.5 m."""
    K = RIG.tele.K.copy()
    K[:2, 2] += MARGIN_PX
    hw = RIG.tele.hw[0] + 2 * MARGIN_PX, RIG.tele.hw[1] + 2 * MARGIN_PX
    rig = replace(RIG, tele=replace(RIG.tele, K=K, hw=hw))
    tele, wide = photos_of_a_plane(rig, np.random.default_rng(3), depth_m=DEPTH_M)
    return np.repeat(tele[..., None], 3, axis=2), np.repeat(wide[..., None], 3, axis=2)


@pytest.fixture
def capture(tmp_path: Path, larger: tuple[np.ndarray, np.ndarray]) -> Capture:
    """Photos as taken, and a pair of the size of the rectified views."""
    taken = Capture("one", tmp_path / "tele.png", tmp_path / "wide.png")
    write_image(taken.tele_path, np.ascontiguousarray(larger[0][MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]))
    write_image(taken.wide_path, larger[1])
    for name, grey in (("ref", 0.4), ("src", 0.6)):
        write_image(tmp_path / f"{name}.png", np.full((*GEOMETRY.hw, 3), grey, np.float32))
    return taken


def plane(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
    """Disparity of the plane across tele's optical axis, in the rectified view."""
    y, x = np.mgrid[: GEOMETRY.hw[0], : GEOMETRY.hw[1]]
    per_depth = GEOMETRY.tele_depth_per_rectified_depth(np.column_stack([x.ravel(), y.ravel()]))
    exact_px = GEOMETRY.f_px * RIG.baseline_m / DEPTH_M * per_depth - GEOMETRY.doffs_px
    disparity_px = exact_px.reshape(GEOMETRY.hw).astype(np.float32)
    return DisparityMap(disparity_px, np.ones_like(disparity_px), np.ones(GEOMETRY.hw, bool))


def made(capture: Capture, folder: Path, *, bokeh: BokehOptions | None = BOKEH) -> DepthOutcome:
    root = capture.tele_path.parent
    pair = HeldOut(Capture("one", root / "ref.png", root / "src.png"), *NO_MATCHES)
    outcome = depth_of_capture(
        capture,
        pair,
        folder,
        facts=CaptureFacts(),
        match=plane,
        window=(0, 32),
        bokeh=bokeh,
        key={"bokeh": None if bokeh is None else asdict(bokeh)},
        shot=ShotGeometry(GEOMETRY, DepthPrecision()),
    )
    assert isinstance(outcome, DepthOutcome), outcome
    return outcome


def test_border_of_a_bokeh_is_that_of_a_larger_photo(
    capture: Capture, tmp_path: Path, larger: tuple[np.ndarray, np.ndarray]
) -> None:
    made(capture, tmp_path / "run")
    written = read_image(tmp_path / "run" / "bokeh.tif")
    depths = np.ones(larger[0].shape[:2], np.float32)  # all of it is 9 px away from the focus
    inner = np.s_[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    lens = {"focus_disparity_px": 0.0, "radius_per_px": 9.0}
    true = render_bokeh(larger[0], depths, **lens)[inner]
    mirrored = render_bokeh(read_image(capture.tele_path), depths[inner], **lens)
    near_border = np.ones(true.shape[:2], bool)
    near_border[9:-9, 9:-9] = False
    from_wide_db, mirrored_db = (psnr_db(each, true, mask=near_border) for each in (written, mirrored))
    assert from_wide_db > 38
    assert from_wide_db > mirrored_db + 8
    np.testing.assert_allclose(written[12:-12, 12:-12], true[12:-12, 12:-12], atol=0.01)


def test_kept_depth_gets_the_same_border(capture: Capture, tmp_path: Path) -> None:
    made(capture, tmp_path / "at_once")
    made(capture, tmp_path / "later", bokeh=None)
    assert made(capture, tmp_path / "later").is_depth_kept
    expected = (tmp_path / "at_once" / "bokeh.tif").read_bytes()
    assert (tmp_path / "later" / "bokeh.tif").read_bytes() == expected


def test_zero_that_a_known_distance_moved_is_found_by_matches() -> None:
    points = seen_points(RIG, np.random.default_rng(1), n=60, nearest_m=DEPTH_M, farthest_m=DEPTH_M)
    ref_px, src_px = GEOMETRY.ref_from_tele(points.ref_px), GEOMETRY.src_from_wide(points.src_px)
    pair = HeldOut(Capture("one", Path("ref"), Path("src")), ref_px, ref_px[:, 0] - src_px[:, 0])
    exact_px = np.full(RIG.tele.hw, RIG.tele.K[0, 0] * RIG.baseline_m / DEPTH_M, np.float32)
    for zero_px in (0.0, 3.5, -2.0):
        assert zero_by_matches(exact_px + np.float32(zero_px), pair, GEOMETRY) == pytest.approx(zero_px, abs=0.02)
    few = HeldOut(pair.capture, pair.ref_px[:5], pair.disparity_px[:5])
    assert zero_by_matches(exact_px + 3, few, GEOMETRY) == 0
