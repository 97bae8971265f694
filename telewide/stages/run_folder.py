"""The run folder: where everything a run makes is written, file by file whole or not at all.

Its layout::

    run/
      run.json          what was run: version, command line, options, fingerprints of the inputs, seconds
      pairs/<name>/     corrected pairs
      train/            checkpoints and the training log
      depth/<name>/     disparity, depth, bokeh, exports
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from telewide.errors import TelewideError, UsageError
from telewide.files import fingerprint, is_folder, is_there, write_text
from telewide.folders import refuse_links
from telewide.records import read_json
from telewide.text import json_text
from telewide.training.options import WEIGHTS_NAME

FORMAT = 1
_log = logging.getLogger("telewide")


@dataclass(frozen=True)
class RunFolder:
    """The places inside one run folder; nothing is created by naming them.

    Attributes:
        root: the folder the user named.
    """

    root: Path

    @property
    def pairs(self) -> Path:
        """Folder of the corrected pairs, one folder each."""
        return self.root / "pairs"

    @property
    def train(self) -> Path:
        """Folder of checkpoints and of the training log."""
        return self.root / "train"

    @property
    def weights(self) -> Path:
        """The result of the training so far."""
        return self.train / WEIGHTS_NAME

    @property
    def training_record(self) -> Path:
        """Recipe, window and captures that the training was begun with."""
        return self.train / "training.json"

    @property
    def training_log(self) -> Path:
        """Losses and judgements of the training, one JSON object a line."""
        return self.train / "log.jsonl"

    @property
    def depth(self) -> Path:
        """Folder of the results, one folder per capture."""
        return self.root / "depth"

    @property
    def run_json(self) -> Path:
        """The record of what was run."""
        return self.root / "run.json"


def locate_run(run: Path | None, captures_root: Path) -> RunFolder:
    """Find the run folder that belongs to a capture folder.

    Args:
        run: the folder the user named, or None for ``run`` here, or beside the captures where only there one is.
        captures_root: the folder of the captures.

    Returns:
        The run folder; it need not exist yet.

    Raises:
        UsageError: the place is taken by a file, or by a link that nobody named.
    """
    here, beside = Path("run"), captures_root.absolute().parent / "run"
    if run is None:
        linked = next((place for place in (here, beside) if place.is_symlink()), None)
        if linked is not None:
            target = linked.readlink()
            raise UsageError(f"{linked} is a link to {target}", hint="name the run folder itself")
        run = beside if is_folder(beside) and not is_there(here) else here
    if is_there(run) and not is_folder(run):
        raise UsageError(f"{run} is a file; the run folder was expected there", hint="name another one")
    return RunFolder(run)


def locate_run_of_depth(run: Path | None, captures_root: Path, *, out: Path | None) -> Path | None:
    """Find the run folder of a depth call; one with a folder of its own for the results needs none.

    Args:
        run: the folder the user named, or None.
        captures_root: the folder of the captures.
        out: folder for the results, or None for the run's.

    Returns:
        The folder; a hidden one among the results where no run folder is needed.

    Raises:
        UsageError: see `locate_run`.
        InputError: the hidden one is a link.
    """
    if run is not None or out is None or is_there(locate_run(None, captures_root).root):
        return run
    hidden = out / ".telewide"
    refuse_links(out, hidden)
    return hidden


def write_run_record(
    run: RunFolder,
    *,
    command: str,
    options: Mapping[str, object],
    inputs: Sequence[Path],
    timings: Mapping[str, float],
) -> None:
    """Record one command in ``run.json``, leaving the records of the other commands as they are.

    Args:
        run: the run folder.
        command: name of the command; an older record of the same command is replaced.
        options: the resolved options, seeds among them.
        inputs: the files read; kept with their SHA-256, by their path relative to the run folder.
        timings: seconds by stage.
    """
    record = _read_record(run.run_json)
    commands = record.get("commands")
    entry = {
        "version": _version(),
        "argv": list(sys.argv),
        "finished_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "options": dict(options),
        "inputs_sha256": {_relative(path, run.root): fingerprint(path) for path in inputs},
        "timings_s": {stage: round(float(seconds_s), 3) for stage, seconds_s in timings.items()},
    }
    others = commands if isinstance(commands, dict) else {}
    merged = {**record, "format": FORMAT, "commands": {**others, command: entry}}
    write_text(run.run_json, json_text(merged, indent=2) + "\n")


def _read_record(path: Path) -> dict[str, object]:
    """Return the record so far; a corrupt one is started anew: a finished run must not fail because of it."""
    if not is_there(path):
        return {}
    try:
        record = read_json(path)
    except TelewideError as error:
        _log.warning("%s; it is written anew", error.message)
        return {}
    return {**record} if isinstance(record, dict) else {}


def _relative(path: Path, root: Path) -> str:
    try:
        return Path(os.path.relpath(path, root)).as_posix()
    except ValueError:  # another drive
        return path.absolute().as_posix()


def _version() -> str:
    try:
        return metadata.version("telewide")
    except metadata.PackageNotFoundError:
        return "unknown"
