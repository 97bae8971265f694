"""Folders that somebody else may have prepared, or is writing to: no link in them is followed, one command at a time.

A shared run folder may hold links that lead out of it. Below the folder that a user named nothing is written or removed
through one.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from telewide.errors import InputError
from telewide.files import changing, is_file, is_there, read_regular, remove_leftovers, temporary_name, write_text

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def refuse_links(root: Path, path: Path) -> None:
    """Refuse a path that is reached by a link.

    Args:
        root: the folder its user named; it may be a link itself.
        path: below it; it need not exist.

    Raises:
        InputError: one of the folders below the root is a link.
    """
    place = root
    for part in path.relative_to(root).parts:
        place = place / part
        if place.is_symlink():
            raise InputError(
                f"{place} is a link; nothing is written or removed through links below {root}",
                hint=f"remove the link, or name another folder than {root}",
            )


def append_line(path: Path, line: str) -> None:
    """Append a line to a file of a folder that exists; it is made where it is not there.

    A file that has another name elsewhere, as in a backup of hard links, is copied first: that one stays as it is.

    Args:
        path: the file.
        line: without its end.

    Raises:
        InputError: it is a link.
        MissingPartError: the disk is full.
        UsageError: it cannot be written.
    """
    if path.is_symlink():
        raise InputError(f"{path} is a link; nothing is written through links", hint="remove the link")
    # A pipe, which has no writer to wait for, is no regular file either.
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    with changing(path):
        if is_file(path) and path.stat().st_nlink > 1:
            write_text(path, read_regular(path).decode("utf-8", errors="replace"))
        descriptor = os.open(path, flags, 0o666)
        with os.fdopen(descriptor, "a", encoding="utf-8") as stream:
            stream.write(f"{line}\n")


@contextmanager
def fresh_folder(parent: Path) -> Iterator[Path]:
    """Make a new folder to be filled and renamed; what is left of it in the end is removed.

    Args:
        parent: is made where it is not there; what killed processes have left there is removed.

    Yields:
        The folder, of a name nobody can have foreseen.

    Raises:
        MissingPartError: the disk is full.
        UsageError: the place cannot be written.
    """
    folder = parent / temporary_name(".partial")
    with changing(parent):
        parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(parent)
        folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)  # follows no links


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder, which is removed in the end, with the parents made for it, where nothing was written into it.

    Args:
        folder: may be there already; then it stays.

    Raises:
        OSError: it cannot be made.
    """
    made = [place for place in (folder, *folder.parents) if not is_there(place)]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):
            for place in made:
                place.rmdir()  # only where nothing was written


@contextmanager
def alone_in(folder: Path, *, waiting: Callable[[str], None]) -> Iterator[None]:
    """Work in a folder while no other telewide does; wait for one that does.

    Args:
        folder: is made where it is not there.
        waiting: is told when there is something to wait for.

    Raises:
        MissingPartError: the disk is full.
        UsageError: the folder cannot be made.
    """
    with ExitStack() as held:
        with changing(folder):
            held.enter_context(made_folder(folder))
            descriptor = os.open(folder, os.O_RDONLY)
        held.callback(os.close, descriptor)  # ends the lock, as the end of the process does
        _lock(descriptor, folder, waiting)
        yield


def _lock(descriptor: int, folder: Path, waiting: Callable[[str], None]) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        waiting(f"another telewide works in {folder}; waiting until it is done")
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    except OSError:  # a file system without locks
        return
