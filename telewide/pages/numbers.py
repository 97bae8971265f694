"""Numbers as the pages write them."""

from __future__ import annotations

import math

Number = float | int | str | None


def number_text(value: Number) -> str:
    """Write three figures, which is what such measurements carry; whole numbers stay whole, the unknown is a dash."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, str):
        return value
    if isinstance(value, int) or math.isinf(value) or abs(value) >= 1000:
        return f"{value:.0f}"
    if value != 0 and abs(value) < 1e-3:
        return f"{value:.2e}"
    decimals = max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{value:.{min(decimals, 4)}f}"
