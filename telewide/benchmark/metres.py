"""From simulated photos to metres: how far off depth is at several distances, and whether it says so.

A simulated phone photographs a board and still lifes; the board is calibrated, the still lifes are brought to metres by
what ``telewide depth`` does. The wide lens holds still or moves in every shot, its colours are those of tele or are
not; the things photographed are the same. A pixel of the tele photo counts where wide sees it too and a depth was
measured, none filled in. What geometry allows is the standard deviation of a depth whose matching is off by
`MATCHING_ERROR_PX`, ``s_z / z = z s / (f B)``: half of normally distributed errors lie below 0.67 of it, 90 % below
1.64. Letters: N pixels of all captures; f B gain, px m.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.benchmark.contenders import source_labels
from telewide.benchmark.memory import SGM
from telewide.benchmark.report import BenchmarkReport, markdown_table, number
from telewide.boards.board import board_points_m, load_board, resized_board
from telewide.boards.shots import detect_shots, find_board_shots
from telewide.calibration.rig_file import RigFacts, write_rig
from telewide.calibration.solver import calibrate_rig
from telewide.capture.images import read_image
from telewide.capture.pfm import read_pfm
from telewide.cores import Device
from telewide.errors import UsageError
from telewide.files import is_file
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import StereoRig
from telewide.matching.methods import Method
from telewide.pipeline import depth_captures
from telewide.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from telewide.simulate.phone import BOARD_SQUARE_M, write_phone
from telewide.stages.depth import DepthOptions, DepthRun, recipe_of_depth
from telewide.stages.observer import Observer
from telewide.training.options import WEIGHTS_NAME

DISTANCES_M = (0.5, 1.0, 2.0, 4.0)
BAND_SHARE = 0.2
"""A distance stands for those that differ by so much of it."""
MATCHING_ERROR_PX = 0.25
INTERVAL_STDS = 1.96
"""Half the width of a normal distribution's 95 % interval."""
DEPTHS_M = ((0.45, 1.3), (0.8, 2.6), (1.5, 5.0))
"""Nearest and farthest of the still lifes, in turn: together they hold every distance."""
BOARD = "chessboard_9x6"
_SHARES = (("known", ".0f"), ("error_p50", ".2f"), ("error_p90", ".2f"), ("allowed", ".2f"), ("inside_95", ".1f"))
_FEW_SHOTS = (
    "the lens moves once a shot, and all depths of a shot by it: the share inside the interval is of as many "
    "independent trials as there are captures"
)


@dataclass(frozen=True)
class MetresOptions:
    """Options of the simulated captures.

    Attributes:
        captures: still lifes of each kind; three hold every distance.
        boards: shots of the board.
        width: of all photos, px.
        seed: of everything drawn.
        device: of networks: auto, cpu or cuda.
    """

    captures: int = 3
    boards: int = 14
    width: int = 720
    seed: int = 0
    device: Device = "auto"


@dataclass(frozen=True)
class DepthMaker:
    """A way from two photos to metres.

    Attributes:
        name: as it stands in tables.
        method: how to match.
        weights: of its network; None for semi-global matching.
        recipe: how the pairs are corrected.
    """

    name: str
    method: Method
    weights: Path | None
    recipe: Recipe


@dataclass(frozen=True)
class MeasuredDepths:
    """Depths of the pixels that count, and the truth.

    Attributes:
        truth_m: (N,) of all pixels that both lenses see.
        depth_m: (N,) NaN where no depth was measured.
        depth_std_m: (N,) stated standard deviation.
    """

    truth_m: FloatArray
    depth_m: FloatArray
    depth_std_m: FloatArray


def depth_makers(sources: Sequence[Path]) -> list[DepthMaker]:
    """Semi-global matching, then the network of each source.

    Args:
        sources: run folders and weights files.

    Raises:
        UsageError: a source without weights.
    """
    makers = [DepthMaker(SGM, "sgm", None, load_recipe(DEFAULT_RECIPE))]
    for source, label in zip(sources, source_labels(sources), strict=True):
        weights = source if is_file(source) else _weights_of(source)
        recipe = recipe_of_depth(weights.absolute().parents[1], source, weights=weights)
        makers.append(DepthMaker(label, "network", weights, recipe))
    return makers


def benchmark_metres(
    folder: Path, makers: Sequence[DepthMaker], options: MetresOptions, *, observer: Observer
) -> BenchmarkReport:
    """Judge depths in metres of a simulated phone.

    Args:
        folder: where photos, rigs and depths go.
        makers: what to judge.
        options: what is simulated.
        observer: hears how far it is.

    Returns:
        A row for each of the makers, a still and a moving lens, without and with a cast of colour, and each distance.

    Raises:
        UsageError: a number out of range.
        InputError: no rig is found, or no capture can be used.
    """
    rows: list[dict[str, object]] = []
    notes: dict[str, None] = {_FEW_SHOTS: None}
    for cast in (False, True):
        rig: Path | None = None
        for moves in (False, True):
            place = folder / f"{'moving' if moves else 'still'}{'-cast' if cast else ''}"
            observer.said(f"photos of {place.name}")
            # The board is photographed by what holds still: one rig for both.
            truth = _simulate(place, options, boards=options.boards if rig is None else 0, moves=moves, cast=cast)
            rig = rig or _calibrate(place, seed=options.seed)
            for index, maker in enumerate(makers):
                out = place / "depth" / str(index)
                done = _depth(place, maker, out=out, rig=rig, device=options.device, observer=observer)
                measured = read_depths(place, done, rig=truth)
                kind = {"matcher": maker.name, "moves": moves, "cast": cast}
                gain = float(truth.tele.K[0, 0]) * truth.baseline_m
                rows += [{**kind, **judge_distance(measured, distance_m, gain=gain)} for distance_m in DISTANCES_M]
                notes |= {f"{place.name}, {problem.name}: {problem.message}": None for problem in done.problems}
    asked = {**vars(options), "depths_m": DEPTHS_M, "band_share": BAND_SHARE, "matching_error_px": MATCHING_ERROR_PX}
    return BenchmarkReport("metres", asked, tuple(rows), tuple(notes))


