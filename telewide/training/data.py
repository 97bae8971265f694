"""Batches, made by a worker process while the network computes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing import resource_tracker

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset
from torch.utils.data.dataloader import _MultiProcessingDataLoaderIter

from telewide.capture.pair import Capture, read_pair
from telewide.errors import MissingPartError, TelewideError, UsageError
from telewide.geometry.arrays import FloatImage
from telewide.geometry.stereo import ValidMasks
from telewide.matching.networks import StereoNetwork
from telewide.matching.other_view import enlarged_size
from telewide.training.objective import Batch
from telewide.training.retaken import retaken_crop
from telewide.training.samples import Sample, SampleSource, SeenPhotos, crop_capture, generator_for
from telewide.training.stages import Stage
from telewide.training.world_samples import WorldBatches, WorldSource, damaged_crops, enlarged_crop, worlds_for

_REHEARSED, _CAPTURED = 0, 1
_ENDED_WORKER = "DataLoader worker (pid"
"""Beginning of torch's message that a worker process was ended from outside."""

Source = SampleSource | WorldSource
"""Where crops come from."""


class StepBatches(Dataset[Batch]):
    """Batch i of a stage, as a function of (seed, stage, i) alone.

    Args:
        source: captures, disparities, sizes.
        stage: how many crops of which kind.
        seed: of the run.
        rank: this process; it makes every ``world``-th crop of the joint batch, rehearsed crops before real ones.
        world: number of processes.
    """

    def __init__(self, source: SampleSource, stage: Stage, *, seed: int, rank: int = 0, world: int = 1) -> None:
        # Where no disparities are needed none may have been written.
        needs_disparities = stage.needs_truth or stage.needs_surfaces
        self._source = source if needs_disparities else replace(source, disparities_folder=None)
        if not stage.needs_undamaged:
            self._source = replace(self._source, undamaged=None)
        elif stage.options.captured and source.undamaged is None:
            raise UsageError(
                f"stage {stage.name} looks at undamaged views, which real captures do not have",
                hint="symmetric_input and symmetric_loss are for data sets that are damaged on purpose",
            )
        self._stage, self._seed = stage, seed
        options = stage.options
        self._mine = range(rank, options.crops, world)
        self._worlds = worlds_for(
            (seed, stage.index),
            crop_hw=source.crop_hw,
            crops=options.rehearsed,
            mine=sum(crop < options.rehearsed for crop in self._mine),
            window_px=source.volume_px,
            photos=SeenPhotos(source),
        )

    def __len__(self) -> int:
        return self._stage.options.steps

    def __getitem__(self, step: int) -> Batch:
        options, mine = self._stage.options, self._mine
        rehearsed = [self._rehearsed(step, crop) for crop in mine if crop < options.exact]
        captured = [
            crop_capture(
                self._source,
                rng=self._generator(step, _CAPTURED, crop - options.exact),
                may_swap=options.swaps_views,
            )
            for crop in mine
            if crop >= options.exact
        ]
        batch = replace(collate([*rehearsed, *captured], n_rehearsed=len(rehearsed)), window=self._source.volume_px)
        return batch if self._stage.needs_undamaged else replace(batch, undamaged=None)

    def _rehearsed(self, step: int, crop: int) -> Sample:
        """A crop of a world painted with the user's own photos too, or of such a photo taken again.

        Its source view is damaged as by the wide lens.
        """
        rng = self._generator(step, _REHEARSED, crop)
        source, scale = self._source, 1 / self._source.enlargement
        if crop < self._stage.options.rehearsed:
            crisp = self._worlds.crop(step, crop, rng=rng, window=source.volume_px, scale=scale)
        else:
            crisp = retaken_crop(source, rng=rng, scale=scale)
        (damaged,) = damaged_crops([crisp], [rng], factors=source.asymmetry, equal_share=0.0)
        if source.enlargement > 1:
            crisp, damaged = (enlarged_crop(cut, hw=source.crop_hw) for cut in (crisp, damaged))
        ref, src, *undamaged = (
            np.ascontiguousarray(view.permute(1, 2, 0)) for view in (damaged.ref, damaged.src, crisp.ref, crisp.src)
        )
        truth_px, occluded = damaged.truth_px.numpy(), damaged.occluded.numpy()
        return Sample(ref, src, truth_px, occluded=occluded, undamaged=(undamaged[0], undamaged[1]))

    def _generator(self, *salt: int) -> np.random.Generator:
        return generator_for(self._seed, self._stage.index, *salt)


Batches = StepBatches | WorldBatches


