"""The record of a training in its run folder, ``training.json``: what it was begun with, and what it may go on with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, JsonValue

from telewide.errors import InputError, UsageError
from telewide.files import fingerprint, is_there
from telewide.matching.window import Window, check_stated_window
from telewide.recipe import Recipe, differing_keys
from telewide.records import Name, Record, read_record, write_record
from telewide.stages.pair_record import RECORD_NAME
from telewide.stages.pairs import PreparedSet
from telewide.stages.run_folder import RunFolder
from telewide.text import first_few

FORMAT = 1
FEWEST_TO_HOLD_OUT = 5
"""With fewer captures a strip of each is held out instead of whole ones."""
MOST_HELD_OUT = 8


def _stated_window(window: Window) -> Window:
    check_stated_window(window)
    return window


class TrainingRecord(Record):
    """Record of what a training was begun with; the file ``training.json``.

    Attributes:
        format: version of the file.
        recipe: resolved recipe as plain data.
        window: disparities of the volume, px.
        captures: names of the captures it has seen or judged by.
        held_out: names of those kept for judging; empty where strips are.
        judged: names of those it is judged by: the held-out ones, or a strip of each that there was at first.
        pairs_sha256: of what each corrected pair was made from, by name; empty where an older version wrote none.
    """

    format: int = FORMAT
    recipe: dict[str, JsonValue]
    window: Annotated[Window, AfterValidator(_stated_window)]
    captures: tuple[Name, ...]
    held_out: tuple[Name, ...]
    judged: tuple[Name, ...] = ()
    pairs_sha256: dict[Name, str] = Field(default_factory=dict)

    def changed_in(self, other: TrainingRecord) -> tuple[str, ...]:
        """Captures of both whose photos, rig or correction are no longer the same."""
        both = self.pairs_sha256.keys() & other.pairs_sha256.keys()
        return tuple(sorted(name for name in both if self.pairs_sha256[name] != other.pairs_sha256[name]))


def read_training(run: RunFolder) -> TrainingRecord | None:
    """The record of the training in a run folder, or None where there is none.

    Raises:
        InputError: the file is corrupt.
    """
    path = run.training_record
    if not is_there(path):
        return None
    try:
        record = read_record(path, TrainingRecord)
    except InputError as error:
        raise InputError(f"{path} is corrupt") from error
    # Older versions did not write who judges.
    return record if record.judged else record.model_copy(update={"judged": record.held_out or record.captures})


def write_training(run: RunFolder, record: TrainingRecord) -> None:
    """Write ``training.json``."""
    write_record(run.training_record, record)


def agreed_record(kept: TrainingRecord | None, prepared: PreparedSet, recipe: Recipe, *, anew: str) -> TrainingRecord:
    """Return the record to go on with, the kept one with what is new; refuse a changed recipe.

    Args:
        kept: of the training that lies there.
        prepared: the pairs.
        recipe: the resolved recipe.
        anew: the command that starts over, to be advised.
    """
    names = tuple(item.capture.name for item in prepared.pairs)
    resolved = recipe.model_dump(mode="json")
    prints = {item.capture.name: fingerprint(item.capture.tele_path.with_name(RECORD_NAME)) for item in prepared.pairs}
    if kept is None:
        held_out = _choose_held_out(names, recipe)
        return TrainingRecord(
            recipe=resolved,
            window=prepared.window_with(None),
            captures=names,
            held_out=held_out,
            judged=held_out or names,
            pairs_sha256=prints,
        )
    refuse_another_recipe(kept, resolved, anew=anew)
    # Held-out captures stay: the judge must not change under a network.
    held_out, judged = (tuple(name for name in of_kept if name in names) for of_kept in (kept.held_out, kept.judged))
    if not judged:
        raise UsageError(
            f"the captures that this training is judged by are no longer there: {first_few(kept.judged)}",
            hint=f"put them back, or start over: {anew}",
        )
    if len(held_out) == len(names):
        raise UsageError(
            f"all captures that are left are held out to judge by, and none to train on: {first_few(names)}",
            hint=f"add captures, or start over: {anew}",
        )
    return TrainingRecord(
        recipe=resolved,
        window=prepared.window_with(kept.window),
        captures=names,
        held_out=held_out,
        judged=judged,
        pairs_sha256=prints,
    )


def refuse_another_recipe(kept: TrainingRecord, resolved: Mapping[str, object], *, anew: str) -> None:
    """Refuse to go on with a training by another recipe than it was begun with.

    Args:
        kept: of the training that lies there.
        resolved: the recipe of now, as plain data.
        anew: how to start over.

    Raises:
        UsageError: naming the keys that differ.
    """
    changed = differing_keys(kept.recipe, resolved)
    if changed:
        raise UsageError(
            f"the training in this run folder was begun with another recipe; these keys differ: {first_few(changed)}",
            hint=f"continue with the same recipe, name another run folder with --out, or start over: {anew}",
        )


def _choose_held_out(names: Sequence[str], recipe: Recipe) -> tuple[str, ...]:
    if len(names) < FEWEST_TO_HOLD_OUT:
        return ()
    count = min(MOST_HELD_OUT, max(1, round(recipe.train.held_out_share * len(names))))
    chosen = np.random.default_rng(recipe.seed).choice(len(names), size=count, replace=False)
    return tuple(names[index] for index in sorted(chosen))
