"""Dataclasses from the plain data of a JSON file, each value checked against its type."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    T = TypeVar("T", bound=DataclassInstance)


def from_plain(cls: type[T], plain: object) -> T:
    """Make a dataclass of plain data.

    Args:
        cls: its fields are numbers, texts, truth values, literals, arrays of float64, and tuples and options of these.
        plain: a mapping with a value for each field that has no default, and no other keys; null for a float that is
            not known becomes NaN.

    Raises:
        ValueError: a key is unknown or missing, or a value is of another type.
    """
    if not isinstance(plain, Mapping):
        raise ValueError(f"{cls.__name__}: keys and values were expected")
    hints = get_type_hints(cls)
    unknown = plain.keys() - hints.keys()
    required = {
        field.name
        for field in dataclasses.fields(cls)
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    }
    if unknown or required - plain.keys():
        raise ValueError(f"{cls.__name__}: {sorted(map(str, unknown | (required - plain.keys())))} unknown or missing")
    return cls(**{name: _checked(hints[name], value, name) for name, value in plain.items()})


def _checked(hint: object, value: object, name: str) -> object:
    origin, arguments = get_origin(hint), get_args(hint)
    origin = get_origin(getattr(origin, "__value__", None)) or origin  # numpy 2.5 names its NDArray by a type alias
    if origin in (Union, types.UnionType):
        if value is None and types.NoneType in arguments:
            return None
        (hint,) = (argument for argument in arguments if argument is not types.NoneType)
        return _checked(hint, value, name)
    if origin is tuple and isinstance(value, list | tuple):
        inner = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        if len(inner) == len(value):
            return tuple(_checked(kind, one, name) for kind, one in zip(inner, value, strict=True))
    elif origin is Literal and value in arguments:
        return value
    elif origin is np.ndarray and isinstance(value, list):
        return np.array(value, dtype=np.float64)
    elif hint is float and (value is None or (isinstance(value, int | float) and not isinstance(value, bool))):
        return float("nan") if value is None else float(value)
    elif (hint in (bool, str) and isinstance(value, hint)) or (hint is int and type(value) is int):
        return value
    raise ValueError(f"{name}: {str(value)[:40]!r} is of another type")
