"""The systems of the publication that learn, as data: ``learned.yaml``, or a file of one's own of the same form."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from telewide.errors import InputError
from telewide.options import Options, parse_options
from telewide.recipe import Recipe, load_recipe
from telewide.yaml_files import read_yaml

LEARNED_FILE = Path(__file__).with_name("learned.yaml")


class LearnedSystem(Options):
    """One system."""

    title: str
    """As it stands in tables."""
    recipe: str = "paper"
    """Recipe that it is trained by."""
    network: str | None = None
    """Instead of the recipe's."""
    restorer: str | None = None
    """Sharpens the second view before anything is trained or matched; None for enlarging it as it is."""
    settings: tuple[str, ...] = ()
    """Differences from the recipe, ``key=value``."""
    shows: Literal["disparity", "space"] = "disparity"
    """Subject of the judgement: the answer of its network, or its space of features."""
    corrects: bool = False
    """Whether rows and colours of every pair are corrected first, as `telewide depth` does."""
    first_share: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """Share of a budget that the first stage takes where others follow; they share the rest evenly."""

    def resolved(self, *, settings: tuple[str, ...] = (), seed: int | None = None) -> Recipe:
        """The recipe with everything that differs from it.

        Args:
            settings: more of it, ``key=value``, such as a budget in steps.
            seed: replaces the recipe's, where given.

        Raises:
            UsageError: an unknown key, or a wrong value.
        """
        of_network = () if self.network is None else (f"network={self.network}",)
        return load_recipe(self.recipe, settings=(*of_network, *self.settings, *settings), seed=seed)


class _LearnedFile(Options):
    format: Literal[1]
    systems: dict[str, LearnedSystem]


def read_learned_systems(*, path: Path = LEARNED_FILE) -> dict[str, LearnedSystem]:
    """Read systems by their names.

    Args:
        path: the shipped file, or one of the same form.

    Raises:
        InputError: no YAML, an unknown key, or a wrong value.
    """
    return parse_options(_LearnedFile, read_yaml(path), source=str(path), error=InputError).systems
