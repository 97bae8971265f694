"""The errors a user can cause, each with the exit code the command line gives it.

Exit codes: 0 done, 1 our own fault, 2 usage, 3 bad input, 4 quality gate, 5 a missing part (an extra, a device, space),
130 interrupted, 141 nobody reads what it writes, 143 terminated.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

_OUT_OF_MEMORY = ("Insufficient memory", "can't allocate memory", "CUDA out of memory")


class TelewideError(Exception):
    """A failure a person can act on.

    Args:
        message: what happened, to which file, and what was expected.
        hint: what to do next, or None where the message says it.
    """

    exit_code = 1

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


class UsageError(TelewideError):
    """The command was called wrongly: a path that does not exist, an unknown recipe or option."""

    exit_code = 2


class InputError(TelewideError):
    """A file is there but cannot be used."""

    exit_code = 3


class QualityError(TelewideError):
    """The result was written, marked as not good enough; or by what was measured there can be none."""

    exit_code = 4


class MissingPartError(TelewideError):
    """Something the machine lacks: an extra, a device, space on its disk."""

    exit_code = 5


@contextmanager
def within_memory(what: str, *, hint: str = "use smaller photos") -> Iterator[None]:
    """Let a lack of memory be a problem of what is being computed, such as one capture of many.

    Args:
        what: the message begins with it.
        hint: what takes less.

    Raises:
        InputError: the body asked for more memory than there is.
    """
    try:
        yield
    except Exception as error:
        # OpenCV and torch say so in words of their own.
        if isinstance(error, MemoryError) or any(word in str(error) for word in _OUT_OF_MEMORY):
            raise InputError(f"{what} takes more memory than there is", hint=hint) from error
        raise


def extra_hint(extra: str) -> str:
    """Advice where an extra is not installed; telewide comes as a clone, not from a package index.

    Args:
        extra: its name in pyproject.toml.
    """
    return f"in your clone of telewide, in its environment: pip install -c constraints.txt -e '.[{extra}]'"


def unknown_name(kind: str, name: str, known: Iterable[str], *, listed: str | None = None) -> UsageError:
    """Make the error of a name that nothing has.

    Args:
        kind: of what was named.
        name: as it was given.
        known: names there are; the nearest is told, in any letter case.
        listed: how they are listed; None lists all.
    """
    known = tuple(known)
    by_fold = {one.casefold(): one for one in known}
    nearest = difflib.get_close_matches(name.casefold(), by_fold, n=1)
    hint = f"did you mean {by_fold[nearest[0]]}?" if nearest else None
    return UsageError(f"unknown {kind} {name!r}; known: {listed or ', '.join(known)}", hint=hint)
