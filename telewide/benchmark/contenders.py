"""The matchers to compare: semi-global matching, and the networks of run folders and weights files."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from telewide.benchmark.memory import SGM
from telewide.cores import Device
from telewide.errors import UsageError
from telewide.files import is_file
from telewide.matching.matcher import Matcher
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import Window
from telewide.stages.run_folder import RunFolder

if TYPE_CHECKING:
    from telewide.matching.networks import StereoNetwork

_SUFFIX = ".safetensors"
_STAGE_ORDER = ("rehearsal", "photometric", "feature")


def semiglobal_contender() -> Matcher:
    """The matcher that needs no training."""
    return Matcher(SGM, match_semiglobal)


def all_contenders(sources: Sequence[Path], *, device: Device) -> list[Matcher]:
    """Semi-global matching, then every stage of every run in the order of training, and its result.

    Args:
        sources: run folders and weights files.
        device: auto, cpu or cuda.

    Returns:
        The contenders; the result of a run is named so, unless a stage before has the very weights.

    Raises:
        UsageError: a path that does not exist, or a run without weights.
        InputError: a corrupt weights file.
    """
    found = [semiglobal_contender()]
    for source, label in zip(sources, source_labels(sources), strict=True):
        found += _contenders_of(source, label, device=device)
    return found


def source_labels(sources: Sequence[Path]) -> list[str]:
    """Name run folders and weights files for a table: by their last names, or by their paths where those do not differ.

    Args:
        sources: run folders and weights files.
    """
    names = [Path(os.path.realpath(source)).name.removesuffix(_SUFFIX) for source in sources]
    return names if len(set(names)) == len(names) else [str(source) for source in sources]


def _contenders_of(source: Path, label: str, *, device: Device) -> list[Matcher]:
    from telewide.matching.inference import choose_device
    from telewide.training.checkpoint import load_weights

    torch_device = choose_device(device)
    if is_file(source):
        network, card = load_weights(source, device=torch_device)
        return [_network_contender(label, network, card.searched_window)]
    run = RunFolder(source)
    result = run.weights
    # Hidden ones are being written by a training under way.
    stages = sorted((p for p in run.train.glob(f"[!.]*{_SUFFIX}") if p != result), key=_position)
    if not stages and not is_file(result):
        raise UsageError(
            f"{source} holds no trained network", hint="a run folder of telewide train, or a weights file, was expected"
        )
    loaded = [(path.stem, *load_weights(path, device=torch_device)) for path in stages]
    if is_file(result):
        network, card = load_weights(result, device=torch_device)
        if not any(_is_equal(network, other) for _, other, _ in loaded):
            loaded.append(("result", network, card))
    return [_network_contender(f"{label}/{stage}", network, card.searched_window) for stage, network, card in loaded]


def _network_contender(name: str, network: StereoNetwork, window: Window | None) -> Matcher:
    from telewide.matching.inference import match_with_network

    return Matcher(name, partial(match_with_network, network=network), window)


def _position(path: Path) -> tuple[int, int, str]:
    """Where a stage stands in the training: rehearsal, photometric, feature-1, feature-2, then what is not known."""
    name, _, digits = path.stem.partition("-")
    rank = _STAGE_ORDER.index(name) if name in _STAGE_ORDER else len(_STAGE_ORDER)
    return rank, int(digits) if re.fullmatch(r"\d+", digits) else 0, path.stem


def _is_equal(network: StereoNetwork, other: StereoNetwork) -> bool:
    mine, theirs = network.state_dict(), other.state_dict()
    return mine.keys() == theirs.keys() and all(
        value.shape == theirs[name].shape and bool((value == theirs[name]).all()) for name, value in mine.items()
    )
