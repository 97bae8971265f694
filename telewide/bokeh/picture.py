"""The bokeh picture a user asks for: focus and strength in their words, checked before anything is computed.

Letters: H W image.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from telewide.bokeh.aperture import DISK, Aperture
from telewide.bokeh.focus import AF_WORD, Focus, find_focus, named_distance_m, named_point
from telewide.bokeh.layers import Behind, SortedPhoto
from telewide.bokeh.lens import IN_FOCUS_PX, sort_for_lens
from telewide.bokeh.render import (
    LARGEST_RADIUS_SHARE,
    Blur,
    away_from_focus_px,
    largest_step_px,
    light_and_radius,
    radius_per_px_from_f_number,
    radius_per_px_from_strength,
    rendered,
)
from telewide.bokeh.subject import OUTLIER_PERCENT
from telewide.bokeh.surroundings import find_surroundings
from telewide.bokeh.uncovered import find_uncovered
from telewide.bokeh.wide_light import WideView
from telewide.capture.exif import read_photo_facts
from telewide.capture.facts import FACTS_FILE
from telewide.capture.pair import CaptureSet
from telewide.depth.precision_notes import away_words
from telewide.drawing import scaled_image
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, resize_disparity

PictureKind = Literal["jpg", "tif", "exr"]
DEFAULT_STRENGTH_SHARE = 0.012
"""Radius of the strongest blur, as a share of the photo's longer side, where neither strength nor f-number is given."""
PREVIEW_SHRINKS = 4
MOST_MARGIN_SHARE = 0.04
"""Widest margin that the wide photo fills, of the shorter side; what lies farther out is mirrored."""
HELD_BACK = "the strongest blur is held"
"""Words of :func:`held_back_note`."""


@dataclass(frozen=True)
class BokehOptions:
    """Focus of a bokeh picture, strength of its blur, shape of its lights.

    Attributes:
        focus: "X,Y" in px of the tele photo, upright, a distance such as "2.5m", near, far, auto, or af: what its EXIF
            says was focused on.
        strength_px: radius of the strongest blur, px; None for the default.
        strength_share: the same as a share of the photo's longer side.
        f_number: of an imitated lens; needs the baseline.
        equiv_focal_mm: focal length of that lens on 35 mm film.
        aperture: shape of its opening.
        highlights: how many times as bright as white small clipped lights are taken to have been; None, not stated,
            leaves them white in files.
        kinds: of the files it is written to: "jpg", "tif" with 16 bits, "exr" in linear light, of a RAW photo; None for
            "jpg" and those that an earlier call has left.
        is_stripped: whether the files are to say nothing of the photo but its colour profile.
        is_preview: whether a small picture is enough, `PREVIEW_SHRINKS` times fewer pixels along each side.
    """

    focus: str = "auto"
    strength_px: float | None = None
    strength_share: float | None = None
    f_number: float | None = None
    equiv_focal_mm: float = 50.0
    aperture: Aperture = DISK
    highlights: float | None = None
    kinds: tuple[PictureKind, ...] | None = None
    is_stripped: bool = False
    is_preview: bool = False

    @property
    def has_stated_strength(self) -> bool:
        """Whether somebody asked for a certain blur."""
        return any(strength is not None for strength in (self.f_number, self.strength_px, self.strength_share))


_BY_RIG = "name a rig with `rig`, if the photos are as they were taken; else "


