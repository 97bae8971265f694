"""Disparity windows: which disparities a volume holds. Free of torch, for recipes and for semi-global matching.

A window ``[d_min, d_max)`` has one plane every ``VOLUME_STEP_PX`` px of the full-size image and may be negative.
"""

from __future__ import annotations

VOLUME_STEP_PX = 4
Window = tuple[int, int]


def check_window(window: Window) -> None:
    """Refuse a disparity window the volume cannot hold.

    Raises:
        ValueError: unless d_min < d_max and both are multiples of the volume's step.
    """
    d_min, d_max = window
    if d_min >= d_max or d_min % VOLUME_STEP_PX or d_max % VOLUME_STEP_PX:
        raise ValueError(f"disparity window {window}: expected d_min < d_max, multiples of {VOLUME_STEP_PX} px")
