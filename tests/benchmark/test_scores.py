"""Measures of maps against cases computed by hand, plain loops, and laws."""

from __future__ import annotations

import math
from dataclasses import astuple

import cv2
import numpy as np
import pytest

from telewide.benchmark.bokeh_quality import STRENGTH_SHARE, bokeh_quality
from telewide.benchmark.boundaries import BoundaryErrors, boundary_errors, boundary_f1, depth_edges
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.scores import score_regions
from telewide.srgb import linear_from_srgb, srgb_from_linear

HW = (48, 64)
RATIOS = [1.05 + 0.2 * i / 9 for i in range(10)]


def step(column: int, *, hw: tuple[int, int] = HW, far: float = 10, near: float = 30) -> np.ndarray:
    """Near on the right, from a column on."""
    truth_px = np.full(hw, far, np.float32)
    truth_px[:, column:] = near
    return truth_px


def test_regions_by_hand() -> None:
    view = np.zeros((1, 6, 3), np.float32)
    truth_px = np.array([[10, 10, 100, 10, 10, np.nan]], np.float32)
    occluded = np.array([[False, False, False, True, True, True]])
    estimate_px = np.array([[10, 11.5, 104, 12.5, np.nan, 3]], np.float32)
    scores = score_regions(estimate_px, StereoTruth(view, view, truth_px, occluded))
    # errors 0, 1.5, 4 (4 % of the truth: within 3PE), 2.5 and none
    assert astuple(scores["visible"]) == pytest.approx((0, 5.5 / 3, 2 / 3, 1 / 3, 1, 3))
    hidden = scores["occluded"]
    assert (hidden.off_3px_5percent, hidden.bad_1px, hidden.bad_2px, hidden.density) == (0.5, 1, 1, 0.5)
    assert math.isnan(hidden.end_point_error_px)
    assert (scores["all"].pixels, hidden.pixels) == (5, 2)
    assert scores["all"].off_3px_5percent == pytest.approx(0.2)
    assert scores["all"].bad_2px == pytest.approx(3 / 5)


def test_regions_that_are_not_told_are_left_out() -> None:
    view, truth_px = np.zeros((2, 2, 3), np.float32), np.ones((2, 2), np.float32)
    assert list(score_regions(truth_px, StereoTruth(view, view, truth_px))) == ["all"]
    nothing_hidden = StereoTruth(view, view, truth_px, np.zeros((2, 2), np.bool_))
    assert list(score_regions(truth_px, nothing_hidden)) == ["all", "visible"]


def test_an_edge_lies_between_the_two_sides() -> None:
    edges = depth_edges(step(30), ends_px=(10, 30))
    assert set(np.flatnonzero(edges.any(axis=0))) <= {29, 30}
    assert (edges.sum(axis=1) == 1)[2:-2].all()
    # After a Gaussian of sigma, a step of height h has a Sobel gradient of 8 h / (sigma sqrt(2 pi)): 0.3 from 0.133 on,
    # a little more because Sobel averages over three columns.
    assert depth_edges(step(30, near=10 + 0.17 * 20), ends_px=(10, 30)).any()
    assert not depth_edges(step(30, near=10 + 0.12 * 20), ends_px=(10, 30)).any()


@pytest.mark.parametrize("off_px", [0, 3, 9])
def test_shifted_edges_are_off_by_their_shift(off_px: int) -> None:
    errors = boundary_errors(step(30 + off_px), step(30))
    assert (errors.accuracy_px, errors.completeness_px) == pytest.approx((off_px, off_px), abs=0.05)


def test_edges_that_are_far_missing_or_unknown() -> None:
    assert boundary_errors(step(50), step(20)) == BoundaryErrors(10, 10)
    assert boundary_errors(np.full(HW, 10, np.float32), step(20)) == BoundaryErrors(10, 10)
    # A second, false edge 20 px away: it does not count for accuracy; completeness is (0 + 0 + 10) / 3.
    doubled = step(20)
    doubled[:, 40:] = 10
    errors = boundary_errors(doubled, step(20))
    assert (errors.accuracy_px, errors.completeness_px) == pytest.approx((0, 10 / 3), abs=0.05)
    hidden = step(20)
    hidden[:, 30:] = np.nan
    assert boundary_errors(doubled, hidden).completeness_px == pytest.approx(0, abs=0.05)
    assert math.isnan(boundary_errors(step(20), np.full(HW, 5, np.float32)).accuracy_px)


