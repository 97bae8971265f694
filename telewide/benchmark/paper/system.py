"""One system that is compared: what it is given, and what it hands back.

A system gets a task (what it may learn from, how the second view is damaged, a budget) and hands back matchers. One
that learns nothing ignores most of the task, and what it does not see does not count when its cells are kept.
Letters: C channels, H W image.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from telewide.benchmark.damages import Damage, damaged_small_view, damaged_view
from telewide.benchmark.datasets.protocols import Scene
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.cores import Device
from telewide.files import fingerprint
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.matching.window import Window

Tell = Callable[[str], None]
Matcher = Callable[[FloatMap, FloatMap, Window], FloatMap]
"""(ref, src, window) to the filled disparity of ref, px."""
Encoder = Callable[[FloatMap], FloatMap]
"""View to its features, (H, W, C)."""

LAST, BEST = "last", "best"
"""Names of the weights that a system which learns hands back: those of its last step, and those best on validation."""


@dataclass(frozen=True)
class Budget:
    """Length of every training, whatever is trained.

    Attributes:
        minutes: on the machine at hand; no judging counts.
        steps: in all stages together; None goes by the minutes.
    """

    minutes: float
    steps: int | None = None

    def __str__(self) -> str:
        """As a report states it."""
        return f"{self.minutes:g} min" if self.steps is None else f"{self.steps} steps"

    def as_data(self) -> dict[str, JsonValue]:
        """Plain data, by which trainings are kept."""
        return {"minutes": self.minutes} if self.steps is None else {"steps": self.steps}


@dataclass(frozen=True)
class Task:
    """Data, damage and budget that a system is prepared for.

    Attributes:
        training: scenes to learn from; their truth is for supervised systems only.
        validation: scenes to choose weights by; may be empty.
        window: disparities to search in the scenes to learn from, px.
        damage: of the second view.
        factor: how many times fewer pixels it has along each side.
        seed: of weights, samples and what is drawn of the damage.
        budget: of each training.
        device: to compute on.
        weights: files of others to take, by the name of a restorer or of `psmnet`, instead of training it.
    """

    training: tuple[Scene, ...]
    validation: tuple[Scene, ...]
    window: Window
    damage: Damage
    factor: float
    seed: int
    budget: Budget
    device: Device = "auto"
    weights: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)

    def small_view(self, scene: str, truth: StereoTruth) -> FloatImage:
        """Damage the right view of a pair and leave it at the worse camera's own size.

        Args:
            scene: its name, on which depends what is drawn.
            truth: the pair.
        """
        return damaged_small_view(truth.right, self.damage, factor=self.factor, scene=scene, seed=self.seed)


SecondView = Callable[[str, StereoTruth], FloatImage]
"""(scene, sharp pair) to what a system sees as the second view, (H, W, 3)."""


def enlarged_view(task: Task) -> SecondView:
    """Second views of a task as they come, enlarged to the size of the first."""
    return lambda scene, truth: damaged_view(truth.right, task.damage, factor=task.factor, scene=scene, seed=task.seed)


def undamaged_view(_task: Task) -> SecondView:
    """Second views before any damage, which no pair of unequal cameras has."""
    return lambda _scene, truth: truth.right


@dataclass(frozen=True)
class Place:
    """Where a system keeps what it learns.

    Attributes:
        folder: of all systems, shared by processes.
        tell: hears how far it is.
    """

    folder: Path
    tell: Tell


@dataclass(frozen=True)
class Prepared:
    """A system, ready to answer.

    Attributes:
        matchers: by the name of their weights: last and best, or one without a name.
        second_view: what it sees instead of the other view; None for that view enlarged.
        encoder: of a space of features; None for what is none.
        steps: that its training took; None where nothing is trained.
    """

    matchers: Mapping[str, Matcher]
    second_view: SecondView | None = None
    encoder: Encoder | None = None
    steps: int | None = None

    def seen_pair(self, task: Task, scene: str, sharp: StereoTruth) -> StereoTruth:
        """Return a pair as the system sees it.

        Args:
            task: how the second view is damaged.
            scene: name of the scene.
            sharp: the pair.
        """
        return replace(sharp, right=(self.second_view or enlarged_view(task))(scene, sharp))


@dataclass(frozen=True)
class System:
    """One row.

    Attributes:
        name: by which it is asked for.
        title: as it stands in tables.
        prepare: (task, place) to what answers.
        sources: entries (`benchmark.paper.sources`) of what decides its answers; a change there makes its cells anew.
        files: what it reads besides, such as weights; a change makes its cells anew likewise.
        learns: whether training, validation and budget of the task matter.
        facts: what it is made of, as plain data; a change makes its cells anew likewise.
        takes: name of what a task may have weights of others for: its restorer or its network; None for nothing.
    """

    name: str
    title: str
    prepare: Callable[[Task, Place], Prepared]
    sources: tuple[str, ...]
    files: tuple[Path, ...] = ()
    learns: bool = True
    facts: Mapping[str, JsonValue] = field(default_factory=dict)
    takes: str | None = None


def weights_fingerprints(system: System, task: Task) -> list[str]:
    """Fingerprint the weights of others that a system would take.

    Args:
        system: may take some.
        task: names the files.

    Raises:
        UsageError: there is no such file.
        InputError: it cannot be read.
    """
    return [fingerprint(path) for path in task.weights.get(system.takes or "", ())]


def content_fingerprint(truth: StereoTruth) -> str:
    """Fingerprint pictures and truth of a pair."""
    digest = hashlib.sha256()
    for array in (truth.left, truth.right, truth.disparity_px, truth.occluded):
        digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:24]
