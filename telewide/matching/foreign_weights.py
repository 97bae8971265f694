"""Weights that others trained: read without running anything, and taken only where every name and shape fits."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from telewide.errors import InputError, UsageError
from telewide.files import is_file, refuse_strange_file

WRAPPERS = ("state_dict", "params", "model")
"""Under these names checkpoints keep their tensors beside epochs and losses."""
PARALLEL_PREFIX = "module."
"""Put before every name by ``nn.DataParallel``."""
COUNTER = "num_batches_tracked"
"""Of batch normalisation; files written by torch 0.4 and before lack it."""
_NAMES_SHOWN = 3


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Read the named tensors of a checkpoint on the processor.

    Args:
        path: safetensors, or what ``torch.save`` wrote: a state dict, or a mapping that holds one.

    Returns:
        Tensors by name, without the prefix of ``nn.DataParallel``.

    Raises:
        UsageError: there is no such file.
        InputError: it is no checkpoint, is corrupt, or holds more than tensors and plain data.
    """
    if not is_file(path):
        raise UsageError(f"{path}: no such weights file")
    refuse_strange_file(path)
    try:
        content: object = load_file(path) if path.suffix == ".safetensors" else _load_plain(path)
        tensors = _state_dict_in(content)
    except (SafetensorError, TypeError) as error:
        raise _not_weights(path) from error
    return {name.removeprefix(PARALLEL_PREFIX): tensor for name, tensor in tensors.items()}


def _load_plain(path: Path) -> object:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of torch, about formats of its own past
            return cast(object, torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # torch and pickle fail on corrupt and unsafe files in a dozen ways
        raise _not_weights(path) from error


def _state_dict_in(content: object) -> dict[str, Tensor]:
    if not isinstance(content, Mapping):
        raise TypeError("no mapping of names")
    named: Mapping[object, object] = next(
        (content[w] for w in WRAPPERS if isinstance(content.get(w), Mapping)), content
    )
    if not all(isinstance(key, str) for key in named):
        raise TypeError("names that are no texts")
    tensors = {str(key): value for key, value in named.items() if isinstance(value, Tensor)}
    if not tensors:
        raise TypeError("no tensors")
    return tensors


def load_tensors(module: nn.Module, tensors: Mapping[str, Tensor], *, path: Path, what: str, prefix: str = "") -> None:
    """Fill a module with tensors of exactly its names and shapes; counters of batch normalisation may be missing.

    Args:
        module: changed in place, whole or not at all.
        tensors: by the module's own names.
        path: where they come from, for the message.
        what: what the module is, for the message.
        prefix: what names have before them in the file, for the message.

    Raises:
        InputError: a name is missing or unknown, a shape differs, or a value is no number.
    """
    own = module.state_dict()
    missing = [name for name in own if name not in tensors and not name.endswith(COUNTER)]
    unknown = [name for name in tensors if name not in own]
    differing = [name for name in own if name in tensors and tensors[name].shape != own[name].shape]
    wrong = [name for name in own if name in tensors and not bool(torch.isfinite(tensors[name]).all())]
    found = (
        ("lacks", missing),
        ("has unknown", unknown),
        ("has another shape for", differing),
        ("is no number in", wrong),
    )
    for verdict, names in found:
        if names:
            raise InputError(
                f"{path} does not hold {what}: it {verdict} {_first_names(names, prefix)}",
                hint="take a checkpoint of the authors' code, for the same factor where there are several",
            )
    module.load_state_dict({**own, **tensors})


def _first_names(names: list[str], prefix: str) -> str:
    shown = ", ".join(prefix + name for name in names[:_NAMES_SHOWN])
    return f"{shown} and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else shown


def _not_weights(path: Path) -> InputError:
    return InputError(
        f"{path} is no checkpoint that can be read safely, or is corrupt",
        hint="it should hold tensors and plain data only; one with more can be saved again as safetensors",
    )
