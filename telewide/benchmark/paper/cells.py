"""The cells of a table: one system in one column, computed once and kept by the fingerprint of all it depends on.

``OUT/cells/<fingerprint>/cell.json`` holds what was asked and the scores of each scene, ``maps/`` what was found, for
pictures. Several processes, on one
machine or on several with a folder in common, share the cells: each takes those that nobody is at.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
from pydantic import JsonValue

from telewide.benchmark.bokeh_quality import bokeh_quality
from telewide.benchmark.boundaries import boundary_errors, boundary_f1
from telewide.benchmark.damages import Damages, find_damage
from telewide.benchmark.datasets.protocols import Scene, find_protocol, search_window, select_scenes
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.paper.pictures import keep_map
from telewide.benchmark.paper.sources import source_fingerprint
from telewide.benchmark.paper.system import (
    Budget,
    Place,
    System,
    Task,
    Tell,
    content_fingerprint,
    weights_fingerprints,
)
from telewide.benchmark.paper.tables import Column
from telewide.benchmark.report import library_versions
from telewide.benchmark.scores import score_regions
from telewide.benchmark.spaces import space_psnr_db
from telewide.cores import Device
from telewide.errors import TelewideError
from telewide.files import fingerprint
from telewide.folders import alone_in
from telewide.geometry.arrays import FloatMap
from telewide.matching.window import Window, joined_window
from telewide.records import Record, as_read, checked, read_record, write_record

FORMAT = 1
CELL_FILE = "cell.json"
_TEST, _TRAINING, _VALIDATION = "test", "training", "validation"
_EVERY = 8
MEASURING = ("benchmark.paper.cells", "benchmark.datasets.protocols", "benchmark.datasets.truth")
"""Where scores are computed: the window of a scene that states none is read from its truth."""
Row = Mapping[str, object]


class CellRecord(Record):
    """Content of ``cell.json``: what the scores depend on, and a row of them for each scene and region."""

    key: dict[str, JsonValue]
    rows: tuple[dict[str, JsonValue], ...]


class _TakenError(Exception):
    """Another process is at this cell."""


@dataclass(frozen=True)
class CellPlan:
    """One system in one column with one seed.

    Attributes:
        system: what answers.
        column: what is asked.
        task: what the system may learn from.
        scenes: to be judged by.
    """

    system: System
    column: Column
    task: Task
    scenes: tuple[Scene, ...]


@dataclass
class Cells:
    """The kept cells below one folder.

    Attributes:
        out: the folder.
        tell: hears how far it is.
        problems: cells that could not be computed, and why.
    """

    out: Path
    tell: Tell
    problems: list[str] = field(default_factory=list)
    _folders: dict[tuple[str, str, int], Path] = field(default_factory=dict)
    _fingerprints: dict[tuple[str, str, str], str] = field(default_factory=dict)

    def rows(self, plans: Sequence[CellPlan]) -> Iterator[tuple[CellPlan, list[Row]]]:
        """Yield each plan with its rows; a cell that another process is at comes last.

        What cannot be computed is added to the problems, and the others go on.

        Args:
            plans: the cells that are wanted.
        """
        taken = []
        for plan in plans:
            try:
                rows = self._rows(plan, waits=False)
            except _TakenError:
                taken.append(plan)
                continue
            yield plan, rows
        for plan in taken:
            yield plan, self._rows(plan, waits=True)

    def key(self, plan: CellPlan) -> dict[str, object]:
        """Everything the scores of a cell depend on, as plain data."""
        key: dict[str, object] = {
            "format": FORMAT,
            "system": plan.system.name,
            "sources": source_fingerprint([*plan.system.sources, *MEASURING]),
            "files": [fingerprint(path) for path in plan.system.files],
            "facts": dict(plan.system.facts),
            "versions": library_versions(),
            "scenes": [self._fingerprint(scene) for scene in plan.scenes],
            "window": list(plan.scenes[0].protocol.window_px or ()),
            "damage": plan.task.damage.model_dump(mode="json", exclude={"description"}),
            "factor": plan.column.factor,
            "seed": plan.task.seed,
        }
        if plan.system.learns:
            from telewide.benchmark.networks import device_type

            key |= {
                "training": [self._fingerprint(scene) for scene in plan.task.training],
                "validation": [self._fingerprint(scene) for scene in plan.task.validation],
                "training_window": list(plan.task.window),
                "budget": plan.task.budget.as_data(),
                "weights": weights_fingerprints(plan.system, plan.task),
                "device": device_type(plan.task.device),
            }
        return key

    def folder(self, plan: CellPlan) -> Path:
        """Folder of a cell."""
        place = (plan.system.name, plan.column.heading, plan.task.seed)
        if place not in self._folders:
            self._folders[place] = self._folder_of(self.key(plan))
        return self._folders[place]

    def _folder_of(self, key: Mapping[str, object]) -> Path:
        digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:24]
        return self.out / "cells" / digest

    def _rows(self, plan: CellPlan, *, waits: bool) -> list[Row]:
        try:
            return self._kept_or_computed(plan, waits=waits)
        except TelewideError as error:
            self.problems.append(f"{plan.system.title}, {plan.column.heading}: {error.message}")
            return []

    def _kept_or_computed(self, plan: CellPlan, *, waits: bool) -> list[Row]:
        key = self.key(plan)
        folder = self._folder_of(key)
        if (rows := _kept(folder / CELL_FILE, key)) is not None:
            return rows
        folder.mkdir(parents=True, exist_ok=True)
        with alone_in(folder, waiting=self.tell if waits else _give_way):
            if (rows := _kept(folder / CELL_FILE, key)) is not None:  # made by whoever was waited for
                return rows
            write_record(
                folder / CELL_FILE, checked(as_read({"key": key, "rows": self._computed(plan, folder)}), CellRecord)
            )
            return [*read_record(folder / CELL_FILE, CellRecord).rows]  # as whoever reads them later gets them

    def _computed(self, plan: CellPlan, folder: Path) -> list[Row]:
        self.tell(f"{plan.system.title}: {plan.column.heading}")
        prepared = plan.system.prepare(plan.task, Place(self.out, self.tell))
        rows: list[Row] = []
        for scene in plan.scenes:
            sharp = scene.read()
            truth = prepared.seen_pair(plan.task, scene.name, sharp)
            if not np.isfinite(truth.disparity_px).any():
                self.tell(f"{scene.name}: no disparity is known, left out")
                continue
            encoder, window = prepared.encoder, search_window(scene.protocol, truth)
            of_scene = {
                "scene": scene.name,
                "space_psnr_db": space_psnr_db(encoder(sharp.right), encoder(truth.right)) if encoder else math.nan,
                "training_steps": prepared.steps,
            }
            for weights, match in prepared.matchers.items():
                found_px = match(truth.left, truth.right, window)
                keep_map(folder, scene.name, weights, disparity_px=found_px)
                judged = _judged(found_px, truth)
                rows += [{**of_scene, "weights": weights, **row} for row in judged]
        return rows

    def _fingerprint(self, scene: Scene) -> str:
        place = (str(scene.root), scene.name, scene.protocol.model_dump_json())
        if place not in self._fingerprints:
            self._fingerprints[place] = f"{scene.data_set.name}/{scene.name} {content_fingerprint(scene.read())}"
        return self._fingerprints[place]


@dataclass(frozen=True)
class Wanted:
    """Settings that all cells of a table share.

    Attributes:
        data_root: holds the data sets.
        damages: those there are.
        seed: of everything drawn.
        budget: of each training.
        device: to compute on: auto, cpu or cuda.
        weights: files of others to take, by what they are of, instead of training it.
    """

    data_root: Path
    damages: Damages
    seed: int
    budget: Budget
    device: Device = "auto"
    weights: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)


def plan_column(column: Column, systems: Sequence[System], wanted: Wanted) -> tuple[list[CellPlan], list[str]]:
    """Find the scenes of a column and plan its cells.

    Args:
        column: of a table.
        systems: to be asked.
        wanted: where and how.

    Returns:
        The plans, none where the test scenes are not there; and notes on what is missing or stands in for it.

    Raises:
        UsageError: there is no data folder or no such damage.
    """
    name, scenes, notes = _first_there(column.test, wanted.data_root, _TEST)
    if name is None:
        return [], notes
    if name != column.test[0]:
        notes = [f"{column.data_set}: {name} stands in for {column.test[0]}, so published values are of other scenes"]
    training, validation = _learned_from(column, wanted.data_root, tested=scenes)
    window = _joined_window(training or scenes)
    if window is None:
        return [], [*notes, f"{column.data_set} is left out: no disparity of its scenes is known"]
    task = Task(
        training=training,
        validation=validation,
        window=window,
        damage=find_damage(column.damage, wanted.damages),
        factor=column.factor,
        seed=wanted.seed,
        budget=wanted.budget,
        device=wanted.device,
        weights=wanted.weights,
    )
    return [CellPlan(system, column, task, scenes) for system in systems], notes


def _learned_from(
    column: Column, data_root: Path, *, tested: Sequence[Scene]
) -> tuple[tuple[Scene, ...], tuple[Scene, ...]]:
    """Scenes to learn from and to choose weights by, of the first protocol that has any which are not tested.

    A scene is tested at whatever size it is read. Where the protocol has none to choose by, every eighth of those to
    learn from is one.
    """
    seen = {(scene.data_set.origin, scene.name) for scene in tested}

    def fresh(protocol: str, split: str) -> tuple[Scene, ...]:
        _, found, _ = _first_there([protocol], data_root, split)
        return tuple(scene for scene in found if (scene.data_set.origin, scene.name) not in seen)

    for name in column.training:
        training, validation = fresh(name, _TRAINING), fresh(name, _VALIDATION)
        if training and not validation:
            validation = training[_EVERY - 1 :: _EVERY]
            training = tuple(scene for scene in training if scene not in validation)
        if training:
            return training, validation
    return (), ()


def _joined_window(scenes: Sequence[Scene]) -> Window | None:
    """Disparities of all scenes together; None where none is known."""
    windows = [window for scene in scenes if (window := _window_of(scene)) is not None]
    return joined_window(windows) if windows else None


def _window_of(scene: Scene) -> Window | None:
    if scene.protocol.window_px is not None:
        return scene.protocol.window_px
    truth = scene.read()
    return search_window(scene.protocol, truth) if np.isfinite(truth.disparity_px).any() else None


def _judged(estimate_px: FloatMap, truth: StereoTruth) -> list[Row]:
    """Judge a map: a row a region; what is measured on the whole map stands in the row of all pixels only."""
    edges = boundary_errors(estimate_px, truth.disparity_px)
    whole = {
        "edge_accuracy_px": edges.accuracy_px,
        "edge_completeness_px": edges.completeness_px,
        "boundary_f1": boundary_f1(estimate_px, truth.disparity_px),
        "bokeh_psnr_db": bokeh_quality(truth.left, estimate_px, truth.disparity_px).mean_db,
    }
    nothing = dict.fromkeys(whole, math.nan)
    return [
        {"region": region, **asdict(score), **(whole if region == "all" else nothing)}
        for region, score in score_regions(estimate_px, truth).items()
    ]


def _first_there(names: Sequence[str], data_root: Path, split: str) -> tuple[str | None, tuple[Scene, ...], list[str]]:
    """Name and scenes of the first protocol whose split has any; one without splits is a test of all its scenes."""
    notes: list[str] = []
    for name in names:
        protocol = find_protocol(name)
        if split not in protocol.splits and (protocol.splits or split != _TEST):
            continue
        selection = select_scenes(protocol, data_root, split=split if protocol.splits else None)
        if selection.scenes:
            return name, selection.scenes, [*selection.notes]
        notes += [note for note in selection.notes if note not in notes]
    return None, (), notes


def _kept(path: Path, key: Mapping[str, object]) -> list[Row] | None:
    try:
        record = read_record(path, CellRecord)
    except TelewideError:
        return None
    return [*record.rows] if record.key == as_read(key) else None


def _give_way(_message: str) -> NoReturn:
    raise _TakenError
