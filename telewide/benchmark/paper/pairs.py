"""Pairs that systems learn from, written once as a training reads them and shared by all that learn from the same.

OUT/pairs/<fingerprint>/<scene>/{tele,wide,sharp}.png     sharp is wide before any damage
OUT/pairs/<fingerprint>/{truth,surfaces}/<scene>/         disparities, where a system needs them
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pydantic import JsonValue

from telewide.benchmark.datasets.protocols import Scene
from telewide.benchmark.paper.sources import SURVEYING, source_fingerprint
from telewide.benchmark.paper.system import Place, SecondView, Task, content_fingerprint
from telewide.capture.images import write_image
from telewide.capture.layout import Capture
from telewide.capture.pair import read_pair
from telewide.capture.pfm import write_pfm
from telewide.errors import InputError
from telewide.files import is_file, write_text
from telewide.folders import alone_in
from telewide.stages.surfaces import matched_surface, surveying_match
from telewide.training.samples import disparity_path

_DONE = "pairs.json"
Facts = Mapping[str, JsonValue]


@dataclass(frozen=True)
class TrainingPairs:
    """Pairs on disk.

    Attributes:
        captures: tele and the second view as the system sees it.
        undamaged: by the name of a capture, the same with the second view before any damage.
        disparities_folder: truths, or what captures are taken again by; None where none are needed.
        digest: of all that they were made from.
        sizes_hw: of the pictures.
    """

    captures: tuple[Capture, ...]
    undamaged: Mapping[str, Capture]
    disparities_folder: Path | None
    digest: str
    sizes_hw: tuple[tuple[int, int], ...]


def digest_of(facts: Facts) -> str:
    """Fingerprint plain data, short enough for the name of a folder."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:24]


def write_pairs(
    task: Task, place: Place, *, second_view: SecondView, view_facts: Facts, teaches_by: str | None
) -> TrainingPairs:
    """Write the pairs of a task's training scenes, unless they lie there.

    Args:
        task: the scenes.
        place: of everything that is learned.
        second_view: what the system sees as the second view.
        view_facts: all that the second view depends on besides the scenes.
        teaches_by: truth, surfaces (semi-global disparities), surfaces-SURVEYOR (those of the network in the box, as of
            `surveyor_of`), or None.

    Raises:
        InputError: the task has no scenes to learn from, or one cannot be read.
    """
    if not task.training:
        raise InputError("no scene to learn from is there", hint="the protocols of the table say which are taken")
    sharp = {_name(scene): scene.read() for scene in task.training}
    contents: list[JsonValue] = [f"{name} {content_fingerprint(truth)}" for name, truth in sharp.items()]
    is_surveyed = teaches_by is not None and teaches_by != "truth"
    facts: dict[str, JsonValue] = {
        "scenes": contents,
        "window": list(task.window),
        "view": dict(view_facts),
        "sources": source_fingerprint(["benchmark.paper.pairs", *(SURVEYING if is_surveyed else ())]),
    }
    digest = digest_of(facts)
    folder = place.folder / "pairs" / digest
    with alone_in(folder, waiting=place.tell):
        if not is_file(folder / _DONE):
            for scene in task.training:
                place.tell(f"{scene.name}: written to learn from")
                truth = sharp[_name(scene)]
                write_image(folder / _name(scene) / "tele.png", truth.left)
                write_image(folder / _name(scene) / "wide.png", second_view(scene.name, truth))
                write_image(folder / _name(scene) / "sharp.png", truth.right)
                write_pfm(disparity_path(folder / "truth" / _name(scene), window_px=task.window), truth.disparity_px)
            write_text(folder / _DONE, json.dumps(facts) + "\n")
        if teaches_by is not None and is_surveyed:
            _write_surfaces(folder / teaches_by, tuple(sharp), task, place)
    views = partial(_capture, folder)
    return TrainingPairs(
        tuple(views(name, "wide.png") for name in sharp),
        {name: views(name, "sharp.png") for name in sharp},
        None if teaches_by is None else folder / teaches_by,
        digest,
        sizes_hw=tuple((truth.left.shape[0], truth.left.shape[1]) for truth in sharp.values()),
    )


def _name(scene: Scene) -> str:
    """A name that no scene of another set has."""
    return f"{scene.data_set.name}-{scene.name}"


def _capture(folder: Path, name: str, wide: str) -> Capture:
    return Capture(name, folder / name / "tele.png", folder / name / wide)


def _write_surfaces(folder: Path, names: tuple[str, ...], task: Task, place: Place) -> None:
    surveyor = folder.name.removeprefix("surfaces").removeprefix("-")
    match = surveying_match(surveyor, device=task.device)
    for name in names:
        path = disparity_path(folder / name, window_px=task.window)
        if not is_file(path):
            place.tell(f"{name}: matched by {'the network in the box' if surveyor else 'semi-global matching'}")
            pair = read_pair(_capture(folder.parent, name, "wide.png"))
            write_pfm(path, matched_surface(pair, task.window, match=match))