def looped_gaussian(values: np.ndarray) -> np.ndarray:
    """A Gaussian of sqrt(2) px, reaching 6 px, the border repeated: exp(-t^2 / 4) along rows, then along columns."""
    weights = {t: math.exp(-t * t / 4) for t in range(-6, 7)}
    total = sum(weights.values())
    height, width = values.shape
    along, both = np.zeros(values.shape), np.zeros(values.shape)
    for y, x in np.ndindex(height, width):
        along[y, x] = sum(w * values[y, min(max(x + t, 0), width - 1)] for t, w in weights.items()) / total
    for y, x in np.ndindex(height, width):
        both[y, x] = sum(w * along[min(max(y + t, 0), height - 1), x] for t, w in weights.items()) / total
    return both


def looped_canny(map_px: np.ndarray, low_px: float, high_px: float) -> np.ndarray:
    """Canny's edges pixel by pixel: Sobel, the steepest across, strong ones and what touches them."""
    smooth = looped_gaussian(np.clip((map_px - low_px) / (high_px - low_px), 0, 1))
    height, width = smooth.shape
    padded = np.pad(smooth, 1, mode="edge")
    slope, sector = np.zeros((height + 2, width + 2)), {}
    for y, x in np.ndindex(height, width):
        dx = sum(w * (padded[y + i, x + 2] - padded[y + i, x]) for i, w in enumerate((1, 2, 1)))
        dy = sum(w * (padded[y + 2, x + i] - padded[y, x + i]) for i, w in enumerate((1, 2, 1)))
        slope[y + 1, x + 1] = math.hypot(dx, dy)
        eighths = round(math.atan2(dy, dx) / (math.pi / 4)) % 4
        sector[y, x] = ((0, 1), (1, 1), (1, 0), (1, -1))[eighths]
    thin = {
        (y, x)
        for (y, x), (down, right) in sector.items()
        if slope[y + 1, x + 1] > max(slope[y + 1 + down, x + 1 + right], slope[y + 1 - down, x + 1 - right], 0.15)
    }
    edges = {(y, x) for y, x in thin if slope[y + 1, x + 1] > 0.3}
    while further := {(y, x) for y, x in thin - edges if any(abs(y - v) < 2 and abs(x - u) < 2 for v, u in edges)}:
        edges |= further
    found = np.zeros(map_px.shape, np.bool_)
    for place in edges:
        found[place] = True
    return found