def check_bokeh(
    bokeh: BokehOptions | None,
    captures: CaptureSet,
    *,
    baseline_m: float | None = None,
    has_rig: bool = False,
    is_pinned: bool = False,
) -> None:
    """Refuse a bokeh that no capture of a set can have, before hours are spent on the way to it.

    Args:
        bokeh: as asked for; None is always fine.
        captures: the set.
        baseline_m: distance of the lenses where a rig states it; None asks what is stated of the captures.
        has_rig: whether they are rectified with a rig; then what is stated of the captures does not count.
        is_pinned: whether a known distance will give the rig its scale.

    Raises:
        UsageError: an f-number without the lenses' distance, a focus in metres where there are none, or a focus that is
            no word and no point of any tele photo.
    """
    if bokeh is None:
        return
    facts = captures.root / FACTS_FILE
    stated_m = baseline_m if has_rig else captures.facts.baseline_m
    has_metres = is_pinned or (stated_m is not None and (has_rig or captures.facts.f_px is not None))
    if named_distance_m(bokeh.focus) is not None and not has_metres:
        raise UsageError(
            f"the focus {bokeh.focus} needs depth in metres, which "
            + ("a rig without a scale does not give" if has_rig else "nothing stated of the captures gives"),
            hint="pin the rig to a measured distance with `distance`, or name a point of the photo with `focus`"
            if has_rig
            else f"{_BY_RIG}state baseline_m and f_px in {facts}, or name a point of the photo with `focus`",
        )
    if bokeh.f_number is not None and stated_m is None and not is_pinned:
        raise UsageError(
            "`f_number` needs the distance of the two lenses, which "
            + ("the rig does not state" if has_rig else "nothing stated of the captures gives"),
            hint="pin the rig to a measured distance with `distance`, or give the blur in pixels with `strength`"
            if has_rig
            else f"{_BY_RIG}state baseline_m in {facts}, or give the blur in pixels with `strength`",
        )
    if named_point(bokeh.focus, hw=None) is not None:
        _check_point(bokeh.focus, captures, rotated_deg=0 if has_rig else captures.facts.rotated_deg)


def _check_point(focus: str, captures: CaptureSet, *, rotated_deg: int) -> None:
    """Refuse a point that lies in no tele photo, upright."""
    refusal: UsageError | None = None
    for capture in captures.captures:
        try:
            hw = read_photo_facts(capture.tele_path).hw
            named_point(focus, hw=hw if hw is None or rotated_deg % 180 == 0 else hw[::-1])
        except UsageError as error:
            refusal = error
        except InputError:  # it is a problem of that capture, and said where the captures are read
            continue
        else:
            return
    if refusal is not None:
        raise refusal


def why_no_bokeh(options: BokehOptions, *, baseline_m: float | None, has_metres: bool = True) -> str | None:
    """Tell why one capture cannot have the bokeh asked for.

    Args:
        options: as asked for.
        baseline_m: distance of the lenses in this shot, m; None where it is not known.
        has_metres: whether its depth is known in metres.

    Returns:
        One sentence, or None where nothing is missing.
    """
    if named_distance_m(options.focus) is not None and not has_metres:
        return "`focus` in metres needs a depth in metres, not known for this shot; a point of the photo needs none"
    if options.f_number is None or baseline_m is not None:
        return None
    return "`f_number` needs the distance of the two lenses, not known for this shot; `strength` gives the blur in px"


def focus_note(
    name: str,
    focus: Focus,
    *,
    place_px: float,
    depth_m: float | None,
    options: BokehOptions,
    std_m: float | None = None,
) -> str:
    """Say what a bokeh picture is focused on, so that its owner can choose another place.

    Args:
        name: of the capture.
        focus: what was found.
        place_px: disparity of its point, as maps and page have it: its plane lies in the middle of a surface.
        depth_m: distance of that place, m, which need not be the one that was named; None where it is not known.
        options: what was asked for.
        std_m: standard deviation of the distance, m; None likewise.
    """
    distance = "" if depth_m is None else f", {away_words(depth_m, std_m)}"
    place = f"x {focus.x_px}, y {focus.y_px}{distance}, disparity {place_px:.1f} px"
    distance_m = named_distance_m(options.focus)
    if distance_m is not None:
        nowhere = "" if focus.is_on_surface else ", where nothing is, so all of it is blurred"
        return f"{name}: the bokeh was focused {distance_m:g} m away{nowhere}; nearest to that is {place}"
    word = options.focus.strip().lower()
    ways = {
        "auto": "the nearest large surface in the middle, in its whole depth; `focus` X,Y, near or far chooses another",
        "near": "the nearest surface",
        "far": "the farthest surface",
    }
    way = ways.get(word)
    if word == AF_WORD:
        way = f"its EXIF names no place, so {ways['auto']}" if focus.sharp_px else "the place that its EXIF names"
    why = f" ({way})" if way else ""
    return f"{name}: the bokeh was focused on {place}{why}"


