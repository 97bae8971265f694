"""Provenance of depth on the page: what matched it, which rig, and what there was to say about a capture."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from telewide.assets import BOX_WEIGHTS
from telewide.errors import TelewideError
from telewide.files import fingerprint, is_file
from telewide.records import read_record
from telewide.stages.call import Call
from telewide.stages.kept_depth import read_lying
from telewide.stages.pair_record import RECORD_NAME, PairRecord
from telewide.stages.rig import lying_rig

_SHOWN = 12
"""Letters of a fingerprint (SHA-256) that are shown; `sha256sum` prints the same ones first."""


def facts_of_call(call: Call) -> dict[str, str]:
    """Tell what a call was on, by the names the page gives it.

    Args:
        call: captures, rig and command.
    """
    told = {"captures": str(call.captures.root)}
    rig_file = call.rig_file or lying_rig(call.captures)
    if call.rig is not None and rig_file is not None:
        told["rig"] = f"{rig_file}, {call.rig.quality.verdict}, {_stamp(rig_file)[:_SHOWN]}"
    told["written"] = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return {**told, "command": call.invocation.again()}


def made_by(folder: Path, *, run_weights: Path) -> str:
    """Tell what matched a capture; empty where no record tells.

    Args:
        folder: where its depth lies.
        run_weights: those of the run folder, which may have made it.
    """
    record = read_lying(folder)
    matcher = None if record is None else record.key.get("matcher")
    if record is None or not isinstance(matcher, str):
        return ""
    method, _, stamp = matcher.partition(" ")
    version = f"telewide {record.key.get('version')}"
    if not stamp:
        return f"Matched by {method}, {version}."
    known = {
        _stamp(run_weights): "trained here",
        _stamp(BOX_WEIGHTS): "the one that comes with telewide",
    }
    return f"Matched by {method} ({known.get(stamp, 'other weights')}, {stamp[:_SHOWN]}), {version}."


def notes_of(name: str, *, depth: Path, pair: Path) -> tuple[str, ...]:
    """Repeat what the terminal said of a capture: doubts about its photos first, then of its depth and its bokeh.

    Args:
        name: of the capture.
        depth: folder of its depth.
        pair: folder of its corrected pair.
    """
    record = read_lying(depth)
    try:
        doubts = read_record(pair / RECORD_NAME, PairRecord).report.reasons
    except TelewideError:  # not there, or corrupt: it is made again
        doubts = ()
    notes = () if record is None else record.shown_notes
    return tuple(dict.fromkeys(note.removeprefix(f"{name}: ") for note in (*doubts, *notes)))


def _stamp(path: Path) -> str:
    """Fingerprint of a file; empty where it cannot be read."""
    try:
        return fingerprint(path) if is_file(path) else ""
    except TelewideError:
        return ""
