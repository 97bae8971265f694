"""One capture from its photos to its files: a given match, and what is made of it."""

from __future__ import annotations

import dataclasses
import errno
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from capture.dng import write_dng
from capture.profiles import DISPLAY_P3, matrix_profile
from PIL import Image, ImageOps
from rig_worlds import phone_rig

from telewide.bokeh.picture import BokehOptions, bokeh_picture
from telewide.capture.images import read_image, write_image
from telewide.capture.pair import Capture, CaptureFacts
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.correction.moving import MovedRegion
from telewide.depth.export import DEFAULT_FORMATS, chosen_formats
from telewide.depth.pin import KnownDistance
from telewide.depth.precision import DepthPrecision
from telewide.drawing import upright
from telewide.errors import MissingPartError, UsageError
from telewide.files import fingerprint
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rectification import rectified_geometry
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.window import Window
from telewide.points.held_out import HeldOut
from telewide.srgb import linear_from_srgb
from telewide.stages.capture_depth import DepthFailure, DepthOutcome, depth_of_capture
from telewide.stages.kept_depth import read_lying
from telewide.stages.photo_depth import ShotGeometry, on_photo

HW = (60, 80)
FACTS = CaptureFacts(rectified=True)
WINDOW = (0, 32)


def stepped(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
    """Far on the left, near on the right."""
    disparity_px = np.where(np.arange(HW[1]) < HW[1] // 2, 4.0, 12.0)[None].repeat(HW[0], axis=0).astype(np.float32)
    return DisparityMap(disparity_px, np.ones(HW, np.float32), np.ones(HW, np.bool_))


@pytest.fixture
def capture(tmp_path: Path, rng: np.random.Generator) -> Capture:
    paths = [tmp_path / "captures" / "one" / f"{view}.png" for view in ("tele", "wide")]
    for path in paths:
        write_image(path, rng.random((*HW, 3)).astype(np.float32))
    return Capture("one", *paths)


def made(capture: Capture, folder: Path, *, bokeh: BokehOptions, facts: CaptureFacts = FACTS) -> DepthOutcome:
    held_out = HeldOut(capture, np.zeros((0, 2)), np.zeros(0))
    key = {"bokeh": vars(bokeh), "baseline_m": facts.baseline_m}
    outcome = depth_of_capture(
        capture, held_out, folder, facts=facts, match=stepped, window=WINDOW, bokeh=bokeh, key=key
    )
    assert isinstance(outcome, DepthOutcome)
    return outcome


def test_an_f_number_without_a_baseline_is_no_other_blur(capture: Capture, tmp_path: Path) -> None:
    strong, wide_open = BokehOptions(strength_px=3.0), BokehOptions(f_number=1.8)
    picture = tmp_path / "run" / "bokeh.jpg"
    assert picture in made(capture, tmp_path / "run", bokeh=strong).paths
    before = picture.read_bytes()
    outcome = made(capture, tmp_path / "run", bokeh=wide_open)
    assert picture.read_bytes() == before
    assert any("bokeh.jpg: there as an earlier call made it" in note for note in outcome.notes)
    (told,) = outcome.shortcomings
    assert "`f_number`" in told
    assert "`strength`" in told
    known = CaptureFacts(rectified=True, baseline_m=0.012)
    assert picture in made(capture, tmp_path / "run", bokeh=wide_open, facts=known).paths
    disparity = stepped(np.zeros(HW), np.zeros(HW), window=WINDOW)
    with pytest.raises(UsageError, match="`strength`"):
        bokeh_picture(lambda: np.zeros((*HW, 3), np.float32), disparity, options=wide_open, baseline_m=None)


@pytest.mark.parametrize("rotated_deg", [0, 90, 180, 270])
def test_files_of_a_capture_lie_over_each_other_upright(capture: Capture, tmp_path: Path, rotated_deg: int) -> None:
    y, x = np.mgrid[: HW[0], : HW[1]] / HW[1]
    photo = np.stack([x, y, 0.5 + 0 * x], axis=-1).astype(np.float32)
    write_image(capture.tele_path, photo)
    facts = CaptureFacts(rectified=True, rotated_deg=rotated_deg)  # type: ignore[arg-type]
    made(capture, tmp_path, bokeh=BokehOptions(strength_px=1.0), facts=facts)
    with Image.open(tmp_path / "bokeh.jpg") as picture:
        stored, shown = (np.asarray(view) / 255 for view in (picture, ImageOps.exif_transpose(picture)))
    standing = upright(photo, rotated_deg=rotated_deg)
    np.testing.assert_allclose(stored, standing, atol=0.06)
    np.testing.assert_array_equal(shown, stored)
    assert read_pfm(tmp_path / "disparity.pfm").shape == standing.shape[:2]
    np.testing.assert_allclose(read_image(tmp_path / "bokeh.jpg"), shown, atol=0.02)


def test_bokeh_keeps_the_colours_and_the_words_of_its_photo(capture: Capture, tmp_path: Path) -> None:
    profile, exif = matrix_profile(DISPLAY_P3, 2.2), Image.Exif()
    exif[272] = "Phone 8"
    pure_red = Image.new("RGB", (HW[1], HW[0]), (255, 0, 0))  # of Display P3: outside of sRGB
    capture = dataclasses.replace(capture, tele_path=capture.tele_path.with_suffix(".jpg"))
    pure_red.save(capture.tele_path, icc_profile=profile, exif=exif, quality=100, subsampling=0)
    bokeh = BokehOptions(strength_px=3.0, kinds=("jpg", "tif"))
    assert {"bokeh.jpg", "bokeh.tif"} <= {path.name for path in made(capture, tmp_path, bokeh=bokeh).paths}
    for name in ("bokeh.jpg", "bokeh.tif"):
        with Image.open(tmp_path / name) as picture:
            assert picture.info["icc_profile"] == profile
            assert picture.getexif()[272] == "Phone 8"
    blurred = tifffile.imread(tmp_path / "bokeh.tif") / 65535
    np.testing.assert_allclose(blurred, np.broadcast_to([1, 0, 0], (*HW, 3)), atol=0.01)
    stripped = dataclasses.replace(bokeh, kinds=("jpg",), is_stripped=True)
    assert tmp_path / "bokeh.tif" not in made(capture, tmp_path, bokeh=stripped).paths
    assert not (tmp_path / "bokeh.tif").exists()
    with Image.open(tmp_path / "bokeh.jpg") as picture:
        assert not picture.getexif()


@pytest.mark.parametrize("rotated_deg", [0, 90, 180, 270])
def test_bokeh_is_focused_where_exif_says(capture: Capture, tmp_path: Path, rotated_deg: int) -> None:
    exif = Image.Exif()
    exif[34665] = {37396: (70, 20)}  # near, as `stepped` has it
    Image.new("RGB", (HW[1], HW[0])).save(capture.tele_path, exif=exif)
    facts = CaptureFacts(rectified=True, rotated_deg=rotated_deg)  # type: ignore[arg-type]
    by_exif = made(capture, tmp_path, bokeh=BokehOptions(focus="af"), facts=facts)
    assert by_exif.numbers["focus_px"] == 12
    found = np.zeros(HW, np.float32)
    found[20, 70] = 1
    y, x = np.nonzero(upright(found, rotated_deg=rotated_deg))
    assert (by_exif.numbers["focus_x_px"], by_exif.numbers["focus_y_px"]) == (x[0], y[0])
    assert "EXIF" in by_exif.notes[-1]


def test_without_such_a_place_the_focus_is_auto_and_said(capture: Capture, tmp_path: Path) -> None:
    by_auto = made(capture, tmp_path, bokeh=BokehOptions())
    by_exif = made(capture, tmp_path, bokeh=BokehOptions(focus="af"))
    assert by_exif.numbers["focus_px"] == by_auto.numbers["focus_px"]
    assert "EXIF names no place" in by_exif.notes[-1]


def test_the_notes_say_how_sure_the_metres_are_and_what_pinned_them(capture: Capture, tmp_path: Path) -> None:
    geometry = rectified_geometry(phone_rig(width_px=HW[1]))
    seen_px = np.full(geometry.hw, 5.0, np.float32)
    seen = DisparityMap(seen_px, np.ones_like(seen_px), seen_px > 0)

    def outcome_of(known: KnownDistance | None, *, shift_px: float = 2.2) -> DepthOutcome:
        outcome = depth_of_capture(
            capture,
            HeldOut(capture, np.zeros((0, 2)), np.zeros(0)),
            tmp_path,
            facts=CaptureFacts(),
            match=lambda ref, src, *, window, valid: seen,
            window=WINDOW,
            bokeh=BokehOptions(focus="40,30"),
            key={"known": known is not None, "shift_px": shift_px},
            shot=ShotGeometry(geometry, DepthPrecision(lens_shift_std_px=shift_px), known=known),
        )
        assert isinstance(outcome, DepthOutcome)
        return outcome

    def notes(known: KnownDistance | None) -> str:
        outcome = outcome_of(known)
        assert outcome.numbers["focus_std_m"] > 0
        assert outcome.withheld is None
        return "\n".join(outcome.notes)

    unsure = notes(None)
    assert "depth in metres is hardly known" in unsure
    assert "at a distance the rig hardly knows" in unsure
    pinned = notes(KnownDistance(40.0, 30.0, 0.79))
    assert "taken to be 0.79 m away" in pinned
    assert ", 0.79 ± 0.0" in pinned
    assert "hardly" not in pinned
    for is_kept in (False, True):  # made, and taken as it lies
        nothing = outcome_of(None, shift_px=40.0)
        assert nothing.is_kept == is_kept
        assert nothing.withheld is not None
        assert nothing.withheld in nothing.notes
        assert "focus_m" not in nothing.numbers
        with np.load(tmp_path / "depth.npz") as arrays:
            assert "disparity" in arrays
            assert not {"depth_m", "depth_std_m"} & set(arrays)


def test_a_result_that_was_cut_off_is_made_again(capture: Capture, tmp_path: Path) -> None:
    whole = {path: path.read_bytes() for path in made(capture, tmp_path, bokeh=BokehOptions()).paths}
    assert made(capture, tmp_path, bokeh=BokehOptions()).is_kept
    for path in whole:
        path.write_bytes(whole[path][:-20])
        again = made(capture, tmp_path, bokeh=BokehOptions())
        assert not again.is_kept
        assert path.stat().st_size == len(whole[path])


def test_what_moved_between_the_photos_is_not_measured(capture: Capture, tmp_path: Path) -> None:
    """Nothing is trusted within a region that moved, and all of it well away from there."""
    rig = phone_rig()
    rig = dataclasses.replace(rig, tele=rig.tele.resized((60, 80)), wide=rig.wide.resized((60, 80)))
    geometry = rectified_geometry(rig)
    outline_px = np.array([[50.0, 20.0], [70.0, 20.0], [70.0, 40.0], [50.0, 40.0]])
    shot = ShotGeometry(geometry, DepthPrecision(), moved=(MovedRegion(outline_px, 9, 3.0),))

    def even(_ref: FloatMap, _src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
        return DisparityMap(
            np.full(geometry.hw, 5, np.float32), np.ones(geometry.hw, np.float32), np.ones(geometry.hw, bool)
        )

    held_out = HeldOut(capture, np.zeros((0, 2)), np.zeros(0))
    outcome = depth_of_capture(
        capture, held_out, tmp_path / "run", facts=FACTS, match=even, window=(0, 32), bokeh=None, key={}, shot=shot
    )
    assert isinstance(outcome, DepthOutcome)
    with np.load(tmp_path / "run" / "depth.npz") as depth:
        confidence, valid = depth["confidence"], depth["valid"]
    assert not confidence[20:41, 50:71].any()
    assert not valid[20:41, 50:71].any()
    assert confidence[5:55, 5:40].min() == 1
    assert valid[5:55, 5:40].all()


def test_what_fails_leaves_earlier_results_alone(capture: Capture, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    made(capture, folder, bokeh=BokehOptions())
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert {"depth.json", "bokeh.jpg"} <= set(before)
    truth_path = tmp_path / "captures" / "one" / "truth.pfm"
    truth_path.write_bytes(b"torn")
    torn = dataclasses.replace(capture, truth_path=truth_path)
    held_out = HeldOut(capture, np.zeros((0, 2)), np.zeros(0))
    failed = depth_of_capture(
        torn, held_out, folder, facts=FACTS, match=stepped, window=WINDOW, bokeh=None, key={"truth": "torn"}
    )
    assert isinstance(failed, DepthFailure)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("width", [100, 201, 209])
def test_confidence_and_validity_stay_with_their_disparity(width: int, rng: np.random.Generator) -> None:
    disparity_px = np.tile(np.arange(HW[1], dtype=np.float32) / 100, (HW[0], 1))  # no jump: edges move nothing
    working = DisparityMap(disparity_px, disparity_px, np.arange(HW[1])[None].repeat(HW[0], axis=0) % 2 == 0)
    on = on_photo(working, rng.random((90, width, 3)).astype(np.float32))
    column = np.rint(on.disparity_px * (HW[1] / width) * 100).astype(int)
    np.testing.assert_array_equal(np.rint(on.confidence * 100).astype(int), column)
    np.testing.assert_array_equal(on.valid, column % 2 == 0)


def test_a_truth_that_knows_nothing_is_said_and_judges_nothing(capture: Capture, tmp_path: Path) -> None:
    truth_path = tmp_path / "truth.pfm"
    write_pfm(truth_path, np.full(HW, np.nan, np.float32))
    silent = dataclasses.replace(capture, truth_path=truth_path)
    outcome = depth_of_capture(
        silent,
        HeldOut(capture, np.zeros((0, 2)), np.zeros(0)),
        tmp_path / "a",
        facts=FACTS,
        match=stepped,
        window=WINDOW,
        bokeh=None,
        key={},
    )
    assert isinstance(outcome, DepthOutcome)
    assert "3PE" not in outcome.numbers
    assert any("truth.pfm knows no disparity" in note for note in outcome.notes)


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory")])
def test_a_lack_of_memory_is_a_problem_of_its_capture(capture: Capture, tmp_path: Path, error: Exception) -> None:
    def greedy(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
        raise error

    outcome = depth_of_capture(
        capture,
        HeldOut(capture, np.zeros((0, 2)), np.zeros(0)),
        tmp_path,
        facts=FACTS,
        match=greedy,
        window=WINDOW,
        bokeh=None,
        key={},
    )
    assert isinstance(outcome, DepthFailure)
    assert "more memory than there is" in outcome.problem.message
    assert not (tmp_path / "depth.npz").exists()


def depth_made(capture: Capture, folder: Path, *, bokeh: BokehOptions | None, turn: int) -> DepthOutcome | DepthFailure:
    """Depth by a match that differs from turn to turn."""

    def match(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
        seen = stepped(ref, src, window=window)
        return dataclasses.replace(seen, disparity_px=seen.disparity_px + np.float32(turn))

    held_out = HeldOut(capture, np.zeros((0, 2)), np.zeros(0))
    key: dict[str, object] = {"turn": turn, "bokeh": bokeh is not None}
    return depth_of_capture(capture, held_out, folder, facts=FACTS, match=match, window=WINDOW, bokeh=bokeh, key=key)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_files_that_telewide_did_not_write_are_neither_replaced_nor_removed(capture: Capture, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("bokeh.jpg", "disparity.png", "notes.txt"):
        (folder / name).write_bytes(b"mine")
    before = contents(folder)
    for bokeh in (BokehOptions(), None):
        failed = depth_made(capture, folder, bokeh=bokeh, turn=0)
        assert isinstance(failed, DepthFailure)
        assert "disparity.png" in failed.problem.message
        assert contents(folder) == before
    (folder / "disparity.png").unlink()
    assert isinstance(depth_made(capture, folder, bokeh=None, turn=0), DepthOutcome)
    assert isinstance(depth_made(capture, folder, bokeh=None, turn=300), DepthOutcome)  # too far for a PNG
    after = contents(folder)
    assert (after["bokeh.jpg"], after["notes.txt"]) == (b"mine", b"mine")
    assert set(after) == {"bokeh.jpg", "notes.txt", "disparity.pfm", "depth.npz", "preview.png", "depth.json"}


def test_a_depth_json_of_somebody_else_is_not_replaced(capture: Capture, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "depth.json").write_text('{"sensor": "lidar"}')
    assert isinstance(depth_made(capture, tmp_path / "mine", bokeh=None, turn=0), DepthFailure)
    assert contents(tmp_path / "mine") == {"depth.json": b'{"sensor": "lidar"}'}


@pytest.mark.parametrize("has_notes", [False, True])
@pytest.mark.parametrize(
    "name", ["disparity.pfm", "disparity.png", "depth.npz", "preview.png", "bokeh.jpg", "depth.json"]
)
def test_all_files_of_a_capture_come_together_or_none(
    name: str, has_notes: bool, capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full at each of the files in turn: the former ones stay, and nothing is left beside them."""
    folder = tmp_path / "run" / "one"
    assert isinstance(depth_made(capture, folder, bokeh=BokehOptions(), turn=0), DepthOutcome)
    if has_notes:
        (folder / "notes.txt").write_text("mine")
    before, replace = contents(folder), Path.replace

    def full_at(path: Path, target: Path) -> Path:
        if Path(target).name == name and Path(target).parent != folder:
            raise OSError(errno.ENOSPC, "No space left on device")
        return replace(path, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", full_at)
        with pytest.raises(MissingPartError, match="No space left"):
            depth_made(capture, folder, bokeh=BokehOptions(), turn=1)
    assert contents(folder) == before
    assert [path.name for path in folder.parent.iterdir()] == ["one"]
    new = tmp_path / "run" / "two"
    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", full_at)
        with pytest.raises(MissingPartError):
            depth_made(capture, new, bokeh=BokehOptions(), turn=1)
    assert not new.exists()
    assert isinstance(depth_made(capture, folder, bokeh=BokehOptions(), turn=1), DepthOutcome)
    assert contents(folder)["disparity.pfm"] != before["disparity.pfm"]


@pytest.mark.parametrize("stopped_at", range(1, 9))
def test_a_call_cut_off_while_files_are_put_in_place_is_made_again(
    stopped_at: int, capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a file of the user's the files are renamed one by one: whatever is there in between counts for nothing."""
    folder = tmp_path / "run" / "one"
    assert isinstance(depth_made(capture, folder, bokeh=BokehOptions(), turn=0), DepthOutcome)
    (folder / "notes.txt").write_text("mine")
    replace, renamed = Path.replace, []

    def killed(path: Path, target: Path) -> Path:
        if Path(target).parent == folder:
            renamed.append(target)
            if len(renamed) == stopped_at:
                raise KeyboardInterrupt
        return replace(path, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", killed)
        try:
            depth_made(capture, folder, bokeh=None, turn=1)
        except KeyboardInterrupt:
            again = depth_made(capture, folder, bokeh=None, turn=1)
        else:
            again = depth_made(capture, folder, bokeh=None, turn=1)
            assert isinstance(again, DepthOutcome)
            assert again.is_kept
    assert isinstance(again, DepthOutcome)
    assert set(contents(folder)) == {*(path.name for path in again.paths), "depth.json", "notes.txt"}
    assert not (folder / "bokeh.jpg").exists()  # of the former photo


def test_a_bokeh_stays_beside_the_same_depth_only(capture: Capture, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    depth_made(capture, folder, bokeh=BokehOptions(), turn=0)
    same = depth_made(capture, folder, bokeh=None, turn=0)
    assert isinstance(same, DepthOutcome)
    assert folder / "bokeh.jpg" in same.paths
    assert (folder / "bokeh.jpg").is_file()
    depth_made(capture, folder, bokeh=None, turn=2)
    assert not (folder / "bokeh.jpg").exists()


@pytest.mark.parametrize("bokeh", [BokehOptions(), BokehOptions(strength_px=5.9)])
def test_a_blur_as_strong_as_asked_for_is_not_spoken_of(bokeh: BokehOptions, capture: Capture, tmp_path: Path) -> None:
    assert not any("held at" in note for note in made(capture, tmp_path / "run", bokeh=bokeh).notes)


def test_a_blur_above_the_largest_is_said_to_be_held_back(capture: Capture, tmp_path: Path) -> None:
    """A tenth of the shorter side of 60 px; by pixels and by an aperture alike."""
    notes = "\n".join(made(capture, tmp_path / "run", bokeh=BokehOptions(strength_px=24)).shortcomings)
    assert "held at a radius of 6 px" in notes
    assert "24 px were asked for" in notes
    known = CaptureFacts(rectified=True, baseline_m=0.012)
    wide_open = made(capture, tmp_path / "wide", bokeh=BokehOptions(f_number=0.5), facts=known)
    assert any("held at a radius of 6 px" in note for note in wide_open.notes)
    assert (tmp_path / "wide" / "bokeh.jpg").is_file()


def test_two_sets_that_name_their_captures_alike_do_not_replace_each_other(capture: Capture, tmp_path: Path) -> None:
    folder = tmp_path / "run" / "one"
    assert isinstance(depth_made(capture, folder, bokeh=None, turn=0), DepthOutcome)
    before = contents(folder)
    shutil.copytree(tmp_path / "captures", tmp_path / "others")
    other = Capture("one", *(tmp_path / "others" / "one" / f"{view}.png" for view in ("tele", "wide")))
    failed = depth_made(other, folder, bokeh=None, turn=1)
    assert isinstance(failed, DepthFailure)
    assert str(capture.tele_path) in failed.problem.message
    assert contents(folder) == before
    shutil.rmtree(tmp_path / "captures")  # moved away: its results may go
    assert isinstance(depth_made(other, folder, bokeh=None, turn=1), DepthOutcome)


@pytest.mark.parametrize("facts", [FACTS, CaptureFacts(rectified=True, f_px=100.0, baseline_m=0.01)])
def test_lenses_that_stand_the_other_way_round_are_spoken_of(
    facts: CaptureFacts, capture: Capture, tmp_path: Path
) -> None:
    """All disparities are negative: near and far are exchanged, and no metre is in front of the cameras."""

    def mirrored(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
        seen = stepped(ref, src, window=window)
        return dataclasses.replace(seen, disparity_px=-seen.disparity_px)

    held_out = HeldOut(capture, np.zeros((0, 2)), np.zeros(0))
    outcome = depth_of_capture(
        capture,
        held_out,
        tmp_path / "a",
        facts=facts,
        match=mirrored,
        window=WINDOW,
        bokeh=None,
        key={"mirrored": True},
    )
    assert isinstance(outcome, DepthOutcome)
    assert any("wide_side: left" in note for note in outcome.shortcomings)
    assert (outcome.withheld is not None) == (facts.baseline_m is not None)
    with np.load(tmp_path / "a" / "depth.npz") as arrays:
        assert "depth_m" not in arrays
    right = depth_of_capture(
        capture,
        held_out,
        tmp_path / "b",
        facts=facts,
        match=stepped,
        window=WINDOW,
        bokeh=None,
        key={"mirrored": False},
    )
    assert isinstance(right, DepthOutcome)
    assert not any("rotated_deg" in note for note in right.notes)
    assert right.withheld is None


@pytest.mark.parametrize("rotated_deg", [90, 270])
def test_every_format_stands_upright(capture: Capture, tmp_path: Path, rotated_deg: int) -> None:
    facts = CaptureFacts(rectified=True, rotated_deg=rotated_deg, f_px=80.0, baseline_m=0.01)  # type: ignore[arg-type]
    held_out = HeldOut(capture, np.zeros((0, 2)), np.zeros(0))
    outcome = depth_of_capture(
        capture,
        held_out,
        tmp_path / "run",
        facts=facts,
        match=stepped,
        window=WINDOW,
        bokeh=None,
        key={},
        formats=("npz", "mm", "tiff", "grey", "gdepth", "dynamic"),
    )
    assert isinstance(outcome, DepthOutcome)
    for name in ("depth_mm.png", "depth.tif", "photo.jpg", "photo_depth.png", "gdepth.jpg", "dynamic_depth.jpg"):
        with Image.open(tmp_path / "run" / name) as picture:
            assert picture.size == HW
    with Image.open(tmp_path / "run" / "photo_depth.png") as picture:
        grey = np.asarray(picture)
    # Near stood on the right before; turned back, it is where the photo's right side is.
    near, far = (grey[-1], grey[0]) if rotated_deg == 90 else (grey[0], grey[-1])
    assert near.min() > far.max()


# What is made of a depth that is there already


class Matching:
    """A match that knows how often it was called."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(
        self, ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None
    ) -> DisparityMap:
        self.calls += 1
        seen = stepped(ref, src, window=window)
        unsure = np.linspace(0.5, 1, HW[0] * HW[1], dtype=np.float32).reshape(HW)
        return dataclasses.replace(seen, confidence=unsure, valid=unsure > 0.6)


METRIC = CaptureFacts(rectified=True, baseline_m=0.012, f_px=400.0, doffs_px=1.5, rotated_deg=90)


def made_again(
    capture: Capture,
    folder: Path,
    match: Matching,
    *,
    bokeh: BokehOptions | None = None,
    formats: tuple[str, ...] | None = DEFAULT_FORMATS,
    matcher: str = "network 1",
) -> DepthOutcome:
    """Depth whose key names the photo and the matcher, as a call does."""
    key: dict[str, object] = {"photo": fingerprint(capture.tele_path), "matcher": matcher, "formats": formats}
    key["bokeh"] = None if bokeh is None else dataclasses.asdict(bokeh)
    held_out = HeldOut(capture, np.zeros((0, 2)), np.zeros(0))
    outcome = depth_of_capture(
        capture, held_out, folder, facts=METRIC, match=match, window=WINDOW, bokeh=bokeh, key=key, formats=formats
    )
    assert isinstance(outcome, DepthOutcome)
    return outcome


def test_another_bokeh_or_format_matches_nothing_again(capture: Capture, tmp_path: Path) -> None:
    folder, match = tmp_path / "run", Matching()
    first = made_again(capture, folder, match)
    stamp = (folder / "depth.npz").stat().st_mtime_ns
    assert not first.is_depth_kept
    for bokeh in (BokehOptions(strength_px=3.0), BokehOptions(focus="near"), BokehOptions(is_preview=True)):
        again = made_again(capture, folder, match, bokeh=bokeh)
        assert again.is_depth_kept
        assert not again.is_kept
    more = made_again(capture, folder, match, formats=("pfm", "npz", "mm", "tiff"))
    assert {"depth_mm.png", "depth.tif"} <= {path.name for path in more.paths}
    assert not (folder / "disparity.png").exists()
    assert match.calls == 1
    assert (folder / "depth.npz").stat().st_mtime_ns == stamp
    assert {name: more.numbers[name] for name in first.numbers} == dict(first.numbers)


def test_depth_that_is_matched_again_keeps_its_formats_and_tells_what_is_gone(capture: Capture, tmp_path: Path) -> None:
    folder, match, formats = tmp_path / "run", Matching(), ("npz", "mm", "tiff")
    made_again(capture, folder, match, bokeh=BokehOptions(), formats=formats)
    again = made_again(capture, folder, match, matcher="network 2", formats=None)
    assert match.calls == 2
    assert {path.name for path in again.paths} >= {"depth_mm.png", "depth.tif"}
    assert not any("removed" in note for note in again.notes)
    fewer = made_again(capture, folder, match, matcher="network 2", formats=("npz", "pfm"))
    assert any(note.endswith("makes none: depth_mm.png, depth.tif") for note in fewer.notes)
    told_once = made_again(capture, folder, match, matcher="network 2", formats=("npz", "pfm"))
    assert not any("removed" in note for note in told_once.notes)


def test_a_bokeh_in_place_of_its_preview_is_no_loss(capture: Capture, tmp_path: Path) -> None:
    folder, match = tmp_path / "run", Matching()
    made_again(capture, folder, match, bokeh=BokehOptions(is_preview=True))
    whole = made_again(capture, folder, match, bokeh=BokehOptions())
    assert not (folder / "bokeh_preview.jpg").exists()
    assert not any("removed" in note for note in whole.notes)


def test_metres_that_were_pinned_and_are_not_now_are_told(capture: Capture, tmp_path: Path) -> None:
    folder, known = tmp_path / "run", {"x_px": 3.0, "y_px": 40.0, "distance_m": 0.9, "is_focus": False}
    for key, is_told in (({"known": known}, False), ({"known": None}, True), ({"known": None}, False)):
        outcome = depth_of_capture(
            capture,
            HeldOut(capture, np.zeros((0, 2)), np.zeros(0)),
            folder,
            facts=METRIC,
            match=stepped,
            window=WINDOW,
            bokeh=None,
            key=key,
        )
        assert isinstance(outcome, DepthOutcome)
        assert any("--distance 3,40,0.9" in note for note in outcome.notes) is is_told


def test_another_photo_or_other_weights_match_again(capture: Capture, tmp_path: Path) -> None:
    folder, match = tmp_path / "run", Matching()
    made_again(capture, folder, match)
    made_again(capture, folder, match, matcher="network 2")
    assert match.calls == 2
    write_image(capture.tele_path, np.full((*HW, 3), 0.5, np.float32))
    assert not made_again(capture, folder, match, matcher="network 2").is_depth_kept
    assert match.calls == 3


@pytest.mark.parametrize(
    "spoil", [lambda path: path.unlink(), lambda path: path.write_bytes(b"0" * path.stat().st_size)]
)
def test_a_depth_that_is_no_longer_whole_is_matched_again(
    capture: Capture, tmp_path: Path, spoil: Callable[[Path], object]
) -> None:
    folder, match = tmp_path / "run", Matching()
    made_again(capture, folder, match)
    spoil(folder / "depth.npz")
    assert not made_again(capture, folder, match, bokeh=BokehOptions()).is_depth_kept
    assert match.calls == 2


def test_files_of_a_kept_depth_are_those_of_one_just_matched(capture: Capture, tmp_path: Path) -> None:
    """Whatever the way to them, the same bytes: all formats, and bokeh in colours and in metres."""
    formats = chosen_formats(["pfm,png,mm,tiff,grey,gdepth"])
    bokeh = BokehOptions(focus="0.6m", f_number=2.0, kinds=("jpg", "tif"))
    at_once = made_again(capture, tmp_path / "at_once", Matching(), bokeh=bokeh, formats=formats)
    match = Matching()
    made_again(capture, tmp_path / "later", match, formats=("npz",))
    later = made_again(capture, tmp_path / "later", match, bokeh=bokeh, formats=formats)
    assert match.calls == 1
    names = {path.name for path in at_once.paths}
    assert {path.name for path in later.paths} == names
    for name in names:
        assert (tmp_path / "later" / name).read_bytes() == (tmp_path / "at_once" / name).read_bytes(), name
    assert later.notes == at_once.notes
    same = ("focus_px", "focus_m", "EPE_px", "matches")
    assert {n: later.numbers.get(n) for n in same} == {n: at_once.numbers.get(n) for n in same}
    assert later.numbers["focus_m"] == 0.6, "what is sharp, wherever the surface next to it is"


def shown_of(folder: Path) -> tuple[object, ...]:
    record = read_lying(folder)
    return record.shown_notes, record.shown_numbers, record.bokeh.asked


def test_a_preview_stands_beside_the_picture_until_that_is_made_again(capture: Capture, tmp_path: Path) -> None:
    folder, match = tmp_path / "run", Matching()
    made_again(capture, folder, match, bokeh=BokehOptions(strength_px=3.0))
    whole, shown = (folder / "bokeh.jpg").read_bytes(), shown_of(folder)
    tried = made_again(capture, folder, match, bokeh=BokehOptions(focus="near", is_preview=True))
    assert shown_of(folder) == shown, "the page shows the picture, and what it is focused on"
    assert not set(tried.notes) <= set(shown[0]), "the terminal tells of the preview"
    made_again(capture, folder, match, bokeh=None)
    assert shown_of(folder) == shown
    assert {folder / "bokeh.jpg", folder / "bokeh_preview.jpg"} <= set(tried.paths)
    assert (folder / "bokeh.jpg").read_bytes() == whole
    with Image.open(folder / "bokeh_preview.jpg") as picture:
        assert picture.size == (HW[0] // 4, HW[1] // 4)  # of the upright photo
    made_again(capture, folder, match, bokeh=BokehOptions(focus="near"))
    assert (folder / "bokeh.jpg").read_bytes() != whole
    assert not (folder / "bokeh_preview.jpg").exists()


def test_bokeh_of_a_raw_photo_in_linear_light_is_that_of_its_picture(
    capture: Capture, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Read back with the library of the format's makers; of a JPEG or PNG there is none, and that is told."""
    OpenEXR = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    raw = write_dng(capture.tele_path.with_suffix(".dng"), rng.uniform(0.1, 0.8, HW).astype(np.float32))
    bokeh = BokehOptions(focus="near", strength_px=3.0, kinds=("tif", "exr"))
    outcome = made(dataclasses.replace(capture, tele_path=raw), tmp_path / "raw", bokeh=bokeh)
    assert {"bokeh.tif", "bokeh.exr"} <= {path.name for path in outcome.paths}
    with OpenEXR.File(str(tmp_path / "raw" / "bokeh.exr")) as file:
        linear = file.channels()["RGB"].pixels.astype(np.float32)
        assert file.header()["software"].startswith("telewide")
    shown = tifffile.imread(tmp_path / "raw" / "bokeh.tif") / np.float32(65535)
    np.testing.assert_allclose(linear, linear_from_srgb(shown), rtol=2e-3, atol=1e-4)
    in_focus = np.s_[5:-5, HW[1] // 2 + 8 : -5]
    np.testing.assert_allclose(linear[in_focus], linear_from_srgb(read_image(raw))[in_focus], rtol=2e-3, atol=1e-4)
    of_png = made(capture, tmp_path / "png", bokeh=bokeh)
    assert "bokeh.exr" not in {path.name for path in of_png.paths}
    (told,) = of_png.shortcomings
    assert "bokeh.exr left out" in told
