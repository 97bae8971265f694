"""Devices to compute on: devices by name, processor cores."""

from __future__ import annotations

import ctypes
import os
import platform
import sys
from pathlib import Path
from typing import Literal

Device = Literal["auto", "cpu", "cuda"]
"""auto takes a GPU where there is one."""


def usable_cores() -> int:
    """Count the cores this process may run on, which containers and ``taskset`` make fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processor_name() -> str:
    """Name the processor as the system does."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def return_freed_memory() -> None:
    """Return freed memory to the system, where the C library keeps it: glibc, half a gigabyte after a network."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries on Linux have none
        if trim is not None:
            trim(0)
