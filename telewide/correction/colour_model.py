"""Model of one camera's colours by another's: mixing in linear light, local brightness, and a curve on top.

``light = (mixing @ terms(src)) * exp(shading @ places(x, y))``, ``out = v + tone(v)``, ``v`` encoded light. The
terms are R G B, or with them the roots of their products (root-polynomial of degree 2, Finlayson, Mackiewicz and
Hurlbert 2015), which scale with exposure as light does. Lens shading is a polynomial of degree 2 of the place in src.
Values are sRGB-encoded in [0, 1] outside, linear light inside; data that is linear loses nothing by being encoded.
Letters: S samples, H W image, K terms (3 or 6), P parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatArray, FloatImage
from telewide.srgb import linear_from_srgb, srgb_from_linear, srgb_slope

N_PLACES = 5
N_TONE = 3
MAX_LOG_SHADING = 0.8
_STRIP_PX = 1 << 18


@dataclass(frozen=True)
class ColourModel:
    """Model that makes src's colours ref's.

    Attributes:
        mixing: (3, K) rows for R G B of ref, of the terms of src, in linear light.
        shading: (5,) of x, y, x^2, xy, y^2, in natural logarithms of light; zeros for none.
        tone: (3, 3) rows for R G B: offset, slope and curve added to the encoded value; zeros for none.
    """

    mixing: FloatArray
    shading: FloatArray
    tone: FloatArray

    @property
    def is_identity(self) -> bool:
        """Whether nothing is changed."""
        return bool(np.array_equal(self.mixing, np.eye(3))) and not self.has_shading and not self.has_tone

    @property
    def has_shading(self) -> bool:
        """Whether brightness varies over the image."""
        return bool(self.shading.any())

    @property
    def has_tone(self) -> bool:
        """Whether a curve follows."""
        return bool(self.tone.any())


IDENTITY = ColourModel(np.eye(3), np.zeros(N_PLACES), np.zeros((3, N_TONE)))


def transform_colours(light: FloatArray, model: ColourModel, *, place: FloatArray) -> FloatArray:
    """Apply a model to samples.

    Args:
        light: (S, 3) linear light of src.
        model: what to apply.
        place: (S, 2) place in src as :func:`places_of` gives it.

    Returns:
        (S, 3) sRGB-encoded, not clipped.
    """
    return _toned(srgb_from_linear(_shaded(light, model, place)), model.tone)


def transform_image(src_srgb: FloatImage, model: ColourModel) -> FloatImage:
    """Apply a model to an image, in strips.

    Args:
        src_srgb: (H, W, 3) in [0, 1].
        model: what to apply.

    Returns:
        (H, W, 3) float32 sRGB in [0, 1]; the same array where the model is the identity.
    """
    if model.is_identity:
        return src_srgb
    height, width = src_srgb.shape[:2]
    out = np.empty_like(src_srgb, dtype=np.float32)
    x = _axis_place(np.arange(width), width, height)
    step = max(1, _STRIP_PX // width)
    for top in range(0, height, step):
        rows = slice(top, min(top + step, height))
        light = _mixed_image(linear_from_srgb(src_srgb[rows]), model.mixing)
        if model.has_shading:
            y = _axis_place(np.arange(rows.start, rows.stop), height, width)
            light *= _shading_image(model.shading, x, y)[:, :, None]
        values = srgb_from_linear(light)
        if model.has_tone:
            offset, slope, curve = model.tone.T.astype(np.float32)
            values = values + (offset + (slope + curve * values) * values)
        np.clip(values, 0.0, 1.0, out=out[rows])
    return out


def fit_model(
    src_light: FloatArray,
    ref_encoded: FloatArray,
    *,
    place: FloatArray,
    parts: Sequence[str],
    start: FloatArray,
    iterations: int = 10,
) -> ColourModel:
    """Fit a model to samples: Gauss-Newton with Huber weights, on encoded values.

    Args:
        src_light: (S, 3) linear light of src.
        ref_encoded: (S, 3) sRGB-encoded values of ref.
        place: (S, 2) place in src.
        parts: what may differ from a gain per channel: any of ``matrix``, ``rootpoly``, ``shading``, ``tone``.
        start: (3,) gains to start from, to which few shades are drawn.
        iterations: steps taken.

    Returns:
        The model.
    """
    n_terms = 6 if "rootpoly" in parts else 3
    mixing = np.zeros((3, n_terms))
    mixing[:, :3] = np.diag(start)
    model = ColourModel(mixing, np.zeros(N_PLACES), np.zeros((3, N_TONE)))
    prior = _Prior.of(model, parts)
    for _ in range(iterations):
        values, jacobian = _linearised(src_light, model, place)
        residual = ref_encoded - values
        delta = np.clip(2.0 * np.median(np.abs(residual)), 0.004, 0.02)
        weight = 1.0 / np.maximum(np.abs(residual) / delta, 1.0)
        step = _solve(jacobian=jacobian, residual=residual, weight=weight, prior=prior, model=model)
        model = _moved(model, step)
        if np.abs(step).max() < 1e-5:
            break
    return model


def robust_gains(src_light: FloatArray, ref_light: FloatArray) -> FloatArray:
    """(3,) ratio ref to src of the median light of each channel, within [0.1, 10]."""
    ratio = np.median(ref_light, axis=0) / np.maximum(np.median(src_light, axis=0), 1e-5)
    return np.asarray(np.clip(ratio, 0.1, 10.0))


def places_of(points_px: FloatArray, *, hw: tuple[int, int]) -> FloatArray:
    """(S, 2) px of an image to places: 0 at its centre, 1 at the end of its longer side."""
    x = _axis_place(points_px[:, 0], hw[1], hw[0])
    return np.column_stack([x, _axis_place(points_px[:, 1], hw[0], hw[1])])


def colour_terms(light: FloatArray, *, n: int) -> FloatArray:
    """(S, n) R G B, and for n = 6 the roots of RG, GB, RB."""
    if n == 3:
        return light
    red, green, blue = np.maximum(light, 0.0).T
    return np.column_stack([light, np.sqrt(red * green), np.sqrt(green * blue), np.sqrt(red * blue)])


def place_terms(place: FloatArray) -> FloatArray:
    """(S, 5) x, y, x^2, xy, y^2."""
    x, y = place.T
    return np.column_stack([x, y, x * x, x * y, y * y])


@dataclass(frozen=True)
class _Prior:
    """Parameters that move, and how strongly the moved ones are drawn back, per sample and in encoded units."""

    is_free: NDArray[np.bool_]
    weight: FloatArray
    centre: FloatArray

    @staticmethod
    def of(model: ColourModel, parts: Sequence[str]) -> _Prior:
        n_terms = model.mixing.shape[1]
        is_mixed = np.eye(3, n_terms, dtype=bool)
        is_mixed |= "matrix" in parts or "rootpoly" in parts
        free = [is_mixed.ravel(), np.full(N_PLACES, "shading" in parts), np.full(3 * N_TONE, "tone" in parts)]
        weight = [np.full(is_mixed.size, 0.02**2), np.full(N_PLACES, 0.01**2), np.full(3 * N_TONE, 0.02**2)]
        return _Prior(np.concatenate(free), np.concatenate(weight), _vector(model))


def _vector(model: ColourModel) -> FloatArray:
    return np.concatenate([model.mixing.ravel(), model.shading, model.tone.ravel()])


def _moved(model: ColourModel, step: FloatArray) -> ColourModel:
    vector = _vector(model) + step
    n = model.mixing.size
    return replace(
        model,
        mixing=vector[:n].reshape(model.mixing.shape),
        shading=np.clip(vector[n : n + N_PLACES], -2.0, 2.0),
        tone=np.clip(vector[n + N_PLACES :].reshape(3, N_TONE), -0.6, 0.6),
    )


def _linearised(light: FloatArray, model: ColourModel, place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (S, 3) of a model and their derivatives (S, 3, P)."""
    n_terms = model.mixing.shape[1]
    terms, spots = colour_terms(light, n=n_terms), place_terms(place)
    gain = np.exp(np.clip(spots @ model.shading, -MAX_LOG_SHADING, MAX_LOG_SHADING))
    out_light = (terms @ model.mixing.T) * gain[:, None]
    values = srgb_from_linear(out_light)
    offset, slope, curve = model.tone.T
    bend = (1.0 + slope + 2.0 * curve * values) * srgb_slope(out_light)
    jacobian = np.zeros((len(light), 3, 3 * n_terms + N_PLACES + 3 * N_TONE))
    first_tone = 3 * n_terms + N_PLACES
    for c in range(3):
        jacobian[:, c, c * n_terms : (c + 1) * n_terms] = terms * (gain * bend[:, c])[:, None]
        jacobian[:, c, 3 * n_terms : first_tone] = spots * (out_light[:, c] * bend[:, c])[:, None]
        tone = slice(first_tone + c * N_TONE, first_tone + (c + 1) * N_TONE)
        jacobian[:, c, tone] = np.column_stack([np.ones(len(light)), values[:, c], values[:, c] ** 2])
    return values + offset + (slope + curve * values) * values, jacobian


