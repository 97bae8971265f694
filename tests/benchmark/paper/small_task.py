"""A task small enough for a test: two rendered scenes to learn from, one to choose by and one to be judged by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from training.small import rendered

from telewide.benchmark.damages import Damage
from telewide.benchmark.datasets.protocols import Protocol, Scene, select_scenes
from telewide.benchmark.paper.cells import CellPlan
from telewide.benchmark.paper.system import Budget, Place, Task
from telewide.benchmark.paper.systems import SYSTEMS
from telewide.benchmark.paper.tables import Column
from telewide.capture.images import write_image
from telewide.capture.pfm import write_pfm

HW = (96, 144)
WINDOW = (0, 32)
SPLITS = {"training": ("a", "b"), "validation": ("c",), "test": ("d",)}
COLUMN = Column("Own", ("captures",), ("captures",), damage="BIC", factor=2.0)


def write_scenes(root: Path) -> None:
    """Four scenes as captures with truth, the second view undamaged."""
    for seed, name in enumerate("abcd"):
        pair = rendered(seed, hw=HW)
        folder = root / "captures" / name
        write_image(folder / "tele.png", pair.ref)
        write_image(folder / "wide.png", pair.src)
        write_pfm(folder / "truth.pfm", pair.disparity_px)


def scenes_of(root: Path, split: str) -> tuple[Scene, ...]:
    protocol = Protocol(data_sets=("captures",), splits=SPLITS, window_px=WINDOW)
    return select_scenes(protocol, root, split=split).scenes


def task_of(root: Path, *, steps: int, **changes: object) -> Task:
    """A task of a few steps at a factor of 2."""
    settings: dict[str, object] = {
        "training": scenes_of(root, "training"),
        "validation": scenes_of(root, "validation"),
        "window": WINDOW,
        "damage": Damage(),
        "factor": 2.0,
        "seed": 0,
        "budget": Budget(1.0, steps),
        "device": "cpu",
    }
    return Task(**{**settings, **changes})  # type: ignore[arg-type]


def cell_of(root: Path, name: str, task: Task) -> CellPlan:
    return CellPlan(SYSTEMS[name], COLUMN, task, scenes_of(root, "test"))


@dataclass
class Told:
    """Remembers what it is told."""

    lines: list[str] = field(default_factory=list)
    then: Callable[[str], None] | None = None

    def __call__(self, line: str) -> None:
        self.lines.append(line)
        if self.then is not None:
            self.then(line)

    def place(self, folder: Path) -> Place:
        return Place(folder, self)
