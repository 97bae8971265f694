"""Several processes on one task, as started by ``torchrun``.

In a training every process computes its crops of the joint batch; losses are divided by global counts, so gradients are
summed. Captures are shared by rank. Rank 0 alone writes what is written once, judges and speaks.

One process alone needs no torch here.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, TypeVar

from telewide.cores import Device

if TYPE_CHECKING:
    from torch import Tensor, nn

_PATIENCE = timedelta(days=7)
"""Longest wait of one process for another; when one dies, ``torchrun`` ends them all."""
Value = TypeVar("Value")


@dataclass(frozen=True)
class Processes:
    """This process among all that work together.

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

    def share(self, values: tuple[Value, ...]) -> tuple[Value, ...]:
        """Share of this process in what all have."""
        return values[self.rank :: self.world]

    def gathered(self, mine: tuple[Value, ...]) -> tuple[Value, ...]:
        """Put the results of all shares together again, in every process, in the order of what was shared."""
        if self.world == 1:
            return mine
        import torch.distributed as dist

        by_rank: list[tuple[Value, ...]] = [()] * self.world
        dist.all_gather_object(by_rank, mine)
        total = sum(len(part) for part in by_rank)
        return tuple(by_rank[index % self.world][index // self.world] for index in range(total))

    def global_sum(self, value: Tensor) -> Tensor:
        """Add a value up over all processes."""
        if self.world > 1:
            import torch.distributed as dist

            value = value.clone()
            dist.all_reduce(value)
        return value

    def sum_gradients(self, network: nn.Module) -> None:
        """Replace every gradient by its sum over all processes."""
        if self.world == 1:
            return
        import torch

        gradients = [p.grad if p.grad is not None else torch.zeros_like(p) for p in network.parameters()]
        flat = self.global_sum(torch.cat([gradient.flatten() for gradient in gradients]))
        pieces = torch.split(flat, [gradient.numel() for gradient in gradients])
        for parameter, piece in zip(network.parameters(), pieces, strict=True):
            parameter.grad = piece.view_as(parameter).clone()

    def from_writer(self, values: list[float]) -> list[float]:
        """Hand the writer's numbers to every process."""
        if self.world == 1:
            return values
        import torch.distributed as dist

        shared: list[object] = list(values)
        dist.broadcast_object_list(shared, src=0)
        return [float(str(value)) for value in shared]

    def wait(self) -> None:
        """Wait for all processes."""
        self.is_any(False)

    def is_any(self, flag: bool) -> bool:
        """Whether the flag is set in any process."""
        if self.world == 1:
            return flag
        import torch

        return bool(self.global_sum(torch.tensor(float(flag))) > 0)


def this_process() -> Processes:
    """This process among those ``torchrun`` started, joined or not; alone without it."""
    return Processes(int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1")))


def take_own_gpu(device: Device) -> None:
    """Let this process compute on a GPU of its own, as far as there are enough of them; without one nothing happens.

    Args:
        device: auto, cpu or cuda.

    Raises:
        MissingPartError: cuda was asked for and is not there.
    """
    import torch

    from telewide.matching.inference import choose_device

    if choose_device(device).type == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())


@contextmanager
def joined_processes(device: Device) -> Iterator[Processes]:
    """Join the group ``torchrun`` started, if it did.

    Args:
        device: auto, cpu or cuda: what each process computes on; of several GPUs each takes its own. Tensors on a GPU
            are summed by NCCL, everything else goes through gloo.

    Yields:
        This process among all.

    Raises:
        MissingPartError: cuda was asked for and is not there.
    """
    processes = this_process()
    if processes.world == 1:
        yield processes
        return
    import torch.distributed as dist

    from telewide.matching.inference import choose_device

    is_gpu = choose_device(device).type == "cuda"
    take_own_gpu(device)
    dist.init_process_group("cpu:gloo,cuda:nccl" if is_gpu else "gloo", timeout=_PATIENCE)
    try:
        yield processes
    finally:
        dist.destroy_process_group()