def _solve(
    jacobian: FloatArray, residual: FloatArray, weight: FloatArray, prior: _Prior, model: ColourModel
) -> FloatArray:
    """The step of the free parameters; zero for the others."""
    rows = jacobian[:, :, prior.is_free].reshape(residual.size, -1)
    pull = len(residual) * prior.weight[prior.is_free]
    weighted = rows * weight.reshape(-1, 1)
    normal = rows.T @ weighted + np.diag(pull)
    back = pull * (prior.centre - _vector(model))[prior.is_free]
    step = np.zeros(prior.is_free.size)
    step[prior.is_free] = np.linalg.solve(normal, weighted.T @ residual.ravel() + back)
    return step


def _shaded(light: FloatArray, model: ColourModel, place: FloatArray) -> FloatArray:
    mixed = colour_terms(light, n=model.mixing.shape[1]) @ model.mixing.T
    log_gain = np.clip(place_terms(place) @ model.shading, -MAX_LOG_SHADING, MAX_LOG_SHADING)
    return np.asarray(mixed * np.exp(log_gain)[:, None])


def _toned(values: FloatArray, tone: FloatArray) -> FloatArray:
    offset, slope, curve = tone.T
    return np.asarray(values + offset + (slope + curve * values) * values)


def _axis_place(along_px: NDArray[np.float64] | NDArray[np.int64], own: int, other: int) -> FloatArray:
    return np.asarray((np.asarray(along_px, dtype=np.float64) - (own - 1) / 2) / (max(own, other) / 2))


def _mixed_image(light: FloatImage, mixing: FloatArray) -> FloatImage:
    matrix = mixing.astype(np.float32)
    mixed = np.asarray(cv2.transform(light, np.ascontiguousarray(matrix[:, :3])), dtype=np.float32)
    if matrix.shape[1] > 3:
        red, green, blue = (np.ascontiguousarray(light[..., c]) for c in range(3))
        roots = cv2.merge([cv2.sqrt(red * green), cv2.sqrt(green * blue), cv2.sqrt(red * blue)])
        mixed += cv2.transform(roots, np.ascontiguousarray(matrix[:, 3:]))
    return mixed


def _shading_image(shading: FloatArray, x: FloatArray, y: FloatArray) -> FloatImage:
    across = shading[0] * x + shading[2] * x * x
    log_gain = across[None, :] + (shading[1] * y + shading[4] * y * y)[:, None] + shading[3] * np.outer(y, x)
    return np.asarray(np.exp(np.clip(log_gain, -MAX_LOG_SHADING, MAX_LOG_SHADING)), dtype=np.float32)
