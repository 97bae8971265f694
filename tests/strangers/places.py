"""Links, pipes, and what stands in the way, in run and capture folders that strangers hand over."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from strangers.inputs import Plant, Tried, Variant, each, one
from strangers.world import DEPTH, TINY, TRAIN

IMPORT = "import roll captures"
REFUSED = "nothing is written or removed through links below"


def link(place: str, target: str = "canary") -> Plant:
    """A link in the place of what lies there."""

    def plant(root: Path) -> None:
        path = root / place
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        path.symlink_to(target if len(target) > 255 else root / target)

    return plant


def hidden_run_elsewhere(root: Path) -> None:
    """Where no run folder is, depth keeps its pairs in a hidden one."""
    shutil.rmtree(root / "run")
    link("out/.telewide")(root)


def pipe(place: str) -> Plant:
    def plant(root: Path) -> None:
        path = root / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        os.mkfifo(path)

    return plant


def lost_and_found(root: Path) -> None:
    """Which only root may open; root may open it here too, and finds nothing."""
    (root / "captures" / "lost+found").mkdir(mode=0)


TRIED = (
    Tried(
        "run3/train is a link, train --fresh",
        one(link("run3/train"), f"train captures --fresh --out run3 {TINY}"),
        3,
        REFUSED,
    ),
    Tried(
        "run3/train is a link, train --recipe box --fresh",
        one(link("run3/train"), "train --recipe box --fresh --quiet --out run3"),
        3,
        REFUSED,
    ),
    Tried("run/pairs/000 is a link", one(link("run/pairs/000")), 0, REFUSED),
    Tried("run/depth/000 is a link", one(link("run/depth/000"), f"{DEPTH} --bokeh"), 0, REFUSED),
    Tried("run is a link that nobody named", one(link("run")), 2, "run is a link to"),
    Tried(
        "out/.telewide is a link, depth --out out",
        one(hidden_run_elsewhere, f"{DEPTH} --out out"),
        3,
        REFUSED,
    ),
    Tried("captures/.000.partial is a link, import", one(link("captures/.2024-05-06_07-08-00.partial"), IMPORT), 0),
    Tried(
        "train/log.jsonl is a link to nowhere",
        one(link("other/train/log.jsonl", "nowhere"), f"train captures --out other {TINY}"),
        3,
        "is a link",
    ),
    Tried("state.pt is a link to a file", one(link("run/train/state.pt", "canary/state.pt"), TRAIN), 3),
    Tried(
        "a link whose target is a name of 300 letters, in the place of a photo, a capture or a record",
        each(
            {
                "a photo": link("captures/000/tele.jpg", "x" * 300),
                "a capture": link("captures/004", "x" * 300),
                "a record": link("run/pairs/000/pair.json", "x" * 300),
            }
        ),
        0,
    ),
    Tried("a link to itself in the place of a capture", one(lambda root: (root / "captures/003").symlink_to("003")), 0),
    Tried(
        "a pipe in the place of captures.yaml",
        one(pipe("captures/captures.yaml")),
        3,
        "captures.yaml is a pipe",
    ),
    Tried(
        "a pipe in the place of a record",
        each({place: pipe(place) for place in ("run/run.json", "run/pairs/000/pair.json", "run/depth/000/depth.json")}),
        0,
    ),
    Tried(
        "a pipe in the place of weights or a rig",
        (
            Variant("weights", pipe("w.safetensors"), "depth captures --weights w.safetensors"),
            Variant("a rig", pipe("phone.yaml"), "show phone.yaml"),
        ),
        3,
        "is a pipe",
    ),
    Tried("a pipe in the place of state.pt, train", one(pipe("run/train/state.pt"), TRAIN), 0),
    Tried("captures/lost+found, which the user may not open", one(lost_and_found), 0),
)
