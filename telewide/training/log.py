"""The log of a training, ``log.jsonl``: losses and judgements, one JSON object a line. Free of torch."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path

from pydantic import Field

from telewide.errors import TelewideError
from telewide.files import read_regular
from telewide.records import Figure, Record, checked, parse_json

MAX_LOG_BYTES = 1 << 26
_MOST_STRANGE_LINES = 1000


class LogLine(Record):
    """One line.

    Attributes:
        stage: name of the stage.
        stage_index: its position in the plan.
        step: of the stage.
        losses: by name, their means since the line before; empty on a line of another kind.
        judgement: by name; NaN where the held-out matches could not answer.
        seconds: a step took; None on a line of another kind.
    """

    stage: str
    stage_index: int = Field(default=0, ge=0)
    step: int = Field(ge=0)
    losses: dict[str, Figure] = Field(default_factory=dict)
    judgement: dict[str, Figure] = Field(default_factory=dict)
    seconds: Figure | None = None


def read_log(path: Path) -> tuple[LogLine, ...]:
    """Read a log; lines that were cut off, or are something else, are passed over.

    Args:
        path: the log; one that does not exist or cannot be read has no lines, nor what follows a thousand strange ones.
    """
    try:
        data = read_regular(path, most_bytes=MAX_LOG_BYTES)
    except TelewideError:
        return ()
    return tuple(_parsed(BytesIO(data)))


def _parsed(lines: Iterable[bytes]) -> Iterable[LogLine]:
    n_strange = 0
    for encoded in lines:
        try:
            yield checked(parse_json(encoded.decode("utf-8", errors="replace")), LogLine)
        except ValueError:
            n_strange += 1
            if n_strange > _MOST_STRANGE_LINES:
                return
