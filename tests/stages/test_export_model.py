"""Export to ONNX: what is refused, what the file states, and that onnxruntime computes what telewide does."""

from __future__ import annotations

import re
import runpy
import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch

from telewide.assets import BOX_WEIGHTS
from telewide.cli import main
from telewide.errors import QualityError
from telewide.matching import inference
from telewide.matching.inference import full_precision, match_with_network
from telewide.matching.networks import StereoNetwork, build_network
from telewide.matching.onnx_check import OnnxComparison, compare_onnx, example_views
from telewide.matching.onnx_model import OnnxNetwork
from telewide.matching.window import Window
from telewide.stages import export_model as stage
from telewide.training.checkpoint import save_weights
from telewide.training.weights_card import WeightsCard

WINDOW: Window = (-8, 24)
MISSING = [name for name in ("onnx", "onnxruntime", "onnxscript") if find_spec(name) is None]
needs_onnx = pytest.mark.skipif(bool(MISSING), reason=f"the extra onnx is not installed: {', '.join(MISSING)}")


def network_with_all_branches(name: str) -> StereoNetwork:
    """A network none of whose branches is still zero."""
    network = build_network(name).eval()
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.01 * torch.randn(parameter.shape, generator=generator))
    return network


def weights_of(name: str, folder: Path) -> Path:
    path = folder / f"{name}.safetensors"
    save_weights(network_with_all_branches(name), path, card=WeightsCard(name, WINDOW, {}, {}))
    return path


def code_of(*words: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(words)
    return int(left.value.code or 0)


@pytest.mark.parametrize("name", ["guided", "lite"])
@pytest.mark.parametrize("hw", [(70, 100), (64, 128)])
def test_the_exported_maps_are_those_of_a_match(
    name: str, hw: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the size of the views, without what comes before and after the network: that is left to whoever calls it."""
    monkeypatch.setattr(inference, "enlarged_size", lambda src: src.shape[:2])
    monkeypatch.setattr(inference, "sharpened", lambda src, *, like: src)
    monkeypatch.setattr(inference, "refine", lambda found, ref, src: found)
    network = network_with_all_branches(name)
    ref, src = example_views(hw, WINDOW)
    with full_precision(), torch.inference_mode():
        disparity_px, confidence, hidden = OnnxNetwork(network, WINDOW)(torch.from_numpy(ref), torch.from_numpy(src))
        matched = match_with_network(*(v[0].transpose(1, 2, 0) for v in (ref, src)), network=network, window=WINDOW)
    assert np.abs(disparity_px[0].numpy() - matched.disparity_px).max() < 1e-3
    assert np.abs(confidence[0].numpy() - matched.confidence).max() < 1e-3
    assert not (matched.valid & (hidden[0].numpy() > 0.501)).any()


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("nowhere",), 2, "nowhere does not exist"),
        (("--window", "1,2"), 2, "multiples of 4"),
        (("--window", "wide"), 2, "0,64"),
        (("--window", "0,2048"), 2, "models of up to 1024 px"),
        (("--size", "huge"), 2, "1280x640"),
        (("--size", "8x8"), 2, "64 to"),
        (("--size", "16384x16384"), 2, "16777216 px at most"),
        (("--out", "model.pt"), 2, ".onnx"),
    ],
)
def test_what_no_model_can_be_is_refused(
    words: tuple[str, ...], code: int, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = words if words[0] == "nowhere" else (str(weights_of("lite", tmp_path)), *words)
    assert code_of("export-model", *given) == code
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "train"),
    [
        ((), "telewide train captures;"),
        (("runs/b",), "--out runs/b;"),
        (("w.safetensors",), "telewide train captures;"),
    ],
)
def test_where_nothing_is_trained_the_call_that_trains_and_the_network_in_the_box_are_named(
    words: tuple[str, ...],
    train: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert code_of("export-model", *words) == 2
    told = capsys.readouterr().err
    assert train in told
    assert str(BOX_WEIGHTS) in told


@needs_onnx
def test_a_place_that_cannot_be_written_is_said_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = weights_of("lite", tmp_path)
    (tmp_path / "folder.onnx").mkdir()
    (tmp_path / "file").touch()
    for place, told in (("folder.onnx", "is a folder"), ("file/m.onnx", "cannot be written")):
        assert code_of("export-model", str(weights), "--out", str(tmp_path / place)) == 2
        said = capsys.readouterr().err
        assert told in said
        assert "exporting" not in said


def test_a_missing_extra_is_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(stage, "find_spec", lambda name: None)
    model = tmp_path / "m.onnx"
    assert code_of("export-model", str(weights_of("lite", tmp_path)), "--out", str(model)) == 5
    told = capsys.readouterr().err
    assert "onnxruntime" in told
    assert ".[onnx]" in told
    assert "Traceback" not in told
    assert not model.exists()


def test_a_model_that_differs_is_refused() -> None:
    same, other = (OnnxComparison((64, 64), differing, 1.0, 1.0, 1) for differing in (0.005, 0.02))
    stage.refuse_difference(Path("m.onnx"), [same])
    with pytest.raises(QualityError, match="not written"):
        stage.refuse_difference(Path("m.onnx"), [same, other])


@needs_onnx
@pytest.mark.slow
def test_a_model_of_any_size_computes_what_torch_does(tmp_path: Path) -> None:
    """At two sizes: the command refuses to write what differs at more than one pixel in a hundred."""
    weights = weights_of("lite", tmp_path)
    done = stage.export_model(weights, tmp_path / "m.onnx", window=(-4, 20), tell=lambda text: None)
    assert len({comparison.hw for comparison in done.comparisons}) == 2
    assert done.path.stat().st_size < 16e6


@needs_onnx
@pytest.mark.slow
@pytest.mark.parametrize(("window", "hw"), [((0, 32), None), ((-12, 4), (72, 104))])
def test_a_model_of_the_network_in_the_box_computes_what_torch_does(
    window: Window, hw: tuple[int, int] | None, tmp_path: Path
) -> None:
    """Of any size, checked at two, and of one size to which it pads by itself."""
    done = stage.export_model(BOX_WEIGHTS, tmp_path / "m.onnx", window=window, hw=hw, tell=lambda text: None)
    assert len({comparison.hw for comparison in done.comparisons}) == (1 if hw else 2)
    assert max(comparison.differing for comparison in done.comparisons) < 0.01


@needs_onnx
@pytest.mark.slow
def test_the_documented_example_runs(repo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = weights_of("lite", tmp_path)
    assert code_of("export-model", str(path), "--size", "320x192", "--out", "depth.onnx", "-q") == 0
    for photo in ("tele.jpg", "wide.jpg"):
        shutil.copy(repo / "examples" / "captures" / "000" / photo, tmp_path)
    [example] = re.findall(r"```python\n(.*?)```", (repo / "docs" / "onnx.md").read_text(), re.DOTALL)
    assert len(example.splitlines()) <= 18
    (tmp_path / "example.py").write_text(example)
    held = runpy.run_path("example.py")
    assert held["disparity_px"].shape == (192, 320) != held["tele"].size[::-1]
    facts = held["session"].get_modelmeta().custom_metadata_map
    assert {name: facts[name] for name in ("network", "window_px", "size_px", "size_multiple")} == {
        "network": "lite",
        "window_px": "-8,24",
        "size_px": "320x192",
        "size_multiple": "1",
    }
    # Another network than the one it was made from: the comparison sees it.
    other = OnnxNetwork(build_network("lite", seed=1).eval(), WINDOW)
    assert compare_onnx(Path("depth.onnx"), other, hw=(192, 320)).differing > 0.5
