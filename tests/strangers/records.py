"""Facts, rigs, recipes, boards, weights, checkpoints and records that strangers hand over."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import torch
import yaml
from safetensors.torch import save_file
from strangers.inputs import Plant, Tried, Variant, each, one
from strangers.world import DEPTH, TINY, TRAIN

from telewide.records import read_json

SHOW = "show phone.yaml"
WEIGHTS = "depth captures --weights w.safetensors"
RECIPE = "train captures --out other --quiet --recipe recipe.yaml"
RUN = f"run captures --out run {TINY}"
ESCAPE = "\x1b]0;owned\x07\x9b2J"
PAIR, DEPTH_JSON = "run/pairs/000/pair.json", "run/depth/000/depth.json"
LOG, TRAINING, STATE = "run/train/log.jsonl", "run/train/training.json", "run/train/state.pt"
SLIPS = {
    "0x_": "0x_",
    "!!int abc": "!!int abc",
    "!!bool x": "!!bool x",
    "a number of 5000 digits": "9" * 5000,
    "100 000 brackets": "[" * 100_000,
    "a list that holds itself": "&a [*a]",
}
LEVELS = "\n".join(["a0: &a0 {x: 1}"] + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 11)])


def written(place: str, text: str | bytes) -> Plant:
    """A file with this content, in the place of what lies there."""
    content = text.encode(errors="surrogateescape") if isinstance(text, str) else text

    def plant(root: Path) -> None:
        (root / place).parent.mkdir(parents=True, exist_ok=True)
        (root / place).write_bytes(content)

    return plant


def rig(change: Callable[[dict[str, dict[str, object]]], object], place: str = "phone.yaml") -> Plant:
    def plant(root: Path) -> None:
        content = yaml.safe_load((root / "phone.yaml").read_text())
        change(content)
        (root / place).write_text(yaml.safe_dump(content))
        (root / "captures" / "captures.yaml").unlink()  # which says that they need none

    return plant


def focal(f_px: float) -> Callable[[dict[str, dict[str, object]]], object]:
    return lambda content: content["tele"].update(fx_px=f_px, fy_px=f_px)


def card(**changes: str) -> Plant:
    """Weights whose metadata say something else."""
    metadata = {"format": "1", "network": "lite", "window": "[0, 64]", "recipe": "{}", "training": "{}", **changes}
    return lambda root: save_file({"x": torch.zeros(3)}, root / "w.safetensors", metadata=metadata)


def record(place: str, change: Callable[[dict[str, object]], object]) -> Plant:
    """A record of the run folder, changed."""

    def plant(root: Path) -> None:
        content = read_json(root / place)
        assert isinstance(content, dict)
        change(content)
        (root / place).write_text(json.dumps(content))

    return plant


def number_in(place: str, key: str, number: float) -> Plant:
    return record(place, lambda content: content[key].update(x=number))  # type: ignore[attr-defined]


def state(change: Callable[[dict[str, object]], object]) -> Plant:
    def plant(root: Path) -> None:
        content = torch.load(root / STATE, weights_only=True)
        change(content)
        torch.save(content, root / STATE)

    return plant


def without_numbers(content: dict[str, dict[str, torch.Tensor]]) -> None:
    content["network"] = {name: value * float("nan") for name, value in content["network"].items()}


def with_lost_moments(content: dict[str, dict[str, dict[int, dict[str, torch.Tensor]]]]) -> None:
    for moments in content["optimiser"]["state"].values():
        moments["exp_avg"] = moments["exp_avg"] * float("nan")


def doubled(levels: int) -> object:
    """A tuple of two tuples of two tuples: small in memory and in a file, endless for who walks through it."""
    content: object = (1.0,)
    for _ in range(levels):
        content = (content, content)
    return content


def last_line(text: str) -> Plant:
    def plant(root: Path) -> None:
        with (root / LOG).open("a") as log:
            log.write(text)

    return plant


def losses(value: object) -> Plant:
    """A log whose first step states another loss."""

    def plant(root: Path) -> None:
        lines = [json.loads(line) for line in (root / LOG).read_text().splitlines()]
        for line in lines:
            if "losses" in line:
                line["losses"] = dict.fromkeys(line["losses"], value)
        (root / LOG).write_text("".join(f"{json.dumps(line)}\n" for line in lines))

    return plant


def vouched(content: bytes) -> Plant:
    """Another depth.npz, of the length that depth.json states."""

    def plant(root: Path) -> None:
        (root / "run/depth/000/depth.npz").write_bytes(content)
        record(DEPTH_JSON, lambda kept: kept["files_bytes"].update({"depth.npz": len(content)}))(root)  # type: ignore[attr-defined]

    return plant


def claiming(n_bytes: int) -> Plant:
    """A depth.npz of a few kB whose arrays claim to be gigabytes."""

    def plant(root: Path) -> None:
        path = root / "run/depth/000/depth.npz"
        side = int((n_bytes / 12) ** 0.5)
        part = np.lib.stride_tricks.as_strided(np.zeros(1, np.float32), (side, side), (0, 0))
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in ("disparity", "confidence", "valid"):
                head = BytesIO()
                np.lib.format.write_array_header_1_0(head, np.lib.format.header_data_from_array_1_0(part))
                archive.writestr(f"{name}.npy", head.getvalue() + bytes(4000))
        vouched(path.read_bytes())(root)

    return plant


def in_yaml(slips: dict[str, str]) -> tuple[Variant, ...]:
    """Each slip in the four files that people write."""
    readers = {
        "captures/captures.yaml": (DEPTH, "notes"),
        "phone.yaml": (SHOW, "notes"),
        "recipe.yaml": (RECIPE, "description"),
        "board.yaml": ("board board.yaml --quiet", "kind"),
    }
    return tuple(
        Variant(f"{name} in {place}", written(place, f"{key}: {slip}\n"), command)
        for place, (command, key) in readers.items()
        for name, slip in slips.items()
    )


def texts(slip: str) -> dict[str, Plant]:
    """A text in the place of each record of a run folder."""
    places = (PAIR, DEPTH_JSON, "run/run.json", LOG)
    return {place: written(place, slip) for place in places}


SLIPPED = in_yaml(SLIPS)
NO_STATE = "training, or is corrupt"
NO_WEIGHTS = "is no weights file of telewide"

RIGS = {
    "1e6": rig(focal(1e6)),
    "1e12": rig(focal(1e12)),
    "10**400": rig(lambda content: content["tele"].update(width_px=10**400)),
}
BELOW_RECIPES = tuple(variant for variant in SLIPPED if "recipe" in variant.name)
BELOW_OTHERS = tuple(variant for variant in SLIPPED if "recipe" not in variant.name)

OF_YAML = (
    Tried("captures.yaml with an escape in a key", one(written("captures/captures.yaml", '"key\\e]0;owned\\a": 1')), 3),
    Tried("notes: 2024-13-45", one(written("captures/captures.yaml", "rectified: true\nnotes: 2024-13-45\n")), 0),
    Tried("!!timestamp x", one(written("captures/captures.yaml", "rectified: true\nnotes: !!timestamp x\n")), 0),
    Tried(
        "0x_, !!int abc, !!bool x, a number of 5000 digits, 100 000 brackets, a list that holds itself, "
        "in captures.yaml, a rig, a board",
        BELOW_OTHERS,
        3,
        "cannot be read as YAML",
    ),
    Tried("the same in a recipe", BELOW_RECIPES, 2, "cannot be read as YAML"),
    Tried(
        "the same after train --set",
        tuple(
            Variant(name, lambda root: None, f"train captures --out other --quiet --set seed={slip}")
            for name, slip in SLIPS.items()
            if " " not in slip and len(slip) < 100
        ),
        2,
        "this is no YAML value",
    ),
    Tried(
        "ten levels of nine aliases each", one(written("captures/captures.yaml", LEVELS)), 3, "more than 50000 values"
    ),
    Tried("f_px: 1.0e+12", one(written("captures/captures.yaml", "f_px: 1.0e+12")), 3, "expected a positive number"),
    Tried("rectified: false, no rig", one(written("captures/captures.yaml", "rectified: false")), 3, "no rig.yaml"),
    Tried(
        "a recipe with stages: 1000000000",
        one(written("recipe.yaml", "train: {stages: 1000000000}"), RECIPE),
        2,
        "stages",
    ),
    Tried(
        "notes and image_pipeline of a rig with escapes",
        one(rig(lambda content: content.update(notes=[ESCAPE], image_pipeline=f"jpeg:{ESCAPE}")), SHOW),
        0,
    ),
    Tried("a rig with fx_px of 1e6 and 1e12, or a width of 10**400, show", each(RIGS, SHOW), 3, "phone.yaml"),
    Tried("the same, depth --rig", each(RIGS, f"{DEPTH} --rig phone.yaml"), 3, "phone.yaml"),
)
OF_WEIGHTS = (
    Tried(
        "weights with the window [0, 4000000], [1, 6] or [0, Infinity]",
        each({window: card(window=window) for window in ("[0, 4000000]", "[1, 6]", "[0, Infinity]")}, WEIGHTS),
        3,
        NO_WEIGHTS,
    ),
    Tried("weights with a recipe of 20 million brackets", one(card(recipe="[" * 20_000_000), WEIGHTS), 3, NO_WEIGHTS),
    Tried("a text as weights", one(written("w.safetensors", "none"), WEIGHTS), 3, "w.safetensors"),
    Tried(
        "state.pt of stage 77, of an optimiser that is a number, with negative or text indices; 4 bytes of pickle",
        each(
            {
                "stage 77": state(lambda content: content.update(stage_index=77)),
                "optimiser": state(lambda content: content.update(optimiser=3)),
                "negative": state(lambda content: content.update(stage_index=-1)),
                "text": state(lambda content: content.update(stage_index="2")),
                "negative moment": state(lambda content: content.update(optimiser={"state": {-1: {}}})),
                "text moment": state(lambda content: content.update(optimiser={"state": {"a": {}}})),
                "4 bytes of pickle": written(STATE, b"K\x01."),
            },
            TRAIN,
        ),
        3,
        NO_STATE,
    ),
    Tried(
        "state.pt whose weights, or moments, are no numbers",
        each({"weights": state(without_numbers), "moments": state(with_lost_moments)}, TRAIN),
        3,
        NO_STATE,
    ),
    Tried(
        "state.pt in which a tuple of 300 bytes names itself 2^40 times, or holds a million others",
        each(
            {
                "2^40": state(lambda content: content.update(judgements=doubled(40))),
                "a million": state(lambda content: content.update(judgements=((),) * 1_000_000)),
            },
            TRAIN,
        ),
        3,
        NO_STATE,
    ),
)
OF_RECORDS = (
    Tried("100 000 brackets in pair.json, depth.json, run.json and log.jsonl", each(texts("[" * 100_000)), 0),
    Tried("the same in training.json, run", one(written(TRAINING, "[" * 100_000), RUN), 3, "training.json is corrupt"),
    Tried(
        "the same in run.json and log.jsonl, run",
        each({place: written(place, "[" * 100_000) for place in ("run/run.json", LOG)}, RUN),
        0,
    ),
    Tried(
        "Infinity and 10**400 in pair.json and depth.json",
        each(
            {
                f"{name} in {place}": number_in(place, key, number)
                for place, key in ((PAIR, "report"), (DEPTH_JSON, "numbers"))
                for name, number in (("Infinity", float("inf")), ("10**400", 10**400))
            }
        ),
        0,
    ),
    Tried("a last line of log.jsonl that is cut off, run", one(last_line('{"stage": "rehe'), RUN), 0),
    Tried("[] or a text as loss in log.jsonl, run", each({"[]": losses([]), "text": losses("none")}, RUN), 0),
    Tried(
        "depth.npz of 13 kB that claims 32 GiB, which depth.json vouches for",
        one(claiming(32 << 30), f"{DEPTH} --bokeh"),
        0,
    ),
    Tried("a garbage depth.npz that depth.json vouches for", one(vouched(b"garbage" * 100), f"{DEPTH} --bokeh"), 0),
)
TRIED = (*OF_YAML, *OF_WEIGHTS, *OF_RECORDS)
