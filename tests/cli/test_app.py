"""The command line as a program sees it: exit codes, what goes to which stream, what a message names."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import yaml
from capture.roll import TELE, WIDE, exif_of, write_photo

from telewide.assets import BOX_WEIGHTS
from telewide.capture.images import write_image
from telewide.cli import main
from telewide.cli.progress import ConsoleObserver
from telewide.cli.stopping import UNREAD
from telewide.simulate.captures import write_captures

COMMANDS = ("import", "board", "calibrate", "show", "train", "depth", "run", "export-model", "simulate")


def run_cli(*words: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(words)
    return int(left.value.code or 0)


@pytest.fixture
def captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two tiny captures in the folder the commands take by themselves."""
    write_captures(tmp_path / "captures", count=2, seed=5, hw=(96, 144), factor=2)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "captures"


def state(captures: Path, **facts: object) -> None:
    path = captures / "captures.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **facts}))


def refused(capsys: pytest.CaptureFixture[str], *words: str, code: int, names: tuple[str, ...]) -> None:
    """The command ends with a code, says the names on standard error, and nothing on standard output."""
    assert run_cli(*words) == code
    told = capsys.readouterr()
    assert told.out == ""
    assert [name for name in names if name not in told.err] == []
    assert "Traceback" not in told.err


def test_help_names_every_command_and_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("--help") == 0
    told = capsys.readouterr().out
    assert [command for command in COMMANDS if command not in told] == []
    assert "Example" in told


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_shows_an_example_that_parses(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli(command, "--help") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert f"Example: telewide {command}" in told
    options = re.findall(r"--[a-z-]+", told[told.index("Example:") :])
    listed = told[: told.index("Example:")]
    assert [option for option in options if option not in listed] == []


def test_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("--version") == 0
    assert capsys.readouterr().out.strip() == metadata.version("telewide")


def test_as_a_program_without_a_terminal_or_colour() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "telewide", "depth", "nowhere", "--json"],
        capture_output=True,
        text=True,
        env={"NO_COLOR": "1", "TERM": "dumb", "PATH": ""},
        check=False,
    )
    assert done.returncode == 2
    assert json.loads(done.stdout)["exit_code"] == 2
    assert "\x1b" not in done.stdout + done.stderr


