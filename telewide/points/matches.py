"""Two-way consistent point matches of a nearly rectified pair: the judge of everything that comes after.

Rotation and scale of the two views agree, so a match may only move along x, and a little along y. SIFT points are
matched within that band, both ways, moved to the best fit of the patch around them, and kept where the vertical misfit
follows one linear law of the image and the disparity agrees with neighbours. No fundamental matrix is fitted: with the
narrow span of disparities of a phone it is degenerate.
Convention: pixel (0, 0) is the centre of the top-left pixel; ``disparity_px = x_ref - x_src``;
``vertical_px = y_ref - y_src = a + b x_src + c y_ref`` where nothing else is wrong.
Letters: N matches, M points of a view, H W image.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from telewide.errors import InputError
from telewide.geometry.arrays import BoolArray, BoolMap, FloatArray, FloatImage
from telewide.geometry.stereo import ValidMasks
from telewide.points.bandwidth import blur_to_bandwidth, estimate_asymmetry
from telewide.points.features import Features, sift_features, stretched
from telewide.points.robust import std_about_zero
from telewide.srgb import grey

VERTICAL_TOLERANCE_PX = (0.5, 1.5)
"""Largest distance of a match from the linear vertical law: four sigma of the matches, at least and at most this."""
_MAX_FEATURES = 4000
_RATIO = 0.85
_MAX_ANGLE_DEG = 20.0
_MAX_SCALE_RATIO = 1.5
_SAME_POINT_PX = 3.0
_NEIGHBOURS = 12
_SUPPORTERS = 5
_MAX_POINT_SIZE_PX = 10.0
_MAX_BLUR_FACTOR = 6.0
_PATCH_RADIUS_PX = 7
_ALIGN_STEPS = 6
_MAX_MOVE_PX = 1.75
_MIN_CORRELATION = 0.9


@dataclass(frozen=True)
class Matches:
    """Points of ref and the same points of src.

    Attributes:
        ref_px: (N, 2) float64, (x, y) in ref.
        src_px: (N, 2) float64, (x, y) in src.
    """

    ref_px: FloatArray
    src_px: FloatArray

    @property
    def disparity_px(self) -> NDArray[np.float64]:
        """(N,) ``x_ref - x_src``."""
        return np.asarray(self.ref_px[:, 0] - self.src_px[:, 0])

    @property
    def vertical_px(self) -> NDArray[np.float64]:
        """(N,) ``y_ref - y_src``."""
        return np.asarray(self.ref_px[:, 1] - self.src_px[:, 1])

    def __len__(self) -> int:
        return len(self.ref_px)

    def select(self, keep: BoolArray | NDArray[np.intp]) -> Matches:
        """Return the matches a mask or a list of indices names."""
        return Matches(self.ref_px[keep], self.src_px[keep])


def find_matches(ref: FloatImage, src: FloatImage) -> Matches:
    """Match two views of one scene whose rows nearly agree.

    SIFT (Lowe 2004) with square-rooted descriptors (Arandjelovic and Zisserman 2012) on views brought to one bandwidth.
    Looked for are disparities up to a quarter of the width, of either sign, and vertical misfits up to 4 % of the
    height, at least 8 px.

    Args:
        ref: (H, W, 3) RGB or (H, W) in [0, 1].
        src: the same shape, in [0, 1].

    Returns:
        The consistent matches; none where the views share no scene.

    Raises:
        InputError: the views differ in size.
    """
    if ref.shape[:2] != src.shape[:2]:
        raise InputError(f"find_matches needs two views of one size, got {ref.shape[:2]} and {src.shape[:2]}")
    height, width = ref.shape[:2]
    ref_grey, src_grey = to_one_bandwidth(grey(ref), grey(src))
    found = match_descriptors(
        detect_points(ref_grey, max_features=_MAX_FEATURES),
        detect_points(src_grey, max_features=_MAX_FEATURES),
        reach_px=(width / 4, max(8.0, 0.04 * height)),
    )
    return consistent_matches(align_matches(ref_grey, src_grey, found))


def photographed_matches(matches: Matches, valid: ValidMasks | None) -> Matches:
    """Keep the matches that lie where both photos reach; a continued border mirrors points that nobody sees there.

    Args:
        matches: of two views.
        valid: of the views; None where the photos fill them.
    """
    if valid is None:
        return matches
    seen = [_values_at(mask, points) for mask, points in ((valid.ref, matches.ref_px), (valid.src, matches.src_px))]
    return matches.select(seen[0] & seen[1])


def _values_at(mask: BoolMap, points_px: NDArray[np.float64]) -> BoolArray:
    height, width = mask.shape
    x, y = np.round(points_px).astype(np.intp).T
    return np.asarray(mask[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)])


def consistent_matches(matches: Matches) -> Matches:
    """Keep the matches that follow one linear vertical law and agree in disparity with their neighbours.

    Args:
        matches: any matches, also wrong ones.

    Returns:
        A subset, in the same order.
    """
    kept = matches
    for _ in range(2):
        if len(kept) < _SUPPORTERS + 1:
            break
        residual_px = np.abs(_vertical_residual_px(kept))
        sigma_px = std_about_zero(residual_px[residual_px <= VERTICAL_TOLERANCE_PX[1]])
        kept = kept.select(residual_px <= np.clip(4.0 * sigma_px, *VERTICAL_TOLERANCE_PX))
        if len(kept) < _SUPPORTERS + 1:
            break
        kept = kept.select(neighbour_support(kept.ref_px, kept.disparity_px, supporters=_SUPPORTERS))
    return kept if len(kept) > _SUPPORTERS else kept.select(np.zeros(len(kept), dtype=bool))


def split_matches(matches: Matches, *, held_out_share: float = 0.5, seed: int = 0) -> tuple[Matches, Matches]:
    """Split matches at random, the same way for the same seed.

    Args:
        matches: N matches.
        held_out_share: share of the matches that goes to the second part.
        seed: seed of the permutation.

    Returns:
        The matches to fit to, and those kept for judging.
    """
    order = np.random.default_rng(seed).permutation(len(matches))
    n_held_out = round(held_out_share * len(matches))
    return matches.select(np.sort(order[n_held_out:])), matches.select(np.sort(order[:n_held_out]))


def to_one_bandwidth(ref_HW: FloatImage, src_HW: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Blur the sharper view to the other's bandwidth.

    Args:
        ref_HW: (H, W) grey, in [0, 1].
        src_HW: (H', W') likewise.

    Returns:
        Both views, equally sharp.
    """
    factor = estimate_asymmetry(ref_HW, src_HW) or 1.0
    ref_blurred = blur_to_bandwidth(ref_HW, factor=min(factor, _MAX_BLUR_FACTOR))
    return ref_blurred, blur_to_bandwidth(src_HW, factor=min(1.0 / factor, _MAX_BLUR_FACTOR))


