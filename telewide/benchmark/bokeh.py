"""Bokeh pictures judged: specks along their outlines on any captures, and PSNR where a real aperture took the truth.

The depth is that of ``telewide depth``, of every matcher, and the true one where the set has it; the blur is ours, and
others by the same depth. So what a matcher loses and what rendering loses stand beside each other.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.benchmark.lens_truth import LensTruth, edge_band, read_lens_truths
from telewide.benchmark.outlines import speck_share
from telewide.benchmark.plain_blurs import BLURS
from telewide.benchmark.report import BenchmarkReport, markdown_table, number
from telewide.benchmark.written import judged_set
from telewide.bokeh.picture import BokehOptions, bokeh_picture
from telewide.capture.images import read_image
from telewide.capture.pair import read_truth
from telewide.depth.result import DepthResult
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.matching.matcher import Matcher
from telewide.metrics import psnr_db
from telewide.recipe import Recipe
from telewide.stages.run_folder import RunFolder

TRUE_DEPTH = "true depth"
SAME_DISTANCE_PX = 0.5


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
        captures_root: folder of the captures; pictures through an aperture lie in ``../truth/<name>/bokeh*.png``.
        contenders: whose depth is used.
        run: its corrected pairs are used; they are made where they are missing.
        recipe: what is corrected.
        tell: hears how far it is.
        bokeh: focus and strength of the pictures whose specks are counted.
        rig: rig file, or None for the one that lies by the captures.

    Returns:
        A row for each capture and matcher; one more for each picture through an aperture, and for its true depth.

    Raises:
        InputError: no capture can be used.
    """
    judged = judged_set(captures_root, contenders, run=run, recipe=recipe, rig=rig)
    options = bokeh or BokehOptions()
    rows: list[dict[str, object]] = []
    for item in judged.prepared.pairs:
        name, photo = item.capture.name, read_image(item.source.tele_path)
        truth_px = read_truth(item.source, hw=(photo.shape[0], photo.shape[1]))
        truths = () if truth_px is None else read_lens_truths(captures_root, name)
        lenses: list[_Lens] = []
        for contender in contenders:
            tell(f"{name}: {contender.name}")
            result = judged.depth(item, contender, photo=photo)
            rows.append({"capture": name, "matcher": contender.name} | _specks(photo, result, options))
            if truth_px is not None:
                f_px = None if result.K is None else float(result.K[0, 0])
                lenses = [_Lens(photo, truth, truth_px, f_px) for truth in truths]
            for lens in lenses:
                scores = lens.scores(result.disparity.disparity_px, baseline_m=result.baseline_m)
                rows.append({"capture": name, "matcher": contender.name} | scores)
        rows += [{"capture": name, "matcher": TRUE_DEPTH} | lens.scores(lens.truth_px) for lens in lenses]
    notes = tuple(f"{problem.name}: {problem.message}" for problem in judged.prepared.problems)
    return BenchmarkReport("bokeh", {"focus": options.focus, "window": list(judged.window)}, tuple(rows), notes)


def bokeh_table(report: BenchmarkReport) -> str:
    """Set the means of a report in Markdown, a line for each matcher: specks, and PSNR where there are pictures.

    Where they are of several distances and apertures, a line for each follows; last, what each blur costs.
    """
    specks, pictures = ([row for row in report.rows if (key in row)] for key in ("specks", "picture"))
    headings = ("depth", "specks % (photo)", "worst excess %", "in")
    tables = [markdown_table(headings, [_speck_line(name, rows) for name, rows in _by_matcher(specks).items()])]
    if pictures:
        exact = {_place(row): row for row in pictures if row["matcher"] == TRUE_DEPTH}
        of_blurs = (*(f"{name}, at edges dB" for name in BLURS), "lost by depth %")
        lines = [_picture_line(name, rows, exact) for name, rows in _by_matcher(pictures).items()]
        tables.append(markdown_table(("depth", *of_blurs), lines))
        if len({row["picture"] for row in pictures}) > 1:
            tables.append(markdown_table(("picture", "depth", *of_blurs[:-1]), _lines_by_picture(pictures)))
        costs = [[name, *(number(_mean(pictures, f"{name}_{unit}"), ".2f") for unit in ("s", "mb"))] for name in BLURS]
        tables.append(markdown_table(("blur", "s of processor", "MB of arrays"), costs))
    return "\n\n".join(tables)


def _by_matcher(rows: Sequence[Mapping[str, object]]) -> dict[str, list[Mapping[str, object]]]:
    matchers = dict.fromkeys(str(row["matcher"]) for row in rows)
    return {name: [row for row in rows if row["matcher"] == name] for name in matchers}


