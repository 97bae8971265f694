"""From photos of a board to rig.yaml and its page: the rig is the one the photos were drawn with."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from photographed_boards import drawn_rig, write_board_photos
from PIL import Image

from telewide.calibration.rig_file import RIG_FILE, read_rig
from telewide.capture.images import read_image, write_image
from telewide.cli import main
from telewide.errors import InputError, UsageError
from telewide.stages.calibrate import CalibrateOptions, calibrate_boards, calibrate_call, captures_beside
from telewide.stages.rig_run import CalibrationRun, calls_with_rig

N_SHOTS = 12
BOARD = "chessboard_9x6"


class Listener:
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.announced = 0
        self.done = 0

    def said(self, message: str) -> None:
        self.lines.append(message)

    def detecting(self, total: int) -> Callable[[], None]:
        self.announced = total
        return self._advance

    def _advance(self) -> None:
        self.done += 1


def run_cli(*words: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(words)
    return int(left.value.code or 0)


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve shots of a board with both lenses."""
    return write_board_photos(tmp_path_factory.mktemp("photos") / "boards", count=N_SHOTS)


@pytest.fixture(scope="module")
def heard() -> Listener:
    return Listener()


@pytest.fixture(scope="module")
def done(boards: Path, heard: Listener) -> CalibrationRun:
    """The board is not named; its squares are said to measure twice what they do."""
    options = CalibrateOptions(square_m=0.05, out=boards.parent / "out" / "rig.yaml", processes=1)
    return calibrate_boards(boards, options=options, observer=heard)


def first_shots(boards: Path, folder: Path, *, count: int) -> Path:
    for shot in sorted(boards.iterdir())[:count]:
        shutil.copytree(shot, folder / shot.name)
    return folder


def test_the_rig_is_the_one_that_took_the_photos(done: CalibrationRun) -> None:
    truth, rig = drawn_rig(), done.stored.rig
    assert rig.tele.hw == truth.tele.hw
    assert rig.wide.hw == truth.wide.hw
    assert rig.asymmetry == pytest.approx(truth.asymmetry, rel=0.001)
    assert rig.baseline_m == pytest.approx(2 * truth.baseline_m, rel=0.01)
    assert rig.tele.f_px == pytest.approx(truth.tele.f_px, rel=0.003)
    assert done.stored.quality.tele_rms_px < 0.1
    assert done.stored.quality.verdict in ("good", "usable")


def test_the_file_holds_the_rig_and_how_it_was_made(done: CalibrationRun) -> None:
    stored = read_rig(done.rig)
    np.testing.assert_array_equal(stored.rig.wide_from_tele, done.stored.rig.wide_from_tele)
    assert stored.facts.board in (BOARD, f"{BOARD}_a3")  # the same pattern in two sizes
    assert stored.facts.scale_verified
    assert stored.facts.image_pipeline == "png:unknown"
    assert stored.quality.verdict == done.stored.quality.verdict


def test_the_page_shows_every_shot_and_a_rectified_pair(done: CalibrationRun) -> None:
    text = done.report.read_text(encoding="utf-8")
    assert done.report == done.rig.with_name("rig_report.html")
    assert all(text.count(f">shot_{number:02d}<") >= 2 for number in range(N_SHOTS))
    for heading in ("Coverage", "Residuals", "Repeatability", "Held-out epipolar error", "A rectified pair"):
        assert f"<h2>{heading}" in text
    assert not re.search(r"https?:|<script|<link", text)


def test_progress_is_told_shot_by_shot(done: CalibrationRun, heard: Listener) -> None:
    assert (heard.announced, heard.done) == (N_SHOTS, N_SHOTS)
    assert any(BOARD in line for line in heard.lines)
    assert heard.lines[-1] == f"board found in {N_SHOTS} tele and {N_SHOTS} wide photos; calibrating"


def test_without_a_measured_square_metres_are_nominal_and_said_to_be(boards: Path, tmp_path: Path) -> None:
    few = first_shots(boards, tmp_path / "boards", count=6)
    options = CalibrateOptions(board=BOARD, out=tmp_path / "rig.yaml", processes=1)
    run = calibrate_boards(few, options=options, observer=Listener())
    assert not run.stored.facts.scale_verified
    assert any("25 mm" in note and "--square-m" in note for note in run.notes)
    assert run.stored.rig.baseline_m == pytest.approx(drawn_rig().baseline_m, rel=0.02)
    assert not read_rig(run.rig).facts.scale_verified
    assert "--square-m" in run.report.read_text(encoding="utf-8")


