"""The console that tables, bars and coloured lines are printed with."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from telewide.text import printable, with_options


class TerminalConsole(Console):
    """A console that shows what a terminal would obey, also in the cells of a table."""

    def render_str(self, text: str, **options: object) -> Text:
        """Turn a string into a text with styles; everything that is given as a string comes here."""
        return super().render_str(printable(with_options(text)), **options)  # type: ignore[arg-type]
