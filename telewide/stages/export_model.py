"""A trained network written as an ONNX model for apps, and the proof that it computes the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from telewide import __version__
from telewide.assets import BOX_WEIGHTS
from telewide.errors import MissingPartError, QualityError, UsageError, extra_hint, within_memory
from telewide.files import changing, is_file, is_folder, replacing
from telewide.matching.window import Window, check_stated_window
from telewide.stages.rig_run import CAPTURES_FOLDER
from telewide.stages.run_folder import RunFolder
from telewide.text import command_line

if TYPE_CHECKING:
    from telewide.matching.onnx_check import OnnxComparison

DEFAULT_RUN = Path("run")
LEAST_SIDE_PX, MOST_SIDE_PX, MOST_PIXELS = 64, 16384, 1 << 24
MOST_SPAN_PX = 1024
"""Of the disparities it searches; each four of them are a part of the model."""
MOST_DIFFERING = 0.01
"""Share of the pixels. Of two peaks as high as each other, rounding decides which is read, and all around follow."""
_PARTS = ("onnx", "onnxruntime", "onnxscript")
_CHECKED_HW = ((448, 640), (256, 384))
"""Sizes at which a model of any size is checked, px."""


@dataclass(frozen=True)
class ExportedModel:
    """A model that was written.

    Attributes:
        path: the file.
        network: name of the network.
        window: disparities it searches, px.
        hw: height and width of the views it takes, px; None for all multiples of 64.
        comparisons: with torch, one for each size it was checked at.
    """

    path: Path
    network: str
    window: Window
    hw: tuple[int, int] | None
    comparisons: tuple[OnnxComparison, ...]


def export_model(
    weights: Path,
    path: Path,
    *,
    window: Window | None = None,
    hw: tuple[int, int] | None = None,
    tell: Callable[[str], None],
) -> ExportedModel:
    """Write a network as ONNX, once onnxruntime has computed with it what torch does.

    Args:
        weights: a weights file, or the run folder of a training.
        path: the model to write or to replace.
        window: disparities ``[d_min, d_max)`` that the model searches, px; None for those it was trained for.
        hw: height and width of the views, px; None for all multiples of 64, which networks pad to.
        tell: hears how far it is.

    Returns:
        The file and the comparisons.

    Raises:
        UsageError: there are no weights, a window or size that no model can have, or a place that cannot be written.
        InputError: the weights cannot be read, or it takes more memory than there is.
        MissingPartError: the extra ``onnx`` is not installed.
        QualityError: onnxruntime computes something else; nothing was written.
    """
    # All that can be refused is, before torch is imported, which takes seconds.
    found = _weights_of(weights)
    _refuse_impossible(window, hw)
    _prepare_place(path)
    _require_parts()
    from telewide.matching.inference import GRID_PX, choose_device
    from telewide.matching.onnx_check import compare_onnx
    from telewide.matching.onnx_model import OnnxNetwork, write_onnx
    from telewide.training.checkpoint import load_weights

    network, card = load_weights(found, device=choose_device("cpu"))
    _refuse_wide(window or card.window)
    model = OnnxNetwork(network, window or card.window).eval()
    # One of a fixed size pads by itself.
    metadata = _metadata(card.network, model.window, hw) | {"size_multiple": "1" if hw else str(GRID_PX)}
    tell(f"exporting {card.network}, which takes a minute or two")
    with within_memory("such a model", hint="state a smaller size or window"), replacing(path) as temporary:
        write_onnx(model, temporary, hw=hw, metadata=metadata)
        tell("comparing it with torch")
        comparisons = tuple(compare_onnx(temporary, model, hw=size) for size in ((hw,) if hw else _CHECKED_HW))
        refuse_difference(path, comparisons)
    return ExportedModel(path, network=card.network, window=model.window, hw=hw, comparisons=comparisons)


def refuse_difference(path: Path, comparisons: Sequence[OnnxComparison]) -> None:
    """Refuse a model that does not compute what torch does.

    Args:
        path: where it would be written.
        comparisons: with torch.

    Raises:
        QualityError: more than ``MOST_DIFFERING`` of the pixels differ.
    """
    differing = max(comparison.differing for comparison in comparisons)
    if differing > MOST_DIFFERING:
        raise QualityError(
            f"{path} was not written: onnxruntime differs from torch at {100 * differing:.2g} % of the pixels, "
            f"{100 * MOST_DIFFERING:g} % at most was expected",
            hint="install the versions of constraints.txt, which were seen to agree",
        )


def _weights_of(place: Path) -> Path:
    """Find the weights of a run folder, or the file itself."""
    found = RunFolder(place).weights if is_folder(place) else place
    if is_file(found):
        return found
    train = command_line("train", CAPTURES_FOLDER, out=None if place.suffix or place == DEFAULT_RUN else place)
    raise UsageError(
        f"{found} does not exist; a run folder with a trained network, or its weights, was expected",
        hint=f"train one: {train}; or name the one that comes with telewide: {BOX_WEIGHTS}",
    )


def _prepare_place(path: Path) -> None:
    if is_folder(path):
        raise UsageError(f"{path} is a folder; the name of a file was expected")
    with changing(path):
        path.parent.mkdir(parents=True, exist_ok=True)


def _refuse_impossible(window: Window | None, hw: tuple[int, int] | None) -> None:
    if window is not None:
        try:
            check_stated_window(window)
        except ValueError as error:
            raise UsageError(str(error)) from error
    if hw is not None and not (min(hw) >= LEAST_SIDE_PX and max(hw) <= MOST_SIDE_PX and hw[0] * hw[1] <= MOST_PIXELS):
        raise UsageError(
            f"{hw[1]}x{hw[0]}: sides of {LEAST_SIDE_PX} to {MOST_SIDE_PX} px were expected, {MOST_PIXELS} px at most"
        )


def _refuse_wide(window: Window) -> None:
    """Refuse a window whose planes an export takes hours for, whoever states it."""
    if window[1] - window[0] > MOST_SPAN_PX:
        raise UsageError(
            f"a window of {window[0]} to {window[1]} px: models of up to {MOST_SPAN_PX} px are exported",
            hint="state a smaller one with --window",
        )


def _require_parts() -> None:
    missing = [name for name in _PARTS if find_spec(name) is None]
    if missing:
        raise MissingPartError(
            f"models are exported with {', '.join(_PARTS)}; not installed: {', '.join(missing)}",
            hint=extra_hint("onnx"),
        )


def _metadata(network: str, window: Window, hw: tuple[int, int] | None) -> dict[str, str]:
    """Facts that whoever runs the model needs, as texts: ONNX has no other kind."""
    return {
        "telewide_version": __version__,
        "network": network,
        "window_px": f"{window[0]},{window[1]}",
        "size_px": f"{hw[1]}x{hw[0]}" if hw else "any",
        "standardisation": "within the model: each channel of each view to mean 0 and deviation 1",
        "inputs": "ref, src: float32 (1, 3, H, W), sRGB in [0, 1], channels R, G, B; rectified, ref the sharp view",
        "outputs": "disparity_px = x_ref - x_src; confidence in [0, 1]; hidden: probability that src does not see it",
    }
