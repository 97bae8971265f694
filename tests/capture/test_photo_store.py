"""Kept photos come back bit by bit, in a quarter of the memory where they have 8 bits: read_image is the oracle."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from capture.dng import write_dng

from telewide.capture.images import read_image
from telewide.capture.photo_store import PhotoStore


@pytest.mark.parametrize(("kind", "value_bytes"), [("eight.png", 1), ("grey.jpg", 1), ("deep.png", 4), ("raw.dng", 4)])
def test_a_kept_photo_comes_back_as_it_was(
    tmp_path: Path, rng: np.random.Generator, kind: str, value_bytes: int
) -> None:
    path = tmp_path / kind
    levels = rng.integers(0, 65536, (200, 48, 3), dtype=np.uint16)
    if kind == "raw.dng":
        write_dng(path, levels[..., 0].astype(np.float32) / 65535)
    else:
        cv2.imwrite(str(path), levels if kind == "deep.png" else (levels // 257).astype(np.uint8))
    store = PhotoStore()
    first, again = store.read(path), store.read(path)
    np.testing.assert_array_equal(first, read_image(path))
    np.testing.assert_array_equal(again, first)
    assert again.dtype == np.float32
    assert store.kept_bytes == value_bytes * first.size
