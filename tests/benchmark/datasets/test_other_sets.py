"""KITTI and light fields in small, built by the tests; what is photographed is read for real."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.benchmark.datasets.catalogue import DATA_SETS, find_data_set, locate, missing_note
from telewide.benchmark.datasets.kitti import KITTI_2012, KITTI_2015, kitti_frames, read_kitti
from telewide.benchmark.datasets.light_fields import hci_scenes, inria_scenes, read_hci, read_inria
from telewide.benchmark.datasets.middlebury import read_middlebury_2001, read_middlebury_2003, read_middlebury_2014
from telewide.benchmark.datasets.own_captures import captures_with_truth, read_capture_with_truth
from telewide.benchmark.datasets.truth import StereoTruth, occluded_by_cross_check
from telewide.capture.images import write_image
from telewide.capture.pfm import write_pfm
from telewide.errors import InputError, UsageError

HW = (20, 32)
STEP_PX = -2.0  # of the light fields: signed


def noise(rng: np.random.Generator) -> np.ndarray:
    return rng.random((*HW, 3), dtype=np.float32)


def assert_right_becomes_left(truth: StereoTruth, *, share: float) -> None:
    """Warped by the truth, the right view looks far more like the left one than before; by its negative it does not."""
    y, x = np.mgrid[: truth.left.shape[0], : truth.left.shape[1]].astype(np.float32)
    known = np.isfinite(truth.disparity_px) & (np.abs(x - x.mean()) < x.mean() - np.nanmax(np.abs(truth.disparity_px)))
    at_zero = np.abs(truth.right - truth.left)[known].mean()
    errors = {}
    for sign in (1, -1):
        warped = cv2.remap(truth.right, x - sign * np.nan_to_num(truth.disparity_px), y, cv2.INTER_LINEAR)
        errors[sign] = np.abs(warped - truth.left)[known].mean()
    assert errors[1] < share * at_zero < errors[-1]


@pytest.fixture
def kitti_2012(tmp_path: Path, rng: np.random.Generator) -> Path:
    """One frame: 7.5 px everywhere, unknown in the first row, occluded in the first columns."""
    training = tmp_path / "kitti_2012" / "training"
    for folder in ("colored_0", "colored_1"):
        write_image(training / folder / "000003_10.png", noise(rng))
        write_image(training / folder / "000003_11.png", noise(rng))
    levels = np.full(HW, 7.5 * 256, np.uint16)
    levels[0] = 0
    for folder in ("disp_occ", "disp_noc"):
        (training / folder).mkdir()
        cv2.imwrite(str(training / folder / "000003_10.png"), levels)
        levels[:, :8] = 0
    return tmp_path / "kitti_2012"


def test_kitti_2012(kitti_2012: Path) -> None:
    assert kitti_frames(kitti_2012, KITTI_2012) == kitti_frames(kitti_2012 / "training", KITTI_2012) == ("000003_10",)
    truth = read_kitti(kitti_2012, "000003_10", layout=KITTI_2012)
    assert np.isnan(truth.disparity_px[0]).all()
    assert (truth.disparity_px[1:] == 7.5).all()
    assert truth.occluded is not None
    assert truth.occluded[1:, :8].all()
    assert not truth.occluded[:, 8:].any()
    assert not truth.occluded[0].any()
    assert kitti_frames(kitti_2012, KITTI_2015) == ()


def test_kitti_with_bytes_or_without_a_view(kitti_2012: Path) -> None:
    cv2.imwrite(str(kitti_2012 / "training/disp_occ/000003_10.png"), np.ones(HW, np.uint8))
    with pytest.raises(InputError, match="has 8 bits"):
        read_kitti(kitti_2012, "000003_10", layout=KITTI_2012)
    with pytest.raises(UsageError, match="no frame 000004_10"):
        read_kitti(kitti_2012, "000004_10", layout=KITTI_2012)


def test_a_real_frame_in_the_layout_of_kitti_2015(data_root: Path, tmp_path: Path) -> None:
    levels = cv2.imread(str(data_root / "kitti_one_frame" / "ground-truth.png"), cv2.IMREAD_UNCHANGED)
    for folder, name in (("image_2", "reference.png"), ("image_3", "target.png")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "000000_10.png").write_bytes((data_root / "kitti_one_frame" / name).read_bytes())
    (tmp_path / "disp_occ_0").mkdir()
    cv2.imwrite(str(tmp_path / "disp_occ_0" / "000000_10.png"), levels.astype(np.uint16) * 256)
    truth = read_kitti(tmp_path, "000000_10", layout=KITTI_2015)
    assert truth.left.shape == (375, 1242, 3)
    assert truth.occluded is None
    assert_right_becomes_left(truth, share=0.3)


def test_a_real_frame_in_whole_px(data_root: Path, tmp_path: Path) -> None:
    data_set = DATA_SETS["kitti_one_frame"]
    root = locate(data_set, data_root)
    assert root is not None
    assert data_set.scenes(root) == ("frame",)
    truth = data_set.read(root, "frame", (0, 1))
    assert truth.left.shape == (375, 1242, 3)
    assert np.isnan(truth.disparity_px).any()
    assert np.nanmin(truth.disparity_px) >= 1
    assert (truth.disparity_px[np.isfinite(truth.disparity_px)] % 1 == 0).all()
    assert_right_becomes_left(truth, share=0.3)
    assert data_set.scenes(tmp_path) == ()


@pytest.fixture
def inria(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A canvas that slides by `STEP_PX` from view to view; the middle row only."""
    folder = tmp_path / "inria_slfd" / "Black&white"
    folder.mkdir(parents=True)
    canvas = rng.random((HW[0], HW[1] + 40, 3), dtype=np.float32)
    for column in range(1, 10):
        shift = round(20 + STEP_PX * (column - 5))
        write_image(folder / f"lf_5_{column}.png", canvas[:, shift : shift + HW[1]])
        np.save(folder / f"disparity_5_{column}.npy", np.full(HW, STEP_PX, np.float64))
    return tmp_path / "inria_slfd"