def test_photos_made_in_two_ways_have_no_rig_in_common(boards: Path, tmp_path: Path) -> None:
    few = first_shots(boards, tmp_path / "boards", count=3)
    for name, model in (("shot_00", "One"), ("shot_02", "Two")):
        path = few / name / "tele.png"
        exif = Image.Exif()
        exif[271], exif[272] = "Maker", model
        Image.fromarray((read_image(path) * 255).astype(np.uint8)).save(path, exif=exif)
    with pytest.raises(InputError, match=r"Maker One.*Maker Two"):
        calibrate_boards(few, options=CalibrateOptions(out=tmp_path / "rig.yaml"), observer=Listener())
    assert not (tmp_path / "rig.yaml").exists()


@pytest.mark.slow
def test_shots_of_which_half_are_turned_by_their_exif_give_the_same_rig(boards: Path, tmp_path: Path) -> None:
    """The sensor does not know how the phone was held: the same pixels, once upright and once on their side."""
    rigs = []
    for name, turned in (("upright", 1), ("half", 6)):
        for number, shot in enumerate(sorted(boards.iterdir())[:8]):
            for path in sorted(shot.glob("*.png")):
                exif = Image.Exif()
                exif[274] = turned if number % 2 else 1
                to = tmp_path / name / shot.name / f"{path.stem}.jpg"
                to.parent.mkdir(parents=True, exist_ok=True)
                Image.open(path).save(to, exif=exif, quality=95)
        options = CalibrateOptions(board=BOARD, out=tmp_path / f"{name}.yaml", processes=1)
        rigs.append(calibrate_boards(tmp_path / name, options=options, observer=Listener()).stored)
    upright, half = rigs
    assert half.left_out == ()
    assert half.rig.tele.hw == upright.rig.tele.hw
    assert half.rig.baseline_m == pytest.approx(upright.rig.baseline_m, rel=0.01)
    assert half.rig.tele.f_px == pytest.approx(upright.rig.tele.f_px, rel=1e-3)
    np.testing.assert_allclose(half.rig.tele.K[:2, 2], upright.rig.tele.K[:2, 2], atol=0.5)


@pytest.mark.parametrize("is_by_lens", [True, False])
def test_exchanged_photos_stop_before_the_solve_with_the_places_to_rename(
    boards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], is_by_lens: bool
) -> None:
    """Two shots are too few to solve anything: that it is not said shows what was looked at first."""
    monkeypatch.chdir(tmp_path)
    for shot in sorted(boards.iterdir())[:2]:
        for name, wrong in (("tele", "wide"), ("wide", "tele")):
            path = (
                Path("boards", wrong, f"{shot.name}.png") if is_by_lens else Path("boards", shot.name, f"{wrong}.png")
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(shot / f"{name}.png", path)
    assert run_cli("calibrate", "--board", BOARD) == 3
    told = capsys.readouterr().err
    assert "exchanged" in told
    first, second = ("boards/tele", "boards/wide") if is_by_lens else ("shot_00/tele.png", "shot_00/wide.png")
    assert f"{first} to " in told
    assert second in told
    assert not (tmp_path / "rig.yaml").exists()


def test_without_a_common_board_exif_tells_that_lenses_are_exchanged(boards: Path, tmp_path: Path) -> None:
    for folder, lens, f35_mm in (("tele_close", "wide", 27), ("wide_close", "tele", 80)):
        (tmp_path / "boards" / folder).mkdir(parents=True)
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0xA405] = f35_mm
        photo = read_image(boards / "shot_00" / f"{lens}.png")
        Image.fromarray((photo * 255).astype(np.uint8)).save(tmp_path / "boards" / folder / "one.jpg", exif=exif)
    options = CalibrateOptions(board=BOARD, out=tmp_path / "rig.yaml", processes=1)
    with pytest.raises(InputError, match=r"exchanged.*27 mm.*80 mm") as caught:
        calibrate_boards(tmp_path / "boards", options=options, observer=Listener())
    assert "tele_close" in str(caught.value.hint)


def test_millimetres_are_refused(boards: Path, tmp_path: Path) -> None:
    options = CalibrateOptions(board=BOARD, square_m=25.0, out=tmp_path / "rig.yaml")
    with pytest.raises(UsageError, match="25"):
        calibrate_boards(boards, options=options, observer=Listener())


