"""The bokeh picture of one capture: what it is focused on, in which colours, and what is told of it.

Letters: H W image.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

from telewide.bokeh.focus import Focus, find_focus, named_distance_m, named_focus
from telewide.bokeh.picture import (
    BokehOptions,
    PictureKind,
    blur_per_px,
    bokeh_picture,
    bokeh_preview,
    focus_note,
    held_back_note,
    why_no_bokeh,
)
from telewide.bokeh.wide_light import WideView
from telewide.capture.carried import CarriedFacts, read_carried
from telewide.capture.colour_profiles import is_other_than_srgb
from telewide.capture.exif import read_photo_facts
from telewide.capture.images import read_image
from telewide.capture.pair import Capture
from telewide.capture.pictures import PictureFacts
from telewide.depth.result import DepthResult
from telewide.drawing import upright
from telewide.errors import MissingPartError, extra_hint
from telewide.files import is_file
from telewide.geometry.arrays import FloatMap
from telewide.stages.beyond_frame import BeyondFrame
from telewide.stages.kept_depth import BOKEH_NAME, BOKEH_NAMES, EXR_BOKEH_NAME, PREVIEW_BOKEH_NAME, listed_files


@dataclass(frozen=True)
class BokehFiles:
    """A bokeh picture that is to be written.

    Attributes:
        pixels: (H, W, 3) float32, upright, in the colours of the photo's profile.
        facts: what the files say of themselves.
        names: of the files.
    """

    pixels: FloatMap
    facts: PictureFacts
    names: tuple[str, ...]


@dataclass(frozen=True)
class CaptureBokeh:
    """Bokeh of one capture, as it was asked for.

    Attributes:
        files: the picture; None where this shot cannot have it.
        notes: what it is focused on, or why there is none.
        numbers: the focus in px, and in metres where they are known or named; the blur in px a px of disparity.
    """

    files: BokehFiles | None
    notes: tuple[str, ...]
    numbers: dict[str, float]


def bokeh_of_capture(
    read_photo: Callable[[], FloatMap],
    result: DepthResult,
    source: Capture,
    *,
    options: BokehOptions,
    turned_deg: int,
    beyond: BeyondFrame | None = None,
) -> CaptureBokeh:
    """Make the bokeh picture of one capture.

    Args:
        read_photo: reads the tele photo, (H, W, 3), upright; called again where it is needed again.
        result: its depth, upright.
        source: the photos as taken.
        options: of the picture.
        turned_deg: how far photo and result were turned clockwise to stand upright.
        beyond: finds the light from beyond the frame in the wide photo; None mirrors the world there.

    Raises:
        InputError: the photo cannot be read again in its own colours.
        UsageError: a focus outside of the photo.
    """
    refusal = why_no_bokeh(options, baseline_m=result.baseline_m, has_metres=result.depth_m is not None)
    if refusal is not None:
        return CaptureBokeh(None, (no_bokeh_note(result.name, refusal),), {})
    carried, maps, baseline_m = read_carried(source.tele_path), result.disparity, result.baseline_m
    of_photo = read_photo_facts(source.tele_path)
    subject_uv = _upright_place(of_photo.subject_uv, turned_deg=turned_deg)
    named = named_focus(options.focus, subject_uv, hw=maps.disparity_px.shape)
    focus = _focus_of(result, named)
    is_own = has_own_colours(carried)
    if is_own:
        read_photo = partial(read_in_own_colours, source, turned_deg=turned_deg)
    wide = None if beyond is None else partial(beyond.wide_view, source, result, is_converted=not is_own)
    pixels = _rendered(read_photo, result, options=options, focus=focus, wide=wide)
    numbers = _focus_numbers(focus, result)
    numbers["blur_per_px"] = blur_per_px(maps.disparity_px, focus, options=options, baseline_m=baseline_m)
    at_px, at_m, std_m = maps.disparity_px[focus.y_px, focus.x_px], numbers.get("focus_m"), numbers.get("focus_std_m")
    note = focus_note(result.name, focus, place_px=float(at_px), depth_m=at_m, std_m=std_m, options=options)
    if (distance_m := named_distance_m(options.focus)) is not None:  # of the sharp plane, not of what lies near it
        numbers["focus_m"] = distance_m
        numbers.pop("focus_std_m", None)
    held_back = held_back_note(result.name, maps.disparity_px, focus, options=options, baseline_m=baseline_m)
    done = note.removeprefix(f"{result.name}: ")
    facts = PictureFacts(software=software(), done=done, of_photo=carried, is_stripped=options.is_stripped)
    names = tuple(name for name in bokeh_names(options) if name != EXR_BOKEH_NAME or of_photo.kind == "raw")
    files = BokehFiles(pixels, facts, names) if names else None
    no_exr = no_exr_note(result.name) if len(names) < len(bokeh_names(options)) else None
    return CaptureBokeh(files, tuple(told for told in (note, held_back, no_exr) if told is not None), numbers)


def _focus_of(result: DepthResult, named: str) -> Focus:
    maps, at_m = result.disparity, result.disparity_at
    return find_focus(maps.disparity_px, maps.confidence, focus=named, disparity_at_m=at_m, valid=maps.valid)


def _rendered(
    read_photo: Callable[[], FloatMap],
    result: DepthResult,
    *,
    options: BokehOptions,
    focus: Focus,
    wide: Callable[[], WideView] | None,
) -> FloatMap:
    maps, baseline_m = result.disparity, result.baseline_m
    if options.is_preview:
        return bokeh_preview(read_photo(), maps, options=options, baseline_m=baseline_m, focus=focus)
    return bokeh_picture(read_photo, maps, options=options, baseline_m=baseline_m, focus=focus, wide=wide)


def has_own_colours(carried: CarriedFacts) -> bool:
    """Whether a photo has colours of a profile other than sRGB, which may be wider."""
    return carried.profile is not None and is_other_than_srgb(carried.profile)


def read_in_own_colours(source: Capture, *, turned_deg: int) -> FloatMap:
    """Read the tele photo in the colours of its profile.

    Args:
        source: where it is read from.
        turned_deg: how far it was turned clockwise to stand upright.

    Returns:
        (H, W, 3) in [0, 1]; light adds up in these colours as well.
    """
    return upright(read_image(source.tele_path, is_converted=False), rotated_deg=turned_deg)


def _upright_place(place_uv: tuple[float, float] | None, *, turned_deg: int) -> tuple[float, float] | None:
    """A place after clockwise quarter turns of the photo."""
    for _ in range(turned_deg // 90):
        place_uv = None if place_uv is None else (1 - place_uv[1], place_uv[0])
    return place_uv


def no_bokeh_note(name: str, why: str) -> str:
    """Say why a capture has no bokeh picture."""
    return f"{name}: {BOKEH_NAME} left out: {why}"


def no_exr_note(name: str) -> str:
    """Say why a capture has no bokeh in linear light."""
    return f"{name}: {EXR_BOKEH_NAME} left out: the tele photo is no RAW, so how bright things were is not known"


def bokeh_names(options: BokehOptions | None) -> tuple[str, ...]:
    """Name the files of a bokeh picture; none where none is asked for."""
    if options is None:
        return ()
    if options.is_preview:
        return (PREVIEW_BOKEH_NAME,)
    return tuple(name for name in BOKEH_NAMES if name.rpartition(".")[2] in (options.kinds or ("jpg",)))


def with_lying_kinds(options: BokehOptions | None, folder: Path) -> BokehOptions | None:
    """Where no kinds of files are named, take the JPEG and those that lie there: left as they are, they would be stale.

    Args:
        options: as asked for; None where no picture is.
        folder: of the capture.

    Raises:
        MissingPartError: one that lies there cannot be made.
    """
    if options is None or options.kinds is not None or options.is_preview:
        return options
    lying = {name for name in listed_files(folder) if is_file(folder / name)}
    if EXR_BOKEH_NAME in lying and find_spec("OpenEXR") is None:
        raise MissingPartError(
            f"{folder / EXR_BOKEH_NAME} shows another bokeh; making it anew needs OpenEXR, which is not installed",
            hint=f"{extra_hint('exr')}; or name the files that you want with `picture`",
        )
    kinds = tuple(kind for kind in get_args(PictureKind) if kind == "jpg" or f"bokeh.{kind}" in lying)
    return replace(options, kinds=kinds)


def software() -> str:
    """Name telewide and its version, as files do."""
    return f"telewide {metadata.version('telewide')}"


def _focus_numbers(focus: Focus, result: DepthResult) -> dict[str, float]:
    """Focus of the bokeh in numbers; metres, of what lies there, only where they are known."""
    numbers = {"focus_px": focus.disparity_px, "focus_x_px": float(focus.x_px), "focus_y_px": float(focus.y_px)}
    if focus.sharp_px is not None:
        numbers |= {"sharp_far_px": focus.sharp_px[0], "sharp_near_px": focus.sharp_px[1]}
    maps = {"focus_m": result.depth_m, "focus_std_m": result.depth_std_m}
    metres = {name: float(m[focus.y_px, focus.x_px]) for name, m in maps.items() if m is not None}
    return numbers | {name: value for name, value in metres.items() if math.isfinite(value)}