def looped_boundary_errors(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Accuracy and completeness by the distance of every edge pixel to every other."""

    def to_nearest(edges: np.ndarray, others: np.ndarray) -> list[float]:
        return [min(math.dist(a, b) for b in np.argwhere(others)) for a in np.argwhere(edges)]

    to_true, to_found = to_nearest(found, true), to_nearest(true, found)
    near = [distance for distance in to_true if distance <= 10]
    both = [min(distance, 10) for distance in to_true + to_found]
    return sum(near) / len(near), sum(both) / len(both)


@pytest.mark.parametrize("has_unknown", [False, True])
def test_boundary_errors_are_those_of_plain_loops(has_unknown: bool, rng: np.random.Generator) -> None:
    blocks, others = (np.kron(rng.uniform(5, 40, (4, 7)), np.ones((9, 10))) for _ in range(2))
    # Of two columns that are equally steep either may be the edge, so steps lie between pixels at no half.
    blocks, others = (0.7 * each + 0.3 * np.roll(each, (1, 1), (0, 1)) for each in (blocks, others))
    truth_px = (blocks + rng.normal(0, 0.3, blocks.shape)).astype(np.float32)
    shifted = np.roll(0.8 * blocks + 0.2 * others, (1, 3), (0, 1))
    truth_px[:, :35] = 20  # nothing is true within 10 px of what is found there
    estimate_px = (shifted + rng.normal(0, 0.5, blocks.shape)).astype(np.float32)
    filled_px = truth_px.copy()
    if has_unknown:
        truth_px[:, -12:] = np.nan
        filled_px[:, -12:] = filled_px[:, -13:-12]  # the nearest that is known
    ends_px = float(np.nanmin(truth_px)), float(np.nanmax(truth_px))
    known = np.isfinite(truth_px)
    found, true = (depth_edges(map_px, ends_px=ends_px) & known for map_px in (estimate_px, truth_px))
    for ours, map_px in ((found, estimate_px), (true, filled_px)):
        expected = looped_canny(map_px, *ends_px) & known
        assert expected.sum() > 100
        assert (ours != expected).sum() <= 3, "slopes are whole numbers, of which two may be equal"
    accuracy_px, completeness_px = looped_boundary_errors(found, true)
    assert 0.5 < accuracy_px < completeness_px < 8, "some are farther than 10 px"
    errors = boundary_errors(estimate_px, truth_px)
    assert (errors.accuracy_px, errors.completeness_px) == pytest.approx((accuracy_px, completeness_px), abs=1e-9)


def looped_f1(estimate: np.ndarray, truth: np.ndarray) -> float:
    """Boundary F1 of one pixel and neighbour at a time."""
    total, weights = 0.0, 0.0
    for ratio in RATIOS:
        recalls, precisions = [], []
        for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            shared = found = true = 0
            for y in range(truth.shape[0]):
                for x in range(truth.shape[1]):
                    if not (0 <= y + dy < truth.shape[0] and 0 <= x + dx < truth.shape[1]):
                        continue
                    is_found = estimate[y + dy, x + dx] / estimate[y, x] > ratio
                    is_true = truth[y + dy, x + dx] / truth[y, x] > ratio
                    shared, found, true = shared + (is_found and is_true), found + is_found, true + is_true
            recalls += [shared / true] if true else []
            precisions += [shared / found] if found else []
        recall, precision = sum(recalls) / len(recalls), sum(precisions) / len(precisions)
        total += ratio * (2 * recall * precision / (recall + precision) if recall + precision else 0)
        weights += ratio
    return total / weights


def test_boundary_f1_is_that_of_a_plain_loop(rng: np.random.Generator) -> None:
    truth = rng.uniform(1, 2, (9, 11))
    estimate = truth * rng.uniform(0.8, 1.25, truth.shape)
    assert boundary_f1(estimate.astype(np.float32), truth.astype(np.float32)) == pytest.approx(
        looped_f1(estimate, truth), abs=1e-4
    )
    assert boundary_f1(7 * truth.astype(np.float32), truth.astype(np.float32)) == 1  # of any scale


def test_boundary_f1_by_hand() -> None:
    truth = step(30, far=1, near=1.5)
    assert boundary_f1(truth, truth) == 1
    assert boundary_f1(step(31, far=1, near=1.5), truth) == 0
    assert boundary_f1(np.ones(HW, np.float32), truth) == 0
    # A step of 10 % is one for the ratios below it only.
    below = [ratio for ratio in RATIOS if ratio < 1.1]
    assert boundary_f1(step(30, far=1, near=1.1), truth) == pytest.approx(sum(below) / sum(RATIOS))
    assert boundary_f1(truth, np.ones(HW, np.float32)) == 0
    assert math.isnan(boundary_f1(np.ones(HW, np.float32), np.ones(HW, np.float32)))
    assert math.isnan(boundary_f1(truth, truth - 1.2))  # signed: no inverse depth
    unknown = truth.copy()
    unknown[:, 20:40] = np.nan
    assert math.isnan(boundary_f1(unknown, unknown))


@pytest.fixture
def picture(rng: np.random.Generator) -> np.ndarray:
    return cv2.GaussianBlur(rng.random((*HW, 3), dtype=np.float32), (0, 0), 1.0)


def test_true_depth_loses_nothing_and_worse_depth_more(picture: np.ndarray) -> None:
    truth_px = step(30)
    assert bokeh_quality(picture, truth_px, truth_px).mean_db == math.inf
    small, large = (bokeh_quality(picture, step(30 + off), truth_px).mean_db for off in (2, 10))
    assert large < small < 60


def test_unknown_truth_does_not_count(picture: np.ndarray) -> None:
    truth_px = step(30)
    estimate_px = truth_px.copy()
    estimate_px[:10] = 90
    truth_px[:10] = np.nan
    assert bokeh_quality(picture, estimate_px, truth_px).mean_db == math.inf


def test_a_flat_estimate_blurs_as_one_disk(picture: np.ndarray) -> None:
    # All is taken for near, so with the focus on what is far, all gets the largest disk; the true far half stays sharp.
    truth_px = step(HW[1] // 2)
    ours = bokeh_quality(picture, np.full(HW, 30, np.float32), truth_px)
    radius = STRENGTH_SHARE * min(HW)
    y, x = np.mgrid[-3 : 4 : 1 / 8, -3 : 4 : 1 / 8] + 1 / 16 - 1 / 2
    fine = (np.hypot(x, y) <= radius).astype(np.float64)
    disk = fine.reshape(7, 8, 7, 8).sum(axis=(1, 3))
    light = cv2.filter2D(linear_from_srgb(picture), -1, disk / disk.sum(), borderType=cv2.BORDER_REFLECT_101)
    error = (srgb_from_linear(light) - picture)[:, : HW[1] // 2 - 4]
    # The near half is right, so that the error of the far half counts by half.
    assert ours.far_db == pytest.approx(-10 * math.log10(np.mean(np.square(error)) / 2), abs=1.0)
    assert ours.near_db < 60


def test_bad_input(picture: np.ndarray) -> None:
    with pytest.raises(ValueError, match="sizes differ"):
        bokeh_quality(picture, step(30)[:-1], step(30))
    for measure in (boundary_errors, boundary_f1):
        with pytest.raises(ValueError, match="one shape"):
            measure(step(30)[:-1], step(30))
        with pytest.raises(ValueError, match="nothing of the truth"):
            measure(step(30), np.full(HW, np.nan, np.float32))