def collate(samples: list[Sample], *, n_rehearsed: int) -> Batch:
    """Stack samples into one batch; undamaged views where every sample has them, what is hidden where rehearsed do."""
    hidden = [sample.occluded for sample in samples[:n_rehearsed] if sample.occluded is not None]
    undamaged = [sample.undamaged for sample in samples if sample.undamaged is not None]
    has_all = len(undamaged) == len(samples)
    return Batch(
        _stack_images([sample.ref for sample in samples]),
        _stack_images([sample.src for sample in samples]),
        torch.from_numpy(np.stack([sample.truth_px for sample in samples])),
        n_rehearsed,
        occluded_BHW=torch.from_numpy(np.stack(hidden)) if hidden else None,
        undamaged=_stack_pairs(undamaged) if has_all else None,
        valid=_stack_masks(samples),
    )


def step_batches(source: Source, stage: Stage, *, seed: int, rank: int, world: int) -> Batches:
    """Batches of a stage, from wherever its crops come."""
    if isinstance(source, WorldSource):
        return WorldBatches(source, stage, rank=rank, world=world)
    return StepBatches(source, stage, seed=seed, rank=rank, world=world)


def iterate_batches(dataset: Batches, *, first_step: int, workers: int) -> Generator[Batch, None, None]:
    """Yield the batches from ``first_step`` to the end of the stage, prepared ahead by worker processes.

    Raises:
        MissingPartError: the system ended one of them, as it does where memory runs out.
        TelewideError: a capture that a batch needs can no longer be used.
    """
    loader = DataLoader(
        _Told(dataset),
        batch_size=None,
        sampler=range(first_step, len(dataset)),
        num_workers=workers,
        prefetch_factor=4 if workers else None,
        worker_init_fn=_one_thread_each if workers else None,
        # A forked process inherits OpenCV's locks without the threads that hold them, and waits for ever.
        multiprocessing_context="spawn" if workers else None,
    )
    with _interrupts_held():  # which worker processes inherit: this process alone answers Ctrl-C and SIGTERM
        batches = iter(loader)
    try:
        for batch in batches:
            if isinstance(batch, TelewideError):
                raise batch
            yield batch
    except (RuntimeError, ConnectionError, EOFError) as error:  # torch's own words, or a batch that was on its way
        if isinstance(error, RuntimeError) and not str(error).startswith(_ENDED_WORKER):
            raise
        raise MissingPartError(
            "a process that prepares crops was ended by the system, which often means that memory ran out",
            hint="close other programs, or make crops smaller (`set` train.crop_hw=[H,W]); the same command goes on",
        ) from error
    finally:
        if isinstance(batches, _MultiProcessingDataLoaderIter):
            # A worker that is told to end while it hands a batch on may abort. Nobody needs it, but where the garbage
            # collector ends it torch prints a traceback.
            with suppress(RuntimeError):
                batches._shutdown_workers()


class _Told(Dataset[Batch | TelewideError]):
    """Batches, or as a value the error of a user that kept one from being made.

    Raised in a worker process it would arrive with a traceback for its message.
    """

    def __init__(self, batches: Batches) -> None:
        self._batches = batches

    def __len__(self) -> int:
        return len(self._batches)

    def __getitem__(self, step: int) -> Batch | TelewideError:
        try:
            return self._batches[step]
        except TelewideError as error:
            return error


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Let no Ctrl-C or SIGTERM through within the block; one that comes meanwhile is answered afterwards."""
    if hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # lets interrupts through when it starts, as it would with the first worker
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def _one_thread_each(_: int) -> None:
    cv2.setNumThreads(1)


def _stack_pairs(pairs: Sequence[tuple[FloatImage, FloatImage]]) -> tuple[torch.Tensor, torch.Tensor]:
    refs, srcs = zip(*pairs, strict=True)
    return _stack_images(refs), _stack_images(srcs)


def _stack_masks(samples: Sequence[Sample]) -> tuple[torch.Tensor, torch.Tensor] | None:
    """Masks of all crops; a crop that is whole is valid everywhere. None where all are whole."""
    if all(sample.valid is None for sample in samples):
        return None
    whole = np.ones(samples[0].truth_px.shape, np.bool_)
    masks = [sample.valid or ValidMasks(whole, whole) for sample in samples]
    ref, src = (torch.from_numpy(np.stack(of_view)) for of_view in ([m.ref for m in masks], [m.src for m in masks]))
    return ref, src


def _stack_images(images: Sequence[NDArray[np.float32]]) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(np.stack(images).transpose(0, 3, 1, 2)))


def enlargement_of(seen: Sequence[Capture], network: StereoNetwork) -> float:
    """Width at which a network will match captures, in their own; the first stands for all.

    Args:
        seen: the captures.
        network: that will match them.
    """
    if not network.has_confidence:
        return 1.0
    wide = read_pair(seen[0]).wide
    return float(enlarged_size(wide)[1] / wide.shape[1])
