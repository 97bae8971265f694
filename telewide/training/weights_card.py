"""Cards of weights files: what a file says of itself, read without torch, which takes seconds to load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import JsonValue
from safetensors import SafetensorError, safe_open

from telewide.errors import InputError
from telewide.files import open_regular, read_regular
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
        training: stage, step and judgement the weights come from; commit of the source, device, and
            hours of the steps where it saw worlds alone.
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
        InputError: the file is corrupt, or holds something else.
    """
    _header(path)
    try:
        with safe_open(path, framework="numpy") as opened:
            metadata = opened.metadata() or {}
        said = {name: parse_json(metadata[name]) for name in ("window", "recipe", "training")}
        card = checked({**said, "network": metadata["network"]}, WeightsCard)
        check_stated_window(card.window)
        return card
    except (OSError, SafetensorError, KeyError, ValueError, RuntimeError) as error:
        raise no_weights(path) from error


def has_same_tensors(path: Path, other: Path) -> bool:
    """Whether two weights files hold the same tensors, bit by bit, whatever they say of themselves.

    Raises:
        UsageError: there is no such file.
        InputError: a file is corrupt, or holds something else.
    """
    places, other_places = _places(path), _places(other)
    if places[0] != other_places[0]:
        return False
    return read_regular(path)[places[1] :] == read_regular(other)[other_places[1] :]


def _places(path: Path) -> tuple[dict[str, object], int]:
    """Kind, shape and place of each tensor in a weights file, and where the tensors begin."""
    header = _header(path)
    try:
        said = checked(parse_json(header.decode()), dict[str, JsonValue])
    except ValueError as error:
        raise no_weights(path) from error
    return {name: place for name, place in said.items() if name != "__metadata__"}, LENGTH_BYTES + len(header)


def _header(path: Path) -> bytes:
    with open_regular(path) as stream:
        n_bytes = int.from_bytes(stream.read(LENGTH_BYTES), "little")
        if n_bytes > _MOST_HEADER_BYTES:  # of a file of another kind it means nothing, and is as large
            raise no_weights(path)
        return stream.read(n_bytes)


def no_weights(path: Path) -> InputError:
    """Say that a file holds no weights, or is corrupt."""
    return InputError(f"{path} is no weights file of telewide, or is corrupt", hint="train a network to make one")