def bokeh_picture(
    read_photo: Callable[[], FloatMap],
    disparity: DisparityMap,
    *,
    options: BokehOptions,
    baseline_m: float | None,
    focus: Focus | None = None,
    wide: Callable[[], WideView] | None = None,
) -> FloatMap:
    """Blur a photo by its disparity.

    Args:
        read_photo: reads tele, (H, W, 3) sRGB; nothing holds on to it while the blur is drawn.
        disparity: on the photo.
        options: focus and strength.
        baseline_m: distance of the lenses, m; needed for an f-number.
        focus: what is sharp; None finds what the options say.
        wide: reads the wide photo, for the light from beyond the frame and from behind nearer things; None mirrors the
            world there, and continues what is seen beside those.

    Returns:
        (H, W, 3) sRGB.

    Raises:
        UsageError: an f-number without the distance of the lenses.
    """
    refusal = why_no_bokeh(options, baseline_m=baseline_m)
    if refusal is not None:
        raise UsageError(refusal)
    if focus is None:
        focus = find_focus(disparity.disparity_px, disparity.confidence, focus=options.focus, valid=disparity.valid)
    disparity_px = disparity.disparity_px
    radius_per_px = blur_per_px(disparity_px, focus, options=options, baseline_m=baseline_m)
    blur = Blur(focus.disparity_px, radius_per_px, focus.sharp_px, highlights=options.highlights or 1.0)
    most_px = 0 if wide is None else _margin_px(disparity_px, focus, radius_per_px * options.aperture.reach)
    photo, margin_px = _sorted(read_photo, disparity_px, blur, wide=wide, margin_px=most_px)
    if photo is None:
        return read_photo().astype(np.float32, copy=True)
    return rendered(photo, aperture=options.aperture, hw=disparity_px.shape, margin_px=margin_px)


def _sorted(
    read_photo: Callable[[], FloatMap],
    disparity_px: FloatMap,
    blur: Blur,
    *,
    wide: Callable[[], WideView] | None,
    margin_px: int,
) -> tuple[SortedPhoto | None, int]:
    """Sort a photo by blur, with what wide shows around it; nothing else of it is left when this returns.

    Returns:
        The sorted photo, None where all of it is sharp; the margin around it, px, 0 where wide shows nothing there.
    """

    def lit() -> tuple[tuple[FloatMap, FloatMap, Behind | None] | None, int]:
        photo, around, uncovered = read_photo(), None, None
        step_px = largest_step_px(disparity_px, blur.focus_disparity_px, sharp_px=blur.sharp_px)
        if wide is not None and step_px * blur.radius_per_px > IN_FOCUS_PX:
            view = wide()
            uncovered = find_uncovered(photo, disparity_px, view)
            if margin_px > 0:
                around = find_surroundings(photo, disparity_px, view, margin_px=margin_px)
        made = light_and_radius(photo, disparity_px, blur, around=around, uncovered=uncovered)
        return made, 0 if around is None else margin_px

    light, found_px = lit()  # the photos are let go
    return None if light is None else sort_for_lens(*light), found_px


def _margin_px(disparity_px: FloatMap, focus: Focus, reach_per_px: float) -> int:
    """Distance from which light comes from beyond the frame, by the depth of its border; 0 where that is sharp."""
    border_px = np.concatenate([disparity_px[0], disparity_px[-1], disparity_px[:, 0], disparity_px[:, -1]])
    border_px = border_px[np.isfinite(border_px)]
    if not len(border_px):
        return 0
    away_px = np.abs(away_from_focus_px(border_px, focus.disparity_px, focus.sharp_px))
    reach_px = reach_per_px * float(np.percentile(away_px, 100 - OUTLIER_PERCENT))
    if reach_px <= IN_FOCUS_PX:
        return 0
    return math.ceil(min(reach_px, MOST_MARGIN_SHARE * float(min(disparity_px.shape))))


