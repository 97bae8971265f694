"""Choice of a matcher, and what its confidence is worth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rig_worlds import phone_rig, photos_of_a_plane

import telewide
from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.rig_file import RigFacts, StoredRig
from telewide.capture.pair import PhotoPair
from telewide.matching.methods import Method
from telewide.matching.networks import build_network
from telewide.recipe import load_recipe
from telewide.training.checkpoint import save_weights
from telewide.training.weights_card import WeightsCard


@pytest.mark.parametrize(
    ("method", "weights", "is_stated"), [("network", "lite", False), ("network", "box", True), ("sgm", None, True)]
)
def test_a_deviation_is_stated_only_where_the_confidence_was_held_against_errors(
    method: Method, weights: str | None, tmp_path: Path, *, is_stated: bool
) -> None:
    rig = phone_rig(width_px=320)
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")
    tele, wide = (photo[..., None].repeat(3, axis=2) for photo in photos_of_a_plane(rig, np.random.default_rng(7)))
    recipe = load_recipe("quick", settings=["window_px=[0, 32]"])
    card = WeightsCard("lite", (0, 32), recipe.model_dump(mode="json"), {})
    save_weights(build_network("lite"), tmp_path / "w.safetensors", card=card)
    depth = telewide.estimate_depth(
        PhotoPair("plane", tele, wide),
        rig=StoredRig(rig, None, None, None, quality, RigFacts()),
        weights=tmp_path / "w.safetensors" if weights == "lite" else None,
        method=method,
        device="cpu",
        recipe=recipe,
    )
    assert depth.depth_m is not None
    assert (depth.depth_std_m is not None) == is_stated