def detect_points(image_HW: FloatImage, *, max_features: int) -> Features:
    """Find the small SIFT points of one view, faint ones too.

    Args:
        image_HW: (H, W) grey, in [0, 1].
        max_features: at most so many points.
    """
    found = sift_features(stretched(image_HW), max_features=max_features, contrast_threshold=0.01, edge_threshold=12)
    return found.select(found.size_px <= _MAX_POINT_SIZE_PX).rooted()


def match_descriptors(ref: Features, src: Features, *, reach_px: tuple[float, float]) -> Matches:
    """Pair mutual nearest neighbours that the geometry allows and that are clearly better than the second best.

    Args:
        ref: points of ref.
        src: points of src.
        reach_px: how far a partner may lie along x and along y.
    """
    row, column = _candidates(ref, src, reach_px=reach_px)
    similarity = np.einsum("pk,pk->p", ref.descriptor[row], src.descriptor[column])
    best = _is_best(similarity, row, src.xy_px[column]) & _is_best(similarity, column, ref.xy_px[row])
    pairs = np.unique(np.hstack([ref.xy_px[row[best]], src.xy_px[column[best]]]), axis=0)
    return Matches(pairs[:, :2], pairs[:, 2:])


def _candidates(
    ref: Features, src: Features, *, reach_px: tuple[float, float]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Index pairs of points within reach that agree in angle and size: a box search, the angle being periodic."""
    trees = []
    for view in (ref, src):
        log_size = np.log(np.maximum(view.size_px, 1e-3)) / np.log(_MAX_SCALE_RATIO)
        turn = np.mod(view.angle_deg, 360.0) / _MAX_ANGLE_DEG
        box = np.column_stack([view.xy_px / np.asarray(reach_px), log_size, turn])
        trees.append(cKDTree(box, boxsize=(0, 0, 0, 360.0 / _MAX_ANGLE_DEG)))
    near = trees[1].query_ball_point(trees[0].data, r=1.0, p=np.inf) if min(len(t.data) for t in trees) else []
    counts = np.array([len(columns) for columns in near], dtype=np.intp)
    column = np.fromiter(itertools.chain.from_iterable(near), dtype=np.intp, count=int(counts.sum()))
    return np.repeat(np.arange(len(counts)), counts), column


def _is_best(similarity: NDArray[np.float32], group: NDArray[np.intp], xy_px: FloatArray) -> BoolArray:
    """Mask of the pairs that are the best of their group and pass Lowe's ratio test against the best point elsewhere.

    Unit vectors: squared distance = 2 - 2 similarity.
    """
    if len(group) == 0:
        return np.zeros(0, dtype=bool)
    order = np.lexsort((-similarity, group))
    leads = np.flatnonzero(np.diff(group[order], prepend=-1))
    leader = np.empty(group.max() + 1, dtype=np.intp)
    leader[group[order[leads]]] = order[leads]
    first = leader[group]
    elsewhere = np.abs(xy_px - xy_px[first]).max(axis=1) > _SAME_POINT_PX
    second = np.full(group.max() + 1, -1.0, dtype=similarity.dtype)
    np.maximum.at(second, group[elsewhere], similarity[elsewhere])
    is_first = first == np.arange(len(group))
    return np.asarray(is_first & ((1.0 - similarity) <= _RATIO**2 * (1.0 - second[group])))


def align_matches(ref_HW: FloatImage, src_HW: FloatImage, matches: Matches) -> Matches:
    """Move src points to the best fit of the small patch around them; drop those that wander or do not fit.

    Gauss-Newton on the shift between patches of zero mean and unit norm (Lucas and Kanade 1981).

    Args:
        ref_HW: (H, W) grey view.
        src_HW: (H', W') grey view, as sharp as ref.
        matches: N matches, right to a few px.
    """
    if len(matches) == 0:
        return matches
    patch = np.arange(-_PATCH_RADIUS_PX, _PATCH_RADIUS_PX + 1, dtype=np.float32)
    window_x, window_y = np.meshgrid(patch, patch)
    weight = np.exp(-(window_x**2 + window_y**2) / (2 * (0.6 * _PATCH_RADIUS_PX) ** 2)).ravel()
    weight /= weight.sum()
    offsets = np.column_stack([window_x.ravel(), window_y.ravel()])
    template, _ = _normalised(_sample(ref_HW, matches.ref_px, offsets), weight)
    gradients = [np.asarray(cv2.Sobel(src_HW, cv2.CV_32F, *dxdy, scale=1 / 8), np.float32) for dxdy in ((1, 0), (0, 1))]
    moved = matches.src_px.copy()
    for _ in range(_ALIGN_STEPS):
        values, norm = _normalised(_sample(src_HW, moved, offsets), weight)
        slopes = np.stack([_sample(g, moved, offsets) for g in gradients], axis=2) / norm[:, None, None]
        slopes -= np.einsum("nkd,k->nd", slopes, weight)[:, None]
        slopes -= np.einsum("nkd,nk,k->nd", slopes, values, weight)[:, None] * values[:, :, None]
        normal = np.einsum("nkd,nke,k->nde", slopes, slopes, weight) + 1e-6 * np.eye(2)
        right = np.einsum("nkd,nk,k->nd", slopes, template - values, weight)
        moved += np.clip(np.linalg.solve(normal, right[:, :, None])[:, :, 0], -1.0, 1.0)
    values, _ = _normalised(_sample(src_HW, moved, offsets), weight)
    fits = np.einsum("nk,nk,k->n", template, values, weight) >= _MIN_CORRELATION
    stays = np.abs(moved - matches.src_px).max(axis=1) <= _MAX_MOVE_PX
    aligned = Matches(matches.ref_px, moved)
    return aligned.select(fits & stays & _is_whole(aligned.ref_px, ref_HW) & _is_whole(moved, src_HW))


def _is_whole(centre_px: FloatArray, image_HW: FloatImage) -> BoolArray:
    """Whether all but the rim of the patches lies inside the image: beyond it pixels are made up."""
    margin = _PATCH_RADIUS_PX // 2
    last = np.array([image_HW.shape[1] - 1 - margin, image_HW.shape[0] - 1 - margin])
    return np.asarray(((centre_px >= margin) & (centre_px <= last)).all(axis=1))


def _sample(image_HW: FloatImage, centre_px: FloatArray, offsets: NDArray[np.float32]) -> NDArray[np.float64]:
    """(N, K) values at K offsets about N points, bilinear, the border repeated."""
    at = (centre_px[:, None, :] + offsets[None, :, :]).astype(np.float32)
    values = cv2.remap(image_HW, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float64)


def _normalised(
    patches: NDArray[np.float64], weight: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Patches of weighted mean 0 and norm 1, and the (N,) norms."""
    centred = patches - (patches @ weight)[:, None]
    norm = np.sqrt(np.maximum((centred**2) @ weight, 1e-10))
    return centred / norm[:, None], norm


def _vertical_residual_px(matches: Matches) -> NDArray[np.float64]:
    """Distance of every vertical misfit from the linear law most matches follow (RANSAC, then least squares)."""
    design = np.column_stack([np.ones(len(matches)), matches.src_px[:, 0], matches.ref_px[:, 1]])
    design[:, 1:] -= design[:, 1:].mean(axis=0)
    vertical = matches.vertical_px
    rng = np.random.default_rng(0)
    samples = rng.integers(0, len(matches), size=(400, 3))
    laws = np.einsum("skl,sl->sk", np.linalg.pinv(design[samples]), vertical[samples])
    # a shift alone is tried too: with few matches in one corner a tilt follows the noise
    laws = np.vstack([laws, np.column_stack([vertical[samples[:, 0]], np.zeros((len(samples), 2))])])
    laws = laws[np.abs(laws[:, 1:]).max(axis=1) < 0.06]
    residual = vertical[None, :] - laws @ design.T
    law = laws[(np.abs(residual) <= VERTICAL_TOLERANCE_PX[1]).sum(axis=1).argmax()]
    for _ in range(3):
        inlier = np.abs(vertical - design @ law) <= VERTICAL_TOLERANCE_PX[1]
        if inlier.sum() < 8:
            break
        law = np.linalg.lstsq(design[inlier], vertical[inlier], rcond=None)[0]
    return np.asarray(vertical - design @ law)


def neighbour_support(xy_px: FloatArray, value_px: FloatArray, *, supporters: int) -> BoolArray:
    """Tell which points agree with enough of their twelve nearest, within 1 px and 8 % of the distance.

    Args:
        xy_px: (N, 2) where the points lie.
        value_px: (N,) or (N, K) what is compared.
        supporters: how many neighbours have to agree.
    """
    n_neighbours = min(_NEIGHBOURS, len(xy_px) - 1)
    if n_neighbours < supporters:
        return np.zeros(len(xy_px), dtype=bool)
    distance_px, index = cKDTree(xy_px).query(xy_px, k=n_neighbours + 1)
    values = value_px.reshape(len(xy_px), -1)
    difference_px = np.abs(values[index[:, 1:]] - values[:, None]).max(axis=2)
    agrees = difference_px <= 1.0 + 0.08 * np.minimum(distance_px[:, 1:], 50.0)
    return np.asarray(agrees.sum(axis=1) >= supporters)
