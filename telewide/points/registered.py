"""Regions both views see whole: small patches of ref, each with the plane that carries it into src.

Between matches that agree, surfaces are taken to be smooth: the triangles of a Delaunay triangulation whose corners
differ little in disparity. A patch is kept where triangles cover it and one affine map explains them; across a jump in
depth, where one view sees what the other does not, there is none.
Convention: ``p_src = A p_ref + t``; pixel (0, 0) is the centre of the top-left pixel.
Letters: N matches, S patches, R radius of a patch (its side is 2 R + 1 px).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from telewide.geometry.arrays import FloatArray, FloatImage
from telewide.points.matches import Matches

MAX_SPREAD_PX = 2.0
"""Triangles whose corners' shifts differ by more may hold a jump in depth."""
MAX_MISFIT_PX = 0.5
"""Largest distance of the triangles below a patch from its affine map."""
_MAX_EDGE_SHARE = 0.12
_PROBES = np.stack(np.meshgrid((-1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class Patches:
    """Square patches of ref and where src shows them.

    Attributes:
        centre_px: (S, 2) centres in ref.
        src_from_ref: (S, 2, 3) affine maps from pixels of ref to pixels of src.
        radius_px: R of all of them.
    """

    centre_px: FloatArray
    src_from_ref: NDArray[np.float64]
    radius_px: int

    def __len__(self) -> int:
        return len(self.centre_px)

    def select(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> Patches:
        """Return the patches a mask or a list of indices names."""
        return Patches(self.centre_px[keep], self.src_from_ref[keep], self.radius_px)

    @property
    def src_centre_px(self) -> FloatArray:
        """(S, 2) where src shows the centres."""
        return _mapped(self.src_from_ref, self.centre_px[:, None])[:, 0]


def find_patches(matches: Matches, *, centre_px: FloatArray, radius_px: int, hw: tuple[int, int]) -> Patches:
    """Keep those patches that lie inside both views and that matches show to be one smooth surface.

    Args:
        matches: N consistent matches.
        centre_px: (S', 2) centres to try, px of ref.
        radius_px: of the patches.
        hw: height and width of both views.

    Returns:
        The patches kept; none where the matches span no triangle.
    """
    centre_px = np.asarray(np.round(centre_px), dtype=np.float64).reshape(-1, 2)
    nothing = Patches(np.zeros((0, 2)), np.zeros((0, 2, 3)), radius_px)
    if len(matches) < 4 or not len(centre_px):
        return nothing
    try:
        mesh = Delaunay(matches.ref_px)
    except QhullError:  # all on one line
        return nothing
    probes_px = centre_px[:, None] + radius_px * _PROBES
    triangle = mesh.find_simplex(probes_px)
    is_smooth = _smooth_triangles(mesh.simplices, matches, max_edge_px=_MAX_EDGE_SHARE * hw[1])
    covered = ((triangle >= 0) & is_smooth[triangle]).all(axis=1)
    src_px = _interpolated(mesh, matches, triangle[covered], probes_px[covered])
    maps, misfit_px = _affine_fits(probes_px[covered], src_px)
    patches = Patches(centre_px[covered], maps, radius_px).select(misfit_px <= MAX_MISFIT_PX)
    return patches.select(_is_inside(patches, hw))


def shifted_patches(matches: Matches, *, radius_px: int, hw: tuple[int, int]) -> Patches:
    """Patches about the matches themselves, each moved as its match says; those that leave a view are left out.

    Args:
        matches: N matches.
        radius_px: of the patches.
        hw: height and width of both views.

    Returns:
        At most N patches.
    """
    centre_px = np.round(matches.ref_px)
    maps = np.tile(np.eye(2, 3), (len(matches), 1, 1))
    maps[:, :, 2] = matches.src_px - matches.ref_px
    patches = Patches(centre_px, maps, radius_px)
    return patches.select(_is_inside(patches, hw))


def cut_patches(ref: FloatImage, src: FloatImage, patches: Patches) -> tuple[FloatImage, FloatImage]:
    """Sample both views at the pixels of the patches, src by bicubic interpolation.

    Args:
        ref: (H, W) or (H, W, C).
        src: the same shape.
        patches: S patches.

    Returns:
        Two arrays (S, 2 R + 1, 2 R + 1) or (S, 2 R + 1, 2 R + 1, C), float32.
    """
    side = 2 * patches.radius_px + 1
    shape = (len(patches), side, side, *ref.shape[2:])
    if not len(patches):
        return np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    reach = np.arange(-patches.radius_px, patches.radius_px + 1)
    offsets = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
    at_px = patches.centre_px[:, None] + offsets
    index = at_px.astype(np.intp)
    from_px = _mapped(patches.src_from_ref, at_px).astype(np.float32)
    # one column of 32767 px is all that remap takes: a patch a row
    sampled = [
        cv2.remap(src, part[..., 0], part[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        for part in np.array_split(from_px, max(1, len(patches) // 8192))
    ]
    return ref[index[..., 1], index[..., 0]].reshape(shape), np.concatenate(sampled).reshape(shape)


def _smooth_triangles(corners: NDArray[np.intp], matches: Matches, *, max_edge_px: float) -> NDArray[np.bool_]:
    """Mask of the triangles that are small and flat enough to hold no jump."""
    shift_px = (matches.ref_px - matches.src_px)[corners]
    spread_px = np.ptp(shift_px, axis=1).max(axis=1)
    edge_px = np.linalg.norm(matches.ref_px[corners] - matches.ref_px[np.roll(corners, 1, axis=1)], axis=2).max(axis=1)
    return np.asarray((spread_px <= MAX_SPREAD_PX) & (edge_px <= max_edge_px))


def _interpolated(mesh: Delaunay, matches: Matches, triangle: NDArray[np.intp], points_px: FloatArray) -> FloatArray:
    """Points of ref carried into src by their triangles; all of (..., 2)."""
    transform = mesh.transform[triangle]
    two = np.einsum("...ij,...j->...i", transform[..., :2, :], points_px - transform[..., 2, :])
    weights = np.concatenate([two, 1.0 - two.sum(axis=-1, keepdims=True)], axis=-1)
    corners = matches.src_px[mesh.simplices[triangle]]
    return np.asarray(np.einsum("...k,...kx->...x", weights, corners))


def _affine_fits(ref_px: FloatArray, src_px: FloatArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least-squares affine maps (S, 2, 3) of (S, P, 2) points, and the largest misfit (S,) of each."""
    centre = ref_px.mean(axis=1, keepdims=True)
    offsets = (ref_px - centre)[0] if len(ref_px) else np.zeros((len(_PROBES), 2))
    inverse = np.linalg.pinv(np.column_stack([offsets, np.ones(len(offsets))]))
    local = np.einsum("kp,spx->sxk", inverse, src_px)
    shift = local[:, :, 2] - np.einsum("sxk,sk->sx", local[:, :, :2], centre[:, 0])
    maps = np.concatenate([local[:, :, :2], shift[:, :, None]], axis=2)
    misfit_px = np.linalg.norm(_mapped(maps, ref_px) - src_px, axis=2).max(axis=1, initial=0.0)
    return maps, misfit_px


def _mapped(maps: NDArray[np.float64], points_px: FloatArray) -> FloatArray:
    """(S, P, 2) points through (S, 2, 3) maps."""
    return np.asarray(np.einsum("sxk,spk->spx", maps[:, :, :2], points_px) + maps[:, None, :, 2])


def _is_inside(patches: Patches, hw: tuple[int, int]) -> NDArray[np.bool_]:
    probes_px = patches.centre_px[:, None] + patches.radius_px * _PROBES
    both_px = np.concatenate([probes_px, _mapped(patches.src_from_ref, probes_px)], axis=1)
    last = np.array([hw[1] - 1, hw[0] - 1])
    return np.asarray(((both_px >= 0) & (both_px <= last)).all(axis=(1, 2)))
