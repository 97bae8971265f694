"""The judge between steps and stages: a network asked on held-out matches."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from telewide.capture.pair import PairReader
from telewide.matching.inference import match_with_network
from telewide.matching.networks import StereoNetwork
from telewide.matching.window import Window
from telewide.points.held_out import HeldOut, match_errors_px, summarise_errors


def network_judge(
    held_out: Sequence[HeldOut], *, window: Window, reader: PairReader
) -> Callable[[StereoNetwork], dict[str, float]]:
    """Bind held-out captures into a judge for the training loop; every match counts the same.

    Args:
        held_out: captures with their matches.
        window: disparities to search, px.
        reader: of the corrected pairs.

    Returns:
        A function from a network to the shares of `summarise_errors`.
    """

    def judge(network: StereoNetwork) -> dict[str, float]:
        errors_px = [np.empty(0)]
        for item in held_out:
            pair = reader.read(item.capture)
            matched = match_with_network(pair.tele, pair.wide, network=network, window=window)
            errors_px.append(match_errors_px(matched.disparity_px, item))
        return summarise_errors(np.concatenate(errors_px))

    return judge
