"""A trained network as an ONNX model: both views as a photo has them in, disparity and what it is worth out.

Standardisation, padding and cropping are part of the graph, so that whoever runs it hands over pictures and reads maps.
Letters: B batch (1), H W image.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import torch
from torch import Tensor, nn

from telewide.matching.inference import GRID_PX
from telewide.matching.networks import StereoNetwork, prepare_view
from telewide.matching.readout import learned_confidence, left_right_gap_px, measured_confidence
from telewide.matching.sampling import pad_to_multiple
from telewide.matching.window import Window, check_window

INPUTS = ("ref", "src")
OUTPUTS = ("disparity_px", "confidence", "hidden")
MOST_CELLS = 256
"""Of the grid that images are padded to, along a side of a model of any size."""
_TRACED_HW = (8 * GRID_PX, 12 * GRID_PX)
"""Of a model of any size: sides of one cell, at the smallest of its sizes, would be taken for constants."""


class OnnxNetwork(nn.Module):
    """A network within one window, from photos to maps.

    Args:
        network: trained.
        window: disparities ``[d_min, d_max)``, px.
    """

    def __init__(self, network: StereoNetwork, window: Window) -> None:
        super().__init__()
        check_window(window)
        self.network = network
        self.window = window

    def forward(self, ref_BCHW: Tensor, src_BCHW: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Match two views (1, 3, H, W) in [0, 1].

        Returns:
            (1, H, W) each: disparity of ref, px; confidence; probability that src does not see the pixel.
        """
        height, width = ref_BCHW.shape[-2:]
        views = (prepare_view(self.network.features, view) for view in (ref_BCHW, src_BCHW))
        ref, src = (pad_to_multiple(view, multiple=GRID_PX) for view in views)
        output = self.network.match_in_scales(ref, src, self.window)
        if output.heads_BCHW is None:
            confidence, hidden = measured_confidence(output, left_right_gap_px(output, self.window))
        else:
            confidence, hidden = learned_confidence(output.heads_BCHW)
        maps = (output.disparity_px, confidence, hidden)
        disparity_px, confidence, hidden = (values[:, :height, :width] for values in maps)
        return disparity_px, confidence, hidden


def write_onnx(model: OnnxNetwork, path: Path, *, hw: tuple[int, int] | None, metadata: Mapping[str, str]) -> None:
    """Write a model as ONNX, all in one file; the extra ``onnx`` is installed.

    Args:
        model: on the CPU, in eval mode.
        path: the file to write.
        hw: height and width of its views, px; None for any multiples of ``GRID_PX``.
        metadata: goes into the file's ``metadata_props``.
    """
    views = tuple(torch.rand(1, 3, *(hw or _TRACED_HW)) for _ in INPUTS)
    cells = (torch.export.Dim(name, min=1, max=MOST_CELLS) for name in ("rows", "columns"))
    sides = {axis: GRID_PX * count for axis, count in zip((2, 3), cells, strict=True)}
    with _quietly(), torch.no_grad():
        # Here and not by the exporter, which would go on to trace in other ways that take minutes.
        traced = torch.export.export(model, views, dynamic_shapes=None if hw else (sides, sides), strict=False)
        program = torch.onnx.export(traced, input_names=INPUTS, output_names=OUTPUTS, dynamo=True, verbose=False)
    if program is None:
        raise RuntimeError("torch exported nothing")
    program.model.metadata_props.update(metadata)
    program.save(path, external_data=False)


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep the exporter's remarks on its own parts from whoever exports."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
