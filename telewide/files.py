"""Files: written whole or not at all, read without harm.

A file is written under a temporary name in its own folder, flushed to the disk, and renamed over the old one; a run cut
off at any moment leaves the old file or the new one, never a piece. The temporary name says which process writes there:
who writes into a folder next removes what killed ones have left.

Only regular files are opened: a pipe would wait for ever, a device never ends. How large and how deeply nested a file
may be is limited before it is parsed, and whatever goes wrong is one message that names the file.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import platform
import re
import secrets
import shutil
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import TypeVar

from telewide.errors import InputError, MissingPartError, TelewideError, UsageError
from telewide.ranges import MAX_FILE_BYTES

Content = TypeVar("Content")

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_TEMPORARY = re.compile(r"\.telewide-(?P<host>[0-9a-f]{8})-(?P<pid>[0-9]+)-[0-9a-f]{12}(\..*)?")
_MOST_KEPT = 8192
_TOO_NEW_NS = 2_000_000_000


def once_a_file(read: Callable[[Path], Content]) -> Callable[[Path], Content]:
    """Make a reader keep what it read of each file until the file changes.

    A file that was changed a moment ago is read each time: its clock may be too coarse to show the next change.

    Args:
        read: a reader whose results nobody changes.
    """

    @lru_cache(maxsize=_MOST_KEPT)
    def kept(path: Path, identity: tuple[int, ...]) -> Content:
        return read(path)

    @wraps(read)
    def read_once(path: Path) -> Content:
        try:
            seen = path.stat()
        except (OSError, ValueError):  # said by the reader
            return read(path)
        if time.time_ns() - max(seen.st_mtime_ns, seen.st_ctime_ns) < _TOO_NEW_NS:
            return read(path)
        return kept(path, (seen.st_dev, seen.st_ino, seen.st_size, seen.st_mtime_ns, seen.st_ctime_ns))

    return read_once


def open_regular(path: Path) -> io.BufferedReader:
    """Open a regular file for reading; links to one are followed.

    Args:
        path: the file.

    Returns:
        The stream, to be closed by the caller.

    Raises:
        UsageError: there is no such file.
        InputError: it is a folder, a pipe, a socket or a device, is larger than any file that is read (one with holes
            takes no space), or cannot be opened.
    """
    try:
        stream = io.FileIO(path, opener=_open_without_waiting)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise UsageError(f"{path} does not exist") from error
    except IsADirectoryError as error:
        raise InputError(f"{path} is a folder; a file was expected") from error
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        raise InputError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    found = os.fstat(stream.fileno())
    problem = _why_not_read(found)
    if problem is not None:
        stream.close()
        raise InputError(f"{path} {problem}")
    if found.st_size == 0:  # so call themselves files of /proc that have no end, or would be waited for
        stream.close()
        stream = io.FileIO(os.devnull)
    return io.BufferedReader(stream)


def is_file(path: Path) -> bool:
    """Whether a path leads to a regular file; False also where it cannot be told.

    Unlike ``Path.is_file``, which fails on a link with too long a name in it and on one into a closed folder.
    """
    return stat.S_ISREG(_mode_of(path))


def is_folder(path: Path) -> bool:
    """Whether a path leads to a folder; False also where it cannot be told."""
    return stat.S_ISDIR(_mode_of(path))


def is_there(path: Path) -> bool:
    """Whether a path leads to anything; False also where it cannot be told."""
    return _mode_of(path) != 0


def _mode_of(path: Path) -> int:
    """Mode of what a path leads to; 0 where it leads to nothing, or that cannot be told."""
    try:
        return path.stat().st_mode
    except (OSError, ValueError):  # ValueError: a name with a null character
        return 0


def refuse_other_than_folder(path: Path, *, expected: str, hint: str | None = None) -> None:
    """Refuse a path that leads to no folder.

    Args:
        path: as its user named it.
        expected: what should be there, for the message.
        hint: what to do next, where there is more to say.

    Raises:
        UsageError: nothing is there, something else is, or it cannot be told.
    """
    try:
        is_other = not stat.S_ISDIR(path.stat().st_mode)
        found = "is a file"
    except (FileNotFoundError, NotADirectoryError):
        is_other, found = True, "does not exist"
    except (OSError, ValueError) as error:
        is_other, found = True, f"cannot be opened: {getattr(error, 'strerror', None) or error}"
    if is_other:
        raise UsageError(f"{path} {found}; {expected} was expected", hint=hint)


def refuse_strange_file(path: Path) -> None:
    """Refuse what `open_regular` refuses, before a library opens it by its name.

    Args:
        path: the file.

    Raises:
        UsageError: there is no such file.
        InputError: it is no regular file, is too large, or cannot be opened.
    """
    open_regular(path).close()


def _why_not_read(found: os.stat_result) -> str | None:
    if not stat.S_ISREG(found.st_mode):
        return "is a pipe, a socket or a device; a file was expected"
    if found.st_size > MAX_FILE_BYTES:
        return f"has {found.st_size} bytes; files of up to {MAX_FILE_BYTES / (1 << 30):g} GiB are read"
    return None


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a file; opening a pipe would wait for somebody to write into it."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_regular(path: Path, *, most_bytes: int | None = None) -> bytes:
    """Read a regular file.

    Args:
        path: the file.
        most_bytes: a larger file is refused; None for any size.

    Returns:
        Its content.

    Raises:
        UsageError: there is no such file.
        InputError: it is no regular file, is too large, or cannot be read.
    """
    with open_regular(path) as stream:
        try:
            data = stream.read() if most_bytes is None else stream.read(most_bytes + 1)
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    if most_bytes is not None and len(data) > most_bytes:
        raise InputError(f"{path} is larger than {most_bytes} bytes, too large for what it should hold")
    return data


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
        MissingPartError: the disk is full.
        UsageError: the place cannot be written.
    """
    temporary = path.with_name(temporary_name(path.suffix))
    try:
        with changing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            remove_leftovers(path.parent)
            yield temporary
            _flush_to_disk(temporary)
            temporary.replace(path)
            _flush_folder(path.parent)
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def changing(path: Path) -> Iterator[None]:
    """Say what is in the way where a file or folder cannot be written, moved or removed.

    Args:
        path: to be named.

    Raises:
        MissingPartError: the disk is full.
        UsageError: the place cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise _write_error(path, error) from error


def refuse_unwritable(path: Path) -> None:
    """Refuse a file that could not be written, before the work whose result it is to hold.

    Nothing is made. What changes in the meantime is said when the file is written.

    Args:
        path: the file; neither it nor its folder need exist.

    Raises:
        UsageError: the nearest folder of its path that exists is none, or cannot be written to.
    """
    with changing(path):
        nearest = next(place for place in path.absolute().parents if place.exists())
        if not nearest.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, f"{nearest} is no folder")
        if not os.access(nearest, os.W_OK | os.X_OK, effective_ids=os.access in os.supports_effective_ids):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def temporary_name(suffix: str) -> str:
    """Return a name that nobody can foresee and that says which process writes there; it ends in the suffix."""
    return f".telewide-{_host()}-{os.getpid()}-{secrets.token_hex(6)}{suffix}"


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files and folders of this machine's dead processes; those of all others stay."""
    with suppress(OSError):  # tidying is not worth a failure
        for entry in folder.iterdir():
            name = _TEMPORARY.fullmatch(entry.name)
            if name and name["host"] == _host() and not _is_running(int(name["pid"])):
                if entry.is_dir() and not entry.is_symlink():
                    shutil.rmtree(entry)  # follows no links
                else:
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
    """Write a text file in UTF-8, whole or not at all; bytes of file names that are no UTF-8 are written as escapes.

    Args:
        path: the file to write or to replace.
        text: its new content.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


@once_a_file
def fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file's content.

    Args:
        path: the file.

    Returns:
        64 hexadecimal digits.

    Raises:
        UsageError: there is no such file, or it cannot be opened.
        InputError: it is no regular file.
    """
    try:
        with open_regular(path) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror or error}") from error


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
        return MissingPartError(
            f"{path} was not written: {reason}; an older file of that name, if there is one, is unchanged",
            hint="free some space, or name a folder on another disk, and run the command again",
        )
    return UsageError(f"{path} cannot be written: {reason}", hint="name a folder that can be written to")
