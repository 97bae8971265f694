"""Training of a restorer on sharp pictures, where its authors' weights are not at hand."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import nn

from telewide.errors import QualityError
from telewide.restoration.crops import CropSource
from telewide.restoration.restorers import RESTORERS

HALVED_AFTER = 0.5
"""Share of the steps after which the learning rate is halved."""


def train_restorer(
    network: nn.Module,
    source: CropSource,
    *,
    name: str,
    steps: int,
    seed: int = 0,
    step_done: Callable[[int, float], None] = lambda step, loss: None,
) -> nn.Module:
    """Train a restorer in place by Adam.

    Args:
        network: of :func:`~telewide.restoration.restorers.build_restorer`.
        source: crops, shrunken as the restorer assumes: ``RESTORERS[name].kernels``.
        name: of the restorer: its loss and learning rate.
        steps: how many batches.
        seed: of the batches.
        step_done: hears of each step and its loss.

    Returns:
        The same network, in eval mode.

    Raises:
        QualityError: the loss is not finite; weights are as before the step.
    """
    restorer, device = RESTORERS[name], next(network.parameters()).device
    learned = [parameter for parameter in network.parameters() if parameter.requires_grad]
    optimiser = torch.optim.Adam(learned, lr=restorer.learning_rate, betas=(0.9, 0.999))
    network.train()
    for step in range(steps):
        if step >= HALVED_AFTER * steps:
            optimiser.param_groups[0]["lr"] = restorer.learning_rate / 2
        loss = restorer.loss(network, source.batch(step, seed=seed).to(device))
        if not math.isfinite(float(loss.detach())):
            raise QualityError(f"the loss of {name} is not a number at step {step}", hint="check the pictures")
        optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        optimiser.step()
        step_done(step + 1, float(loss.detach()))
    return network.eval()
