"""Commands to paste into a shell."""

from __future__ import annotations

import shlex
from pathlib import Path

from telewide.command_line import command_line


def test_a_shell_reads_what_was_meant() -> None:
    written = command_line("depth", Path("it's mine/*"), run=Path("my run"), bokeh=True, rig=None, fresh=False)
    assert shlex.split(written) == ["telewide", "depth", "it's mine/*", "--run", "my run", "--bokeh"]
    assert command_line("calibrate", square_m=0.0243, from_scenes=True).endswith("--square-m 0.0243 --from-scenes")
