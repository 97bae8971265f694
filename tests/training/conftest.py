"""Pairs to train on, shared by the tests of the training."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from training.small import source_of, write_pairs

from telewide.capture.pair import Capture
from telewide.training.samples import SampleSource


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """Small steps: threads would cost more than they bring."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def captures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Capture, ...]:
    """Two corrected pairs."""
    return write_pairs(tmp_path_factory.mktemp("pairs"))


@pytest.fixture(scope="session")
def source(captures: tuple[Capture, ...]) -> SampleSource:
    """Small crops of the two pairs."""
    return source_of(captures)
