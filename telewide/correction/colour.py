"""Colour of one shot: what carries src's colours to ref's, and how far apart they are to the eye.

Two cameras expose, balance and shade a scene each in its own way, differently in every shot. Colours are compared as
means of linear light over small patches that both views see whole, wide enough that sharpness plays little part;
clipped pixels take no part. Gains per channel come first; a matrix or a root-polynomial, lens shading and a tone curve
are added only where they lower the error at patches they were not fitted to.
Images are sRGB-encoded in [0, 1]; differences are CIE DeltaE 2000 under D65. Letters: N matches, S samples, H W image.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from telewide.correction.colour_model import (
    IDENTITY,
    ColourModel,
    fit_model,
    places_of,
    robust_gains,
    transform_colours,
    transform_image,
)
from telewide.geometry.arrays import FloatArray, FloatImage
from telewide.points.matches import Matches
from telewide.points.registered import Patches, cut_patches, find_patches, shifted_patches
from telewide.srgb import linear_from_srgb, srgb_from_linear

MIN_SAMPLES = 12
"""Fewer matched points than this leave the colours alone."""
MIN_CHANGE_DELTA_E = 0.5
"""A change that moves the colours by less on average is not made: no eye sees it."""
CLIPPED_FROM = 0.98
"""A pixel with a channel above this in either view is not fitted: its light was more than the view can say."""
_MIN_CHOICE_SAMPLES = 40
_MAX_SAMPLES = 800
_FOLDS = 3
_BLOCKS_PER_WIDTH = 10
_SIGMA_PER_HEIGHT = 0.00625
_LEAST_SIGMA_PX = 3.0
_LEAST_UNCLIPPED = 0.9


@dataclass(frozen=True)
class ColourFit:
    """Fit that makes src's colours ref's, and its worth.

    Attributes:
        model: what is applied.
        parts: what it has besides gains: ``matrix`` or ``rootpoly``, ``shading``, ``tone``.
        delta_before: mean DeltaE 2000 at matches held out, before; NaN without matches.
        delta_after: the same after.
        n: number of patches it was fitted to.
        n_judged: number of patches the two differences are means of.
    """

    model: ColourModel
    parts: tuple[str, ...]
    delta_before: float
    delta_after: float
    n: int
    n_judged: int

    @property
    def is_identity(self) -> bool:
        """Whether the colours are left alone."""
        return self.model.is_identity


@dataclass(frozen=True)
class ColourSamples:
    """Mean colours of patches.

    Attributes:
        ref_light: (S, 3) linear light of ref.
        src_light: (S, 3) linear light of src.
        src_place: (S, 2) place in src, from -1 to 1 along the longer side.
    """

    ref_light: FloatArray
    src_light: FloatArray
    src_place: FloatArray

    def __len__(self) -> int:
        return len(self.ref_light)

    def select(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> ColourSamples:
        """Return the samples a mask or a list of indices names."""
        return ColourSamples(self.ref_light[keep], self.src_light[keep], self.src_place[keep])


def fit_colour(ref: FloatImage, src: FloatImage, matches: Matches, *, held_out: Matches | None = None) -> ColourFit:
    """Find what carries src's colours to ref's.

    Gains per channel; then, each where it lowers the cross-validated DeltaE by more than its own uncertainty, a 3x3
    matrix or a root-polynomial in linear light, lens shading, a tone curve. A change below 0.5 DeltaE, or one that does
    not lessen the difference by a tenth, is not made.

    Args:
        ref: (H, W, 3) RGB in [0, 1].
        src: (H, W, 3), the same shape.
        matches: N matches of the two, to fit to.
        held_out: matches to judge by, seen by no fit and no choice; None judges by cross-validation.

    Returns:
        The fit; the identity for fewer than 12 matches.
    """
    samples = registered_colours(ref, src, matches)
    judged = None if held_out is None else matched_colours(ref, src, held_out)
    if min(len(matches), len(samples)) < MIN_SAMPLES:
        return _judged(_Choice(IDENTITY, (), _deltas(samples, IDENTITY)), samples, judged)
    choice = _chosen(samples)
    change = delta_e(_transformed(samples, IDENTITY), _transformed(samples, choice.model))
    before = _deltas(samples, IDENTITY)
    if change.mean() < MIN_CHANGE_DELTA_E or choice.deltas.mean() > 0.9 * before.mean():
        choice = _Choice(IDENTITY, (), before)
    return _judged(choice, samples, judged)


def apply_colour(src: FloatImage, fit: ColourFit) -> FloatImage:
    """Carry src's colours to ref's.

    Args:
        src: (H, W, 3) RGB in [0, 1].
        fit: what :func:`fit_colour` found.

    Returns:
        The same shape, float32 in [0, 1]; src itself where the fit is the identity.
    """
    return transform_image(src, fit.model)


def registered_colours(ref: FloatImage, src: FloatImage, matches: Matches) -> ColourSamples:
    """Colours of patches spread over the regions that both views see whole; about the matches where there are few.

    Args:
        ref: (H, W, 3) RGB in [0, 1].
        src: the same shape.
        matches: N matches.

    Returns:
        At most 800 samples.
    """
    hw = (ref.shape[0], ref.shape[1])
    sigma_px, radius_px = _patch_size(hw)
    step = 2 * radius_px + 2
    grid = np.stack(np.meshgrid(np.arange(radius_px, hw[1], step), np.arange(radius_px, hw[0], step)), axis=-1)
    centres_px = np.vstack([matches.ref_px, grid.reshape(-1, 2)])
    patches = find_patches(matches, centre_px=centres_px, radius_px=radius_px, hw=hw)
    if len(patches) < _MIN_CHOICE_SAMPLES:
        patches = shifted_patches(matches, radius_px=radius_px, hw=hw)
    if len(patches) > _MAX_SAMPLES:
        patches = patches.select(np.linspace(0, len(patches) - 1, _MAX_SAMPLES).astype(np.intp))
    return _patch_colours(ref, src, patches, sigma_px=sigma_px)


def matched_colours(ref: FloatImage, src: FloatImage, matches: Matches) -> ColourSamples:
    """Colours of the patches about matches: what a fit is judged by.

    Args:
        ref: (H, W, 3) RGB in [0, 1].
        src: the same shape.
        matches: N matches.

    Returns:
        At most N samples.
    """
    hw = (ref.shape[0], ref.shape[1])
    sigma_px, radius_px = _patch_size(hw)
    return _patch_colours(ref, src, shifted_patches(matches, radius_px=radius_px, hw=hw), sigma_px=sigma_px)


def delta_e(first: FloatArray, second: FloatArray) -> FloatArray:
    """Colour differences CIE DeltaE 2000 (CIE 142-2001) of sRGB-encoded colours.

    Args:
        first: (S, 3).
        second: (S, 3).

    Returns:
        (S,); about 1 is just visible side by side.
    """
    if not len(first):
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it speaks of plotting parts that are not installed
        import colour
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    to_xyz = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
    light = (linear_from_srgb(np.clip(values, 0.0, 1.0)) for values in (first, second))
    labs = [colour.XYZ_to_Lab(values @ to_xyz.T, white) for values in light]
    return np.asarray(colour.difference.delta_E_CIE2000(labs[0], labs[1]), dtype=np.float64)


def light_ratio(ref: FloatImage, src: FloatImage, matches: Matches) -> tuple[float, float, float]:
    """Ratio of the light of ref over that of src at matches, clipped patches left out; a stop is a factor of two.

    Args:
        ref: (H, W, 3) RGB in [0, 1].
        src: the same shape.
        matches: N matches.

    Returns:
        Ratios of the means of linear light of red, green and blue; NaN without a patch to compare.
    """
    samples = matched_colours(ref, src, matches)
    if len(samples) == 0:
        return (float("nan"),) * 3
    red, green, blue = samples.ref_light.mean(axis=0) / np.maximum(samples.src_light.mean(axis=0), 1e-6)
    return float(red), float(green), float(blue)


@dataclass(frozen=True)
class _Choice:
    """A model, its parts, and what it leaves of the difference at samples that it was not fitted to."""

    model: ColourModel
    parts: tuple[str, ...]
    deltas: FloatArray


def _judged(choice: _Choice, samples: ColourSamples, judged: ColourSamples | None) -> ColourFit:
    """The fit with its quality, at the held-out samples where there are enough."""
    if judged is None or len(judged) < MIN_SAMPLES:
        before, after, n_judged = _deltas(samples, IDENTITY), choice.deltas, len(samples)
    else:
        before, after, n_judged = _deltas(judged, IDENTITY), _deltas(judged, choice.model), len(judged)
    means = [float(deltas.mean()) if len(deltas) else float("nan") for deltas in (before, after)]
    return ColourFit(
        model=choice.model,
        parts=choice.parts,
        delta_before=means[0],
        delta_after=means[1],
        n=len(samples),
        n_judged=n_judged,
    )


def _chosen(samples: ColourSamples) -> _Choice:
    """The richest model whose every part lowers the error at samples held out."""
    fold = _folds(samples.src_place)
    best: tuple[tuple[str, ...], FloatArray] = ((), _cross_validated(samples, (), fold))
    if len(samples) >= _MIN_CHOICE_SAMPLES:
        for name in ("matrix", "rootpoly"):
            best = _better(samples, best, (name,), fold)
        mixing = best[0]
        for more in (("shading",), ("tone",), ("shading", "tone")):
            best = _better(samples, best, (*mixing, *more), fold)
        for name in ("matrix", "rootpoly"):
            # a mixing that gained nothing under a wrong curve may gain now
            curves = tuple(part for part in best[0] if part in ("shading", "tone"))
            best = _better(samples, best, (name, *curves), fold)
    return _Choice(_fitted(samples, best[0]), *best)


def _better(
    samples: ColourSamples, best: tuple[tuple[str, ...], FloatArray], parts: tuple[str, ...], fold: NDArray[np.intp]
) -> tuple[tuple[str, ...], FloatArray]:
    """Of the best so far and a candidate the one to keep: a candidate must win by a standard error."""
    if parts == best[0]:
        return best
    deltas = _cross_validated(samples, parts, fold)
    gained = best[1] - deltas
    # neighbouring patches share what they show: count a quarter of them
    error = 2.0 * float(gained.std()) / np.sqrt(len(gained))
    return (parts, deltas) if gained.mean() > max(error, 0.01) else best


def _cross_validated(samples: ColourSamples, parts: tuple[str, ...], fold: NDArray[np.intp]) -> FloatArray:
    """(S,) DeltaE of every sample under the model fitted to the folds it is not in."""
    values = np.empty_like(samples.src_light)
    for number in range(_FOLDS):
        is_out = fold == number
        model = _fitted(samples.select(~is_out), parts) if (~is_out).sum() >= MIN_SAMPLES // 2 else IDENTITY
        values[is_out] = _transformed(samples.select(is_out), model)
    return delta_e(srgb_from_linear(samples.ref_light), values)


def _fitted(samples: ColourSamples, parts: tuple[str, ...]) -> ColourModel:
    return fit_model(
        samples.src_light,
        srgb_from_linear(samples.ref_light),
        place=samples.src_place,
        parts=parts,
        start=robust_gains(samples.src_light, samples.ref_light),
    )


def _transformed(samples: ColourSamples, model: ColourModel) -> FloatArray:
    return transform_colours(samples.src_light, model, place=samples.src_place)


def _deltas(samples: ColourSamples, model: ColourModel) -> FloatArray:
    return delta_e(srgb_from_linear(samples.ref_light), _transformed(samples, model))


def _folds(place: FloatArray) -> NDArray[np.intp]:
    """(S,) number of the fold, the same for a whole block of the image: neighbours do not judge each other."""
    block = np.floor((place + 1.0) * (_BLOCKS_PER_WIDTH / 2)).astype(np.intp)
    return np.asarray((block[:, 0] + 2 * block[:, 1] + block[:, 0] // _FOLDS) % _FOLDS)


def _patch_size(hw: tuple[int, int]) -> tuple[float, int]:
    """Width of the Gaussian that weighs a patch, and the patch's radius, px."""
    sigma_px = max(_LEAST_SIGMA_PX, _SIGMA_PER_HEIGHT * hw[0])
    return sigma_px, round(2 * sigma_px)


def _patch_colours(ref_srgb: FloatImage, src_srgb: FloatImage, patches: Patches, *, sigma_px: float) -> ColourSamples:
    """Gaussian means of linear light; patches that are largely clipped are left out."""
    ref_cut, src_cut = cut_patches(ref_srgb, src_srgb, patches)
    reach = np.arange(-patches.radius_px, patches.radius_px + 1) / sigma_px
    bell = np.exp(-0.5 * (reach[:, None] ** 2 + reach[None, :] ** 2))
    weight = bell * (np.maximum(ref_cut.max(axis=3), src_cut.max(axis=3)) < CLIPPED_FROM)
    total = weight.sum(axis=(1, 2))
    is_used = total >= _LEAST_UNCLIPPED * bell.sum()
    weight = (weight[is_used] / total[is_used, None, None]).reshape(-1, 1, bell.size)
    means = [
        (weight @ linear_from_srgb(cut[is_used]).reshape(-1, bell.size, 3))[:, 0].astype(np.float64)
        for cut in (ref_cut, src_cut)
    ]
    place = places_of(patches.select(is_used).src_centre_px, hw=(ref_srgb.shape[0], ref_srgb.shape[1]))
    return ColourSamples(means[0], means[1], place)