def test_inria(inria: Path) -> None:
    assert inria_scenes(inria) == ("Black&white",)
    truth = read_inria(inria, "Black&white", views=(40, 43))
    assert (truth.disparity_px == 3 * STEP_PX).all()
    np.testing.assert_array_equal(truth.left[:, :-6], truth.right[:, 6:])  # x_right = x_left - d = x_left + 6
    assert truth.occluded is not None
    assert truth.occluded[:, -6:].all()
    assert not truth.occluded[:, :-6].any()


def test_light_field_views_of_one_row(inria: Path) -> None:
    for views in ((40, 49), (44, 40), (80, 81), (40, 40)):
        with pytest.raises(UsageError, match="two of one row"):
            read_inria(inria, "Black&white", views=views)
    with pytest.raises(UsageError, match="no scene Lion") as caught:
        read_inria(inria, "Lion", views=(40, 41))
    assert "Black&white" in (caught.value.hint or "")


def test_arrays_of_objects_are_not_loaded(inria: Path) -> None:
    path = inria / "Black&white" / "disparity_5_5.npy"
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="is corrupt"):
        read_inria(inria, "Black&white", views=(40, 41))
    np.save(path, np.zeros((3, *HW)))
    with pytest.raises(InputError, match="a map of numbers was expected"):
        read_inria(inria, "Black&white", views=(40, 41))


def test_the_real_light_field(data_root: Path) -> None:
    root = data_root / "hci_antinous"
    assert hci_scenes(root) == ("antinous",)
    truth = read_hci(root, "antinous", views=(40, 44))
    assert truth.disparity_px.min() < -12
    assert truth.disparity_px.max() > 10
    assert_right_becomes_left(truth, share=0.5)
    assert np.isnan(read_hci(root, "antinous", views=(39, 44)).disparity_px).all()


def test_real_tsukuba(data_root: Path) -> None:
    truth = read_middlebury_2001(data_root / "middlebury_2001" / "tsukuba")
    assert np.nanmax(truth.disparity_px) == 14
    assert_right_becomes_left(truth, share=0.3)


