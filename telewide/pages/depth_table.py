"""Cost of errors of disparity at a few distances, as a table for the pages about a rig."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

MATCHING_STD_PX = 0.5
"""What matching is taken to be off by, px."""
ROWS_M = (0.5, 1.0, 2.0, 4.0)
"""The distances of the rows."""


def depth_table_html(columns: Mapping[str, Sequence[str]], *, distances: Sequence[str]) -> str:
    """Build the table.

    Args:
        columns: cells by the name of their column, one for each distance.
        distances: names of the rows.

    Returns:
        HTML.
    """
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    rows = "".join(
        f'<tr><th scope="row">{distance}</th>' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>\n"
        for distance, *cells in zip(distances, *columns.values(), strict=True)
    )
    return f"<table><thead><tr><th>distance</th>{head}</tr></thead>\n<tbody>{rows}</tbody></table>"


def depth_error_words(error_m: float, *, depth_m: float) -> str:
    """A deviation of depth as a length and as a share of the distance."""
    length = f"{error_m * 1e3:.1f} mm" if error_m < 0.0995 else f"{error_m:.2f} m"
    return f"&plusmn; {length} ({error_m / depth_m:.1%})"
