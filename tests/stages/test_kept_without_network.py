"""Kept depth needs no network: what a fresh interpreter has loaded tells; an oracle of its own, ``sys.modules``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from source import modules_loaded_by

from telewide.errors import InputError
from telewide.matching.matcher import WITH_CONFIDENCE
from telewide.matching.networks import NETWORKS, build_network
from telewide.simulate.captures import write_captures
from telewide.stages.match import read_matcher
from telewide.training.checkpoint import save_weights
from telewide.training.weights_card import WeightsCard

NETWORK_MODULES = {"torch", "safetensors.torch", "telewide.matching.networks"}


def loaded_by_depth(folder: Path, *words: str) -> set[str]:
    """Modules that ``telewide depth`` loads."""
    argv = ["depth", str(folder / "captures"), "--run", str(folder / "run"), "--quiet", "--device", "cpu", *words]
    return modules_loaded_by(
        "from telewide.cli import main\n"
        f"try:\n    main({argv!r})\n"
        "except SystemExit as end:\n    assert not end.code, end.code\n"
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captures whose depth the network in the box has made."""
    folder = tmp_path_factory.mktemp("kept")
    write_captures(folder / "captures", count=2, seed=1, hw=(64, 96), factor=2)
    assert loaded_by_depth(folder) >= NETWORK_MODULES
    return folder


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--bokeh", "--focus", "near"),
        ("--bokeh", "--preview", "--focus", "far"),
        ("--format", "tiff,grey"),
        ("--only", "001", "--bokeh", "--strength", "3"),
    ],
)
def test_files_of_a_kept_depth_are_made_without_a_network(folder: Path, words: tuple[str, ...]) -> None:
    loaded = loaded_by_depth(folder, *words)
    assert "telewide.stages.capture_depth" in loaded
    assert not NETWORK_MODULES & loaded


def test_a_preview_leaves_the_page_as_it_is_and_makes_one_where_there_is_none(folder: Path) -> None:
    page, depth = folder / "run" / "report.html", folder / "run" / "depth"
    loaded_by_depth(folder, "--bokeh", "--focus", "near")
    before = page.read_bytes()
    loaded_by_depth(folder, "--bokeh", "--preview", "--focus", "far")
    assert page.read_bytes() == before
    assert (depth / "000" / "bokeh_preview.jpg").is_file()
    page.unlink()
    loaded_by_depth(folder, "--bokeh", "--preview", "--focus", "far")
    assert page.is_file()


def test_what_has_to_be_matched_after_all_is_matched(folder: Path) -> None:
    """One map is damaged, which its record does not tell: the network is read when that is found out."""
    npz = folder / "run" / "depth" / "001" / "depth.npz"
    whole = npz.read_bytes()
    npz.write_bytes(bytes(len(whole)))
    assert loaded_by_depth(folder, "--bokeh", "--focus", "near") >= NETWORK_MODULES
    assert npz.read_bytes() == whole


def test_networks_are_known_by_name_to_state_their_confidence() -> None:
    assert {name for name in NETWORKS if build_network(name).has_confidence} == WITH_CONFIDENCE


def test_weights_that_change_before_they_are_read_are_not_taken_for_the_former(
    tmp_path: Path,
) -> None:
    grey = np.full((64, 96, 3), 0.5, np.float32)
    path, card = tmp_path / "w.safetensors", WeightsCard("lite", (0, 32), {}, {})
    save_weights(build_network("lite", seed=0), path, card=card)
    matcher = read_matcher(path, method="network", device="cpu")
    save_weights(build_network("lite", seed=1), path, card=card)
    with pytest.raises(InputError, match=r"w\.safetensors has changed since this call began"):
        matcher.match(grey, grey, window=(0, 32))
