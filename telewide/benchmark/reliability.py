"""Reliability of confidence, and of what a matcher calls hidden, against the truth.

The confidence of a network that has learned it is the probability that a disparity is right within 1 px: of the
pixels with a confidence of 0.7, 70 % should be. That of other matchers only puts pixels in order. A pixel is called
hidden where the map is not ``valid``. Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from telewide.benchmark.report import markdown_table, number
from telewide.geometry.arrays import BoolMap, FloatMap
from telewide.geometry.stereo import DisparityMap

RIGHT_PX = 1.0
N_BINS = 10
Row = Mapping[str, object]


@dataclass(frozen=True)
class Reliability:
    """Counts of pixels, which add up over scenes.

    Attributes:
        in_bins: (10,) by their confidence.
        confidence_in_bins: (10,) sums of it.
        right_in_bins: (10,) right within 1 px.
        hidden: that the other view does not see, among those of which that is known.
        called_hidden: by the matcher, among the same.
        both: hidden and called so.
    """

    in_bins: NDArray[np.float64]
    confidence_in_bins: NDArray[np.float64]
    right_in_bins: NDArray[np.float64]
    hidden: int
    called_hidden: int
    both: int

    def __add__(self, other: Reliability) -> Reliability:
        """Counts of both."""
        return Reliability(
            in_bins=self.in_bins + other.in_bins,
            confidence_in_bins=self.confidence_in_bins + other.confidence_in_bins,
            right_in_bins=self.right_in_bins + other.right_in_bins,
            hidden=self.hidden + other.hidden,
            called_hidden=self.called_hidden + other.called_hidden,
            both=self.both + other.both,
        )


def count_reliability(
    found: DisparityMap, truth_px: FloatMap, *, occluded: BoolMap | None, left_out_columns: int = 0
) -> Reliability:
    """Count the pixels of a map by how sure and how right they are.

    Args:
        found: (H, W) map of a matcher.
        truth_px: (H, W) disparity, px; NaN where unknown.
        occluded: (H, W) bool, what only the reference view sees; None where nobody knows.
        left_out_columns: first columns that do not count.
    """
    counts = np.isfinite(truth_px)
    counts[:, :left_out_columns] = False
    confidence = found.confidence[counts].astype(np.float64)
    is_right = np.abs(found.disparity_px - truth_px)[counts] <= RIGHT_PX
    bins = np.clip((confidence * N_BINS).astype(np.int64), 0, N_BINS - 1)
    is_hidden = np.zeros(0, np.bool_) if occluded is None else occluded[counts]
    is_called = np.zeros(0, np.bool_) if occluded is None else ~found.valid[counts]
    return Reliability(
        in_bins=_sums(bins, np.ones_like(confidence)),
        confidence_in_bins=_sums(bins, confidence),
        right_in_bins=_sums(bins, is_right.astype(np.float64)),
        hidden=int(is_hidden.sum()),
        called_hidden=int(is_called.sum()),
        both=int((is_hidden & is_called).sum()),
    )


def reliability_rows(matcher: str, counted: Reliability) -> list[Row]:
    """Give a row for each bin of confidence: its bounds, mean confidence, share right within 1 px, share of pixels."""
    n_all = counted.in_bins.sum()
    return [
        {
            "matcher": matcher,
            "from": index / N_BINS,
            "to": (index + 1) / N_BINS,
            "mean_confidence": _share(counted.confidence_in_bins[index], counted.in_bins[index]),
            "right_1px": _share(counted.right_in_bins[index], counted.in_bins[index]),
            "share": _share(counted.in_bins[index], n_all),
        }
        for index in range(N_BINS)
    ]


def hidden_row(matcher: str, counted: Reliability) -> Row:
    """Give recall and precision of what a matcher calls hidden; None where nothing is hidden, or called so."""
    return {
        "matcher": matcher,
        "recall": _share(counted.both, counted.hidden),
        "precision": _share(counted.both, counted.called_hidden),
    }


def reliability_tables(rows: Sequence[Row], hidden: Sequence[Row]) -> str:
    """Set both in Markdown.

    Args:
        rows: of `reliability_rows`, of one matcher after the other.
        hidden: of `hidden_row`.
    """
    tables = []
    for matcher in dict.fromkeys(str(row["matcher"]) for row in rows):
        lines = [
            [
                f"{number(row['from'], '.1f')} to {number(row['to'], '.1f')}",
                number(row["mean_confidence"], ".2f"),
                _per_cent(row["right_1px"]),
                _per_cent(row["share"]),
            ]
            for row in rows
            if row["matcher"] == matcher
        ]
        tables.append(markdown_table([f"confidence of {matcher}", "mean", "right within 1 px %", "pixels %"], lines))
    lines = [[str(row["matcher"]), _per_cent(row["recall"]), _per_cent(row["precision"])] for row in hidden]
    return "\n\n".join([*tables, markdown_table(["called hidden", "recall %", "precision %"], lines)])


def _sums(bins: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.bincount(bins, weights=values, minlength=N_BINS), dtype=np.float64)


def _share(part: float, whole: float) -> float | None:
    return float(part / whole) if whole else None


def _per_cent(share: object) -> str:
    return number(100 * share if isinstance(share, float) else None, ".1f")
