"""Batch normalisation whose statistics are those of the joint batch, however many processes share it.

``nn.SyncBatchNorm`` computes on GPUs alone; these layers add up over whatever group ``torchrun`` started, on processors
too. In eval mode, and in one process, they are torch's own. Weights and buffers keep torch's names.
"""

from __future__ import annotations

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx
from torch.nn.modules.batchnorm import _BatchNorm


class _JointBatchNorm(_BatchNorm):
    """Normalisation of (B, C, ...) by the mean and variance of each channel over all processes."""

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, ...) to the same shape; processes may have batches of different sizes."""
        if not (self.training and _is_shared()):
            return super().forward(x)
        per_channel = (1, -1, *(1,) * (x.ndim - 2))
        axes = [axis for axis in range(x.ndim) if axis != 1]
        precise = x if x.dtype == torch.float64 else x.float()
        size = precise.new_tensor([x.numel() / x.shape[1]])
        *_, count = sums = _sum(torch.cat((precise.sum(axes), size)))
        mean = sums[:-1] / count
        centred = precise - mean.view(per_channel)
        variance = _sum(centred.square().sum(axes)) / count
        self._follow(mean, variance * count / (count - 1))
        scale = self.weight / torch.sqrt(variance + self.eps)
        normalised: Tensor = centred * scale.view(per_channel) + self.bias.view(per_channel)
        return normalised.to(x.dtype)

    @torch.no_grad()
    def _follow(self, mean: Tensor, variance: Tensor) -> None:
        if self.running_mean is None or self.running_var is None or self.num_batches_tracked is None:
            return
        self.num_batches_tracked.add_(1)
        self.running_mean.lerp_(mean.to(self.running_mean.dtype), self.momentum or 0.0)
        self.running_var.lerp_(variance.to(self.running_var.dtype), self.momentum or 0.0)


class BatchNorm2d(_JointBatchNorm, nn.BatchNorm2d):
    """``nn.BatchNorm2d`` over all processes."""


class BatchNorm3d(_JointBatchNorm, nn.BatchNorm3d):
    """``nn.BatchNorm3d`` over all processes."""


class _AllReduce(torch.autograd.Function):
    """A sum over all processes; each process' loss depends on it, so its gradient is the sum of all their gradients."""

    @staticmethod
    def forward(ctx: FunctionCtx, value: Tensor) -> Tensor:
        total = value.clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: FunctionCtx, *gradients: Tensor) -> Tensor:
        total = gradients[0].contiguous().clone()
        dist.all_reduce(total)
        return total


def _sum(value: Tensor) -> Tensor:
    total: Tensor = _AllReduce.apply(value)  # type: ignore[no-untyped-call]
    return total


def _is_shared() -> bool:
    return dist.is_available() and dist.is_initialized() and dist.get_world_size() > 1