def _place(row: Mapping[str, object]) -> tuple[object, object]:
    return row["capture"], row["picture"]


def _specks(photo: FloatImage, result: DepthResult, options: BokehOptions) -> dict[str, object]:
    maps = result.disparity
    picture = bokeh_picture(lambda: photo, maps, options=options, baseline_m=result.baseline_m)
    return {"specks": speck_share(picture, maps.disparity_px), "photo_specks": speck_share(photo, maps.disparity_px)}


@dataclass(frozen=True)
class _Lens:
    """A photo, what an aperture made of it, and its true disparity; its focal length where it is known."""

    photo: FloatImage
    truth: LensTruth
    truth_px: FloatMap
    f_px: float | None = None

    def scores(self, disparity_px: FloatMap, *, baseline_m: float | None = None) -> dict[str, object]:
        """PSNR of every blur by a depth, full frame and edge band, dB; seconds of processor and most memory, MB.

        The focus is where a person would set it: on what truly lies at that distance. So an error of the scale, which
        moves the whole map, does not count twice.
        """
        true_k, k = self.truth.lens(f_px=self.f_px), self.truth.lens(f_px=self.f_px, baseline_m=baseline_m)
        if true_k is None or k is None:
            return {}
        band = edge_band(self.truth_px, k=true_k)
        is_there = np.abs(self.truth_px - self.truth.focus_disparity_px) < SAME_DISTANCE_PX
        known_px = disparity_px[is_there & np.isfinite(disparity_px)]
        focus_px = float(np.median(known_px)) if known_px.size else self.truth.focus_disparity_px
        scores: dict[str, object] = {"picture": self.truth.name, "radius_per_px": true_k}
        for name, blur in BLURS.items():
            tracemalloc.start()  # NumPy and OpenCV's arrays are counted by it
            begun_s = time.process_time()
            blurred = np.clip(blur(self.photo, disparity_px, focus_px=focus_px, k=k), 0, 1)
            scores[f"{name}_s"] = time.process_time() - begun_s
            scores[f"{name}_mb"] = tracemalloc.get_traced_memory()[1] / 1e6
            tracemalloc.stop()
            scores[f"{name}_db"] = psnr_db(blurred, self.truth.picture)
            scores[f"{name}_edges_db"] = psnr_db(blurred, self.truth.picture, mask=band if band.any() else None)
        return scores


def _speck_line(matcher: str, rows: Sequence[Mapping[str, object]]) -> list[str]:
    excess = [float(str(row["specks"])) - float(str(row["photo_specks"])) for row in rows]
    worst = int(np.nanargmax(excess)) if np.isfinite(excess).any() else None
    shares = [100 * _mean(rows, key) for key in ("specks", "photo_specks")]
    return [
        matcher,
        f"{number(shares[0], '.2f')} ({number(shares[1], '.2f')})",
        "-" if worst is None else f"{100 * excess[worst]:+.2f}",
        "-" if worst is None else str(rows[worst]["capture"]),
    ]


def _picture_line(
    matcher: str,
    rows: Sequence[Mapping[str, object]],
    exact: Mapping[tuple[object, object], Mapping[str, object]],
) -> list[str]:
    """Means over the pictures; of the squared error of our blur, the share that the true depth would not have made."""
    by_rendering = [10 ** ((_db(row) - _db(exact[_place(row)])) / 10) for row in rows]
    lost = 100 * (1 - float(np.mean(by_rendering)))
    return [matcher, *_decibels(rows), number(lost, ".0f")]


def _lines_by_picture(rows: Sequence[Mapping[str, object]]) -> list[list[str]]:
    """Means over the captures, for each distance and aperture, of each depth."""
    lines = []
    for picture in dict.fromkeys(str(row["picture"]) for row in rows):
        of_picture = _by_matcher([row for row in rows if row["picture"] == picture])
        lines += [[picture, matcher, *_decibels(some)] for matcher, some in of_picture.items()]
    return lines


def _decibels(rows: Sequence[Mapping[str, object]]) -> list[str]:
    pairs = [[number(_mean(rows, f"{name}_{part}db"), ".1f") for part in ("", "edges_")] for name in BLURS]
    return [f"{full}, {edges}" for full, edges in pairs]


def _db(row: Mapping[str, object]) -> float:
    return float(str(row["ours_db"]))


def _mean(rows: Sequence[Mapping[str, object]], key: str) -> float:
    values = [value for row in rows if isinstance(value := row.get(key), float) and np.isfinite(value)]
    return float(np.mean(values)) if values else float("nan")
