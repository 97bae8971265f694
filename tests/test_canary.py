"""Links and pipes planted in shared run and capture folders: whatever command is called, what they lead to stays.

The canary holds a file of every name that telewide writes. Links lead to it from everywhere below the folders that a
command is given; pipes and links to nowhere stand where records are read.
"""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path
from types import FrameType

import pytest
import typer
from strangers.world import TINY, state_of, write_world

from telewide.cli import main
from telewide.cli.app import app

HANGS_AFTER_S = 600
MARKS = """format: 1
photo_wh: [128, 96]
captures:
  "000":
    planes: {wall: [[10, 10], [60, 10], [60, 60]]}
"""
# Those of one group are read by other commands or in other steps, so that none keeps another from being met.
LINKS = (
    ("run/train",),
    ("run/depth",),
    ("run/pairs", "run/report.html"),
    ("run/pairs/000", "run/train/log.jsonl"),
    ("run/depth/000", "run/train/state.pt", "captures/.telewide-x"),
    ("run/train/training.json", "captures/.000.partial"),
    ("run/train/rehearsal.png", "run/run.json", "captures/000/pair.json"),
)
PIPES = (
    ("captures/captures.yaml",),
    ("rig.yaml",),
    ("captures/000/pair.json", "run/train/log.jsonl"),
    ("captures/001/tele.png", "run/run.json"),
    ("roll/b.jpg", "run/train/training.json"),
    ("run/train/state.pt", "run/pairs/000/pair.json"),
    ("run/train/weights.safetensors", "run/pairs/000/tele.png", "run/depth/000/depth.json"),
)


COMMANDS = (
    "depth captures --method sgm --bokeh --quiet",
    "depth captures --method sgm --run run --out run/depth --quiet",
    f"train captures --fresh {TINY}",
    f"run captures --out run {TINY}",
    "import roll captures --quiet",
    "calibrate captures --from-scenes --f35 54,27 --quiet --out rig.yaml",
    "calibrate captures --quiet --out run/rig.yaml",
    "show rig.yaml",
    "board chessboard_9x6 --out run/board.pdf --quiet",
    "simulate run --captures 1",
    "benchmark matches captures --run run",
    "view run",
)
LONG_COMMANDS = (
    "export-model run --window 0,16 --size 128x64 --out run/telewide.onnx --quiet",
    "benchmark marks captures --marks marks.yaml --run run --sheets run/sheets --json run/run.json",
    "benchmark bokeh captures --run run --json run/run.json",
    "benchmark middlebury captures --split test --run run",
    "benchmark paper --table overall --data captures --systems sgm --out run",
    "benchmark metres --run run --captures 1 --boards 3 --width 96 --keep run/kept --json run/run.json",
    "benchmark speed --matcher sgm --repeats 1 --warm-up 0 --json run/run.json",
)


def first_quick(groups: tuple[tuple[str, ...], ...], n_quick: int) -> list[object]:
    """The first few in the quick tests, the others in the slow ones."""
    return [
        pytest.param(places, id=" ".join(places), marks=[pytest.mark.slow] if at >= n_quick else [])
        for at, places in enumerate(groups)
    ]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory, repo: Path) -> Path:
    """Captures, a roll of their photos, and the canary."""
    root = tmp_path_factory.mktemp("clean")
    write_world(root, rig=repo / "calib" / "rigs" / "example_phone.yaml")
    (root / "marks.yaml").write_text(MARKS)
    return root


def call_every_command(
    root: Path, monkeypatch: pytest.MonkeyPatch, *, commands: tuple[str, ...] = COMMANDS
) -> dict[str, int]:
    """The exit code of each, none of which may hang."""
    monkeypatch.chdir(root)
    monkeypatch.setenv("BROWSER", "true")  # a browser that ends at once
    codes: dict[str, int] = {}

    def stop(signum: int, frame: FrameType | None) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    try:
        for command in commands:
            signal.alarm(HANGS_AFTER_S)
            with pytest.raises(SystemExit) as left:
                main(command.split())
            codes[command] = int(left.value.code or 0)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    return codes


def copied(clean: Path, tmp_path: Path) -> Path:
    root = tmp_path / "shared"
    shutil.copytree(clean, root)
    return root


def test_every_command_is_called() -> None:
    group = typer.main.get_command(app)
    names = {f"benchmark {name}" for name in group.commands["benchmark"].commands} | {*group.commands} - {"benchmark"}
    called = [command.split() for command in COMMANDS + LONG_COMMANDS]
    assert {" ".join(words[: 2 if words[0] == "benchmark" else 1]) for words in called} == names


