"""JSON that every reader takes."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from telewide.json_text import json_text


@pytest.mark.parametrize("missing", [math.nan, math.inf, -math.inf, np.float64("nan")])
def test_numbers_that_do_not_exist_become_null_wherever_they_stand(missing: float) -> None:
    written = json_text({"a": missing, "b": [1.5, {"c": (missing, 2)}]})
    assert json.loads(written) == {"a": None, "b": [1.5, {"c": [None, 2]}]}


@pytest.mark.parametrize("indent", [None, 2])
def test_what_json_can_hold_comes_back(indent: int | None) -> None:
    value = {"name": "Käse [1]", "is_new": True, "none": None, "values": [1, -2.5, "x"], "inner": {"a": {}}}
    assert json.loads(json_text(value, indent=indent)) == value
    assert "Käse" in json_text(value)
    assert json.loads(json_text({"at": Path("a/b")})) == {"at": "a/b"}
