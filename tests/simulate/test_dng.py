"""Simulated photos as files: LibRaw and tifffile read the DNG, our reader finds the scene, EXIF says the same."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
from simulate.cards import QUIET, chart, grey

from telewide.capture.exif import read_photo_facts
from telewide.capture.images import read_image
from telewide.capture.raw import read_raw
from telewide.errors import UsageError
from telewide.simulate.dng import ExifFacts, write_dng, write_jpeg
from telewide.simulate.sensor import PATTERNS, RawFrame, Sensor, developed, expose, phone_sensor
from telewide.srgb import srgb_from_linear

FACTS = ExifFacts("Maker", "Phone 1", 6.86, 24, datetime(2026, 5, 1, 12, 0, 1, 250_000), 1.75)
INSIDE = (slice(6, -6), slice(6, -6))  # demosaicing guesses at the border


def phone_frame(rng: np.random.Generator, *, is_wide: bool = True, **changes: object) -> RawFrame:
    sensor = replace(phone_sensor(rng, is_wide=is_wide), **changes)
    return expose(chart(), sensor, rng=rng)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_libraw_reads_what_the_sensor_counted(tmp_path: Path, rng: np.random.Generator, pattern: str) -> None:
    frame = phone_frame(rng, pattern=pattern)
    write_dng(tmp_path / "a.dng", frame, facts=FACTS)
    sensor = frame.sensor
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, frame.bayer)
        assert set(raw.black_level_per_channel) == {sensor.black_level}
        assert raw.white_level == sensor.white_level
        balance = np.array(raw.camera_whitebalance[:3])
        np.testing.assert_allclose(balance / balance[1], sensor.neutral[1] / np.array(sensor.neutral), rtol=1e-4)
        names = raw.color_desc.decode()
        assert "".join(names[c] for c in raw.raw_pattern.ravel()) == pattern
        np.testing.assert_allclose(raw.color_matrix[:, :3], sensor.srgb_from_balanced, atol=1e-3)


def test_the_file_is_a_tiff_with_the_tags_of_a_dng(tmp_path: Path, rng: np.random.Generator) -> None:
    frame = phone_frame(rng)
    write_dng(tmp_path / "a.dng", frame, facts=FACTS)
    with tifffile.TiffFile(tmp_path / "a.dng") as tiff:
        (page,) = tiff.pages
        tags = {tag.name: tag.value for tag in page.tags}
        np.testing.assert_array_equal(page.asarray(), frame.bayer)
        codes = [tag.code for tag in page.tags]
    assert codes == sorted(codes)
    assert tags["DNGVersion"] == bytes([1, 4, 0, 0])
    assert tags["UniqueCameraModel"] == "Maker Phone 1"
    assert tags["CFAPattern"] == bytes([0, 1, 1, 2])
    assert tags["PhotometricInterpretation"] == 32803
    assert tags["CalibrationIlluminant1"] == 21
    assert tags["ExifTag"]["FocalLengthIn35mmFilm"] == 24


@pytest.mark.parametrize("is_wide", [False, True])
def test_a_grey_card_is_neutral_and_flat(tmp_path: Path, rng: np.random.Generator, is_wide: bool) -> None:
    """The gain map undoes the lens's shading: corners as bright as the middle."""
    sensor = replace(phone_sensor(rng, is_wide=is_wide), **QUIET)
    write_dng(tmp_path / "a.dng", expose(grey(0.3, (192, 256)), sensor, rng=rng), facts=FACTS)
    photo = read_raw(tmp_path / "a.dng")
    assert photo.corrections == ("GainMap",)
    blocks = photo.linear.reshape(12, 16, 16, 16, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(blocks, 0.3 * sensor.exposure, rtol=0.006)


def test_a_noisy_grey_card_is_neutral(tmp_path: Path, rng: np.random.Generator) -> None:
    for is_wide in (False, True):
        sensor = phone_sensor(rng, is_wide=is_wide)
        write_dng(tmp_path / "a.dng", expose(grey(0.18, (192, 256)), sensor, rng=rng), facts=FACTS)
        mean = read_raw(tmp_path / "a.dng").linear[INSIDE].mean(axis=(0, 1))
        assert mean.max() / mean.min() < 1.01


@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_colour_chart_comes_back(tmp_path: Path, rng: np.random.Generator, pattern: str) -> None:
    frame = phone_frame(rng, pattern=pattern, **QUIET)
    write_dng(tmp_path / "a.dng", frame, facts=FACTS)
    linear, scene = read_raw(tmp_path / "a.dng").linear, chart()
    for top in (0, 32):
        for left in (0, 40, 80):
            patch = (slice(top + 8, top + 24), slice(left + 8, left + 32))
            expected = frame.sensor.exposure * scene[patch].mean(axis=(0, 1))
            np.testing.assert_allclose(linear[patch].mean(axis=(0, 1)), expected, rtol=0.02, atol=0.002)


def test_libraw_and_the_phone_develop_alike(tmp_path: Path, rng: np.random.Generator) -> None:
    """Without shading, which the phone leaves in part."""
    frame = phone_frame(rng, vignetting=0.0, **QUIET)
    write_dng(tmp_path / "a.dng", frame, facts=FACTS)
    patch = (slice(8, 24), slice(8, 32))
    np.testing.assert_allclose(
        srgb_from_linear(read_raw(tmp_path / "a.dng").linear)[patch].mean((0, 1)),
        developed(frame)[patch].mean((0, 1)),
        atol=0.005,
    )


@pytest.mark.parametrize(
    "facts",
    [
        FACTS,
        replace(FACTS, subject_distance_m=None),
        replace(FACTS, subject_distance_m=math.inf, focal_length_mm=18.6, f35_mm=120),
        replace(FACTS, taken=FACTS.taken.replace(tzinfo=timezone(timedelta(hours=-3, minutes=-30)))),
        replace(FACTS, taken=FACTS.taken.replace(tzinfo=UTC, microsecond=0), subject_distance_m=1 / 3),
    ],
)
@pytest.mark.parametrize("suffix", ["dng", "jpg"])
def test_exif_says_what_it_was_told(tmp_path: Path, rng: np.random.Generator, facts: ExifFacts, suffix: str) -> None:
    path, frame = tmp_path / f"a.{suffix}", phone_frame(rng)
    if suffix == "dng":
        write_dng(path, frame, facts=facts)
    else:
        write_jpeg(path, developed(frame), facts=facts)
    found = read_photo_facts(path)
    assert found.kind == {"dng": "raw", "jpg": "jpeg"}[suffix]
    assert found.hw == frame.bayer.shape
    assert (found.make, found.model, found.taken) == (facts.make, facts.model, facts.taken)
    assert found.focal_length_mm == pytest.approx(facts.focal_length_mm, rel=1e-6)
    assert found.f35_mm == facts.f35_mm
    assert found.subject_distance_m == (
        None if facts.subject_distance_m is None else pytest.approx(facts.subject_distance_m, rel=1e-6)
    )


def test_a_jpeg_holds_the_picture(tmp_path: Path) -> None:
    y, x = np.mgrid[0:64, 0:96] / 96
    picture = np.stack([x, y, 0.5 * x + 0.2], axis=-1).astype(np.float32)
    write_jpeg(tmp_path / "a.jpg", picture, facts=FACTS, quality=97)
    np.testing.assert_allclose(read_image(tmp_path / "a.jpg"), picture, atol=0.03)


def test_odd_sizes_are_kept(tmp_path: Path, rng: np.random.Generator) -> None:
    frame = expose(grey(0.3, (77, 101)), Sensor(**QUIET), rng=rng)
    write_dng(tmp_path / "a.dng", frame, facts=FACTS)
    assert read_raw(tmp_path / "a.dng").linear.shape == (77, 101, 3)
    assert developed(frame).shape == (77, 101, 3)


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "file").write_text("")
    frame = phone_frame(rng)
    with pytest.raises(UsageError, match=r"a\.dng"):
        write_dng(tmp_path / "file" / "a.dng", frame, facts=FACTS)
    with pytest.raises(UsageError, match=r"a\.jpg"):
        write_jpeg(tmp_path / "file" / "a.jpg", developed(frame), facts=FACTS)
