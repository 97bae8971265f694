"""The errors a user can cause, each with the exit code the command line gives it.

Exit codes: 0 done, 1 our own fault, 2 usage, 3 bad input, 4 quality gate, 5 missing optional part, 130 interrupted,
141 nobody reads what it writes, 143 terminated.
"""

from __future__ import annotations


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
    """The result was written, marked as not good enough."""

    exit_code = 4


class MissingPartError(TelewideError):
    """An optional part (an extra, a device) is not installed."""

    exit_code = 5


def extra_hint(extra: str) -> str:
    """What to do where an extra is not installed; telewide comes as a clone, not from a package index.

    Args:
        extra: its name in pyproject.toml.
    """
    return f"in your clone of telewide, in its environment: pip install -e '.[{extra}]'"
