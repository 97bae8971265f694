"""Records: telewide's own JSON files, each described by a pydantic model or by a dataclass.

Written with null for a figure that is not known, never NaN. Read back with limits of size and depth, every number
finite and within 64 bits, every value of its type: somebody else may have written what lies in a run folder.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetPydanticSchema,
    JsonValue,
    PlainSerializer,
    TypeAdapter,
)

from telewide.errors import InputError
from telewide.files import read_regular, write_text
from telewide.text import json_text
from telewide.yaml_files import MAX_DEPTH

MAX_JSON_BYTES, MAX_JSON_VALUES = 1 << 24, 1 << 20
_LARGEST_WHOLE = 1 << 63
_TOO_DEEP = f"it is nested deeper than {MAX_DEPTH} levels"

# Python keeps a byte of a file name that is no UTF-8 as half a surrogate pair, which pydantic takes for corrupt JSON:
# while it is checked, such a byte is a character of private use.
_PRIVATE = {0xDC00 + byte: 0xF700 + byte for byte in range(0x80, 0x100)}
_BYTES = {private: surrogate for surrogate, private in _PRIVATE.items()}

Name = Annotated[str, AfterValidator(lambda text: text.translate(_BYTES))]
"""A text that holds the name of a file, which may be no UTF-8."""
Line = Annotated[Name, AfterValidator(lambda text: text.replace("\n", "\\n"))]
"""A sentence that is told to a person: line breaks in it are shown, for each could begin a message of its own."""
Figure = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
"""A number that may be unknown: NaN in memory, null in JSON."""


def _array_of(kind: object, *, shape: tuple[int, ...]) -> GetPydanticSchema:
    as_array = AfterValidator(lambda rows: np.array(rows, dtype=np.float64).reshape(shape))
    return GetPydanticSchema(lambda _, handler: handler(Annotated[kind, as_array]))


_as_lists = PlainSerializer(lambda array: array.tolist())
Vector = Annotated[NDArray[np.float64], _array_of(tuple[Figure, Figure, Figure], shape=(3,)), _as_lists]
"""(3,) numbers."""
Points = Annotated[NDArray[np.float64], _array_of(tuple[tuple[float, float], ...], shape=(-1, 2)), _as_lists]
"""(N, 2) numbers."""

_adapter: Callable[[Any], TypeAdapter[Any]] = lru_cache(maxsize=64)(TypeAdapter)

RecordT = TypeVar("RecordT", bound="Record")
Content = TypeVar("Content")


class Record(BaseModel):
    """Base of every record: frozen; keys that it does not know are passed over."""

    model_config = ConfigDict(frozen=True)


def record_text(record: Record, *, indent: int | None = 2, has_defaults: bool = True) -> str:
    """Write a record as JSON.

    Args:
        record: numbers that are not finite become null.
        indent: columns a level is indented by; None for one line.
        has_defaults: whether what nobody stated is written too.

    Returns:
        The text, with a line end.
    """
    return json_text(record.model_dump(mode="json", exclude_unset=not has_defaults), indent=indent) + "\n"


def write_record(path: Path, record: Record) -> None:
    """Write a record as a file, whole or not at all."""
    write_text(path, record_text(record))


def read_record(path: Path, cls: type[RecordT]) -> RecordT:
    """Read a record of at most `MAX_JSON_BYTES`.

    Args:
        path: the file.
        cls: class of the record.

    Raises:
        UsageError: there is no such file.
        InputError: no regular file, no JSON, or a value that the record does not hold.
    """
    content = read_json(path)
    try:
        return checked(content, cls)
    except ValueError as error:
        raise InputError(f"{path} is no such record: {error}") from error


def read_json(path: Path) -> JsonValue:
    """Read a JSON file of at most `MAX_JSON_BYTES`.

    Args:
        path: the file.

    Returns:
        Plain data; every number in it is finite and fits 64 bits.

    Raises:
        UsageError: there is no such file.
        InputError: no regular file, or no such JSON.
    """
    data = read_regular(path, most_bytes=MAX_JSON_BYTES)
    try:
        return parse_json(data)
    except ValueError as error:
        raise InputError(f"{path} cannot be read as JSON: {error}") from error


def parse_json(text: str | bytes) -> JsonValue:
    """Parse JSON that somebody else wrote.

    Args:
        text: one value; bytes are UTF-8.

    Returns:
        Plain data; every number in it is finite and fits 64 bits.

    Raises:
        ValueError: no JSON, a number that does not exist or is too large, or nested too deeply.
    """
    data = text.encode(errors="surrogatepass") if isinstance(text, str) else text
    if sum(data.count(mark) for mark in (b",", b"[", b"{")) > MAX_JSON_VALUES:
        raise ValueError(f"it holds more than {MAX_JSON_VALUES} values")
    try:
        content: JsonValue = json.loads(text, parse_constant=_refuse_constant, parse_int=_whole, parse_float=_finite)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    _check_depth(content, levels=0)
    return content


def checked(content: JsonValue, kind: type[Content]) -> Content:
    """Check plain data of a JSON file against a type.

    Args:
        content: of :func:`parse_json`.
        kind: a record, a dataclass, or a plain type such as ``tuple[int, int]``.

    Raises:
        ValueError: a key is missing, or a value is of another type; the message names the key.
    """
    text = json.dumps(content, ensure_ascii=False).translate(_PRIVATE)
    try:
        value: Content = _adapter(kind).validate_json(text, strict=True)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise ValueError(f"{place}: {first['msg']}" if place else first["msg"]) from None
    return value


def as_read(content: Mapping[str, object]) -> dict[str, JsonValue]:
    """Return plain data as it comes back from a file: tuples are lists, what is not finite is null."""
    return checked(parse_json(json_text(content)), dict[str, JsonValue])


def _check_depth(content: JsonValue, *, levels: int) -> None:
    if levels > MAX_DEPTH:
        raise ValueError(_TOO_DEEP)
    inner = content.values() if isinstance(content, dict) else content if isinstance(content, list) else ()
    for one in inner:
        _check_depth(one, levels=levels + 1)


def _refuse_constant(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number")


def _whole(digits: str) -> int:
    if len(digits) > len(str(_LARGEST_WHOLE)) or abs(int(digits)) >= _LARGEST_WHOLE:
        raise ValueError("a whole number of more than 64 bits")
    return int(digits)


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits[:20]} is no finite number")
    return value
