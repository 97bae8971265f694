"""Everything that was tried, the calls that try it, and the table of what each gives."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from strangers import further, photos, places, records
from strangers.inputs import Tried, Variant
from strangers.world import state_of

TRIED: tuple[Tried, ...] = (*places.TRIED, *photos.TRIED, *records.TRIED, *further.TRIED)
MOST_SECONDS, MOST_MB = 20, 2048
_TOLD = re.compile(r"^(error|skipped|note|left out)")
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")


@dataclass(frozen=True)
class Given:
    """What a call gave.

    Attributes:
        code: its exit code.
        said: all that it said.
        seconds: of one core.
        megabytes: its peak above what it began with.
        megabytes_in_all: its peak.
    """

    code: int
    said: str
    seconds: float
    megabytes: float
    megabytes_in_all: float

    def line(self, said: str) -> str:
        """The last message, if there are some the last of those with this piece; empty where there was none."""
        lines = [" ".join(line.split()) for line in self.said.splitlines() if line.strip()]
        named = [line for line in lines if said and said in line]
        return (named or [line for line in lines if _TOLD.match(line)] or [""])[-1]


Call = Callable[[str, Path], Given]
"""Runs a command in a folder, in a process of its own."""


def tried(one: Tried, variant: Variant, *, world: Path, call: Call) -> Given:
    """Plant a variant in a copy of a world, call its command there, and look at what must hold of every one.

    Args:
        one: what the variant is of.
        variant: what is planted.
        world: of `strangers.world`, made in ``here`` beside it; it stays as it is.
        call: runs the command.

    Raises:
        AssertionError: another exit code, a traceback, a changed canary, what a terminal obeys, too much of time or
            memory.
    """
    root = world.with_name("here")  # where it was made: records name their photos
    shutil.rmtree(root, ignore_errors=True)
    shutil.copytree(world, root, symlinks=True)
    variant.plant(root)
    before = state_of(root / "canary")
    given = call(variant.command, root)
    told = f"{one.name} ({variant.name}): {given.code}, {given.said[-2000:]}"
    assert given.code == one.code, told
    assert "Traceback" not in given.said, told
    assert one.said in given.said, told
    assert not _OBEYED.search(given.said), told
    assert state_of(root / "canary") == before, told
    assert not (root / "nowhere").exists(), told
    assert given.seconds < MOST_SECONDS, f"{given.seconds} s: {told}"
    assert given.megabytes < MOST_MB, f"{given.megabytes} MB: {told}"
    return given


HEAD = "| input | exit code | line | s | MB |"


def rows(world: Path, *, call: Call) -> Iterator[str]:
    """The rows of the table in docs/reliability.md, as they come, with the most that a variant took.

    Args:
        world: of `strangers.world`.
        call: runs a command.

    Raises:
        AssertionError: after the last row, where some do not give what they must.
    """
    yield f"{HEAD}\n| --- | ---: | --- | ---: | ---: |"
    failures = []
    for one in TRIED:
        try:
            given = [tried(one, variant, world=world, call=call) for variant in one.variants]
        except AssertionError as failure:
            failures.append(str(failure))
            yield f"FAILED: {failure}"
            continue
        line = given[0].line(one.said).replace(f"{world.parent}/", "").replace("|", "/")
        seconds, megabytes = max(each.seconds for each in given), max(each.megabytes_in_all for each in given)
        yield f"{row(one, f'`{line}`' if line else '')} {seconds:.0f} | {megabytes:.0f} |"
    assert not failures, f"{len(failures)} of {len(TRIED)} rows"


def row(one: Tried, line: str) -> str:
    """What a row of the table begins with."""
    return f"| {one.name} | {one.code} | {line} |"
