"""Protocols: the shipped ones name what exists, and cut what they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from telewide.benchmark.datasets.catalogue import DATA_SETS
from telewide.benchmark.datasets.protocols import (
    Protocol,
    find_protocol,
    load_protocols,
    search_window,
    select_scenes,
    taken_by,
)
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.capture.images import write_image
from telewide.errors import InputError, UsageError

SIZES = {
    "middlebury-2006-third": (14, 3, 4),
    "choice-middlebury-2006": (17,),
    "paper-inria-slfd": (40, 13),
    "paper-hci": (15, 7),
    "paper-middlebury": (24, 6),
    "paper-kitti-2015": (8, 2),
    "kitti-2012": (8, 2),
}


# The scenes that the supplement tests on; the others of each set are trained on.
TESTED = {
    "paper-inria-slfd": "Coffee_beans_vases Three_pillows Antiques Flying_furniture Toy_bricks Kiwi_bike "
    "Electro_devices Fruit_box Camera_brush Egyptian_sculpture Flying_dice Moai Flying_toys",
    "paper-hci": "boardgames vinyl pillows table medieval2 rosemary tower",
    "paper-middlebury": "Art Books Dolls Laundry Moebius Reindeer",
}


def numbered(hw: tuple[int, int]) -> StereoTruth:
    """Every pixel's truth is its own number."""
    numbers = np.arange(hw[0] * hw[1], dtype=np.float32).reshape(hw)
    view = np.repeat(numbers[..., None] / numbers.size, 3, axis=2)
    return StereoTruth(view, view, numbers, numbers % 2 == 0)


def test_shipped_protocols_have_their_scenes_once() -> None:
    protocols = load_protocols()
    assert {name: tuple(map(len, p.splits.values())) for name, p in protocols.items()} == SIZES
    for protocol in protocols.values():
        assert set(protocol.data_sets) <= DATA_SETS.keys()
        scenes = [scene for split in protocol.splits.values() for scene in split]
        assert len(set(scenes)) == len(scenes)
    assert {name: protocols[name].splits["test"] for name in TESTED} == {n: tuple(t.split()) for n, t in TESTED.items()}


def test_a_data_set_is_a_protocol_that_takes_all_of_it() -> None:
    assert find_protocol("hci") == Protocol(data_sets=("hci",))
    whole = numbered((6, 8))
    taken = taken_by(find_protocol("hci"), whole)
    np.testing.assert_array_equal(taken.disparity_px, whole.disparity_px)
    with pytest.raises(UsageError, match="unknown protocol") as caught:
        find_protocol("paper-hcl")
    assert "paper-hci" in (caught.value.hint or "")


def test_crop_rows_and_columns() -> None:
    whole = numbered((10, 12))
    middle = taken_by(Protocol(data_sets=("hci",), crop_wh=(6, 4)), whole)
    np.testing.assert_array_equal(middle.disparity_px, whole.disparity_px[3:7, 3:9])
    assert middle.left.shape == middle.right.shape == (4, 6, 3)
    lower = taken_by(Protocol(data_sets=("hci",), last_rows=3, left_out_columns=2), whole)
    assert np.isnan(lower.disparity_px[:, :2]).all()
    np.testing.assert_array_equal(lower.disparity_px[:, 2:], whole.disparity_px[7:, 2:])
    assert lower.occluded is not None
    assert lower.occluded.shape == (3, 12)
    assert not np.isnan(whole.disparity_px).any()  # what was read is not written to
    larger = taken_by(Protocol(data_sets=("hci",), crop_wh=(100, 100), last_rows=100), whole)
    np.testing.assert_array_equal(larger.disparity_px, whole.disparity_px)


def test_the_window_covers_the_truth() -> None:
    truth = numbered((2, 2))
    free = Protocol(data_sets=("hci",))
    for values, expected in (([3, 20, 31.9, 5], (0, 32)), ([-12.5, 0, 10, 16], (-16, 32))):
        truth.disparity_px[:] = np.reshape(values, (2, 2))
        assert search_window(free, truth) == expected
    assert search_window(Protocol(data_sets=("hci",), window_px=(-8, 8)), truth) == (-8, 8)
    truth.disparity_px[:] = np.nan
    with pytest.raises(InputError, match="no disparity of the scene is known"):
        search_window(free, truth)


@pytest.fixture
def light_fields(tmp_path: Path, rng: np.random.Generator) -> Path:
    for scene in ("pillows", "table", "boxes"):
        for view in (40, 44):
            picture = rng.random((16, 16, 3), dtype=np.float32)
            write_image(tmp_path / "hci" / "some" / scene / f"input_Cam{view:03d}.png", picture)
    return tmp_path


def test_what_is_missing_is_told_and_left_out(light_fields: Path) -> None:
    chosen = select_scenes(find_protocol("paper-hci"), light_fields, split="test")
    assert [scene.name for scene in chosen.scenes] == ["pillows", "table"]  # in the order of the protocol
    assert any("rosemary" in note for note in chosen.notes)
    assert chosen.scenes[0].read().left.shape == (16, 16, 3)
    nothing = select_scenes(find_protocol("paper-inria-slfd"), light_fields, split="test")
    assert nothing.scenes == ()
    assert "clim.inria.fr" in nothing.notes[0]
    assert len(select_scenes(find_protocol("hci"), light_fields).scenes) == 3
    patterns = Protocol(data_sets=("hci",), splits={"test": ("*o*s",)})
    assert [scene.name for scene in select_scenes(patterns, light_fields, split="test").scenes] == ["boxes", "pillows"]
    with pytest.raises(UsageError, match="unknown split 'tset'"):
        select_scenes(find_protocol("paper-hci"), light_fields, split="tset")


def test_slips_in_a_file_of_protocols(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("format: 1\nprotocols: {mine: {data_sets: [hci], crop: [3, 4]}}\n")
    with pytest.raises(InputError, match="crop"):
        load_protocols(path=path)
    path.write_text("format: 1\nprotocols: {mine: {data_sets: [hci], crop_wh: [3, 4]}}\n")
    assert load_protocols(path=path)["mine"].crop_wh == (3, 4)


def test_third_size_scenes_are_all_there(data_root: Path) -> None:
    protocol = find_protocol("middlebury-2006-third")
    chosen = select_scenes(protocol, data_root)
    assert {scene.name for scene in chosen.scenes} == {name for split in protocol.splits.values() for name in split}
    assert chosen.notes == ()
    truth = chosen.scenes[0].read()
    assert np.isnan(truth.disparity_px[:, :53]).all()
    assert np.isfinite(truth.disparity_px[:, 53:]).mean() > 0.5
    assert truth.occluded is not None


def test_half_size_scenes_are_not_taken_for_third(data_root: Path, tmp_path: Path) -> None:
    (tmp_path / "middlebury_2006_third").symlink_to(data_root / "middlebury_half")
    scene = select_scenes(find_protocol("middlebury-2006-third"), tmp_path).scenes[0]
    with pytest.raises(InputError, match="third-size scenes have about 370"):
        scene.read()