@pytest.mark.parametrize("command", ["train", "depth", "run"])
def test_captures_that_do_not_exist(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(capsys, command, "nowhere", code=2, names=("nowhere does not exist",))
    refused(capsys, command, code=2, names=("captures does not exist",))


@pytest.mark.parametrize("words", [("train",), ("depth",), ("depth", "--method", "sgm"), ("run",)])
def test_photos_straight_from_a_phone_are_calibrated_first(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, lens, second in (("T1", TELE, 0.0), ("W1", WIDE, 1.3)):
        write_photo(tmp_path / "DCIM" / f"{name}.jpg", exif=exif_of(**lens, second=second))  # type: ignore[arg-type]
    monkeypatch.chdir(tmp_path)
    assert run_cli("import", "DCIM", "captures", "--quiet") == 0
    names = (
        "no rig.yaml",
        "telewide calibrate boards --out captures/rig.yaml",
        "telewide calibrate captures --from-scenes --out captures/rig.yaml",
        "rectified: true",
    )
    refused(capsys, *words, code=3, names=names)
    assert not Path("run").exists()
    Path("captures/captures.yaml").write_text("rectified: true\n")
    assert run_cli(*words) != 0  # tiny photos, but they are looked at
    assert "no rig.yaml" not in capsys.readouterr().err


def test_pairs_without_matches_and_without_a_rig_are_sent_to_the_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    for name in ("tele", "wide"):
        write_image(tmp_path / "captures" / "one" / f"{name}.png", rng.random((120, 160, 3)).astype(np.float32))
    monkeypatch.chdir(tmp_path)
    names = ("telewide calibrate captures --from-scenes", "one: 0 consistent matches")
    for words in (("depth", "--method", "sgm"), ("run", "--recipe", "quick")):
        refused(capsys, *words, code=3, names=names)


def test_unknown_recipe_names_the_nearest(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, "train", "--recipe", "quik", code=2, names=("quik", "did you mean quick?"))


def test_unknown_choice_names_the_nearest(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["depth", "--method", "smg", "--json"])
    assert left.value.code == 2
    told = capsys.readouterr()
    for text in (" ".join(told.err.split()), json.loads(told.out)["error"]):
        assert "'smg' is not one of 'network', 'sgm'. Did you mean sgm?" in text
        assert "Value error" not in text


@pytest.mark.parametrize(("device", "meant"), [("gpu", "cuda"), ("GPU", "cuda"), ("cpus", "cpu"), ("tpu", "cpu")])
def test_a_device_is_known_by_its_other_name(device: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["depth", "--device", device])
    assert f"Did you mean {meant}?" in " ".join(capsys.readouterr().err.split())


def test_a_photo_instead_of_the_folder_is_answered_with_the_call_that_works(
    captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo = next((captures / "001").glob("tele.*"))
    words = ("depth", str(photo.relative_to(captures.parent)), "--method", "sgm", "--out", "my depth")
    one = "telewide depth captures/001 --method sgm --out 'my depth'"
    refused(capsys, *words, code=2, names=(f"{Path(words[1])} is a file", f"name the folder that holds it: {one}\n"))
    assert run_cli(*shlex.split(one)[1:], "--quiet") == 0


def test_a_second_folder_of_captures_names_the_option_that_chooses(
    captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(["depth", "captures/000", "captures/001"])
    assert left.value.code == 2
    assert "--only NAME" in " ".join(capsys.readouterr().err.split())


def test_unknown_setting_names_the_nearest_key(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("train", "--set", "train.rehearsal.step=3")
    refused(capsys, *words, code=2, names=("train.rehearsal.step", "did you mean train.rehearsal.steps?"))


def test_unknown_key_in_captures_yaml_names_the_nearest(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    state(captures, baseline_mm=10)
    refused(capsys, "depth", "--method", "sgm", code=3, names=("baseline_mm", "baseline_m", "captures.yaml"))


def test_depth_without_a_training_is_of_the_network_in_the_box(
    captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And the way to make it better is said, as this call would be typed."""
    captures.rename("my pairs")
    assert run_cli("depth", "my pairs", "--out", "d1") == 0
    told = capsys.readouterr().err
    assert "network that comes with telewide" in told
    assert "telewide train 'my pairs'" in told
    assert not Path("run").exists()
    assert run_cli("depth", "my pairs", "--out", "d1", "--bokeh") == 0
    assert "matched by" not in capsys.readouterr().err, "its depth lies there"
    assert run_cli("depth", "my pairs", "--out", "d2", "--weights", str(BOX_WEIGHTS)) == 0
    for made in sorted(Path("d1").glob("*/disparity.pfm")):
        assert made.read_bytes() == (Path("d2") / made.parent.name / made.name).read_bytes()


def test_a_call_that_fails_on_all_captures_matches_nothing_and_leaves_no_folder(
    captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder that was there before stays."""
    for photo in captures.glob("*/wide.*"):
        photo.write_bytes(photo.read_bytes()[:300])
    Path("mine").mkdir()
    for out in ("new/deep", "mine"):
        assert run_cli("depth", "--out", out) == 3
        assert "matched by" not in capsys.readouterr().err
    assert run_cli("depth") == 3
    assert sorted(path.name for path in Path().iterdir()) == ["captures", "mine"]
    assert not list(Path("mine").iterdir())


def test_weights_that_are_missing_or_something_else(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, "depth", "--weights", "no.safetensors", code=2, names=("no.safetensors",))
    Path("odd.safetensors").write_bytes(b"something else")
    refused(capsys, "depth", "--weights", "odd.safetensors", code=3, names=("odd.safetensors", "train a network"))


@pytest.mark.parametrize("words", [("depth", "--method", "sgm", "--bokeh"), ("run", "--recipe", "quick")])
class TestBokehIsCheckedFirst:
    def test_f_number_needs_the_baseline(
        self, words: tuple[str, ...], captures: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        names = ("baseline_m", "--strength")
        refused(capsys, *words, "--f-number", "1.8", code=2, names=names)
        assert not Path("run").exists()

    def test_focus_outside_the_photo(
        self, words: tuple[str, ...], captures: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        refused(capsys, *words, "--focus", "144,10", code=2, names=("144,10", "144 x 96 px", "0 to 143"))
        assert not Path("run").exists()

    def test_focus_that_is_no_point(
        self, words: tuple[str, ...], captures: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        refused(capsys, *words, "--focus", "nearby", code=2, names=("nearby", "X,Y", "near", "far", "auto"))

    def test_two_strengths(self, words: tuple[str, ...], captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
        both = ("--strength", "4", "--f-number", "2")
        refused(capsys, *words, *both, code=2, names=("--f-number", "--strength"))
        refused(capsys, *words, "--strength", "-1", code=2, names=("--strength", "above 0"))


@pytest.mark.parametrize(
    "words", [("train", "--device", "tpu"), ("depth", "--method", "magic"), ("depth", "--nonsense"), ("depht",)]
)
def test_words_that_mean_nothing(words: tuple[str, ...], captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, *words, code=2, names=(words[-1],))


def test_missing_cuda(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import torch

    if torch.cuda.is_available():
        pytest.skip("a CUDA device is here")
    refused(capsys, "train", "--device", "cuda", code=5, names=("CUDA", "--device cpu"))


def test_training_says_how_to_go_on_from_it(
    captures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from telewide.stages.train import TrainOutcome

    done = TrainOutcome(Path("weights.safetensors"), False, {}, "feature-1")
    monkeypatch.setattr("telewide.pipeline.train_captures", lambda *_, **__: done)
    assert run_cli("train", "my captures", "--out", "my run", "--rig", "phone rig.yaml") == 0
    advised = "next: telewide depth 'my captures' --run 'my run' --rig 'phone rig.yaml' --bokeh"
    assert advised in capsys.readouterr().err.splitlines()
    assert run_cli("train") == 0
    assert "next: telewide depth captures --bokeh" in capsys.readouterr().err.splitlines()


def test_a_training_of_another_recipe_is_answered_with_the_call_that_starts_over(
    captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--fresh is an option of train alone; the rest of the call is kept."""
    few = ("--set", "train.rehearsal.steps=0", "--set", "train.feature.steps=0", "--set", "train.photometric.steps=1")
    crops = ("--set", "train.crop_hw=[64, 64]", "--set", "train.photometric.captured=1", "--set", "train.stages=0")
    assert run_cli("train", "--out", "my run", *few, *crops, "--seed", "1", "--quiet") == 0
    capsys.readouterr()

    def answered(code: int, name: str) -> None:
        for words, recipe in ((("train",), ""), (("run", "--recipe", "quick"), " --recipe quick")):
            anew = f"start over: telewide train captures --out 'my run'{recipe} --seed 2 --fresh\n"
            refused(capsys, *words, "--out", "my run", "--seed", "2", code=code, names=(name, anew))

    answered(2, "another recipe")
    (Path("my run") / "train" / "training.json").write_text("{")
    answered(3, "corrupt")
    (Path("my run") / "train" / "state.pt").write_bytes(b"torn")
    (Path("my run") / "train" / "training.json").unlink()
    answered(3, "state.pt")


def layouts(folder: Path, kind: str) -> tuple[Path, str]:
    """The captures of a folder in another layout, and the name of the first."""
    for capture in sorted(path for path in folder.iterdir() if path.is_dir()):
        for view in ("tele", "wide"):
            photo = next(capture.glob(f"{view}.*"))
            if kind == "suffix":
                photo.rename(folder / f"{capture.name}_{photo.name}")
            elif kind == "views":
                (folder / view).mkdir(exist_ok=True)
                photo.rename(folder / view / f"{capture.name}{photo.suffix}")
    return folder, "000"


@pytest.mark.parametrize("kind", ["folders", "suffix", "views"])
def test_a_distance_can_be_stated_in_every_layout(
    kind: str, captures: Path, capsys: pytest.CaptureFixture[str], repo: Path
) -> None:
    """The command that is advised names one capture, whatever the layout, and gets as far as the photo's border."""
    folder, name = layouts(captures, kind)
    words = ("depth", folder.name, "--method", "sgm", "--out", "my depth", "--distance", "5000,5,2")
    one = f"telewide depth captures --method sgm --distance 5000,5,2 --out 'my depth' --only {name}\n"
    state(captures, rectified=None)
    shutil.copy(repo / "calib" / "rigs" / "example_phone.yaml", captures / "rig.yaml")
    refused(capsys, *words, code=2, names=(f"name one: {one}",))
    refused(capsys, *shlex.split(one)[1:], code=2, names=("the point 5000,5 lies outside the tele photo",))
    refused(capsys, "run", "captures", "--distance", "5,5,2", code=2, names=(f"telewide depth captures --only {name}",))
    (captures / "rig.yaml").unlink()
    state(captures, rectified=True)
    refused(capsys, "depth", "--only", "00", code=2, names=("no capture 00", "000"))
    refused(capsys, "depth", "--only", "000,001", code=2, names=("the option once more: 000, 001",))
    assert run_cli("depth", "--method", "sgm", "--only", "001", "--json") == 0
    assert [capture["name"] for capture in json.loads(capsys.readouterr().out)["captures"]] == ["001"]


@pytest.mark.parametrize(("rectified", "hint"), [(None, "telewide calibrate boards"), (True, "state baseline_m, f_px")])
def test_a_distance_without_a_rig_is_refused_with_a_way_that_leads_on(
    captures: Path, capsys: pytest.CaptureFixture[str], *, rectified: bool | None, hint: str
) -> None:
    """Of two captures and of one alike; photos that are stated to be rectified could use no rig."""
    state(captures, rectified=rectified)
    for only in ((), ("--only", "000")):
        words = ("depth", *only, "--method", "sgm", "--distance", "5,5,2")
        refused(capsys, *words, code=2, names=("--distance pins a rig", hint))


def test_what_is_less_than_asked_for_is_said_quietly_too_and_stands_in_the_answer(
    captures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from telewide.stages.depth import DepthRun

    def warns(*_: object, observer: ConsoleObserver, **__: object) -> DepthRun:
        observer.said("worth a line")
        observer.warned("the rig is marked insufficient")
        return DepthRun(Path("run/depth"), (), ())

    monkeypatch.setattr("telewide.pipeline.depth_captures", warns)
    assert run_cli("depth", "--method", "sgm", "--quiet", "--json") == 0
    told = capsys.readouterr()
    assert told.err.splitlines() == ["the rig is marked insufficient"]
    assert json.loads(told.out)["warnings"] == ["the rig is marked insufficient"]


@pytest.mark.parametrize(
    "words",
    [
        *(("depth", "LONG"), ("depth", "--run", "LONG"), ("depth", "--method", "sgm", "--out", "LONG")),
        *(("depth", "--weights", "LONG"), ("train", "--recipe", "LONG"), ("train", "--out", "LONG"), ("show", "LONG")),
        *(("board", "LONG"), ("board", "LONG.yaml"), ("board", "chessboard_9x6", "--out", "LONG.pdf")),
        *(("calibrate", "LONG"), ("calibrate", "--from-scenes", "LONG")),
        *(("import", "LONG"), ("import", "captures", "LONG"), ("export-model", "LONG"), ("simulate", "LONG")),
        *(("benchmark", "matches", "LONG"), ("benchmark", "matches", "captures", "--run", "LONG")),
        *(("benchmark", "middlebury", "LONG"), ("benchmark", "paper", "--table", "overall", "--data", "LONG")),
    ],
)
def test_a_name_too_long_for_any_file_is_a_wrong_call(
    words: tuple[str, ...], captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = run_cli(*(word.replace("LONG", "x" * 300) for word in words))
    told = capsys.readouterr()
    assert code in {2, 3}
    assert told.err.count("\n") <= 2
    assert "xxx" in told.err or "captures" in told.err
    assert sorted(path.name for path in captures.parent.iterdir()) == ["captures"]


def test_our_own_fault_asks_for_a_report(
    captures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("telewide.pipeline.depth_captures", fails)
    assert run_cli("depth", "--method", "sgm", "--json") == 1
    told = capsys.readouterr()
    assert "Traceback" in told.err
    assert "please report" in told.err
    assert json.loads(told.out)["exit_code"] == 1


@pytest.mark.parametrize(
    ("words", "unread_output", "unread_messages"),
    [
        (("--help",), UNREAD, 0),
        (("--version",), UNREAD, 0),
        (("depth", "nowhere"), 2, 2),
        (("depth", "nowhere", "--json"), 2, 2),
        (("depth", "--json", "--nonsense"), 2, 2),
    ],
)
def test_a_pipe_that_nobody_reads(words: tuple[str, ...], unread_output: int, unread_messages: int) -> None:
    """Never success where the answer is lost, never a fault of ours; a failure stays the failure it was."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    command = [sys.executable, "-m", "telewide", *words]
    try:
        done = subprocess.run(command, stdout=write_end, stderr=subprocess.PIPE, text=True, check=False)
        assert (done.returncode, "Traceback" in done.stderr) == (unread_output, False)
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=write_end, text=True, check=False)
        assert done.returncode == unread_messages
        assert ("exit_code" in done.stdout) == ("--json" in words)
    finally:
        os.close(write_end)


def test_stopping_by_hand(captures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def stops(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("telewide.pipeline.depth_captures", stops)
    refused(capsys, "depth", "--method", "sgm", code=130, names=("run the same command to continue",))


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("depth", "nowhere", "--json"), 2),
        (("train", "--json", "--recipe", "quik"), 2),
        (("depth", "--json", "--nonsense"), 2),
        (("depth", "--json", "--method", "sgm", "--strength", "wide"), 2),
    ],
)
def test_json_is_one_object_on_errors(
    words: tuple[str, ...], code: int, captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_cli(*words) == code
    answer = json.loads(capsys.readouterr().out)
    assert answer["exit_code"] == code
    assert answer["error"]
    assert set(answer) == {"error", "hint", "exit_code"}


@pytest.mark.parametrize(("rank", "objects"), [("0", 1), ("1", 0)])
def test_of_several_processes_one_answers(
    rank: str, objects: int, captures: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RANK", rank)
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert run_cli("depth", "nowhere", "--json") == 2
    told = capsys.readouterr()
    assert len(told.out.splitlines()) == objects
    assert "nowhere does not exist" in told.err, "an error is said by whoever has it"


def test_depth_by_its_defaults(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("depth", "--method", "sgm", "--json") == 0
    told = capsys.readouterr()
    answer = json.loads(told.out)
    assert answer["folder"] == str(Path("run") / "depth")
    assert [capture["name"] for capture in answer["captures"]] == ["000", "001"]
    assert all(Path(file).is_file() for capture in answer["captures"] for file in capture["files"])
    assert "NaN" not in told.out
    assert "2 captures" in told.err


@pytest.mark.parametrize(
    "words",
    [
        ("depth", "captures", "--out", "captures"),
        ("depth", "captures/000", "--out", "captures"),
        ("depth", "captures", "--run", "captures"),
        ("depth", "captures", "--out", "link"),
    ],
)
def test_results_among_the_photos_are_refused(
    words: tuple[str, ...], captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("link").symlink_to("captures")
    before = sorted(captures.rglob("*"))
    refused(capsys, *words, "--method", "sgm", code=2, names=("holds the captures", "name"))
    assert sorted(captures.rglob("*")) == before


def test_semi_global_depth_elsewhere_leaves_no_run_folder(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("depth", "--method", "sgm", "--only", "000", "--out", "d1")
    assert run_cli(*words) == 0
    assert sorted(path.name for path in captures.parent.iterdir()) == ["captures", "d1"]
    assert "kept as they were" not in capsys.readouterr().err
    assert run_cli(*words) == 0
    assert "kept as they were" in capsys.readouterr().err


def test_quiet_says_nothing_but_problems(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("depth", "--method", "sgm", "--quiet") == 0
    told = capsys.readouterr()
    assert told.out == ""
    assert all(line.startswith("warning: 000: ") for line in told.err.splitlines())


def test_a_bad_capture_is_said_and_skipped(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (captures / "000" / "tele.png").write_bytes(b"torn")
    assert run_cli("depth", "--method", "sgm", "--json") == 0
    told = capsys.readouterr()
    assert "skipped: 000" in told.err
    answer = json.loads(told.out)
    assert [capture["name"] for capture in answer["captures"]] == ["001"]
    assert [problem["name"] for problem in answer["problems"]] == ["000"]
    (captures / "001" / "wide.png").write_bytes(b"torn too")
    refused(capsys, "depth", "--method", "sgm", code=3, names=("000", "001"))


def test_simulate_says_what_to_do_next(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "made"
    words = ("simulate", str(out), "--captures", "1", "--width", "96", "--height", "96", "--factor", "1.5")
    assert run_cli(*words) == 0
    told = capsys.readouterr().err.splitlines()
    assert told == [f"wrote 1 capture to {out}", f"next: telewide train {out}"]
    refused(capsys, "simulate", str(tmp_path / "none"), "--captures", "0", code=2, names=("captures is 0",))


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "made", "--seed", "-1"),
        ("calibrate", "--seed", "-1"),
        ("calibrate", "--from-scenes", "--seed", "4294967296"),
        ("train", "--seed", "-1"),
        ("run", "--seed", "-2"),
        ("benchmark", "metres", "--seed", "-1"),
        ("benchmark", "metres", "--boards", "0"),
        ("benchmark", "metres", "--captures", "-1"),
        ("benchmark", "speed", "--repeats", "0"),
        ("benchmark", "speed", "--warm-up", "-1"),
    ],
)
def test_numbers_that_nothing_can_have_are_a_wrong_call(
    words: tuple[str, ...], captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(capsys, *words, code=2, names=(words[-2],))
    assert sorted(path.name for path in captures.parent.iterdir()) == ["captures"]


def test_a_world_is_written_in_json_and_names_the_calls_that_use_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "my phone"
    words = ("simulate", str(out), "--world", "phone", "--captures", "1", "--boards", "1", "--seed", "4", "--json")
    assert run_cli(*words) == 0
    told = capsys.readouterr()
    assert json.loads(told.out) == {"folder": str(out), "world": "phone", "captures": 1, "boards": 1, "seed": 4}
    stated = f"'{out}/boards' --board chessboard_9x6 --square-m 0.025 --out '{out}/rig.yaml'"
    assert f"next: telewide calibrate {stated}" in told.err.splitlines()


@pytest.mark.parametrize("world", ["pairs", "phone", "rooms"])
def test_simulate_leaves_what_lies_in_a_folder_alone(
    world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine" / "000" / "tele.png"
    mine.parent.mkdir(parents=True)
    mine.write_bytes(b"my photo")
    words = ("simulate", str(tmp_path / "mine"), "--world", world, "--captures", "1")
    refused(capsys, *words, code=2, names=(f"{tmp_path / 'mine'} is not empty", "name a folder"))
    assert [path for path in (tmp_path / "mine").rglob("*") if path.is_file()] == [mine]
    assert mine.read_bytes() == b"my photo"


def test_simulate_fills_an_empty_folder(tmp_path: Path) -> None:
    assert run_cli("simulate", str(tmp_path), "--captures", "1", "--width", "96", "--height", "96") == 0
    assert (tmp_path / "000" / "truth.pfm").is_file()


def test_a_place_that_cannot_be_a_folder_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_captures(tmp_path / "captures", count=1, hw=(96, 128))
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(SystemExit) as left:
        main(["depth", str(tmp_path / "captures"), "--method", "sgm", "--out", str(tmp_path / "taken" / "depth")])
    assert left.value.code == 2
    assert "cannot be made" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "words", "option"),
    [
        ("depth", ("--out", "file"), "--out"),
        ("depth", ("--out", "mine"), "--out"),
        ("depth", ("--run", "mine"), "--run"),
        ("depth", ("--run-folder", "occupied"), "--run"),
        ("depth", ("--run", "mine", "--out", "file"), "--out"),
        ("depth", ("--run", "."), "--run"),
        ("run", ("--out", "mine"), "--out"),
    ],
)
def test_a_place_that_is_taken_names_the_option_that_was_typed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    words: tuple[str, ...],
    option: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_captures(Path("depth"), count=1, hw=(96, 128))
    for folder in ("mine/depth/000", "mine/000", "occupied"):
        Path(folder).mkdir(parents=True)
    for file in ("mine/depth/000/depth.npz", "mine/000/depth.npz", "occupied/depth", "file"):
        Path(file).write_text("mine")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert run_cli(command, "depth", "--method", "sgm", *words) == 2
    told = capsys.readouterr().err
    hint = told.strip().splitlines()[-1]
    assert hint.endswith(f" with {option}")
    assert ("a folder for the results was expected" in told) is (words[-1] in ("file", "occupied"))
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.parametrize("quiet", [(), ("-q",)])
def test_quiet_leaves_warnings_and_no_notes(captures: Path, quiet: tuple[str, ...]) -> None:
    """As a program, whose log is that of no test runner."""
    (captures / "rig.yaml").touch()
    shutil.copyfile(captures / "000" / "tele.png", captures / "000" / "tele.jpeg")
    words = ("depth", "captures", "--only", "000", "--method", "sgm", *quiet)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-m", "telewide", *words], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    lines = done.stderr.splitlines()
    assert (f"note: {captures.name}/rig.yaml is not used" in done.stderr) is not bool(quiet)
    warnings = [line for line in lines if line.startswith("warning: ")]
    assert sum("two files for the tele view" in line for line in warnings) == 1
    assert (lines == warnings) is bool(quiet)


def test_weights_that_nothing_would_read_are_refused(captures: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("some.safetensors").touch()
    words = ("depth", "--method", "sgm", "--weights", "some.safetensors")
    refused(capsys, *words, code=2, names=("--method sgm", "--weights"))
    assert not Path("run").exists()


def test_bokeh_options_without_bokeh_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["depth", str(tmp_path), "--method", "sgm", "--focus", "near"])
    assert left.value.code == 2
    assert "--bokeh" in capsys.readouterr().err
