"""The restorers by name. A new one is a file with its network, and a line in ``RESTORERS``.

Letters: B batch, C channels, H W image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.errors import UsageError
from telewide.geometry.arrays import FloatImage
from telewide.matching.foreign_weights import load_tensors, read_tensors
from telewide.restoration.crops import Crops
from telewide.restoration.dan import CODE_LENGTH, Dan
from telewide.restoration.dan import FACTORS as DAN_FACTORS
from telewide.restoration.kernels import KERNEL_RANGES, KernelRange, kernel_components
from telewide.restoration.rcan import FACTORS as RCAN_FACTORS
from telewide.restoration.rcan import Rcan


@dataclass(frozen=True)
class Restorer:
    """One way to restore.

    Attributes:
        build: a network with fresh weights for a factor; it takes (B, 3, H, W) in [0, 1].
        loss: what its training minimises over a batch, a scalar.
        factors: by which it can enlarge.
        kernels: blurs that it assumes before bicubic shrinking; None for none.
        learning_rate: of its authors' training by Adam.
    """

    build: Callable[[int], nn.Module]
    loss: Callable[[nn.Module, Crops], Tensor]
    factors: tuple[int, ...]
    kernels: KernelRange | None
    learning_rate: float


def absolute_loss(network: nn.Module, crops: Crops) -> Tensor:
    """Mean absolute difference to the sharp crops."""
    return functional.l1_loss(network(crops.small_BCHW), crops.sharp_BCHW)


def alternating_loss(network: nn.Module, crops: Crops) -> Tensor:
    """Mean absolute difference of pictures and of kernels' codes, summed over the turns of DAN."""
    if not isinstance(network, Dan):
        raise TypeError("the alternating loss is of DAN")
    pictures, codes = network.turns(crops.small_BCHW)
    code = network.encode(crops.kernels_BHW)
    terms = [functional.l1_loss(picture, crops.sharp_BCHW) for picture in pictures]
    return torch.stack([*terms, *(functional.l1_loss(guess, code) for guess in codes)]).sum()


def _build_dan(factor: int, kernels: str) -> Dan:
    return Dan(factor, kernel_components(KERNEL_RANGES[kernels], length=CODE_LENGTH))


def _dan(kernels: str) -> Restorer:
    return Restorer(
        build=lambda factor: _build_dan(factor, kernels),
        loss=alternating_loss,
        factors=DAN_FACTORS,
        kernels=KERNEL_RANGES[kernels],
        learning_rate=4e-4,
    )


RESTORERS: dict[str, Restorer] = {
    "rcan": Restorer(build=Rcan, loss=absolute_loss, factors=RCAN_FACTORS, kernels=None, learning_rate=1e-4),
    "dan": _dan("anisotropic"),
    "dan-isotropic": _dan("isotropic"),
}


def build_restorer(name: str, *, factor: int, weights: Path | None = None, seed: int = 0) -> nn.Module:
    """Build a restorer by name, with weights of a file or drawn from ``seed``.

    Args:
        name: in ``RESTORERS``.
        factor: by which it enlarges.
        weights: a checkpoint of its authors, or a saved state of the same network; None for fresh ones.
        seed: of fresh weights.

    Raises:
        UsageError: unknown name, a factor that it has no layout for, or no such file.
        InputError: the file is corrupt, or holds something else.
    """
    if name not in RESTORERS:
        raise UsageError(f"unknown restorer {name!r}", hint=f"known restorers: {', '.join(RESTORERS)}")
    factors = RESTORERS[name].factors
    if factor not in factors:
        known = ", ".join(map(str, factors))
        raise UsageError(f"{name} enlarges by {known}, not by {factor}", hint="take another factor")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = RESTORERS[name].build(factor)
    if weights is not None:
        load_tensors(network, read_tensors(weights), path=weights, what=f"{name} for a factor of {factor}")
    return network.eval()


@torch.inference_mode()
def restore(small: FloatImage, network: nn.Module) -> FloatImage:
    """Restore one picture on the device of the network's weights.

    Args:
        small: (H, W, 3) float32 sRGB in [0, 1], at the worse camera's own size.
        network: of :func:`build_restorer`; put into eval mode.

    Returns:
        (factor H, factor W, 3) float32 in [0, 1].
    """
    network.eval()
    device = next(network.parameters()).device
    image = torch.from_numpy(np.ascontiguousarray(small.transpose(2, 0, 1)))[None].to(device)
    restored = network(image)[0].clamp(0, 1).float().cpu().numpy()
    return np.ascontiguousarray(restored.transpose(1, 2, 0), np.float32)