def bokeh_preview(
    photo: FloatMap, disparity: DisparityMap, *, options: BokehOptions, baseline_m: float | None, focus: Focus
) -> FloatMap:
    """Blur a photo made smaller as :func:`bokeh_picture` would blur the photo: for trying focus and strength.

    Args:
        photo: (H, W, 3) tele, sRGB.
        disparity: on the photo.
        options: focus and strength, px of the photo.
        baseline_m: distance of the lenses, m; needed for an f-number.
        focus: what is sharp, on the photo.

    Returns:
        (h, w, 3) sRGB, sides `PREVIEW_SHRINKS` times shorter.

    Raises:
        UsageError: an f-number without the distance of the lenses.
    """
    height, width = disparity.disparity_px.shape
    wh = max(round(width / PREVIEW_SHRINKS), 1), max(round(height / PREVIEW_SHRINKS), 1)
    scale = wh[0] / width
    confidence, valid = (
        np.asarray(cv2.resize(each.astype(np.float32), wh, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.float32)
        for each in (disparity.confidence, disparity.valid)
    )
    small = DisparityMap(resize_disparity(disparity.disparity_px, wh=wh), confidence, valid > 0)
    sharp_px = None if focus.sharp_px is None else (scale * focus.sharp_px[0], scale * focus.sharp_px[1])
    strength_px = None if options.strength_px is None else scale * options.strength_px
    small_photo = scaled_image(photo, wh=wh)
    return bokeh_picture(
        lambda: small_photo,
        small,
        options=replace(options, strength_px=strength_px),
        baseline_m=baseline_m,
        focus=replace(focus, disparity_px=scale * focus.disparity_px, sharp_px=sharp_px),
    )


def held_back_note(
    name: str, disparity_px: FloatMap, focus: Focus, *, options: BokehOptions, baseline_m: float | None
) -> str | None:
    """Say that a blur is weaker than was asked for, the largest that is rendered; None where it is as asked for.

    Args:
        name: of the capture.
        disparity_px: (H, W) on the photo, px.
        focus: what is sharp.
        options: focus and strength.
        baseline_m: distance of the lenses, m; None where it is not known.
    """
    if not options.has_stated_strength:
        return None
    radius_per_px = blur_per_px(disparity_px, focus, options=options, baseline_m=baseline_m)
    asked_px = radius_per_px * largest_step_px(disparity_px, focus.disparity_px, sharp_px=focus.sharp_px)
    cap_px = LARGEST_RADIUS_SHARE * min(disparity_px.shape)
    if not asked_px > cap_px:
        return None
    return (
        f"{name}: {HELD_BACK} at a radius of {cap_px:.0f} px, a tenth of the photo's shorter side; "
        f"{asked_px:.0f} px were asked for"
    )


def blur_per_px(disparity_px: FloatMap, focus: Focus, *, options: BokehOptions, baseline_m: float | None) -> float:
    """Blur that options ask for: px of radius per px of disparity away from the focus.

    Args:
        disparity_px: (H, W) on the photo, px.
        focus: what is sharp.
        options: strength or f-number; neither for the default.
        baseline_m: distance of the lenses, m; needed for an f-number.
    """
    if options.f_number is not None and baseline_m is not None:
        return radius_per_px_from_f_number(
            f_number=options.f_number, baseline_m=baseline_m, equiv_focal_mm=options.equiv_focal_mm
        )
    share = DEFAULT_STRENGTH_SHARE if options.strength_share is None else options.strength_share
    strength_px = share * max(disparity_px.shape) if options.strength_px is None else options.strength_px
    return radius_per_px_from_strength(
        disparity_px, focus.disparity_px, strength_px=strength_px, sharp_px=focus.sharp_px
    )
