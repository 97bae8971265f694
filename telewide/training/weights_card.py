"""Cards of weights files: what a file says of itself, read without torch, which takes seconds to load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError, safe_open

from telewide.errors import InputError
from telewide.files import open_regular
from telewide.matching.window import Window, check_stated_window
from telewide.records import checked, parse_json

FORMAT = "1"
LENGTH_BYTES = 8
"""Of a safetensors file begin it, and say how long its header is."""
_MOST_HEADER_BYTES = 1 << 22
"""Of a weights file: names and shapes of the largest network take a twentieth, a recipe a thousandth."""


@dataclass(frozen=True)
class WeightsCard:
    """Card of a weights file: what it says of itself.

    Attributes:
        network: name of the network.
        window: disparities it was trained for, px.
        recipe: resolved recipe, as plain data.
        training: stage, step and judgement the weights come from.
    """

    network: str
    window: Window
    recipe: Mapping[str, object]
    training: Mapping[str, object]

    @property
    def searched_window(self) -> Window | None:
        """Disparities that the captures of its training needed, px; None where it saw worlds alone."""
        options = self.recipe.get("train")
        saw_worlds = isinstance(options, Mapping) and options.get("worlds") is True
        return None if saw_worlds else self.window


def read_card(path: Path) -> WeightsCard:
    """Read what a weights file says of itself.

    Raises:
        UsageError: there is no such file.
        InputError: the file is damaged, or holds something else.
    """
    with open_regular(path) as stream:
        header_bytes = int.from_bytes(stream.read(LENGTH_BYTES), "little")
    if header_bytes > _MOST_HEADER_BYTES:  # of a file of another kind it means nothing, and is as large
        raise no_weights(path)
    try:
        with safe_open(path, framework="numpy") as opened:
            metadata = opened.metadata() or {}
        said = {name: parse_json(metadata[name]) for name in ("window", "recipe", "training")}
        card = checked({**said, "network": metadata["network"]}, WeightsCard)
        check_stated_window(card.window)
        return card
    except (OSError, SafetensorError, KeyError, ValueError, RuntimeError) as error:
        raise no_weights(path) from error


def no_weights(path: Path) -> InputError:
    """Say that a file holds no weights, or is damaged."""
    return InputError(f"{path} is no weights file of telewide, or is corrupt", hint="train a network to make one")
