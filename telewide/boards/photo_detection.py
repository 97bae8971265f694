"""Find a board in many photos: one process per core, each with one photo at a time."""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import cv2

from telewide.boards.board import Board
from telewide.boards.detection import BoardView, detect_board
from telewide.boards.kept_photos import KeptPhotos, grey_of
from telewide.capture.images import read_image
from telewide.cores import usable_cores
from telewide.errors import InputError, UsageError, within_memory
from telewide.geometry.arrays import ByteImage

MAX_PROCESSES = 8
"""Each holds a photo of some 100 to 500 MB."""
_FEW_PHOTOS = 3  # are done before a process has started
_log = logging.getLogger("telewide")


@dataclass(frozen=True)
class PhotoResult:
    """Result of one photo.

    Attributes:
        view: the corners, or None where none were found.
        note: why none were found; None where some were.
    """

    view: BoardView | None
    note: str | None = None


def read_grey(path: Path) -> ByteImage:
    """Read a photo upright, as (H, W) uint8 grey, sRGB-encoded.

    Args:
        path: any photo that can be read.

    Raises:
        UsageError: there is no such file.
        InputError: it cannot be read.
    """
    return grey_of(read_image(path))


def detect_photos(
    paths: Sequence[Path], *, board: Board, processes: int | None = None, photos: KeptPhotos | None = None
) -> Iterator[PhotoResult]:
    """Find a board in photos.

    Args:
        paths: the photos.
        board: what they show.
        processes: how many to work with; None takes one per core, 1 works in this one.
        photos: those that are kept are not decoded again; None for none.

    Yields:
        A result for each, in their order, as soon as it is there.

    Raises:
        MissingPartError: a photo needs a reader that is not installed.
    """
    kept = photos or KeptPhotos(max_bytes=0)
    n_processes = min(processes or _n_cores(), len(paths))
    done = 0
    if n_processes > 1 and (processes is not None or len(paths) > _FEW_PHOTOS):
        try:
            for result in _detect_in_processes(paths, board, kept, n_processes=n_processes):
                yield result
                done += 1
        except (BrokenProcessPool, OSError):
            # Out of memory, no semaphores, or the caller's script cannot be started twice: one at a time still works.
            _log.warning("the processes that look for boards were stopped; going on with one")
    for path in paths[done:]:
        yield _detect_photo(path, board, _kept_grey(kept, path))


def _detect_in_processes(
    paths: Sequence[Path], board: Board, photos: KeptPhotos, *, n_processes: int
) -> Iterator[PhotoResult]:
    pool = ProcessPoolExecutor(
        n_processes, mp_context=multiprocessing.get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
    )
    try:
        for future in [pool.submit(_detect_photo, path, board, _kept_grey(photos, path)) for path in paths]:
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _kept_grey(photos: KeptPhotos, path: Path) -> ByteImage | None:
    return photos.read_grey(path) if path in photos.paths else None


def _detect_photo(path: Path, board: Board, grey_u8: ByteImage | None) -> PhotoResult:
    try:
        with within_memory(str(path)):
            view = detect_board(read_grey(path) if grey_u8 is None else grey_u8, board=board)
    except (InputError, UsageError) as error:
        return PhotoResult(None, error.message)
    return PhotoResult(view, None if view is not None else f"no board found in {path}")


def _n_cores() -> int:
    return min(usable_cores(), MAX_PROCESSES)
