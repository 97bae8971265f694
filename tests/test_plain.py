"""A dataclass written as JSON comes back equal; a value of another type is refused."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from telewide.files import parse_json
from telewide.plain import from_plain
from telewide.text import json_text


@dataclass(frozen=True)
class Sample:
    """One field of each kind."""

    name: str
    n: int
    is_good: bool
    size_px: float
    ratio: float | None
    pair: tuple[float, float]
    notes: tuple[str, ...]
    kind: Literal["a", "b"] | None
    points: NDArray[np.float64] | None = None


GOOD = Sample("x", 3, True, 1.5, None, (1.0, math.nan), ("one", "two"), "a")


def plain(sample: Sample) -> dict[str, object]:
    content = parse_json(json_text(dataclasses.asdict(sample)))
    assert isinstance(content, dict)
    return content


def test_what_was_written_comes_back() -> None:
    again = from_plain(Sample, plain(GOOD))
    assert math.isnan(again.pair[1])
    assert dataclasses.replace(again, pair=(1.0, 2.0)) == dataclasses.replace(GOOD, pair=(1.0, 2.0))
    points = from_plain(Sample, {**plain(GOOD), "points": [[1, 2], [3, 4]]}).points
    np.testing.assert_array_equal(points, [[1.0, 2.0], [3.0, 4.0]])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("name", 3), ("n", True), ("n", 1.5), ("n", "3"), ("is_good", 1), ("size_px", "1"), ("size_px", True)],
        *[("ratio", []), ("pair", [1]), ("pair", 1), ("pair", [1, "2"]), ("notes", "text"), ("notes", [1])],
        *[("kind", "c"), ("points", [[1], [2, 3]]), ("points", "text"), ("other", 1)],
    ],
)
def test_a_value_of_another_type_is_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=r"."):
        from_plain(Sample, {**plain(GOOD), name: value})


def test_a_missing_key_and_something_else_are_refused() -> None:
    for content in ([], None, "text", {key: value for key, value in plain(GOOD).items() if key != "n"}):
        with pytest.raises(ValueError, match=r"expected|missing"):
            from_plain(Sample, content)
