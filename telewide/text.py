"""Words and numbers as telewide writes them: counts, JSON, commands to type, nothing a terminal obeys."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

# C0 but for tab and line feed, DEL, C1, line and paragraph separators, marks of direction, halves of a surrogate pair.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_LONGEST_WORD = 100
MOST_LINES = 20
"""Without a terminal, a line for each of so many captures or photos, or for every second, third, ... of more."""
_OPTION = re.compile(r"`([a-z][a-z0-9]*(?:_[a-z0-9]+)*)`")


def counted(number: int, noun: str) -> str:
    """Say how many there are: ``1 capture``, ``2 captures``.

    Args:
        number: how many.
        noun: of one of them; its plural is made with an s.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def is_worth_a_line(done: int, total: int) -> bool:
    """Whether a person without a terminal is told that so many of so many are done.

    Args:
        done: how many are.
        total: of how many; 0 where nobody knows.
    """
    every = math.ceil(total / MOST_LINES)
    return every > 0 and (done % every == 0 or done == total)


def first_few(words: Sequence[str], *, most: int = 12) -> str:
    """List some words, and say how many more there are; what other people wrote may be as long as a book.

    Args:
        words: names or keys.
        most: how many are listed.
    """
    shown = ", ".join(shortened(word, most=_LONGEST_WORD) for word in words[:most])
    return f"{shown} and {len(words) - most} more" if len(words) > most else shown


def shortened(text: str, *, most: int = 60) -> str:
    r"""Cut a text that somebody else wrote, and show its line breaks as ``\n``: a message stays one line.

    Args:
        text: of any length.
        most: letters that are shown.
    """
    line = text.replace("\n", "\\n")
    return line if len(line) <= most else line[: most - 3] + "..."


def printable(text: str) -> str:
    r"""Show what a terminal would obey instead of print: control characters (C0, DEL, C1) and marks that turn writing.

    Names of photos, notes of a rig and EXIF come from other people; raw, they could rename the window, clear the screen
    or write to the clipboard.

    Args:
        text: to be shown to a person; line ends and tabs stay.

    Returns:
        The text with ``\x1b`` for an escape character, and so on; bytes of a file name that are no UTF-8 likewise.
    """
    return _UNPRINTABLE.sub(lambda found: _named(found[0]), text)


def _named(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:  # how Python keeps a byte of a file name that is no UTF-8
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def json_text(value: object, *, indent: int | None = None) -> str:
    """Write plain data as JSON.

    Args:
        value: mappings, sequences, texts and numbers; NaN and infinity become null, anything else its text.
        indent: columns a level is indented by; None for one line.
    """
    text = json.dumps(_with_finite_numbers(value), indent=indent, ensure_ascii=False, allow_nan=False, default=str)
    return _UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _with_finite_numbers(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _with_finite_numbers(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_with_finite_numbers(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def with_options(text: str) -> str:
    """Spell the options that a message names as the command line has them.

    Below the commands a message names an option as Python does, in backticks; ```` `square_m` ```` gives
    ``--square-m``.

    Args:
        text: a message, a hint, a note.
    """
    return _OPTION.sub(lambda found: f"--{found[1].replace('_', '-')}", text)


def command_line(*words: object, **options: object) -> str:
    """Write a command of telewide, quoted for a shell.

    Args:
        words: subcommand and arguments.
        options: ``run=folder`` gives ``--run folder``, ``bokeh=True`` gives ``--bokeh``, a sequence gives its option
            once for each value; None and False give nothing.

    Returns:
        One line.
    """
    said = ["telewide", *(str(word) for word in words)]
    for name, value in options.items():
        flag = f"--{name.replace('_', '-')}"
        for one in value if isinstance(value, list | tuple) else (value,):
            if one is not None and one is not False:
                said += [flag] if one is True else [flag, str(one)]
    return shlex.join(said)


@dataclass(frozen=True)
class Invocation:
    """A command as it was typed; the commands that are advised after it keep what it stated.

    Attributes:
        command: its subcommand.
        words: its arguments.
        options: what was stated, by the names of the options (``f_number`` for ``--f-number``).
    """

    command: str
    words: tuple[object, ...] = ()
    options: Mapping[str, object] = field(default_factory=dict)

    def again(self, **changes: object) -> str:
        """Write the same call with other options; None leaves one out."""
        return command_line(self.command, *self.words, **{**self.options, **changes})

    def instead(self, command: str, *words: object, **changes: object) -> str:
        """Write a call of train, depth or run on the same captures, in the same run folder, with the same rig.

        Args:
            command: its subcommand.
            words: its arguments; those of this call where there are none.
            changes: options besides, or in the place of those that both have; None leaves one out.
        """
        if command == self.command:
            return command_line(command, *(words or self.words), **{**self.options, **changes})
        run_option = "run" if command == "depth" else "out"
        mine = "run" if self.command == "depth" else "out"
        shared = {run_option: self.options.get(mine), "rig": self.options.get("rig")}
        if "depth" not in (command, self.command):
            shared |= {name: self.options.get(name) for name in ("recipe", "set", "seed")}
        shared["device"] = self.options.get("device")
        return command_line(command, *(words or self.words), **{**shared, **changes})
