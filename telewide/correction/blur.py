"""The blur that turns tele into wide: a Gaussian kernel measured on the registered pair.

In windows that both views see whole, ``SRC(f) = K(f) REF(f)`` with ``K(f) = exp(-2 pi^2 f' C f)``: C is the covariance
of the kernel, px^2, round or elongated. Least squares over f is, by Parseval, least squares of the blurred tele against
wide. Each window is first shifted to the sub-pixel, lest rests of the registration pass for blur; noise of wide, which
ref knows nothing of, averages out. There is no free gain: a flat-topped kernel would hide a part of its width in it.
Lengths are px of the registered views; angles run from x towards y. Letters: S windows, F frequencies, n side of a
window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from telewide.geometry.arrays import FloatArray, FloatImage
from telewide.points.bandwidth import SIGMA_PER_FACTOR_PX
from telewide.points.matches import Matches
from telewide.points.registered import Patches, cut_patches, find_patches
from telewide.records import Figure
from telewide.srgb import grey

Spectra = NDArray[np.complex64]

MIN_WINDOWS = 6
"""Fewer windows than this do not tell a kernel."""
LARGEST_SIGMA_PX = 8.0
_RADII_PX = (24, 16)
_MAX_WINDOWS = 160
_ALIGN_STEPS = 3
_ALIGN_BELOW_CYCLES = 0.2
_LARGEST_SHIFT_PX = 1.5
_LEAST_CYCLES = 1.5
_WORST_WINDOW = 1.5
_GROUPS = 6
_ELONGATION_WORTH = 1.08
_LEAST_ELONGATED_PX = 0.5
_DOUBTFUL_RESIDUAL = 0.45
"""A kernel that leaves more of src has met depth, not blur; it counts only where there is no better one."""


@dataclass(frozen=True)
class BlurEstimate:
    """The kernel between two registered views.

    Attributes:
        sigma_px: standard deviations along its major and its minor axis; equal for a round one, 0 for no blur.
        angle_rad: direction of the major axis, from x towards y, in [0, pi).
        sigma_std_px: standard deviation of the two, from parts of the image; NaN where there are too few.
        residual: what the blurred ref leaves of src, as a share of src's contrast.
        n: number of windows.
    """

    sigma_px: tuple[float, float]
    angle_rad: float
    sigma_std_px: tuple[Figure, Figure]
    residual: Figure
    n: int

    @property
    def mean_sigma_px(self) -> float:
        """Width of the round kernel of equal area."""
        return float(np.sqrt(self.sigma_px[0] * self.sigma_px[1]))

    @property
    def factor(self) -> float:
        """Factor by which fewer pixels, enlarged again, blur as much; 1 or more."""
        return factor_from_sigma(self.mean_sigma_px)


@dataclass(frozen=True)
class DamageRange:
    """Range of what a rehearsal may do to a sharp view so that it looks like the measured ones.

    Attributes:
        factor: least and largest factor of fewer pixels.
        blur_sigma_px: least and largest width of a Gaussian blur before them, px of the sharp view.
    """

    factor: tuple[float, float]
    blur_sigma_px: tuple[float, float]


def fit_blur(ref: FloatImage, src: FloatImage, matches: Matches) -> BlurEstimate | None:
    """Fit the kernel that turns ref into src.

    Least squares over frequencies, first a round kernel, then an elongated one where that explains windows it was not
    fitted to better.

    Args:
        ref: (H, W, 3) or (H, W) in [0, 1], the sharper view.
        src: the same shape, its colours already brought to ref's.
        matches: N matches of the two.

    Returns:
        The kernel; None where fewer than 6 windows are covered by matches.
    """
    windows = _windows(grey(ref), grey(src), matches)
    if windows is None:
        return None
    kept = windows
    for _ in range(2):
        law = _fitted(kept, is_round=True)
        left = _window_residuals(windows, law)
        kept = windows.select(left <= _WORST_WINDOW * np.median(left))
    law = _fitted(kept, is_round=not _is_elongated(kept))
    sigma_px, angle_rad = _axes(law)
    residual = float(np.sqrt(np.mean(_window_residuals(kept, law))))
    return BlurEstimate(
        sigma_px=sigma_px, angle_rad=angle_rad, sigma_std_px=_spread(kept, law), residual=residual, n=len(kept)
    )


def sigma_from_factor(factor: float) -> float:
    """Width of the Gaussian that halves the amplitude where a view shrunk and enlarged by a factor does, px."""
    return float(SIGMA_PER_FACTOR_PX * factor) if factor > 1.0 else 0.0


def factor_from_sigma(sigma_px: float) -> float:
    """Inverse of :func:`sigma_from_factor`, 1 at least."""
    return max(1.0, float(sigma_px / SIGMA_PER_FACTOR_PX))


def damage_range(
    estimates: Sequence[BlurEstimate], *, asymmetry: float | None = None, margin: float = 0.15
) -> DamageRange | None:
    """Say how strongly a rehearsal should damage the sharp view, from what was measured on the pairs.

    Without a known asymmetry all of the blur is put down to fewer pixels. With one, the pixels are known, and what the
    blur exceeds them by, in variance, is put down to the lens.

    Args:
        estimates: of the pairs of one set; those that explain little count only where there is no better one.
        asymmetry: ``f_tele_px / f_wide_px``, where it is known.
        margin: share by which the range is widened at either end.

    Returns:
        The range; None without estimates.
    """
    if not estimates:
        return None
    telling = [estimate for estimate in estimates if estimate.residual <= _DOUBTFUL_RESIDUAL] or list(estimates)
    sigma_px = np.array([estimate.mean_sigma_px for estimate in telling])
    low_px, high_px = np.percentile(sigma_px, (5, 95))
    low_px, high_px = low_px * (1.0 - margin), high_px * (1.0 + margin)
    largest = factor_from_sigma(high_px)
    if asymmetry is None:
        return DamageRange((factor_from_sigma(low_px), largest), (0.0, 0.0))
    pixels = float(np.clip(asymmetry, 1.0, largest))
    own_px = sigma_from_factor(pixels)
    lens_px = [float(np.sqrt(max(0.0, width_px**2 - own_px**2))) for width_px in (low_px, high_px)]
    least = min(pixels, factor_from_sigma(low_px))
    return DamageRange((max(1.0, least), pixels), (lens_px[0], lens_px[1]))


@dataclass(frozen=True)
class _Windows:
    """Spectra of S windows at the F frequencies of half a plane, aligned, each divided by ref's contrast."""

    ref: Spectra
    src: Spectra
    cycles: FloatArray

    def select(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> _Windows:
        return replace(self, ref=self.ref[keep], src=self.src[keep])

    def __len__(self) -> int:
        return len(self.ref)


def _windows(ref_HW: FloatImage, src_HW: FloatImage, matches: Matches) -> _Windows | None:
    for radius_px in _RADII_PX:
        patches = _window_patches(matches, hw=ref_HW.shape, radius_px=radius_px)
        if len(patches) >= (MIN_WINDOWS if radius_px == _RADII_PX[-1] else 2 * MIN_WINDOWS):
            ref, src = cut_patches(ref_HW, src_HW, patches)
            return _aligned(_spectra(ref), _spectra(src), _frequencies(ref.shape[1]))
    return None


def _window_patches(matches: Matches, *, hw: tuple[int, ...], radius_px: int) -> Patches:
    step = radius_px
    x, y = (np.arange(radius_px, size - radius_px, step) for size in (hw[1], hw[0]))
    centre_px = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(np.float64)
    patches = find_patches(matches, centre_px=centre_px, radius_px=radius_px, hw=(hw[0], hw[1]))
    if len(patches) > _MAX_WINDOWS:
        patches = patches.select(np.linspace(0, len(patches) - 1, _MAX_WINDOWS).astype(np.intp))
    return patches


def _spectra(patches: FloatImage) -> Spectra:
    side = patches.shape[1]
    bell = np.sqrt(np.hanning(side + 2)[1:-1]).astype(np.float32)
    weight = np.outer(bell, bell)
    mean = (patches * weight).sum(axis=(1, 2), keepdims=True) / weight.sum()
    return np.asarray(np.fft.rfft2((patches - mean) * weight).reshape(len(patches), -1), dtype=np.complex64)


def _frequencies(side: int) -> FloatArray:
    """(F, 2) cycles per px along x and y, in the order of the spectra."""
    y, x = np.meshgrid(np.fft.fftfreq(side), np.fft.rfftfreq(side), indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()])