@pytest.mark.parametrize("places", first_quick(LINKS, 2))
def test_the_canary_behind_a_link_never_changes(
    clean: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, places: tuple[str, ...]
) -> None:
    root = copied(clean, tmp_path)
    target = root / "canary"
    for place in places:
        named = target / Path(place).name
        link = root / place
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(named if named.exists() else target)
    before = state_of(target)
    codes = call_every_command(root, monkeypatch)
    assert state_of(target) == before
    assert set(codes.values()) <= {0, 2, 3, 4}, codes


@pytest.mark.slow
@pytest.mark.parametrize("strange", ["links", "pipes"])
def test_so_it_is_for_the_commands_that_take_long(
    clean: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, strange: str
) -> None:
    """All links, or pipes, at once, where they read a run folder and write."""
    root = copied(clean, tmp_path)
    target = root / "canary"
    places = ("run/run.json", "run/telewide.onnx", "run/sheets", "run/kept", "run/pairs/000", "run/depth/000")
    for place in (*places, "run/train/weights.safetensors", "run/train/training.json", "run/cells", "run/overall"):
        named = target / Path(place).name
        (root / place).parent.mkdir(parents=True, exist_ok=True)
        if strange == "pipes":
            os.mkfifo(root / place)
        else:
            (root / place).symlink_to(named if named.exists() else target)
    before = state_of(target)
    codes = call_every_command(root, monkeypatch, commands=LONG_COMMANDS)
    assert state_of(target) == before
    assert set(codes.values()) <= {0, 2, 3, 4, 5}, codes


@pytest.mark.slow
def test_links_to_nowhere_make_nothing_there(clean: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = copied(clean, tmp_path)
    for place in ("run/train/log.jsonl", "run/run.json", "run/report.html", "run/pairs/001", "captures/.x.partial"):
        (root / place).parent.mkdir(parents=True, exist_ok=True)
        (root / place).symlink_to(root / "nowhere")
    codes = call_every_command(root, monkeypatch)
    assert not (root / "nowhere").exists()
    assert set(codes.values()) <= {0, 2, 3, 4}, codes


@pytest.mark.parametrize("places", first_quick(PIPES, 1))
def test_a_pipe_stops_no_command(
    clean: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, places: tuple[str, ...]
) -> None:
    root = copied(clean, tmp_path)
    for place in places:
        (root / place).parent.mkdir(parents=True, exist_ok=True)
        (root / place).unlink(missing_ok=True)
        os.mkfifo(root / place)
    codes = call_every_command(root, monkeypatch)
    assert set(codes.values()) <= {0, 2, 3, 4}, codes


def test_what_stands_in_the_way_ends_no_command(clean: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files in the places of folders, folders in those of files, links to themselves and with too long a name."""
    root = copied(clean, tmp_path)
    for place in ("run/pairs/000", "run/depth/001", "captures/002", "roll/c"):
        (root / place).parent.mkdir(parents=True, exist_ok=True)
        (root / place).write_text("in the way")
    for place in (
        *("run/pairs/001/pair.json", "run/pairs/001/tele.png", "run/pairs/001/disparity_0_32.pfm", "run/run.json"),
        *("run/depth/000/preview.png", "run/train/state.pt", "run/train/log.jsonl", "run/train/weights.safetensors"),
        *("captures/000/truth.pfm", "roll/d.jpg", "run/report.html"),
    ):
        (root / place).unlink(missing_ok=True)
        (root / place).mkdir(parents=True)
        (root / place / "mine").write_text("in the way")
    for place in ("captures/003", "roll/e.jpg", "roll/f", "captures/001/pair.json"):
        (root / place).symlink_to(Path(place).name)
    for place in ("captures/004", "captures/001/tele.jpg", "captures/x_wide.jpg", "captures/000/pair.json"):
        (root / place).symlink_to("x" * 300)
    for place in ("roll/g.jpg", "roll/h", "run/train/training.json", "run/pairs/000.json"):
        (root / place).symlink_to("x" * 300)
    codes = call_every_command(root, monkeypatch)
    assert set(codes.values()) <= {0, 2, 3, 4}, codes
    assert (root / "run/depth/001").read_text() == "in the way"
    assert (root / "run/depth/000/preview.png/mine").read_text() == "in the way"
