"""HEIC photos: read where the extra is installed, and asked for where it is not."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest
from capture.roll import WIDE, exif_of, write_photo
from PIL import Image

from telewide.capture.exif import image_pipeline, read_photo_facts
from telewide.capture.images import read_image
from telewide.errors import InputError, MissingPartError

HEIC = b"\0\0\0\x18ftypheic\0\0\0\0" + b"\0" * 40


@pytest.fixture
def heif() -> None:
    """Lets Pillow write HEIC; the test is skipped without the extra."""
    pytest.importorskip("pillow_heif", reason="the extra heif is not installed").register_heif_opener()


def scene() -> np.ndarray:
    """A smooth picture with every corner different: a lossy coder keeps it."""
    noise = np.random.default_rng(3).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    return np.clip(128 + 3 * (cv2.GaussianBlur(noise, (0, 0), 8).astype(np.float32) - 128), 0, 255).astype(np.uint8)


@pytest.mark.usefixtures("heif")
@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (8, 1), (3, 2), (6, 3)])
def test_a_heic_is_the_picture_it_was_made_from(tmp_path: Path, orientation: int, turns: int) -> None:
    path = tmp_path / "a.heic"
    Image.fromarray(scene()).save(path, quality=95, exif=exif_of(**WIDE, orientation=orientation).tobytes())
    image = read_image(path)
    expected = np.rot90(scene(), turns) / 255
    assert image.dtype == np.float32
    assert image.shape == expected.shape
    assert np.abs(image - expected).mean() < 0.01


@pytest.mark.usefixtures("heif")
def test_what_a_heic_states(tmp_path: Path) -> None:
    path = write_photo(tmp_path / "a.HEIC", exif=exif_of(**WIDE, second=2.5, orientation=6))
    facts = read_photo_facts(path)
    assert (facts.focal_length_mm, facts.f35_mm, facts.hw) == (4.25, 26, (48, 36))
    assert facts.taken is not None
    assert facts.taken.microsecond == 500_000
    assert image_pipeline(path) == "jpeg:Maker Phone 1"  # the phone treats both alike


@pytest.mark.usefixtures("heif")
def test_the_content_counts_not_the_suffix(tmp_path: Path) -> None:
    heic = tmp_path / "a.heic"
    Image.fromarray(scene()).save(heic, quality=95)
    heic.rename(tmp_path / "b.jpg")
    Image.fromarray(scene()).save(tmp_path / "c.jpg", quality=95)
    (tmp_path / "c.jpg").rename(tmp_path / "d.heic")
    for name in ("b.jpg", "d.heic"):
        assert np.abs(read_image(tmp_path / name) - scene() / 255).mean() < 0.02


@pytest.mark.usefixtures("heif")
def test_a_corrupt_heic(tmp_path: Path) -> None:
    (tmp_path / "a.heic").write_bytes(HEIC)
    with pytest.raises(InputError, match="cut off or corrupt"):
        read_image(tmp_path / "a.heic")


def test_without_the_extra_its_name_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "telewide.capture.pillow_photos.find_spec", lambda name: None if name == "pillow_heif" else found(name)
    )
    (tmp_path / "a.jpg").write_bytes(HEIC)
    for read in (read_image, read_photo_facts):
        with pytest.raises(MissingPartError, match=r"a\.jpg is a HEIC photo") as caught:
            read(tmp_path / "a.jpg")
        assert caught.value.exit_code == 5
        assert caught.value.hint is not None
        assert "pip install -c constraints.txt -e '.[heif]'" in caught.value.hint
