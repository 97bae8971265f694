"""What restorers learn from, and that they learn."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

from telewide.errors import InputError, QualityError
from telewide.restoration.crops import CropSource, shrink
from telewide.restoration.dan import Dan
from telewide.restoration.kernels import (
    KERNEL_RANGES,
    KERNEL_SIDE,
    KernelRange,
    blur_with,
    draw_kernels,
    kernel_components,
)
from telewide.restoration.rcan import Rcan
from telewide.restoration.restorers import RESTORERS
from telewide.restoration.training import train_restorer


def picture(seed: int = 0, *, hw: tuple[int, int] = (64, 72)) -> np.ndarray:
    noise = np.random.default_rng(seed).random((*hw, 3), dtype=np.float32)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.5), np.float32)


def test_kernels_have_the_stated_deviations() -> None:
    """Second moments of wide enough kernels are the squares of what was drawn, along any direction."""
    narrow = KernelRange((1.5, 1.5), is_isotropic=True)
    (kernel,) = draw_kernels(narrow, count=1, rng=np.random.default_rng(0)).astype(np.float64)
    y, x = np.mgrid[:KERNEL_SIDE, :KERNEL_SIDE] - KERNEL_SIDE // 2
    moments = [(kernel * x * x).sum(), (kernel * y * y).sum(), (kernel * x * y).sum(), (kernel * x).sum()]
    np.testing.assert_allclose(moments, [2.25, 2.25, 0, 0], atol=1e-3)
    drawn = draw_kernels(KERNEL_RANGES["anisotropic"], count=50, rng=np.random.default_rng(1)).astype(np.float64)
    np.testing.assert_allclose(drawn.sum(axis=(1, 2)), 1, atol=1e-5)
    tensors = np.array([[[(k * a * b).sum() for a in (x, y)] for b in (x, y)] for k in drawn])
    ratios = np.linalg.eigvalsh(tensors)
    assert (ratios[:, 1] / ratios[:, 0]).max() > 4, "ellipses"
    assert np.abs(tensors[:, 0, 1]).max() > 1, "turned"


def test_a_kernel_blurs_as_a_gaussian_does() -> None:
    (kernel,) = draw_kernels(KernelRange((1.2, 1.2), is_isotropic=True), count=1, rng=np.random.default_rng(0))
    image = picture()
    expected = cv2.GaussianBlur(image, (KERNEL_SIDE, KERNEL_SIDE), 1.2, borderType=cv2.BORDER_REFLECT_101)
    np.testing.assert_allclose(blur_with(image, kernel), expected, atol=1e-5)
    point = np.zeros((41, 41, 3), np.float32)
    point[20, 20] = 1
    lopsided = np.random.default_rng(0).random((KERNEL_SIDE, KERNEL_SIDE), dtype=np.float32)
    np.testing.assert_allclose(blur_with(point, lopsided)[10:31, 10:31, 0], lopsided, atol=1e-6)


def test_components_hold_what_kernels_differ_by() -> None:
    components = kernel_components(KERNEL_RANGES["isotropic"], length=10)
    np.testing.assert_allclose(components.T @ components, np.eye(10), atol=1e-5)
    fresh = draw_kernels(KERNEL_RANGES["isotropic"], count=200, rng=np.random.default_rng(9)).reshape(200, -1)
    centred = fresh - fresh.mean(axis=0)
    kept = centred @ components @ components.T
    assert ((centred - kept) ** 2).sum() < 1e-3 * (centred**2).sum()


@pytest.mark.parametrize("kernels", [None, KERNEL_RANGES["isotropic"]])
def test_small_crops_are_their_sharp_ones_shrunken(kernels: KernelRange | None) -> None:
    source = CropSource([picture()], factor=2, kernels=kernels, small_px=12, count=3)
    crops, again, other = source.batch(4, seed=1), source.batch(4, seed=1), source.batch(5, seed=1)
    assert torch.equal(crops.small_BCHW, again.small_BCHW)
    assert not torch.equal(crops.small_BCHW, other.small_BCHW)
    assert crops.sharp_BCHW.shape == (3, 3, 24, 24)
    for small, sharp, kernel in zip(crops.small_BCHW, crops.sharp_BCHW, crops.kernels_BHW, strict=True):
        image = np.ascontiguousarray(sharp.numpy().transpose(1, 2, 0))
        expected = shrink(blur_with(image, kernel.numpy()), factor=2)
        np.testing.assert_allclose(small.numpy().transpose(1, 2, 0), expected, atol=1e-6)


def test_pictures_that_hold_no_crop_are_refused() -> None:
    with pytest.raises(InputError, match="there is none"):
        CropSource([], factor=2, kernels=None)
    with pytest.raises(InputError, match="72x64 px holds no crop of 96 px"):
        CropSource([picture()], factor=4, kernels=None, small_px=24)


def tiny(name: str) -> Rcan | Dan:
    torch.manual_seed(0)
    if name == "rcan":
        return Rcan(2, groups=1, blocks=1, channels=16)
    return Dan(2, kernel_components(KERNEL_RANGES["isotropic"], length=10), channels=16, blocks=1)


@pytest.mark.parametrize("name", ["rcan", pytest.param("dan-isotropic", marks=pytest.mark.slow)])
def test_training_lowers_the_loss(name: str) -> None:
    network, kernels = tiny(name), RESTORERS[name].kernels
    source = CropSource([picture(), picture(1)], factor=2, kernels=kernels, small_px=12, count=4)
    held_out = CropSource([picture(2)], factor=2, kernels=kernels, small_px=12, count=4).batch(0, seed=9)
    heard: list[float] = []
    with torch.no_grad():
        before = float(RESTORERS[name].loss(network, held_out))
    train_restorer(network, source, name=name, steps=60, step_done=lambda step, loss: heard.append(loss))
    with torch.no_grad():
        after = float(RESTORERS[name].loss(network, held_out))
    assert len(heard) == 60
    assert after < 0.7 * before
    assert not network.training


def test_a_loss_that_is_no_number_stops_before_it_harms() -> None:
    network = tiny("rcan")
    source = CropSource([np.full((64, 64, 3), np.nan, np.float32)], factor=2, kernels=None, small_px=12, count=1)
    kept = {name: value.clone() for name, value in network.state_dict().items()}
    with pytest.raises(QualityError, match="step 0"):
        train_restorer(network, source, name="rcan", steps=2)
    assert all(torch.equal(value, kept[name]) for name, value in network.state_dict().items())
