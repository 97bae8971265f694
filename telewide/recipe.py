"""Recipes: everything a user may choose about a run, as YAML in ``pipelines/`` or of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import Field, field_validator

from telewide.assets import find_asset
from telewide.errors import InputError, UsageError
from telewide.matching.window import check_stated_window
from telewide.options import Options, apply_settings, parse_options
from telewide.ranges import MAX_DISPARITY_PX, MAX_SEED
from telewide.training.options import TrainOptions
from telewide.yaml_files import read_yaml

DEFAULT_RECIPE = "default"


class CorrectionOptions(Options):
    """Corrections between the two views before anything is matched."""

    vertical: bool = True
    """Fit and undo the rows' misfit of each shot, dy = a + b x + c y."""
    colour: bool = True
    """Fit and undo gain and offset of each channel of each shot."""


class Recipe(Options):
    """One way to go from captures to depth."""

    description: str = ""
    """One line for people."""
    network: str = "guided"
    """Name of the network; the default one is that in the box, which `train.start: box` begins with."""
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] = 0
    """Of weights and samples."""
    working_width_px: Annotated[int, Field(ge=128, le=MAX_DISPARITY_PX)] = 1536
    """Larger photos are matched at this width; depth comes back at their own size."""
    window_px: tuple[int, int] | None = None
    """Disparities [d_min, d_max) to search, at the working size; None measures them on the captures."""
    correction: CorrectionOptions = CorrectionOptions()
    train: TrainOptions = TrainOptions()

    @field_validator("window_px")
    @classmethod
    def _fits_the_volume(cls, window: tuple[int, int] | None) -> tuple[int, int] | None:
        if window is not None:
            check_stated_window(window)
        return window


OF_THE_PAIRS = ("working_width_px", "window_px", "correction")
"""Options that say how the pairs look which a network was taught on."""


def load_recipe(name: str, *, settings: Sequence[str] = (), seed: int | None = None) -> Recipe:
    """Read a recipe by name or path and apply ``key=value`` settings.

    Args:
        name: a name in ``pipelines/``, or the path of a YAML file.
        settings: dotted overrides.
        seed: replaces the recipe's, where given.

    Raises:
        UsageError: no such recipe, an unknown key (the nearest known one is named) or a wrong value.
    """
    path = find_asset("pipelines", name)
    try:
        data = read_yaml(path) or {}
    except InputError as error:
        raise UsageError(f"recipe {error.message}", hint="it should be YAML: key: value") from error
    recipe = parse_options(Recipe, data, source=f"recipe {path}", error=UsageError)
    if settings:
        changed = apply_settings(recipe.model_dump(mode="json"), settings)
        recipe = parse_options(Recipe, changed, source="`set`", error=UsageError)
    if seed is not None:
        changed = recipe.model_dump(mode="json") | {"seed": seed}
        recipe = parse_options(Recipe, changed, source="`seed`", error=UsageError)
    return recipe


def differing_keys(first: Mapping[str, object], second: Mapping[str, object], *, prefix: str = "") -> list[str]:
    """Dotted keys in which two resolved recipes differ; what people only read does not count."""
    differing = []
    for key in sorted({*first, *second} - {"description"}):
        a, b = first.get(key), second.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            differing += differing_keys(a, b, prefix=f"{prefix}{key}.")
        elif a != b:
            differing.append(f"{prefix}{key}")
    return differing
