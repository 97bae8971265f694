"""The log of a training, ``log.jsonl``: losses and judgements, one JSON object a line. Free of torch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from telewide.errors import TelewideError
from telewide.files import parse_json, read_regular

MAX_LOG_BYTES = 1 << 26
_MOST_STRANGE_LINES = 1000


@dataclass(frozen=True)
class LogLine:
    """One line.

    Attributes:
        stage: name of the stage.
        stage_index: its position in the plan.
        step: of the stage.
        losses: by name, their means since the line before; empty on a line of another kind.
        judgement: by name; without those that the held-out matches could not answer.
        text: the line as it was written.
    """

    stage: str
    stage_index: int
    step: int
    losses: Mapping[str, float]
    judgement: Mapping[str, float]
    text: str


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
        line = encoded.decode("utf-8", errors="replace").rstrip("\n")
        n_strange += 1
        if n_strange > _MOST_STRANGE_LINES:
            return
        try:
            entry = parse_json(line)
            if not isinstance(entry, dict):
                continue
            losses, judgement = entry.get("losses", {}), entry.get("judgement", {})
            stage, index, step = entry["stage"], entry.get("stage_index", 0), entry["step"]
            if isinstance(stage, str) and _is_count(index) and _is_count(step):
                n_strange -= 1
                yield LogLine(
                    stage=stage,
                    stage_index=index,
                    step=step,
                    losses=_numbers(losses),
                    judgement=_numbers(judgement),
                    text=line,
                )
        except (ValueError, KeyError, TypeError, AttributeError):
            continue


def _is_count(value: object) -> bool:
    return type(value) is int and value >= 0


def _numbers(plain: Mapping[str, float | None]) -> dict[str, float]:
    """Return the numbers of a mapping; what is unknown is left out."""
    return {name: float(value) for name, value in plain.items() if value is not None}
