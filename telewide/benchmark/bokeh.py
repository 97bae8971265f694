"""Bokeh pictures judged: specks along their outlines on any captures, and PSNR where a real aperture took the truth.

The depth is that of ``telewide depth``, of every matcher, and the true one where the set has it; the blur is ours, and
a Gaussian by the same depth. So what a matcher loses and what rendering loses stand beside each other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.benchmark.lens_truth import LensTruth, blurred_by_depth, edge_band, read_lens_truth
from telewide.benchmark.outlines import speck_share
from telewide.benchmark.report import BenchmarkReport, markdown_table, number
from telewide.benchmark.written import judged_set
from telewide.bokeh.picture import BokehOptions, bokeh_picture
from telewide.bokeh.render import render_bokeh
from telewide.capture.images import read_image
from telewide.capture.pair import read_truth
from telewide.depth.result import DepthResult
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.matching.matcher import Matcher
from telewide.metrics import psnr_db
from telewide.recipe import Recipe
from telewide.stages.run_folder import RunFolder

TRUE_DEPTH = "true depth"
_DB = ("ours_db", "ours_edges_db", "gaussian_db", "gaussian_edges_db")
_DB_HEADINGS = ("ours dB", "at edges", "Gaussian dB", "at edges")


def benchmark_bokeh(
    captures_root: Path,
    contenders: Sequence[Matcher],
    *,
    run: RunFolder,
    recipe: Recipe,
    tell: Callable[[str], None],
    bokeh: BokehOptions | None = None,
    rig: Path | None = None,
) -> BenchmarkReport:
    """Judge bokeh on captures.

    Args:
        captures_root: folder of the captures; pictures through an aperture lie in ``../truth/<name>/bokeh.png``.
        contenders: whose depth is used.
        run: its corrected pairs are used; they are made where they are missing.
        recipe: what is corrected.
        tell: hears how far it is.
        bokeh: focus and strength of the pictures whose specks are counted.
        rig: rig file, or None for the one that lies by the captures.

    Returns:
        A row for each capture and matcher, and one for the true depth where it is known.

    Raises:
        InputError: no capture can be used.
    """
    judged = judged_set(captures_root, contenders, run=run, recipe=recipe, rig=rig)
    options = bokeh or BokehOptions()
    rows: list[dict[str, object]] = []
    for item in judged.prepared.pairs:
        photo = read_image(item.source.tele_path)
        truth = read_lens_truth(captures_root, item.capture.name)
        truth_px = read_truth(item.source, hw=(photo.shape[0], photo.shape[1]))
        for contender in contenders:
            tell(f"{item.capture.name}: {contender.name}")
            result = judged.depth(item, contender, photo=photo)
            row = {"capture": item.capture.name, "matcher": contender.name} | _specks(photo, result, options)
            if truth is not None and truth_px is not None and result.K is not None:
                lens = _Lens(photo, truth, truth_px, f_px=float(result.K[0, 0]))
                row |= lens.scores(result.disparity.disparity_px, baseline_m=result.baseline_m)
                if contender == contenders[-1]:
                    exact = {"capture": item.capture.name, "matcher": TRUE_DEPTH} | lens.scores(truth_px)
                    rows.append(exact)
            rows.append(row)
    notes = tuple(f"{problem.name}: {problem.message}" for problem in judged.prepared.problems)
    return BenchmarkReport("bokeh", {"focus": options.focus, "window": list(judged.window)}, tuple(rows), notes)


def bokeh_table(report: BenchmarkReport) -> str:
    """Set the means of a report in Markdown, a line for each matcher, and the capture with the most specks."""
    headings = ("depth", "specks % (photo)", "worst excess %", "in", *_DB_HEADINGS)
    matchers = dict.fromkeys(str(row["matcher"]) for row in report.rows)
    return markdown_table(headings, [_line(m, [row for row in report.rows if row["matcher"] == m]) for m in matchers])


def _specks(photo: FloatImage, result: DepthResult, options: BokehOptions) -> dict[str, object]:
    maps = result.disparity
    picture = bokeh_picture(photo, maps, options=options, baseline_m=result.baseline_m)
    return {"specks": speck_share(picture, maps.disparity_px), "photo_specks": speck_share(photo, maps.disparity_px)}


@dataclass(frozen=True)
class _Lens:
    """A photo, what an aperture made of it, and its true disparity."""

    photo: FloatImage
    truth: LensTruth
    truth_px: FloatMap
    f_px: float

    def scores(self, disparity_px: FloatMap, *, baseline_m: float | None = None) -> dict[str, object]:
        """PSNR of our bokeh and of a Gaussian by the same depth, full frame and edge band, dB."""
        true_baseline_m = self.truth.baseline_m(self.f_px)
        baseline_m = baseline_m or true_baseline_m
        band = edge_band(self.truth_px, k=self.truth.aperture_radius_m / true_baseline_m)
        focus_px, k = self.f_px * baseline_m / self.truth.focus_distance_m, self.truth.aperture_radius_m / baseline_m
        ours = render_bokeh(self.photo, disparity_px, focus_disparity_px=focus_px, radius_per_px=k)
        plain = blurred_by_depth(self.photo, disparity_px, focus_px=focus_px, k=k)
        masks = (None, band if band.any() else None)
        values = [psnr_db(np.clip(p, 0, 1), self.truth.picture, mask=mask) for p in (ours, plain) for mask in masks]
        return dict(zip(_DB, values, strict=True))


def _line(matcher: str, rows: Sequence[Mapping[str, object]]) -> list[str]:
    judged = [row for row in rows if isinstance(row.get("specks"), float)]
    excess = [float(str(row["specks"])) - float(str(row["photo_specks"])) for row in judged]
    worst = int(np.nanargmax(excess)) if np.isfinite(excess).any() else None
    shares = [100 * _mean(rows, key) for key in ("specks", "photo_specks")]
    return [
        matcher,
        f"{number(shares[0], '.2f')} ({number(shares[1], '.2f')})",
        "-" if worst is None else f"{100 * excess[worst]:+.2f}",
        "-" if worst is None else str(judged[worst]["capture"]),
        *(number(_mean(rows, key), ".1f") for key in _DB),
    ]


def _mean(rows: Sequence[Mapping[str, object]], key: str) -> float:
    values = [value for row in rows if isinstance(value := row.get(key), float) and np.isfinite(value)]
    return float(np.mean(values)) if values else float("nan")
