"""Options: defaults, messages that name the key, settings from the command line."""

from __future__ import annotations

import time

import pydantic
import pytest

from telewide.errors import InputError, UsageError
from telewide.options import Options, apply_settings, parse_options
from telewide.recipe import Recipe as WholeRecipe


class Train(Options):
    learning_rate: float = 1e-3
    """Step size of the optimiser."""
    window_px: tuple[int, int] = (0, 64)
    """Smallest and largest disparity, px."""


class Stage(Options):
    steps: int
    """Optimiser steps."""


class Recipe(Options):
    name: str = "quick"
    """What the recipe is called."""
    train: Train = Train()
    """Training."""
    stages: tuple[Stage, ...] = ()
    """Self-boosting stages."""


def parse(data: dict[str, object]) -> Recipe:
    return parse_options(Recipe, data, source="quick.yaml", error=InputError)


def test_defaults_and_yaml_shapes() -> None:
    recipe = parse({"train": {"window_px": [-8, 40], "learning_rate": "1e-4"}, "stages": [{"steps": 3}]})
    assert recipe == Recipe(train=Train(window_px=(-8, 40), learning_rate=1e-4), stages=(Stage(steps=3),))
    with pytest.raises(pydantic.ValidationError):
        recipe.name = "other"  # type: ignore[misc]


def test_field_docstrings_reach_the_schema() -> None:
    assert Recipe.model_fields["name"].description == "What the recipe is called."


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"train": {"learning_rat": 1}}, ["quick.yaml", "train.learning_rat", "did you mean train.learning_rate?"]),
        ({"lerning_rate": 1}, ["unknown key lerning_rate", "did you mean train.learning_rate?"]),
        ({"stages": [{"stepps": 2, "steps": 1}]}, ["stages.0.stepps", "did you mean stages.steps?"]),
        ({"train": {"learning_rate": "fast"}}, ["train.learning_rate is 'fast'", "expected a valid number"]),
        ({"stages": [{}]}, ["stages.0.steps is missing"]),
        ({"train": 3}, ["train is 3"]),
        ({"train": {"learning_rate": "x", "window_px": 1}}, ["train.learning_rate is 'x'", "train.window_px is 1"]),
    ],
)
def test_messages_name_the_key(data: dict[str, object], words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        parse(data)
    for word in words:
        assert word in caught.value.message


def test_unknown_key_lists_the_known_ones() -> None:
    with pytest.raises(UsageError) as caught:
        parse_options(Train, {"zzz": 1}, source="`set`", error=UsageError)
    assert caught.value.hint == "known keys: learning_rate, window_px"
    assert "did you mean" not in caught.value.message


@pytest.mark.parametrize("data", [None, [1, 2], "text"])
def test_data_that_is_no_mapping(data: object) -> None:
    with pytest.raises(InputError, match="expected keys and values"):
        parse(data)  # type: ignore[arg-type]


def test_settings_overlay() -> None:
    data: dict[str, object] = {"name": "a", "train": {"learning_rate": 1.0}, "stages": None}
    settings = ["train.learning_rate=1e-4", "train.window_px=[0, 8]", "name=b=c", "stages.x=", "z=1"]
    changed = apply_settings(data, settings)
    assert changed == {
        "name": "b=c",
        "train": {"learning_rate": "1e-4", "window_px": [0, 8]},
        "stages": {"x": None},
        "z": 1,
    }
    assert data == {"name": "a", "train": {"learning_rate": 1.0}, "stages": None}


@pytest.mark.parametrize("setting", ["name", "=3", "a..b=1", "a=[1", "name.inner=1"])
def test_settings_that_cannot_be_applied(setting: str) -> None:
    with pytest.raises(UsageError, match="setting"):
        apply_settings({"name": "a"}, [setting])


def test_of_thousands_of_wrong_keys_the_first_are_named() -> None:
    """Each is compared with every known one."""
    data = {f"key{number}\nerror: all is lost {'x' * 1000}": 1 for number in range(10_000)}
    begun_s = time.process_time()
    with pytest.raises(InputError) as caught:
        parse_options(WholeRecipe, data, source="recipe.yaml", error=InputError)
    assert time.process_time() - begun_s < 5
    assert "and 9995 more" in caught.value.message
    assert len(caught.value.message) < 1000
    assert "\n" not in caught.value.message


def test_a_setting_of_a_thousand_levels_is_refused() -> None:
    with pytest.raises(UsageError, match="expected key=value") as caught:
        apply_settings({}, [".".join("a" * 5000) + "=1"])
    assert len(caught.value.message) < 200
