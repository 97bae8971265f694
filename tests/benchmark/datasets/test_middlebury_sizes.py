"""Middlebury 2005 and 2006 at each size: views that slide over one canvas, and real scenes of two sizes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from benchmark.datasets.test_other_sets import assert_right_becomes_left

from telewide.benchmark.datasets.protocols import find_protocol, select_scenes
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.paper.run import PaperOptions, benchmark_table
from telewide.benchmark.paper.tables import find_table, with_columns
from telewide.errors import InputError

STEP_PX = 3  # from view to view
SIZES = {"third": (3, 370), "half": (2, 555), "full": (1, 1110)}  # what the bytes are multiplied by, and px of height
WIDTH_PX = 120


def write_scene(folder: Path, size: str, rng: np.random.Generator) -> None:
    """Each view lies `STEP_PX` further right on the canvas than the one before; the bytes are of views 1 and 5."""
    scale, height = SIZES[size]
    folder.mkdir(parents=True)
    canvas = rng.integers(0, 256, (height, WIDTH_PX + 7 * STEP_PX, 3), dtype=np.uint8)
    for view in (1, 2, 5):
        cv2.imwrite(str(folder / f"view{view}.png"), canvas[:, view * STEP_PX : view * STEP_PX + WIDTH_PX])
    for view in (1, 5):
        levels = np.full((height, WIDTH_PX), scale * 4 * STEP_PX, np.uint8)
        levels[:7] = 0
        cv2.imwrite(str(folder / f"disp{view}.png"), levels)


def only_scene(name: str, root: Path, *, split: str | None = None) -> StereoTruth:
    (scene,) = select_scenes(find_protocol(name), root, split=split).scenes
    return scene.read()


def assert_apart(truth: StereoTruth, disparity_px: int) -> None:
    """What is at x on the left is at x - d on the right, and the truth says so."""
    np.testing.assert_array_equal(truth.left[:, disparity_px:], truth.right[:, :-disparity_px])
    known = np.isfinite(truth.disparity_px)
    assert known.mean() > 0.5
    assert (truth.disparity_px[known] == disparity_px).all()


@pytest.mark.parametrize("year", [2005, 2006])
@pytest.mark.parametrize("size", SIZES)
def test_bytes_are_px_of_the_size_at_hand(year: int, size: str, tmp_path: Path, rng: np.random.Generator) -> None:
    write_scene(tmp_path / f"middlebury_{year}_{size}" / "Own", size, rng)
    truth = only_scene(f"middlebury_{year}_{size}", tmp_path)
    assert_apart(truth, 4 * STEP_PX)
    assert np.isnan(truth.disparity_px[:7]).all()
    assert np.isfinite(truth.disparity_px[7:]).all()
    assert truth.occluded is not None
    assert truth.occluded[:, : 4 * STEP_PX].all(), "left of what view 5 sees"
    assert not truth.occluded[7:, 4 * STEP_PX :].any()
    other = next(name for name in SIZES if name != size)
    (tmp_path / f"middlebury_{year}_{size}").rename(tmp_path / f"middlebury_{year}_{other}")
    with pytest.raises(InputError, match=f"{other}-size scenes have about"):
        only_scene(f"middlebury_{year}_{other}", tmp_path)


@pytest.mark.parametrize(("year", "name", "split"), [(2005, "Art", "test"), (2006, "Aloe", "training")])
def test_neighbouring_views_have_a_quarter_of_the_disparity(
    year: int, name: str, split: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    write_scene(tmp_path / f"middlebury_{year}_full" / name, "full", rng)
    truth = only_scene("paper-middlebury", tmp_path, split=split)
    assert truth.left.shape == (1024, WIDTH_PX, 3), "of the middle"
    assert_apart(truth, STEP_PX)
    assert np.isnan(truth.disparity_px[:, :53]).all()
    assert np.isfinite(truth.disparity_px[:, 53:]).all()
    assert truth.occluded is None, "the right view's disparity is of view 5"


def test_scenes_of_2005_without_disparities_are_learned_from_and_not_judged(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    root = tmp_path / "middlebury_2005_half"
    for name in ("Art", "Dwarves"):
        write_scene(root / name, "half", rng)
    for view in (1, 5):
        (root / "Dwarves" / f"disp{view}.png").unlink()
    known, unknown = (scene.read() for scene in select_scenes(find_protocol("middlebury_2005_half"), tmp_path).scenes)
    assert np.isfinite(known.disparity_px).any()
    assert np.isnan(unknown.disparity_px).all()
    np.testing.assert_array_equal(unknown.left[:, 4 * STEP_PX :], unknown.right[:, : -4 * STEP_PX])
    table = with_columns(find_table("prior"), data_sets=("middlebury_2005_half",), factors=(1,))
    options = PaperOptions(tmp_path, tmp_path / "out", systems=("sgm-opencv",))
    rows = benchmark_table(table, options, tell=lambda _: None).report.rows
    assert {row["scene"] for row in rows} == {"Art"}
    for path in (root / "Art").glob("disp*.png"):
        path.unlink()
    with pytest.raises(InputError, match="no data set of the table") as caught:
        benchmark_table(table, options, tell=lambda _: None)
    assert "no disparity of its scenes is known" in (caught.value.hint or "")


@pytest.fixture
def real_half(data_root: Path, tmp_path: Path) -> Path:
    """The photographed half-size scenes under the name of the catalogue."""
    if not (data_root / "middlebury_half").is_dir():
        pytest.skip(f"no half-size scenes in {data_root}")
    (tmp_path / "middlebury_2006_half").symlink_to(data_root / "middlebury_half")
    return tmp_path


def test_real_half_size_scenes_are_those_of_a_third_at_half_as_many_px_again(data_root: Path, real_half: Path) -> None:
    thirds = {scene.name: scene for scene in select_scenes(find_protocol("middlebury_2006_third"), data_root).scenes}
    halves = select_scenes(find_protocol("middlebury_2006_half"), real_half).scenes
    assert len(halves) == 8
    for scene in (halves[0], halves[-1]):
        half, third = scene.read(), thirds[scene.name].read()
        assert_right_becomes_left(half, share=0.4)
        assert np.nanmedian(half.disparity_px) == pytest.approx(1.5 * np.nanmedian(third.disparity_px), abs=1)
        assert half.occluded is not None
        assert third.occluded is not None
        assert half.occluded.mean() == pytest.approx(third.occluded.mean(), abs=0.03)
