"""Every reader against mutated files: it reads them or refuses them with one message; no traceback, no hang, no greed.

100 mutations of each kind; `make soak` takes 2000 (TELEWIDE_MUTATIONS).
"""

from __future__ import annotations

import logging
import os
import resource
import signal
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from mutations import Kind, kinds, mutated

from telewide.errors import TelewideError

N_MUTATIONS = int(os.environ.get("TELEWIDE_MUTATIONS", "100"))
MOST_SECONDS = 20
MOST_BYTES = 2 << 30
KINDS = ("pictures", "EXIF", "DNG", "YAML", "JSON", "PFM", "NPZ", "weights", "state")


@pytest.fixture(scope="module")
def specimens(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kind]:
    return kinds(tmp_path_factory.mktemp("specimens"))


@contextmanager
def no_hang() -> Iterator[None]:
    def stop(signum: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"longer than {MOST_SECONDS} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(MOST_SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_every_kind_is_here(specimens: dict[str, Kind]) -> None:
    assert tuple(specimens) == KINDS


@pytest.mark.parametrize("name", KINDS)
def test_whole_files_are_read(specimens: dict[str, Kind], name: str, tmp_path: Path) -> None:
    for file, content in specimens[name].files.items():
        (tmp_path / file).write_bytes(content)
        specimens[name].read(tmp_path / file)


@pytest.mark.parametrize("name", KINDS)
def test_mutated_files_are_read_or_refused(
    specimens: dict[str, Kind], name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kind, rng = specimens[name], np.random.default_rng(zlib.crc32(name.encode()))
    caplog.set_level(logging.ERROR, "telewide")  # for this test alone
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused: list[TelewideError] = []
    for number in range(N_MUTATIONS):
        file = sorted(kind.files)[number % len(kind.files)]
        path = tmp_path / file
        path.write_bytes(mutated(kind.files[file], rng, is_text=kind.is_text))
        with warnings.catch_warnings(), no_hang():
            warnings.simplefilter("ignore")
            try:
                kind.read(path)
            except TelewideError as error:
                refused.append(error)
            except BaseException as error:
                kept = path.rename(tmp_path / f"kept-{file}")
                raise AssertionError(f"mutation {number} of {file}, kept as {kept}") from error
    assert refused, "mutations that break nothing show nothing"
    assert {error.exit_code for error in refused} <= {2, 3, 5}
    assert [error.message for error in refused if "\n" in error.message] == []
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < MOST_BYTES
