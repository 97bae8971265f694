"""What a person sees at a console."""

from __future__ import annotations

import io
import math

from rich.console import Console

from telewide.correction.inspect import PairReport
from telewide.progress import captures_table


def test_the_table_names_captures_as_they_are_called() -> None:
    nan = math.nan
    report = PairReport("beach[red]", 9, nan, nan, nan, None, (nan, nan, nan), nan, nan, "doubtful", ())
    told = Console(file=io.StringIO(), width=200)
    told.print(captures_table([report]))
    assert isinstance(told.file, io.StringIO)
    cells = told.file.getvalue().splitlines()[1].split()
    assert (cells[0], cells[1], cells[-1]) == ("beach[red]", "9", "doubtful")