def _aligned(ref: Spectra, src: Spectra, cycles: FloatArray) -> _Windows:
    """Shift every window of src onto ref by the slope of the phase at low frequencies."""
    radius = np.hypot(*cycles.T)
    is_low = (radius > 0) & (radius < _ALIGN_BELOW_CYCLES)
    low, low_cycles = (ref[:, is_low], src[:, is_low]), 2 * np.pi * cycles[is_low]
    shift_px = np.zeros((len(ref), 2))
    for _ in range(_ALIGN_STEPS):
        cross = np.conj(low[0]) * low[1] * np.exp(1j * (shift_px @ low_cycles.T))
        weight = np.abs(cross)
        phase = np.where(np.abs(np.angle(cross)) < np.pi / 2, np.angle(cross), 0.0)
        normal = np.einsum("sf,fi,fj->sij", weight, low_cycles, low_cycles) + 1e-12 * np.eye(2)
        shift_px -= np.linalg.solve(normal, np.einsum("sf,fi->si", weight * phase, low_cycles)[..., None])[..., 0]
    contrast = np.sqrt(np.mean(np.abs(ref) ** 2, axis=1))
    is_used = (np.abs(shift_px).max(axis=1) < _LARGEST_SHIFT_PX) & (contrast > 1e-6)
    moved = src * np.exp(2j * np.pi * (shift_px @ cycles.T))
    scale = contrast[is_used, None]
    is_telling = radius > _LEAST_CYCLES / np.sqrt(len(cycles) * 2)
    return _Windows(
        (ref[is_used] / scale)[:, is_telling].astype(np.complex64),
        (moved[is_used] / scale)[:, is_telling].astype(np.complex64),
        cycles[is_telling],
    )