@pytest.mark.parametrize("scene", ["Cones", "Teddy"])
def test_real_middlebury_2003(data_root: Path, scene: str) -> None:
    folder = data_root / "middlebury_2003" / scene
    truth = read_middlebury_2003(folder)
    assert np.nanmax(truth.disparity_px) < 60  # quarter size
    assert_right_becomes_left(truth, share=0.3)
    # The mask of its makers against the cross check of the two maps.
    levels = (cv2.imread(str(folder / f"disp{view}.png"), cv2.IMREAD_UNCHANGED) for view in (2, 6))
    left_px, right_px = (np.where(m > 0, m / 4, np.nan).astype(np.float32) for m in levels)
    known = np.isfinite(left_px)
    ours, theirs = occluded_by_cross_check(left_px, right_px)[known], truth.occluded
    assert theirs is not None
    assert (ours == theirs[known]).mean() > 0.97


def test_real_middlebury_2014(data_root: Path) -> None:
    truth = read_middlebury_2014(data_root / "middlebury_2014" / "Motorcycle_Q")
    assert truth.occluded is not None
    assert 0.05 < truth.occluded.mean() < 0.2
    assert not truth.occluded[np.isnan(truth.disparity_px)].any()
    assert_right_becomes_left(truth, share=0.3)


def test_portable_pictures_of_2001(tmp_path: Path, rng: np.random.Generator) -> None:
    levels = rng.integers(0, 256, (2, *HW, 3), dtype=np.uint8)
    for name, view in zip(("im2", "im6"), levels, strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.ppm"), view)
    cv2.imwrite(str(tmp_path / "disp2.pgm"), np.full(HW, 44, np.uint8))
    truth = read_middlebury_2001(tmp_path)
    assert (truth.disparity_px == 5.5).all()
    np.testing.assert_allclose(truth.left, levels[0][..., ::-1] / 255, atol=1e-6)
    (tmp_path / "disp2.pgm").write_bytes(b"P5\n32 20\n255\n")
    with pytest.raises(InputError, match="cannot be read as a picture"):
        read_middlebury_2001(tmp_path)


def test_captures_with_a_truth(tmp_path: Path, rng: np.random.Generator) -> None:
    hw = (64, 64)
    for name in ("a", "b"):
        for view in ("tele", "wide"):
            write_image(tmp_path / name / f"{view}.png", rng.random((*hw, 3), dtype=np.float32))
    write_pfm(tmp_path / "a" / "truth.pfm", np.full(hw, 3.0, np.float32))
    assert captures_with_truth(tmp_path) == ("a",)
    assert (read_capture_with_truth(tmp_path, "a").disparity_px == 3).all()
    with pytest.raises(UsageError, match="has no truth"):
        read_capture_with_truth(tmp_path, "b")


def test_what_another_point_covers_is_occluded() -> None:
    # A near bar, 4 px, over a far ground, 1 px: of 10 columns the bar has 5 and 6 on the left, 1 and 2 on the right.
    left_px = np.array([[1, 1, 1, 1, 1, 4, 4, 1, 1, 1]], np.float32)
    right_px = np.array([[1, 4, 4, 1, 1, 1, 1, 1, 1, np.nan]], np.float32)
    expected = [True, False, True, True, False, False, False, False, False, False]
    assert occluded_by_cross_check(left_px, right_px)[0].tolist() == expected


def test_a_missing_set_says_where_to_get_it(tmp_path: Path, inria: Path) -> None:
    for data_set in DATA_SETS.values():
        note = missing_note(data_set, tmp_path)
        assert data_set.name in note
        assert data_set.source in note
        assert data_set.licence in note
    assert locate(DATA_SETS["inria_slfd"], inria.parent) == inria
    inria.rename(inria.with_name("inria_slfd_some"))
    assert locate(DATA_SETS["inria_slfd"], inria.parent) == inria.with_name("inria_slfd_some")
    assert locate(DATA_SETS["hci"], inria.parent) is None
    with pytest.raises(UsageError, match="is no folder"):
        locate(DATA_SETS["hci"], tmp_path / "nothing")
    with pytest.raises(UsageError, match="unknown data set") as caught:
        find_data_set("kiti_2015")
    assert "kitti_2015" in (caught.value.hint or "")
