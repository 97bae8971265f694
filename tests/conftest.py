"""Shared fixtures: where the photographed data lies, seeds, devices."""

from __future__ import annotations

import os
from pathlib import Path

# Before numpy, OpenCV or torch load: many small arrays run faster on few threads, and results do not depend on them.
os.environ.setdefault("OMP_NUM_THREADS", "2")

import numpy as np
import pytest

REPO = Path(__file__).resolve().parent.parent


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A test that asks for ``data_root`` is marked ``data``, one that asks for ``gpu`` is marked ``gpu``."""
    for item in items:
        names = getattr(item, "fixturenames", ())
        if "data_root" in names:
            item.add_marker("data")
        if "gpu" in names:
            item.add_marker("gpu")


@pytest.fixture(scope="session")
def repo() -> Path:
    """Root of the checkout."""
    return REPO


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of the photographed data sets; the test is skipped where it is absent."""
    root = Path(os.environ.get("TELEWIDE_DATA", REPO.parent / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no data sets at {root}: set TELEWIDE_DATA to their folder")
    return root


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20180707)


@pytest.fixture(scope="session")
def gpu() -> str:
    """Name of a CUDA device; the test is skipped without one."""
    import torch

    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    return "cuda"
