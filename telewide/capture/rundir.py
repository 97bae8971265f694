"""The run folder: where everything a run makes is written, and how it is written so that nothing is ever half there.

A file is written under a temporary name in its own folder, flushed to the disk, and renamed over the old one; a run cut
off at any moment leaves the old file or the new one, never a piece. The temporary name says which process writes there:
who writes into a folder next removes what killed ones have left. Layout::

    run/
      run.json          what was run: version, command line, options, fingerprints of the inputs, seconds
      pairs/<name>/     corrected pairs
      train/            checkpoints and the training log
      depth/<name>/     disparity, depth, bokeh, exports
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import platform
import re
import secrets
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from telewide.errors import TelewideError, UsageError

FORMAT = 1
WEIGHTS_NAME = "weights.safetensors"
"""Of the result of a training, in the folder of the training."""
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_TEMPORARY = re.compile(r"\.telewide-(?P<host>[0-9a-f]{8})-(?P<pid>[0-9]+)-[0-9a-f]{12}(\..*)?")
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
        run: the folder the user named, or None for: ``run`` here if it exists, else ``run`` beside the captures if it
            exists, else ``run`` here.
        captures_root: the folder of the captures.

    Returns:
        The run folder; it need not exist yet.

    Raises:
        UsageError: the place is taken by a file.
    """
    here, beside = Path("run"), captures_root.absolute().parent / "run"
    if run is None:
        run = beside if beside.is_dir() and not here.is_dir() else here
    if run.exists() and not run.is_dir():
        raise UsageError(f"{run} is a file; the run folder was expected there", hint="name another folder with --run")
    return RunFolder(run)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write a file so that it appears whole or not at all.

    Creates the folder. The body writes to the path it is given, which has the suffix of `path`; when the body ends
    well that file is flushed to the disk and renamed to `path`, when it fails it is removed and `path` stays as it was.

    Args:
        path: the file to write or to replace.

    Yields:
        The temporary path to write to, in the same folder.

    Raises:
        TelewideError: the disk is full.
        UsageError: the place cannot be written.
    """
    temporary = path.with_name(f".telewide-{_host()}-{os.getpid()}-{secrets.token_hex(6)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(path.parent)
        yield temporary
        _flush_to_disk(temporary)
        temporary.replace(path)
        _flush_folder(path.parent)
    except OSError as error:
        raise _write_error(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def _remove_leftovers(folder: Path) -> None:
    """Remove the temporary files of this machine's dead processes; those of living ones, and of others', stay."""
    with suppress(OSError):  # tidying is not worth a failure
        for entry in folder.iterdir():
            name = _TEMPORARY.fullmatch(entry.name)
            if name and name["host"] == _host() and not _is_running(int(name["pid"])):
                entry.unlink(missing_ok=True)


def _host() -> str:
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _is_running(pid: int) -> bool:
    """Whether a process of this number lives, whoever's it is; in doubt it does."""
    try:
        if os.name != "nt":  # there signal 0 is Ctrl-C
            os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # somebody else's, or no number of a process
        return True
    return True


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all.

    Args:
        path: the file to write or to replace.
        text: its new content.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file's content.

    Args:
        path: the file.

    Returns:
        64 hexadecimal digits.

    Raises:
        UsageError: there is no such file, or it cannot be opened.
    """
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror or error}") from error


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
    write_text(run.run_json, json.dumps(merged, indent=2, ensure_ascii=False, default=str) + "\n")


def _read_record(path: Path) -> dict[str, object]:
    """Return the record so far; a broken one is started anew, since a finished run must not fail on its diary."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        _log.warning("%s cannot be read (%s) and is written anew", path, error)
        return {}
    return record if isinstance(record, dict) else {}


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


def _flush_to_disk(path: Path) -> None:
    # Windows flushes what is open for writing only; elsewhere a file may be read-only, as a link to a locked photo is.
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(folder: Path) -> None:
    """Make the rename itself durable; not every system lets a folder be opened, and the file is safe without it."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _write_error(path: Path, error: OSError) -> TelewideError:
    reason = error.strerror or str(error)
    if error.errno in _FULL:
        return TelewideError(
            f"{path} was not written: {reason}; an older file of that name is unchanged",
            hint="free some space, or name another run folder, and run the command again",
        )
    return UsageError(f"{path} cannot be written: {reason}", hint="name a folder that can be written to")