def test_commands_advised_name_the_rig_and_all_that_was_stated(done: CalibrationRun, tmp_path: Path) -> None:
    """Without --out the next call would replace the rig of another phone."""
    options = CalibrateOptions(board="my board.yaml", square_m=0.024, out=Path("phone B.yaml"), seed=3)
    again = calibrate_call(Path("my boards"), options).again()
    stated = "--board 'my board.yaml' --square-m 0.024 --seed 3 --out 'phone B.yaml'"
    assert again == f"telewide calibrate 'my boards' {stated}"
    depth, train = calls_with_rig(captures_beside(Path("my boards")), options.out)
    assert depth == "telewide depth captures --rig 'phone B.yaml' --bokeh"
    assert train == "telewide train captures --rig 'phone B.yaml'"
    assert calibrate_call(Path("boards"), CalibrateOptions()).again() == "telewide calibrate boards"
    (tmp_path / "captures").mkdir()
    of_boards = calls_with_rig(captures_beside(tmp_path / "boards"), RIG_FILE)
    assert of_boards[1] == f"telewide train {tmp_path / 'captures'}"
    page = done.report.read_text(encoding="utf-8")
    depth, train = calls_with_rig(Path("captures"), done.rig)
    assert 0 < page.index(depth) < page.index(train), "depth needs no training"


# The command line


def test_a_missing_folder_is_a_wrong_call(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_cli("calibrate") == 2
    told = capsys.readouterr().err
    assert "boards does not exist" in told
    assert "boards/1/tele.jpg" in told
    assert "telewide calibrate captures --from-scenes" in told, "a way that needs no board"
    assert run_cli("calibrate", "--from-scenes") == 2
    told = capsys.readouterr().err
    assert "captures does not exist" in told
    assert "telewide import DCIM captures" in told
    assert run_cli("calibrate", "nowhere") == 2
    assert run_cli("show") == 2
    assert list(tmp_path.iterdir()) == []


def test_photos_without_a_board_are_bad_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("tele", "wide"):
        write_image(tmp_path / "boards" / "one" / f"{name}.png", rng.random((120, 160, 3)).astype(np.float32))
    assert run_cli("calibrate") == 3
    told = capsys.readouterr().err
    assert BOARD in told  # the known boards are named
    assert "--board" in told
    assert run_cli("calibrate", "--board", BOARD) == 3
    assert not (tmp_path / "rig.yaml").exists()


@pytest.mark.parametrize("as_json", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_too_few_photos_are_written_and_refused(
    boards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    first_shots(boards, tmp_path / "boards", count=4)
    assert run_cli("calibrate", "--board", BOARD, *(["--json"] if as_json else [])) == 4
    told = capsys.readouterr()
    assert "error: rig.yaml was written" in told.err
    assert "Traceback" not in told.err
    assert read_rig(tmp_path / "rig.yaml").quality.verdict == "insufficient"
    assert "Not good enough" in (tmp_path / "rig_report.html").read_text(encoding="utf-8")
    if as_json:
        answer = json.loads(told.out)
        assert (answer["verdict"], answer["exit_code"]) == ("insufficient", 4)
        assert "more" in answer["hint"]  # what to photograph next
    else:
        assert told.out == ""


def test_show_says_the_numbers_and_json_is_the_file(done: CalibrationRun, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("show", str(done.rig)) == 0
    told = capsys.readouterr().out
    rig = done.stored.rig
    for words in (f"{rig.tele.f_px:.1f}", f"{rig.wide.f_px:.1f}", f"{rig.baseline_m * 1e3:.2f}", "640 x 480", BOARD):
        assert words in told
    assert run_cli("show", str(done.rig), "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["format"] == 1


def test_a_file_that_is_no_rig_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rig.yaml").write_text("format: 1\nhello: world\n", encoding="utf-8")
    assert run_cli("show", str(tmp_path / "rig.yaml")) == 3
    assert "rig.yaml" in capsys.readouterr().err
    assert run_cli("calibrate", str(tmp_path), "--out", str(tmp_path / "rig.json")) == 2


@pytest.mark.slow
def test_a_photographed_set(data_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for lens, side in (("tele", "left"), ("wide", "right")):
        (tmp_path / "boards" / lens).mkdir(parents=True)
        for path in sorted((data_root / "calib_stereo_opencv").glob(f"{side}*.jpg")):
            shutil.copy(path, tmp_path / "boards" / lens / path.name.removeprefix(side))
    monkeypatch.chdir(tmp_path)
    assert run_cli("calibrate", "--square-m", "0.025", "--quiet") == 0
    stored = read_rig(tmp_path / "rig.yaml")
    assert stored.rig.baseline_m / 0.025 == pytest.approx(3.33, rel=0.005)
    assert stored.quality.tele_rms_px < 0.22
    assert stored.quality.wide_rms_px < 0.22
    assert stored.left_out == ()
    assert (tmp_path / "rig_report.html").stat().st_size < 2_000_000
