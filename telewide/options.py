"""Options: what a recipe, a board or a capture sheet may say, and messages a person can act on when it says it wrongly.

An options class is a frozen pydantic model that refuses unknown keys; every field has a docstring. A key is named by
its dotted path (``train.learning_rate``), in messages and in settings such as ``train.learning_rate=1e-4`` alike.
"""

from __future__ import annotations

import copy
import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from telewide.errors import TelewideError, UsageError
from telewide.text import first_few, shortened
from telewide.yaml_files import MAX_DEPTH, parse_yaml

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

_FAULTS_SHOWN, _LONGEST_SENTENCE = 5, 300
# What pydantic calls a key it does not know, and one that is no text.
_UNKNOWN_KEY = {"extra_forbidden", "invalid_key"}


class Options(BaseModel):
    """Base of every options class: frozen, no unknown key, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)


OptionsT = TypeVar("OptionsT", bound=Options)


def parse_options(cls: type[OptionsT], data: object, *, source: str, error: type[TelewideError]) -> OptionsT:
    """Check plain data against an options class.

    Args:
        cls: the options class.
        data: keys and values as YAML gives them.
        source: where the data comes from, for the message: a file name, the settings.
        error: what to raise.

    Returns:
        The options, with defaults filled in.

    Raises:
        TelewideError: of the given class. The message names the first wrong keys by their dotted paths: an unknown one
            with the nearest known one, a wrong value with what was expected.
    """
    if not isinstance(data, Mapping):
        raise error(f"{source}: found {_shown(data)}, expected keys and values")
    try:
        return cls.model_validate(dict(data))
    except ValidationError as caught:
        details = caught.errors(include_url=False)
        lines = [_explained(cls, detail) for detail in details[:_FAULTS_SHOWN]]
        if len(details) > len(lines):
            lines.append(f"and {len(details) - len(lines)} more")
        hint = f"known keys: {first_few(sorted(_dotted_keys(cls)))}"
        is_key_unknown = any(detail["type"] in _UNKNOWN_KEY for detail in details)
        raise error(f"{source}: " + "; ".join(lines), hint=hint if is_key_unknown else None) from None


def apply_settings(data: Mapping[str, object], settings: Sequence[str]) -> dict[str, object]:
    """Overlay ``a.b=value`` settings on plain data.

    Args:
        data: keys and values as YAML gives them; left as it is.
        settings: dotted key, ``=``, a YAML value; later ones win. ``a.b=`` sets null.

    Returns:
        A changed copy.

    Raises:
        UsageError: a setting without ``=`` or key, a value that is no YAML, or a path through a plain value.
    """
    changed: dict[str, object] = copy.deepcopy(dict(data))
    for setting in settings:
        key, equals, text = setting.partition("=")
        path = key.strip().split(".")
        if not equals or not all(path) or len(path) > MAX_DEPTH:
            raise UsageError(f"setting {_shown(setting)}: expected key=value, such as train.seed=3")
        value = parse_yaml(text, source=f"setting {_shown(setting)}: this is no YAML value", error=UsageError)
        _set_in(changed, path, value, setting=setting)
    return changed


def _set_in(data: dict[str, object], path: Sequence[str], value: object, *, setting: str) -> None:
    for depth, key in enumerate(path[:-1], start=1):
        inner = data.setdefault(key, {})
        if inner is None:
            inner = data[key] = {}
        if not isinstance(inner, dict):
            raise UsageError(
                f"setting {_shown(setting)}: {'.'.join(path[:depth])} is {_shown(inner)}, it holds no keys"
            )
        data = inner
    data[path[-1]] = value


def _explained(cls: type[Options], detail: ErrorDetails) -> str:
    path = shortened(".".join(str(part) for part in detail["loc"]))
    if detail["type"] in _UNKNOWN_KEY:
        nearest = _nearest_key(cls, path)
        return f"unknown key {path}" + (f", did you mean {nearest}?" if nearest else "")
    if detail["type"] == "missing":
        return f"{path} is missing"
    # pydantic's sentence reads "Input should be a valid integer, ..."; a check of our own "Value error, ...".
    expected = detail["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    place = f"{path} is" if path else "found"
    return f"{place} {_shown(detail['input'])}, expected {shortened(expected, most=_LONGEST_SENTENCE)}"


def _nearest_key(cls: type[Options], path: str) -> str | None:
    known = sorted(_dotted_keys(cls))
    near = difflib.get_close_matches(path, known, n=1)
    if near:
        return near[0]
    # The right word in the wrong section: compare last words.
    by_word = {key.rpartition(".")[2]: key for key in known}
    near = difflib.get_close_matches(path.rpartition(".")[2], sorted(by_word), n=1)
    return by_word[near[0]] if near else None


def _dotted_keys(cls: type[Options]) -> Iterator[str]:
    for name, field in cls.model_fields.items():
        key = field.alias or name
        yield key
        for inner in _options_inside(field.annotation):
            yield from (f"{key}.{below}" for below in _dotted_keys(inner))


def _options_inside(annotation: object) -> Iterator[type[Options]]:
    """The options classes in an annotation such as ``Section | None`` or ``tuple[Stage, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, Options):
        yield annotation
    for argument in get_args(annotation):
        yield from _options_inside(argument)


def _shown(value: object) -> str:
    return shortened(repr(value))
