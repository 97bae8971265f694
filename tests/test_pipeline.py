"""The whole way from captures to files: what is written, that it is right, and that nothing is done twice."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from rig_worlds import phone_rig, photos_of_a_plane

from telewide.bokeh.picture import BokehOptions, bokeh_picture, check_bokeh
from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.rig_file import RigFacts, StoredRig, write_stored_rig
from telewide.capture.facts import CaptureFacts
from telewide.capture.images import read_image, write_image
from telewide.capture.pair import Capture, find_captures
from telewide.capture.pfm import read_pfm
from telewide.cli import main
from telewide.errors import UsageError
from telewide.geometry.stereo import DisparityMap
from telewide.matching.networks import build_network
from telewide.matching.window import Window
from telewide.metrics import three_pixel_error
from telewide.pipeline import depth_captures
from telewide.points.held_out import HeldOut
from telewide.recipe import load_recipe
from telewide.simulate.captures import write_captures
from telewide.stages.capture_depth import DepthOutcome, depth_of_capture
from telewide.stages.depth import DepthOptions, recipe_of_depth
from telewide.stages.kept_depth import KeptDepth, read_kept, write_kept
from telewide.stages.observer import Silent
from telewide.stages.prepare import prepare_captures
from telewide.stages.run_folder import RunFolder
from telewide.training.checkpoint import save_weights
from telewide.training.weights_card import WeightsCard

FILES = {"disparity.pfm", "disparity.png", "depth.npz", "preview.png", "bokeh.jpg", "depth.json"}
TINY = ("train.rehearsal.steps=2", "train.crop_hw=[64, 96]", "window_px=[-8, 32]")


def run_cli(*words: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(words)
    return int(left.value.code or 0)


def json_of(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, object]:
    capsys.readouterr()
    assert run_cli(*words, "--json") == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "captures"
    write_captures(folder, count=2, seed=3, hw=(144, 216), factor=2)
    return folder


@pytest.fixture(scope="module")
def matched(simulated: Path) -> Path:
    """Depth and bokeh of the simulated captures, semi-global."""
    out = simulated.parent / "run"
    assert run_cli("depth", str(simulated), "--run", str(out), "--method", "sgm", "--bokeh", "--quiet") == 0
    return out / "depth"


def restated(simulated: Path, folder: Path, **facts: object) -> Path:
    shutil.copytree(simulated, folder)
    path = folder / "captures.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **facts}))
    return folder


class TestFiles:
    def test_every_capture_has_every_file(self, matched: Path) -> None:
        for name in ("000", "001"):
            written = {path.name for path in (matched / name).iterdir()}
            lacks_png = np.load(matched / name / "depth.npz")["disparity"].min() <= 0
            assert FILES - written <= ({"disparity.png"} if lacks_png else set())
            assert written <= FILES

    def test_disparity_is_right(self, matched: Path, simulated: Path) -> None:
        for name in ("000", "001"):
            truth_px = read_pfm(simulated / name / "truth.pfm")
            assert three_pixel_error(read_pfm(matched / name / "disparity.pfm"), truth_px) < 0.25

    def test_files_agree_with_one_another(self, matched: Path) -> None:
        disparity_px = read_pfm(matched / "000" / "disparity.pfm")
        with np.load(matched / "000" / "depth.npz") as kept:
            assert set(kept) == {"format", "disparity", "confidence", "valid", "K"}
            np.testing.assert_array_equal(kept["disparity"], disparity_px)
            assert kept["confidence"].shape == kept["valid"].shape == disparity_px.shape
            assert np.isnan(kept["K"]).all()
        png_path = matched / "000" / "disparity.png"
        if png_path.exists():
            steps = cv2.imread(str(png_path), cv2.IMREAD_UNCHANGED)
            np.testing.assert_allclose(steps[steps > 0] / 256, disparity_px[steps > 0], atol=1 / 256)

    def test_what_the_bokeh_is_focused_on_is_written_down(self, matched: Path) -> None:
        for folder in sorted(path for path in matched.iterdir() if path.is_dir()):
            kept = json.loads((folder / "depth.json").read_text())
            numbers = kept["numbers"]
            x, y = int(numbers["focus_x_px"]), int(numbers["focus_y_px"])
            disparity_px = read_pfm(folder / "disparity.pfm")
            assert disparity_px[y, x] == pytest.approx(numbers["focus_px"], abs=0.5)
            note = next(note for note in kept["notes"] if "bokeh" in note)
            assert note.startswith(f"{folder.name}: the bokeh was focused on x {x}, y {y}")
            assert f"{disparity_px[y, x]:.1f} px" in note

    def test_the_run_records_what_was_asked_for(self, matched: Path, simulated: Path) -> None:
        record = json.loads((matched.parent / "run.json").read_text())["commands"]["depth"]
        options = DepthOptions(method="sgm", bokeh=BokehOptions())
        assert record["options"] == json.loads(json.dumps({**dataclasses.asdict(options), "matcher": "sgm"}))
        views = {f"../{simulated.name}/{name}/{view}.png" for name in ("000", "001") for view in ("tele", "wide")}
        assert set(record["inputs_sha256"]) == views

    def test_bokeh_blurs_and_keeps_the_focus(self, matched: Path, simulated: Path) -> None:
        photo, blurred = read_image(simulated / "000" / "tele.png"), read_image(matched / "000" / "bokeh.jpg")
        assert blurred.shape == photo.shape
        detail = [float(np.abs(cv2.Laplacian(image.mean(axis=2), cv2.CV_32F)).mean()) for image in (photo, blurred)]
        assert detail[1] < 0.8 * detail[0]
        assert abs(blurred.mean() - photo.mean()) < 0.03

    def test_metres_where_the_scale_is_known(self, simulated: Path, tmp_path: Path) -> None:
        folder = restated(simulated, tmp_path / "scaled", baseline_m=0.012, f_px=500.0, doffs_px=4.0)
        words = ("depth", str(folder), "--run", str(tmp_path / "run"), "--method", "sgm", "--bokeh", "--f-number", "2")
        assert run_cli(*words, "--quiet") == 0
        with np.load(tmp_path / "run" / "depth" / "001" / "depth.npz") as kept:
            expected_m = 500.0 * 0.012 / (kept["disparity"].astype(np.float64) + 4.0)
            is_in_front = kept["disparity"] + 4.0 > 0
            np.testing.assert_allclose(kept["depth_m"][is_in_front], expected_m[is_in_front], rtol=1e-5)
            assert np.isnan(kept["depth_m"][~is_in_front]).all()
            assert (float(kept["baseline_m"]), float(kept["doffs_px"])) == (0.012, 4.0)
            assert kept["K"][0, 0] == 500.0

    def test_negative_disparities_leave_the_png_out_and_say_so(
        self, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder = tmp_path / "shifted"
        shutil.copytree(simulated, folder)
        for capture in (folder / "000", folder / "001"):  # both views cropped so that all disparities fall by 26 px
            tele, wide = cv2.imread(str(capture / "tele.png")), cv2.imread(str(capture / "wide.png"))
            wide = cv2.resize(wide, (tele.shape[1], tele.shape[0]), interpolation=cv2.INTER_CUBIC)
            cv2.imwrite(str(capture / "tele.png"), tele[:, 26:])
            cv2.imwrite(str(capture / "wide.png"), wide[:, :-26])
            (capture / "truth.pfm").unlink()
        answer = json_of(capsys, "depth", str(folder), "--run", str(tmp_path / "run"), "--method", "sgm")
        for capture in answer["captures"]:
            assert not any(file.endswith("disparity.png") for file in capture["files"])
            assert any("no disparity.png" in note for note in capture["notes"])
            assert np.median(read_pfm(Path(capture["files"][0]))) < 0


def test_depth_goes_onto_the_tele_photo_and_needs_no_other(simulated: Path, tmp_path: Path) -> None:
    (pair, _) = find_captures(simulated).captures
    height, width = read_image(pair.tele_path).shape[:2]
    matched = DisparityMap(*(np.ones((height, width), kind) for kind in (np.float32, np.float32, np.bool_)))
    done = depth_of_capture(
        Capture(pair.name, pair.tele_path, tmp_path / "gone.png"),
        HeldOut(pair, np.zeros((0, 2)), np.zeros(0)),
        tmp_path / "depth",
        facts=CaptureFacts(),
        match=lambda ref, src, *, window, valid: matched,
        window=(0, 32),
        bokeh=None,
        key={},
    )
    assert isinstance(done, DepthOutcome)
    np.testing.assert_array_equal(read_pfm(tmp_path / "depth" / "disparity.pfm"), matched.disparity_px)


def by_suffix(source: Path, folder: Path) -> None:
    for view in source.glob("*/*"):
        shutil.copy(view, folder / f"{view.parent.name}_{view.name}")


def by_view(source: Path, folder: Path) -> None:
    for view in source.glob("*/*"):
        (folder / view.stem).mkdir(exist_ok=True)
        shutil.copy(view, folder / view.stem / f"{view.parent.name}{view.suffix}")


@pytest.mark.parametrize("arrange", [by_suffix, by_view])
def test_every_layout_gives_the_same(
    arrange: Callable[[Path, Path], None],
    simulated: Path,
    matched: Path,
    tmp_path: Path,
) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    arrange(simulated, folder)
    shutil.copy(simulated / "captures.yaml", folder)
    assert run_cli("depth", str(folder), "--run", str(tmp_path / "run"), "--method", "sgm", "--quiet") == 0
    for name in ("000", "001"):
        expected = (matched / name / "disparity.pfm").read_bytes()
        assert (tmp_path / "run" / "depth" / name / "disparity.pfm").read_bytes() == expected


def test_a_distance_outside_the_photo_touches_nothing(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = phone_rig(width_px=480)
    for name, photo in zip(("tele", "wide"), photos_of_a_plane(rig, rng), strict=True):
        write_image(tmp_path / "captures" / "plane" / f"{name}.png", photo)
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")
    write_stored_rig(tmp_path / "captures" / "rig.yaml", StoredRig(rig, None, None, None, quality, RigFacts()))
    words = ("depth", str(tmp_path / "captures" / "plane"), "--rig", str(tmp_path / "captures" / "rig.yaml"))
    words += ("--run", str(tmp_path / "run"), "--out", str(tmp_path / "kept"), "--method", "sgm", "--quiet")
    assert run_cli(*words, "--bokeh") == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert run_cli(*words, "--distance", "180,1200,1.5") == 2
    told = capsys.readouterr().err
    assert f"180,1200 lies outside the tele photo of {rig.tele.hw[1]} x {rig.tele.hw[0]} px" in told
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


class TestNothingIsDoneTwice:
    def test_depth_is_kept_until_something_changes(
        self, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder, run = tmp_path / "captures", tmp_path / "run"
        shutil.copytree(simulated, folder)
        words = ("depth", str(folder), "--run", str(run), "--method", "sgm")
        first = json_of(capsys, *words)
        stamps = written_ns(run)
        assert json_of(capsys, *words) == first
        assert written_ns(run) == stamps
        json_of(capsys, *words, "--bokeh", "--focus", "near")
        assert written_ns(run)["000"] != stamps["000"]
        assert (run / "depth" / "000" / "depth.npz").stat().st_mtime_ns in stamps["000"], "not matched again"
        stamps = written_ns(run)
        (run / "depth" / "001" / "depth.npz").unlink()
        json_of(capsys, *words, "--bokeh", "--focus", "near")
        assert written_ns(run)["000"] == stamps["000"]
        assert written_ns(run)["001"] != stamps["001"]

    @pytest.mark.slow
    def test_a_whole_run_again_only_says_so(
        self, simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        words = ("run", str(simulated), "--recipe", "quick", "--out", str(tmp_path / "run"))
        words += tuple(word for setting in TINY for word in ("--set", setting))
        first = json_of(capsys, *words)
        assert Path(str(first["report"])).is_file()
        assert list((tmp_path / "run" / "train").glob("*.png"))
        weights = (tmp_path / "run" / "train" / "weights.safetensors").read_bytes()
        stamps = written_ns(tmp_path / "run")
        capsys.readouterr()
        assert run_cli(*words) == 0
        told = capsys.readouterr().err
        assert "finished already" in told
        assert "kept as they were: 2 of 2 captures" in told
        assert written_ns(tmp_path / "run") == stamps
        assert (tmp_path / "run" / "train" / "weights.safetensors").read_bytes() == weights
        assert run_cli("depth", str(simulated), "--run", str(tmp_path / "run"), "--bokeh", "--quiet") == 0

    def test_a_corrupt_or_foreign_record_is_made_again(self, tmp_path: Path) -> None:
        kept = KeptDepth(("disparity.pfm",), ("a note",), {"matches": 7.0, "off_1px": float("nan")})
        (tmp_path / "disparity.pfm").write_bytes(b"whole")
        key: Mapping[str, object] = {"matcher": "sgm", "window": (0, 32)}
        assert read_kept(tmp_path, key) is None
        write_kept(tmp_path, kept, key=key)
        back = read_kept(tmp_path, key)
        assert back is not None
        assert (back.files, back.notes, back.numbers["matches"]) == (kept.files, kept.notes, 7.0)
        assert np.isnan(back.numbers["off_1px"])
        assert read_kept(tmp_path, {**key, "window": (0, 64)}) is None
        (tmp_path / "disparity.pfm").write_bytes(b"cut")
        assert read_kept(tmp_path, key) is None
        for text in ("", "[]", "{}", '{"format": 1, "key": {}, "files": 3}'):
            (tmp_path / "depth.json").write_text(text)
            assert read_kept(tmp_path, key) is None


class TestBokehOptions:
    def test_a_known_distance_gives_an_f_number_its_baseline(self, simulated: Path) -> None:
        """What a hint advises is not refused in its turn."""
        captures, wide_open = find_captures(simulated), BokehOptions(f_number=1.8)
        unstated = dataclasses.replace(captures, facts=CaptureFacts(rectified=True))
        stated = dataclasses.replace(captures, facts=CaptureFacts(baseline_m=0.012))
        for fine in ({"baseline_m": 0.012, "has_rig": True}, {"has_rig": True, "is_pinned": True}):
            check_bokeh(wide_open, unstated, **fine)  # type: ignore[arg-type]
        check_bokeh(wide_open, stated)
        with pytest.raises(UsageError, match="captures") as refused:
            check_bokeh(wide_open, unstated)
        assert "baseline_m in " in str(refused.value.hint)
        with pytest.raises(UsageError, match="the rig") as refused:
            check_bokeh(wide_open, stated, has_rig=True)
        assert "`distance`" in str(refused.value.hint)
        assert "captures.yaml" not in str(refused.value.hint)

    def test_a_point_in_any_photo_will_do(self, simulated: Path) -> None:
        captures = find_captures(simulated)
        check_bokeh(None, captures)
        check_bokeh(BokehOptions(focus="215,143"), captures)
        with pytest.raises(UsageError, match="outside"):
            check_bokeh(BokehOptions(focus="216,143"), captures)

    def test_the_sizes_of_the_photos_are_enough(self, simulated: Path, tmp_path: Path) -> None:
        for view in ("tele", "wide"):
            path = tmp_path / "cut off" / f"{view}.jpg"
            write_image(path, read_image(simulated / "000" / f"{view}.png"))
            path.write_bytes(path.read_bytes()[:2000])
        captures = find_captures(tmp_path)
        check_bokeh(BokehOptions(focus="auto"), captures)
        with pytest.raises(UsageError, match="216 x 144"):
            check_bokeh(BokehOptions(focus="216,143"), captures)
        check_bokeh(BokehOptions(focus="215,143"), captures)

    def test_no_strength_leaves_the_photo(self, simulated: Path, matched: Path) -> None:
        photo = read_image(simulated / "000" / "tele.png")
        flat = DisparityMap(
            np.full(photo.shape[:2], 7, np.float32),
            np.ones(photo.shape[:2], np.float32),
            np.ones(photo.shape[:2], bool),
        )
        np.testing.assert_array_equal(
            bokeh_picture(lambda: photo, flat, options=BokehOptions(), baseline_m=None), photo
        )

    def test_a_wider_aperture_blurs_more(self, simulated: Path) -> None:
        photo = read_image(simulated / "000" / "tele.png")
        truth_px = read_pfm(simulated / "000" / "truth.pfm")
        disparity = DisparityMap(truth_px, np.ones_like(truth_px), np.ones(truth_px.shape, bool))
        changes = [
            float(np.abs(bokeh_picture(lambda: photo, disparity, options=options, baseline_m=0.01) - photo).mean())
            for options in (BokehOptions(f_number=16), BokehOptions(f_number=4))
        ]
        assert changes[0] < changes[1]


def written_ns(run: Path) -> dict[str, list[int]]:
    """When the files of each capture were written."""
    return {
        folder.name: [path.stat().st_mtime_ns for path in sorted(folder.iterdir())]
        for folder in sorted((run / "depth").iterdir())
    }


def test_facts_without_a_scale_invent_none() -> None:
    assert CaptureFacts().baseline_m is None


def test_weights_come_with_the_pairs_they_were_taught_on(simulated: Path, tmp_path: Path) -> None:
    """Size, window and correction are those of the weights; of their training, whatever its keys, nothing is taken."""
    taught = load_recipe("quick", settings=["working_width_px=256", "correction.colour=false"], seed=7)
    network = build_network(taught.network)
    stated = {**taught.model_dump(mode="json"), "train": {"a_key_of_another_version": 1}}
    card = WeightsCard(taught.network, (-8, 32), stated, {})
    save_weights(network, tmp_path / "w.safetensors", card=card)
    recipe = recipe_of_depth(tmp_path / "run", simulated, weights=tmp_path / "w.safetensors")
    assert recipe.working_width_px == 256
    assert not recipe.correction.colour
    default = recipe_of_depth(tmp_path / "run", simulated)
    assert recipe.seed == default.seed
    assert recipe.train == default.train
    assert default.working_width_px == 1536


def test_a_network_searches_beyond_what_it_was_trained_for(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Trained on far things, shown near ones: nothing is cut off, and it is said."""
    card = WeightsCard("lite", (-40, 4), load_recipe("quick").model_dump(mode="json"), {})
    save_weights(build_network("lite"), tmp_path / "w.safetensors", card=card)
    words = ("depth", str(simulated), "--run", str(tmp_path / "run"), "--method", "network", "--device", "cpu")
    assert run_cli(*words, "--weights", str(tmp_path / "w.safetensors")) == 0
    needed = prepare_captures(find_captures(simulated), RunFolder(tmp_path / "run"), recipe=load_recipe("quick")).window
    told = capsys.readouterr().err
    assert f"searched at -40 to {needed[1]} px, as these captures need; the network was trained at -40 to 4 px" in told
    for name in ("000", "001"):
        disparity_px, truth_px = (
            read_pfm(path) for path in (tmp_path / "run/depth" / name / "disparity.pfm", simulated / name / "truth.pfm")
        )
        is_near = truth_px > 12
        assert (disparity_px[is_near] > 8.5).mean() > 0.4, "the trained window ends at 4 px"
    heard = _Searched()
    options = DepthOptions(method="network", weights=tmp_path / "w.safetensors", device="cpu")
    depth_captures(simulated, run=tmp_path / "run", recipe=load_recipe("quick"), options=options, observer=heard)
    assert heard.windows == [(-40, needed[1])], "what is told is what is searched"


class _Searched(Silent):
    """Hears which disparities are searched."""

    def __init__(self) -> None:
        self.windows: list[Window] = []

    def searching(self, window: Window) -> None:
        self.windows.append(window)
