"""A phone that was held otherwise than for its calibration: the rig turns with the photos, or it is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from capture.roll import exif_of
from PIL import Image
from rig_worlds import phone_rig, photos_of_a_plane

import telewide
from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.rig_file import RigFacts, StoredRig, write_stored_rig
from telewide.capture.pair import find_captures
from telewide.cli import main
from telewide.geometry.arrays import FloatMap

DEPTH_M = 1.5
RIG = phone_rig(width_px=480)
QUALITY = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")


def stored(orientations: tuple[int, int] | None) -> StoredRig:
    return StoredRig(RIG, None, None, None, QUALITY, RigFacts(orientations=orientations))


@pytest.fixture(scope="module")
def photos() -> tuple[FloatMap, FloatMap]:
    return photos_of_a_plane(RIG, np.random.default_rng(5), depth_m=DEPTH_M)


def shoot(folder: Path, photos: tuple[FloatMap, FloatMap], *, orientation: int) -> Path:
    """The sensors see what they saw; EXIF says how the phone was held."""
    for name, photo in zip(("tele", "wide"), photos, strict=True):
        path = folder / "captures" / "plane" / f"{name}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = np.round(photo * 255).astype(np.uint8)[..., None].repeat(3, axis=2)
        Image.fromarray(pixels).save(path, exif=exif_of(orientation=orientation).tobytes(), quality=95)
    return folder / "captures"


def depth_by_command(captures: Path, run: Path, rig: StoredRig) -> int:
    write_stored_rig(captures / "rig.yaml", rig)
    with pytest.raises(SystemExit) as left:
        main(["depth", str(captures), "--run", str(run), "--method", "sgm", "--quiet"])
    return int(left.value.code or 0)


@pytest.mark.parametrize("orientation", [*(pytest.param(held, marks=pytest.mark.slow) for held in (1, 3, 8)), 6])
def test_metres_do_not_depend_on_how_the_phone_was_held(
    photos: tuple[FloatMap, FloatMap], tmp_path: Path, orientation: int
) -> None:
    captures = shoot(tmp_path, photos, orientation=orientation)
    assert depth_by_command(captures, tmp_path / "run", stored((1, 1))) == 0
    with np.load(tmp_path / "run" / "depth" / "plane" / "depth.npz") as kept:
        depth_m = kept["depth_m"]
    assert depth_m.shape == (RIG.tele.hw if orientation in {1, 3} else RIG.tele.hw[::-1])
    assert np.nanmedian(depth_m) == pytest.approx(DEPTH_M, rel=0.1)
    assert np.isfinite(depth_m).mean() > 0.9
    by_hand = telewide.estimate_depth(telewide.read_pair(captures / "plane"), rig=stored((1, 1)))
    assert by_hand.depth_m is not None
    assert np.nanmedian(by_hand.depth_m) == pytest.approx(np.nanmedian(depth_m), rel=0.02)


def test_depth_behind_the_cameras_is_refused_in_words(
    photos: tuple[FloatMap, FloatMap], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Upside down, by a rig that does not say how the phone was held for it."""
    captures = shoot(tmp_path, photos, orientation=3)
    assert depth_by_command(captures, tmp_path / "run", stored(None)) == 4
    told = capsys.readouterr().err
    assert "no depth in metres" in told
    assert "held otherwise than for the calibration" in told
    with np.load(tmp_path / "run" / "depth" / "plane" / "depth.npz") as kept:
        assert "depth_m" not in kept


def test_a_photo_turned_for_good_is_not_turned_again() -> None:
    """Made in portrait by EXIF, photographed in portrait by a program that writes no orientation."""
    portrait = stored((6, 6))
    tall = RIG.turned(tele_deg=90, wide_deg=90)
    portrait = StoredRig(tall, None, None, None, QUALITY, portrait.facts)
    assert portrait.as_held((1, 1), tele_hw=tall.tele.hw) is tall
    assert portrait.as_held((1, 1), tele_hw=RIG.tele.hw).tele.hw == RIG.tele.hw
    assert portrait.as_held(None, tele_hw=tall.tele.hw) is tall
    assert portrait.as_held((2, 6), tele_hw=tall.tele.hw) is tall


def test_a_read_pair_says_how_the_phone_was_held(photos: tuple[FloatMap, FloatMap], tmp_path: Path) -> None:
    captures = shoot(tmp_path, photos, orientation=8)
    assert telewide.read_pair(captures / "plane").orientations == (8, 8)
    assert len(find_captures(captures).captures) == 1
