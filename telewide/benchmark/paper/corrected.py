"""Second views whose rows and colours are corrected first, as `telewide depth` does."""

from __future__ import annotations

from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.paper.system import SecondView, Task, enlarged_view
from telewide.capture.pair import RectifiedPair
from telewide.correction.correct import correct_pair
from telewide.geometry.arrays import FloatImage


def corrected_view(task: Task) -> SecondView:
    """Second views of a task with rows and colours brought to the first view's, as far as matches allow."""
    enlarged = enlarged_view(task)

    def corrected(scene: str, truth: StereoTruth) -> FloatImage:
        pair = RectifiedPair(scene, truth.left, enlarged(scene, truth))
        return correct_pair(pair, seed=task.seed).pair.wide

    return corrected
