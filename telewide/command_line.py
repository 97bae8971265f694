"""Commands to suggest, as a person would type them."""

from __future__ import annotations

import shlex


def command_line(*words: object, **options: object) -> str:
    """Write a command of telewide, quoted for a shell.

    Args:
        words: subcommand and arguments.
        options: ``run=folder`` gives ``--run folder``, ``bokeh=True`` gives ``--bokeh``; None and False give nothing.

    Returns:
        One line.
    """
    said = ["telewide", *(str(word) for word in words)]
    for name, value in options.items():
        if value is not None and value is not False:
            flag = f"--{name.replace('_', '-')}"
            said += [flag] if value is True else [flag, str(value)]
    return shlex.join(said)
