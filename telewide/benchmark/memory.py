"""Peak memory of one inference, measured in a process of its own.

    python -m telewide.benchmark.memory '{"matcher": "lite", "precision": "float32", ...}'

The process imports what it needs, makes two views, notes its peak, matches them, and states by how much the peak rose.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from telewide.cores import Device
from telewide.errors import TelewideError
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import Window
from telewide.records import checked, parse_json
from telewide.text import json_text

SGM = "sgm"
_STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class MemoryCase:
    """One inference to be measured.

    Attributes:
        matcher: sgm, or the name of a network.
        precision: float32 or bf16; of no meaning for sgm.
        hw: height and width of the views.
        window: disparities searched, px.
        device: auto, cpu or cuda.
    """

    matcher: str
    precision: str
    hw: tuple[int, int]
    window: Window
    device: Device = "auto"


@dataclass(frozen=True)
class MemoryPeak:
    """Peak memory of one inference.

    Attributes:
        process_bytes: resident memory beyond that of the imports and the two views.
        gpu_bytes: most memory torch held on the GPU, weights included; None without one.
    """

    process_bytes: int
    gpu_bytes: int | None


def measure_peak(case: MemoryCase) -> MemoryPeak:
    """Run one inference in a fresh process and read its peak.

    Raises:
        TelewideError: the process failed, as it does when it runs out of memory.
    """
    command = [sys.executable, "-m", "telewide.benchmark.memory", json_text(asdict(case))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise TelewideError(f"measuring the memory of {case.matcher} failed with code {done.returncode}: {last}")
    return checked(parse_json(done.stdout.splitlines()[-1]), MemoryPeak)


def measure_peak_here(case: MemoryCase) -> MemoryPeak:
    """Run one inference in this process; right only if nothing larger ran in it before."""
    rng = np.random.default_rng(0)
    ref, src = (rng.random((*case.hw, 3), dtype=np.float32) for _ in range(2))
    if case.matcher == SGM:
        before = peak_resident_bytes()
        match_semiglobal(ref, src, window=case.window)
        return MemoryPeak(peak_resident_bytes() - before, None)
    from telewide.benchmark.networks import gpu_peak_bytes, inference_case
    from telewide.matching.inference import choose_device

    before = peak_resident_bytes()
    device = choose_device(case.device)
    match: Callable[[], None] = inference_case(
        case.matcher, (ref, src), window=case.window, device=device, precision=case.precision
    )
    match()
    return MemoryPeak(peak_resident_bytes() - before, gpu_peak_bytes(case.device))


def peak_resident_bytes() -> int:
    """Tell the most memory this process has had in RAM so far; 0 where the system does not tell."""
    # Linux hands ru_maxrss of the parent on to the child it starts; the line of the child itself is right.
    if _STATUS.is_file():
        line = next((line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM:")), "")
        if line:
            return int(line.split()[1]) * 1024
    try:
        import resource
    except ImportError:  # Windows
        return 0

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


if __name__ == "__main__":
    sys.stdout.write(json_text(asdict(measure_peak_here(checked(parse_json(sys.argv[1]), MemoryCase)))) + "\n")