def _transfer(law: FloatArray, cycles: FloatArray) -> FloatArray:
    """``K(f)`` of a law (C_xx, C_xy, C_yy)."""
    x, y = cycles.T
    exponent = law[0] * x * x + 2 * law[1] * x * y + law[2] * y * y
    return np.asarray(np.exp(-2 * np.pi**2 * np.clip(exponent, -0.2, None)))


def _fitted(windows: _Windows, *, is_round: bool) -> FloatArray:
    """Law (C_xx, C_xy, C_yy), px^2, by least squares over frequencies, each weighed by ref's amplitude there."""
    ref_power = np.mean(np.abs(windows.ref) ** 2, axis=0).astype(np.float64)
    cross = np.mean((np.conj(windows.ref) * windows.src).real, axis=0).astype(np.float64)
    weight = np.sqrt(ref_power)
    weight /= np.sqrt(np.mean(weight**2))
    measured = cross / ref_power
    spread = np.array([[1.0], [0.0], [1.0]]) if is_round else np.eye(3)
    start = np.array([1.0]) if is_round else np.array([1.0, 0.0, 1.0])
    solved = least_squares(
        lambda p: weight * (_transfer(spread @ p, windows.cycles) - measured), start, loss="soft_l1", f_scale=0.1
    )
    return np.asarray(spread @ solved.x)


def _window_residuals(windows: _Windows, law: FloatArray) -> FloatArray:
    """(S,) share of src's power that the blurred ref does not explain."""
    left = windows.src - _transfer(law, windows.cycles) * windows.ref
    return np.asarray(np.sum(np.abs(left) ** 2, axis=1) / np.maximum(np.sum(np.abs(windows.src) ** 2, axis=1), 1e-12))


def _is_elongated(windows: _Windows) -> bool:
    """Whether an elongated kernel explains the windows it was not fitted to better, and is one."""
    if len(windows) < 2 * MIN_WINDOWS:
        return False
    odd = np.arange(len(windows)) % 2 == 1
    left = {True: 0.0, False: 0.0}
    for part in (odd, ~odd):
        for is_round in left:
            law = _fitted(windows.select(part), is_round=is_round)
            left[is_round] += float(_window_residuals(windows.select(~part), law).sum())
    (major, minor), _ = _axes(_fitted(windows, is_round=False))
    return left[False] < left[True] and major > max(_LEAST_ELONGATED_PX, _ELONGATION_WORTH * minor)


def _axes(law: FloatArray) -> tuple[tuple[float, float], float]:
    """Widths along the major and the minor axis, px, and the direction of the major one, rad."""
    variance, axes = np.linalg.eigh(np.array([[law[0], law[1]], [law[1], law[2]]]))
    minor, major = np.sqrt(np.clip(variance, 0.0, LARGEST_SIGMA_PX**2))
    if np.isclose(major, minor):
        return (float(major), float(major)), 0.0
    return (float(major), float(minor)), float(np.arctan2(axes[1, 1], axes[0, 1]) % np.pi)


def _spread(windows: _Windows, law: FloatArray) -> tuple[float, float]:
    """Standard deviations of the widths, by leaving out a group of neighbouring windows at a time."""
    if len(windows) < 2 * _GROUPS:
        return float("nan"), float("nan")
    is_round = law[0] == law[2] and law[1] == 0
    group = np.arange(len(windows)) * _GROUPS // len(windows)
    widths = [_axes(_fitted(windows.select(group != g), is_round=is_round))[0] for g in range(_GROUPS)]
    deviation = np.std(widths, axis=0) * np.sqrt(_GROUPS - 1)
    return float(deviation[0]), float(deviation[1])