def read_depths(place: Path, done: DepthRun, *, rig: StereoRig) -> MeasuredDepths:
    """Read the depths of all captures, at the pixels that wide sees too.

    Args:
        place: what `write_phone` wrote.
        done: the depths made of it.
        rig: the true one.
    """
    gain = float(rig.tele.K[0, 0]) * rig.baseline_m
    parts = []
    with_depth = {outcome.name for outcome in done.outcomes}
    for truth_path in sorted((place / "captures").glob("*/truth.pfm")):
        name = truth_path.parent.name
        truth_m = gain / read_pfm(truth_path)
        # A capture that was left out, or whose metres would mean nothing, has none: it counts as not known.
        depth_m = std_m = np.full(truth_m.shape, np.nan)
        if name in with_depth:
            with np.load(done.folder / name / "depth.npz", allow_pickle=False) as depth:
                depth_m, std_m = depth.get("depth_m", depth_m), depth.get("depth_std_m", std_m)
                depth_m = np.where(depth["valid"], depth_m, np.nan)
        is_seen = read_image(place / "truth" / "hidden" / f"{name}.png")[..., 0] < 0.5
        parts.append(np.stack([truth_m, depth_m, std_m])[:, is_seen])
    truth, depths, stds = np.concatenate(parts, axis=1).astype(np.float64)
    return MeasuredDepths(truth, depths, stds)


def judge_distance(measured: MeasuredDepths, distance_m: float, *, gain: float) -> dict[str, object]:
    """Judge the depths about one distance.

    Args:
        measured: depths and truth.
        distance_m: the middle of the band.
        gain: f B of the tele photo, px m.

    Returns:
        ``distance_m``; ``pixels`` that count; ``known``, their share of what both lenses see there; median and 90th
        percentile of the relative error; ``allowed``, the relative error that geometry allows; ``inside_95``, the
        share of truths within 1.96 stated standard deviations. NaN where there is no pixel.
    """
    is_near = np.abs(measured.truth_m - distance_m) <= BAND_SHARE * distance_m
    counts = is_near & np.isfinite(measured.depth_m)
    row: dict[str, object] = {"distance_m": distance_m, "pixels": int(np.count_nonzero(counts))}
    if not counts.any():
        missing = float("nan")
        known = 0.0 if is_near.any() else missing
        return row | {"known": known} | dict.fromkeys(("error_p50", "error_p90", "allowed", "inside_95"), missing)
    truth_m = measured.truth_m[counts]
    error_m = np.abs(measured.depth_m[counts] - truth_m)
    error_p50, error_p90 = np.percentile(error_m / truth_m, [50, 90])
    return row | {
        "known": float(np.count_nonzero(counts) / np.count_nonzero(is_near)),
        "error_p50": float(error_p50),
        "error_p90": float(error_p90),
        "allowed": float(np.median(truth_m)) * MATCHING_ERROR_PX / gain,
        "inside_95": float(np.mean(error_m <= INTERVAL_STDS * measured.depth_std_m[counts])),
    }


def metres_table(report: BenchmarkReport) -> str:
    """Set a report in Markdown: a line for each maker, lens, colours and distance."""
    headings = (
        *("matcher", "lens moves", "cast", "at m", "pixels", "known %", "error median %", "90 % below %"),
        *(f"{MATCHING_ERROR_PX:g} px is %", "truth inside 95 %"),
    )
    return markdown_table(headings, [_line(row) for row in report.rows])


def _line(row: Mapping[str, object]) -> list[str]:
    switches = ["yes" if row[key] else "no" for key in ("moves", "cast")]
    shares = [_percent(row[key], form) for key, form in _SHARES]
    return [str(row["matcher"]), *switches, number(row["distance_m"], "g"), str(row["pixels"]), *shares]


def _percent(value: object, form: str) -> str:
    return number(100 * float(str(value)), form)


def _weights_of(run: Path) -> Path:
    weights = run / "train" / WEIGHTS_NAME
    if not is_file(weights):
        raise UsageError(
            f"{run} holds no trained network", hint="a run folder of telewide train, or a weights file, was expected"
        )
    return weights


def _simulate(place: Path, options: MetresOptions, *, boards: int, moves: bool, cast: bool) -> StereoRig:
    return write_phone(
        place,
        captures=options.captures,
        boards=boards,
        seed=options.seed,
        width=options.width,
        moves=moves,
        cast=cast,
        depths_m=DEPTHS_M,
    )


def _calibrate(place: Path, *, seed: int) -> Path:
    """The rig that ``telewide calibrate`` finds, without its page."""
    board = resized_board(load_board(BOARD), square_m=BOARD_SQUARE_M)
    detected = detect_shots(find_board_shots(place / "boards"), board=board)
    calibration = calibrate_rig(detected, board_points_m=board_points_m(board), seed=seed)
    facts = RigFacts(scale_verified=True, board=BOARD)
    write_rig(place / "rig.yaml", calibration, facts=facts)
    return place / "rig.yaml"


def _depth(place: Path, maker: DepthMaker, *, out: Path, rig: Path, device: Device, observer: Observer) -> DepthRun:
    """Do what ``telewide depth`` does."""
    asked = DepthOptions(method=maker.method, weights=maker.weights, out=out, device=device, rig=rig)
    return depth_captures(place / "captures", run=place / "run", recipe=maker.recipe, options=asked, observer=observer)
