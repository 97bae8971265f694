"""Devices to compute on: devices by name, processor cores."""

from __future__ import annotations

import os
from typing import Literal

Device = Literal["auto", "cpu", "cuda"]
"""auto takes a GPU where there is one."""


def usable_cores() -> int:
    """Count the cores this process may run on, which containers and ``taskset`` make fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
