"""Numbers of things in sentences."""

from __future__ import annotations

from telewide.counted import counted


def test_one_is_singular_and_no_other_number_is() -> None:
    assert [counted(number, "capture") for number in (0, 1, 2, 11)] == [
        "0 captures",
        "1 capture",
        "2 captures",
        "11 captures",
    ]
    assert counted(1, "new capture") == "1 new capture"
