"""What strangers' files were tried, each with the command that meets it, its exit code, and a piece of what is said.

A row of the table in docs/reliability.md is one `Tried`; its variants are siblings that must give the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from strangers.world import DEPTH

Plant = Callable[[Path], object]
"""Puts something into a folder of `strangers.world`."""


@dataclass(frozen=True)
class Variant:
    """One file, or link, or pipe, and a command.

    Attributes:
        name: tells it from its siblings.
        plant: puts it there.
        command: after ``telewide``; ``{...}`` of nothing is filled in.
    """

    name: str
    plant: Plant
    command: str = DEPTH


@dataclass(frozen=True)
class Tried:
    """A kind of input, in one or several variants.

    Attributes:
        name: what it is, as the table has it.
        variants: of which the first gives the line of the table.
        code: the exit code.
        said: a piece of what is said; empty where nothing need be.
    """

    name: str
    variants: tuple[Variant, ...]
    code: int
    said: str = ""


def one(plant: Plant, command: str = DEPTH) -> tuple[Variant, ...]:
    """A single variant."""
    return (Variant("", plant, command),)


def each(plants: dict[str, Plant], command: str = DEPTH) -> tuple[Variant, ...]:
    """Variants that meet one command."""
    return tuple(Variant(name, plant, command) for name, plant in plants.items())
