"""One training on several processes, as started by ``torchrun``.

Every process computes its crops of the joint batch; losses are divided by global counts, so gradients are summed.
Rank 0 alone writes and judges.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import Tensor, nn


@dataclass(frozen=True)
class Processes:
    """Which process this is.

    Attributes:
        rank: 0 to world - 1.
        world: how many there are.
    """

    rank: int = 0
    world: int = 1

    @property
    def is_writer(self) -> bool:
        """Whether this process writes files and speaks."""
        return self.rank == 0

    def global_sum(self, value: Tensor) -> Tensor:
        """Add a value up over all processes."""
        if self.world > 1:
            value = value.clone()
            dist.all_reduce(value)
        return value

    def sum_gradients(self, network: nn.Module) -> None:
        """Replace every gradient by its sum over all processes."""
        if self.world == 1:
            return
        gradients = [p.grad if p.grad is not None else torch.zeros_like(p) for p in network.parameters()]
        flat = torch.cat([gradient.flatten() for gradient in gradients])
        dist.all_reduce(flat)
        pieces = torch.split(flat, [gradient.numel() for gradient in gradients])
        for parameter, piece in zip(network.parameters(), pieces, strict=True):
            parameter.grad = piece.view_as(parameter).clone()

    def from_writer(self, values: list[float]) -> list[float]:
        """Hand the writer's numbers to every process."""
        if self.world == 1:
            return values
        shared: list[object] = list(values)
        dist.broadcast_object_list(shared, src=0)
        return [float(str(value)) for value in shared]

    def wait(self) -> None:
        """Wait for all processes."""
        if self.world > 1:
            dist.barrier()

    def is_any(self, flag: bool) -> bool:
        """Whether the flag is set in any process."""
        return bool(self.global_sum(torch.tensor(float(flag))) > 0) if self.world > 1 else flag


@contextmanager
def joined_processes(device: torch.device) -> Iterator[Processes]:
    """Join the group ``torchrun`` started, if it did; gloo on processors, NCCL on GPUs."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if world == 1:
        yield Processes()
        return
    rank = int(os.environ["RANK"])
    if device.type == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    dist.init_process_group("cpu:gloo,cuda:nccl" if device.type == "cuda" else "gloo")
    try:
        yield Processes(rank, world)
    finally:
        dist.destroy_process_group()
