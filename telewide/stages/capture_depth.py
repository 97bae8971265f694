"""One capture's depth: matched, brought to the photo's own size and edges, written, and measured; or kept.

Letters: H W image.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import cv2
import numpy as np

from telewide.bokeh.focus import Focus, find_focus, named_focus
from telewide.bokeh.picture import HELD_BACK, BokehOptions, bokeh_picture, focus_note, held_back_note, why_no_bokeh
from telewide.capture.carried import CarriedFacts, read_carried
from telewide.capture.colour_profiles import is_other_than_srgb
from telewide.capture.exif import read_photo_facts
from telewide.capture.images import read_image
from telewide.capture.pair import Capture, CaptureFacts, Problem, read_pair, read_truth
from telewide.capture.photo_store import PhotoStore
from telewide.capture.pictures import PictureFacts, write_picture
from telewide.correction.moving import MovedRegion, moving_mask
from telewide.depth.edges import follow_edges
from telewide.depth.export import DEFAULT_FORMATS, WITH_EXIF, file_names, write_depth
from telewide.depth.formats.numpy_archive import NPZ_NAME
from telewide.depth.pin import KnownDistance
from telewide.depth.precision import DepthPrecision
from telewide.depth.precision_notes import (
    ALL_NEGATIVE,
    hardly_known_notes,
    pinned_shot,
    without_depth_behind,
    without_meaningless_metres,
    without_unknown_std,
)
from telewide.depth.result import DepthResult, depth_result, depth_result_of_rig, stood_upright
from telewide.depth.unrectify import disparity_on_tele
from telewide.drawing import upright
from telewide.errors import InputError, UsageError, within_memory
from telewide.files import fingerprint, is_file, replacing
from telewide.folders import fresh_folder, refuse_links
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rectification import RectifiedGeometry
from telewide.geometry.stereo import DisparityMap, resize_disparity
from telewide.matching.matcher import Match
from telewide.matching.window import Window, within_width
from telewide.metrics import end_point_error_px, three_pixel_error
from telewide.points.held_out import HeldOut, match_errors_px, summarise_errors
from telewide.stages.kept_depth import (
    BOKEH_NAME,
    BOKEH_NAMES,
    KEPT_NAME,
    KeptDepth,
    listed_files,
    put_in_place,
    read_kept,
    refuse_foreign_files,
    refuse_results_of_another,
    write_kept,
)


@dataclass(frozen=True)
class ShotGeometry:
    """Geometry between the matched pair and the photos it was rectified from.

    Attributes:
        geometry: of the rectified views.
        precision: what all depths of the shot share.
        moved: parts of the tele photo that moved between the two exposures.
        known: a point of known distance; None without.
    """

    geometry: RectifiedGeometry
    precision: DepthPrecision
    moved: tuple[MovedRegion, ...] = ()
    known: KnownDistance | None = None


@dataclass(frozen=True)
class DepthOutcome:
    """Results of one capture.

    Attributes:
        name: of the capture.
        paths: files written.
        notes: what was left out, and why; what the bokeh is focused on.
        numbers: seconds, focus, shares of held-out matches missed, errors against a truth where the set has one.
        is_kept: whether all files were there already, made from the same inputs.
        withheld: what is not among the files because it would mean nothing, and why; None where all is there.
    """

    name: str
    paths: tuple[Path, ...]
    notes: tuple[str, ...]
    numbers: Mapping[str, float]
    is_kept: bool = False
    withheld: str | None = None

    @property
    def shortcomings(self) -> tuple[str, ...]:
        """The notes that tell of less than was asked for, or that near and far may be exchanged."""
        telling = (_no_bokeh_note(self.name, ""), f"{self.name}: {HELD_BACK}")
        return tuple(
            note
            for note in self.notes
            if note == self.withheld or note.startswith(telling) or ALL_NEGATIVE in note.removeprefix(self.name)
        )


def _no_bokeh_note(name: str, why: str) -> str:
    return f"{name}: {BOKEH_NAME} left out: {why}"


@dataclass(frozen=True)
class DepthFailure:
    """Reason why there is no depth of one capture.

    Attributes:
        name: of the capture.
        error: what was wrong.
    """

    name: str
    error: InputError | UsageError

    @property
    def problem(self) -> Problem:
        """Return it as a capture that was left out."""
        return Problem(self.name, self.error.message)

    def of_all(self, captures_root: Path) -> InputError | UsageError:
        """Return the error to raise where no capture of a set is left."""
        message = f"{captures_root}: no depth could be computed; {self.name}: {self.error.message}"
        return type(self.error)(message, hint=self.error.hint)


def depth_of_capture(
    source: Capture,
    held_out: HeldOut,
    folder: Path,
    *,
    facts: CaptureFacts,
    match: Match,
    window: Window,
    bokeh: BokehOptions | None,
    key: Mapping[str, object],
    shot: ShotGeometry | None = None,
    photos: PhotoStore | None = None,
    formats: tuple[str, ...] = DEFAULT_FORMATS,
) -> DepthOutcome | DepthFailure:
    """Make depth, and bokeh if asked, of one capture, unless the same lies there already.

    Args:
        source: the photos as taken.
        held_out: the corrected pair made from them, with the matches to judge by.
        folder: where the files go.
        facts: what the owner states.
        match: makes the disparity.
        window: disparities to search, px.
        bokeh: None for no bokeh picture.
        key: everything the files depend on, as plain data.
        shot: of a pair that was rectified with a rig; None for photos that were rectified when they came.
        photos: where the tele photo may be kept; None decodes it.
        formats: of the depth files, the npz among them.

    Returns:
        The files, and what was measured; or why there are none, where a photo, the truth or the bokeh asked for
        cannot be used: one bad capture does not stop the others.
    """
    photos = photos or PhotoStore(max_bytes=0)
    try:
        refuse_links(folder.parent, folder)
        lying = made = read_kept(folder, key)
        if made is None:
            refuse_results_of_another(folder, source.tele_path)
            refuse_foreign_files(folder, (*file_names(formats), *_bokeh_names(bokeh), KEPT_NAME))
            with within_memory("its depth"):
                computed = _compute(
                    source, held_out, photos, facts=facts, match=match, window=window, bokeh=bokeh, shot=shot
                )
            made = _put(computed, folder, formats=formats, key=key, source=source.tele_path)
    except (InputError, UsageError) as error:
        return DepthFailure(source.name, error)
    paths = tuple(folder / name for name in made.files)
    return DepthOutcome(source.name, paths, made.notes, made.numbers, is_kept=lying is not None, withheld=made.withheld)


@dataclass(frozen=True)
class _Picture:
    """A bokeh picture, what it says of itself, and the names of its files."""

    pixels: FloatMap
    facts: PictureFacts
    names: tuple[str, ...]


@dataclass(frozen=True)
class _Computed:
    """All that is to be written of one capture, upright; `bokeh_notes` without a picture say why there is none."""

    photo: FloatMap
    result: DepthResult
    metric_notes: tuple[str, ...]
    picture: _Picture | None
    bokeh_notes: tuple[str, ...]
    numbers: Mapping[str, float]
    withheld: str | None = None


def _compute(
    source: Capture,
    held_out: HeldOut,
    photos: PhotoStore,
    *,
    facts: CaptureFacts,
    match: Match,
    window: Window,
    bokeh: BokehOptions | None,
    shot: ShotGeometry | None,
) -> _Computed:
    """Do all that can fail, and touch no file."""
    begun_s = time.monotonic()
    pair = read_pair(held_out.capture)
    window = within_width(window, pair.tele.shape[1])
    working = match(pair.tele, pair.wide, window=window, valid=pair.valid)
    numbers = {"match_s": time.monotonic() - begun_s}
    photo = photos.read(source.tele_path)
    result, metric_notes, withheld = depth_on_photo(working, photo, name=source.name, facts=facts, shot=shot)
    numbers |= summarise_errors(match_errors_px(working.disparity_px, held_out))
    errors, unjudged = _errors_by_truth(source, result, is_mirrored=shot is None and facts.wide_side == "left")
    numbers |= errors
    turned_deg = result.rotated_deg
    photo, result = upright(photo, rotated_deg=turned_deg), stood_upright(result)
    picture: _Picture | None = None
    told: tuple[str, ...] = ()
    if bokeh is not None:
        carried = read_carried(source.tele_path)
        own = _in_own_colours(photo, source, carried, rotated_deg=turned_deg)
        subject_uv = _upright_place(read_photo_facts(source.tele_path).subject_uv, rotated_deg=turned_deg)
        picture, told, focused = _blurred(own, result, bokeh, carried=carried, subject_uv=subject_uv)
        numbers |= focused
    numbers["total_s"] = time.monotonic() - begun_s
    return _Computed(
        photo=photo,
        result=result,
        metric_notes=(*metric_notes, *unjudged),
        picture=picture,
        bokeh_notes=told,
        numbers=numbers,
        withheld=withheld,
    )


def _errors_by_truth(
    source: Capture, result: DepthResult, *, is_mirrored: bool
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Errors against a truth where the set has one, and what to say of one that knows nothing."""
    found_px = result.disparity.disparity_px
    truth_px = read_truth(source, hw=(found_px.shape[0], found_px.shape[1]))
    if truth_px is None:
        return {}, ()
    if not np.isfinite(truth_px).any():
        return {}, (f"{source.name}: {source.truth_path} knows no disparity, so nothing is judged by it",)
    if is_mirrored:
        truth_px = -truth_px  # it is x_tele - x_wide of the photos as given
    return {"3PE": three_pixel_error(found_px, truth_px), "EPE_px": end_point_error_px(found_px, truth_px)}, ()


def _in_own_colours(photo: FloatMap, source: Capture, carried: CarriedFacts, *, rotated_deg: int) -> FloatMap:
    """The photo in the colours of its profile, which may be wider than sRGB; light adds up in those as well."""
    if carried.profile is None or not is_other_than_srgb(carried.profile):
        return photo
    return upright(read_image(source.tele_path, is_converted=False), rotated_deg=rotated_deg)


def _upright_place(place_uv: tuple[float, float] | None, *, rotated_deg: int) -> tuple[float, float] | None:
    """A place after clockwise quarter turns of the photo."""
    for _ in range(rotated_deg // 90):
        place_uv = None if place_uv is None else (1 - place_uv[1], place_uv[0])
    return place_uv


def _blurred(
    photo: FloatMap,
    result: DepthResult,
    bokeh: BokehOptions,
    *,
    carried: CarriedFacts,
    subject_uv: tuple[float, float] | None,
) -> tuple[_Picture | None, tuple[str, ...], dict[str, float]]:
    """The bokeh picture, what to say of it, and what it is focused on; no picture where this shot cannot have it."""
    refusal = why_no_bokeh(bokeh, baseline_m=result.baseline_m, has_metres=result.depth_m is not None)
    if refusal is not None:
        return None, (_no_bokeh_note(result.name, refusal),), {}
    focus = find_focus(
        result.disparity.disparity_px,
        result.disparity.confidence,
        focus=named_focus(bokeh.focus, subject_uv, hw=(photo.shape[0], photo.shape[1])),
        disparity_at_m=result.disparity_at,
    )
    pixels = bokeh_picture(photo, result.disparity, options=bokeh, baseline_m=result.baseline_m, focus=focus)
    focused = _focus_numbers(focus, result)
    depth_m, std_m = focused.get("focus_m"), focused.get("focus_std_m")
    note = focus_note(result.name, focus, depth_m=depth_m, std_m=std_m, options=bokeh)
    held_back = held_back_note(
        result.name, result.disparity.disparity_px, focus, options=bokeh, baseline_m=result.baseline_m
    )
    software, done = _software(), note.removeprefix(f"{result.name}: ")
    said = PictureFacts(software=software, done=done, of_photo=carried, is_stripped=bokeh.is_stripped)
    picture = _Picture(pixels, said, _bokeh_names(bokeh))
    return picture, tuple(told for told in (note, held_back) if told is not None), focused


def _bokeh_names(bokeh: BokehOptions | None) -> tuple[str, ...]:
    return () if bokeh is None else tuple(name for name in BOKEH_NAMES if name.rpartition(".")[2] in bokeh.kinds)


def _put(
    computed: _Computed, folder: Path, *, formats: tuple[str, ...], key: Mapping[str, object], source: Path
) -> KeptDepth:
    """Write all files of one capture, which appear together."""
    with fresh_folder(folder.parent) as new:
        exif = _exif_without_place(source, computed.photo) if WITH_EXIF.intersection(formats) else b""
        made = _write(new, computed, former=folder, formats=formats, exif=exif)
        write_kept(new, made, key=key, source=source)
        put_in_place(new, folder)
    return made


def _exif_without_place(source: Path, photo: FloatMap) -> bytes:
    """EXIF for files that are made to be handed on: camera, exposure and date; no GPS."""
    carried = replace(read_carried(source), gps={})
    return carried.exif_bytes(wh=(photo.shape[1], photo.shape[0]), software=_software())


def _software() -> str:
    return f"telewide {metadata.version('telewide')}"


def _write(folder: Path, computed: _Computed, *, former: Path, formats: tuple[str, ...], exif: bytes) -> KeptDepth:
    """Write all files of one capture into a folder; an earlier bokeh is kept where its depth is the same."""
    written = write_depth(folder, computed.result, image=computed.photo, formats=formats, exif=exif)
    names, notes = [path.name for path in written.paths], (*written.notes, *computed.metric_notes)
    notes = (*notes, *computed.bokeh_notes)
    if computed.picture is not None:
        for name in computed.picture.names:
            write_picture(folder / name, computed.picture.pixels, facts=computed.picture.facts)
            names.append(name)
    elif not computed.bokeh_notes:
        for name in _bokeh_of(former, folder / NPZ_NAME):
            with replacing(folder / name) as temporary:
                shutil.copyfile(former / name, temporary)
            names.append(name)
    return KeptDepth(tuple(names), notes, computed.numbers, computed.withheld)


def depth_on_photo(
    working: DisparityMap, photo: FloatMap, *, name: str, facts: CaptureFacts, shot: ShotGeometry | None = None
) -> tuple[DepthResult, tuple[str, ...], str | None]:
    """Bring what was matched to the tele photo as it was taken, and into metres where the scale is known.

    Args:
        working: disparity of the views that were matched.
        photo: (H, W, 3) the tele photo, RGB in [0, 1].
        name: of the capture.
        facts: what the owner states; they count where no rig does. The views of a wide lens on the left were mirrored.
        shot: how the views lie to the photo; None for photos that were rectified when they came.

    Returns:
        The result, what a person should know of its metres, and why it has none where they would mean nothing.
    """
    if shot is None:
        given = _mirrored(working) if facts.wide_side == "left" else working
        stated = depth_result(name, on_photo(given, photo), facts=facts)
        result, told = without_depth_behind(stated, has_rig=False)
        is_withheld = stated.depth_m is not None and result.depth_m is None
        return result, () if told is None else (told,), told if is_withheld else None
    return _result_of_shot(name, working, photo, shot=shot)


def _mirrored(disparity: DisparityMap) -> DisparityMap:
    """Maps with left and right exchanged; the disparities stay as they are, larger where something is nearer."""
    return DisparityMap(disparity.disparity_px[:, ::-1], disparity.confidence[:, ::-1], disparity.valid[:, ::-1])


def _bokeh_of(folder: Path, depth: Path) -> list[str]:
    """Names of the bokeh files there that were made of this very depth."""
    lying = listed_files(folder)
    names = [name for name in BOKEH_NAMES if name in lying and is_file(folder / name)]
    former = folder / depth.name
    is_same = bool(names) and depth.name in lying and is_file(former)
    return names if is_same and fingerprint(former) == fingerprint(depth) else []


def _result_of_shot(
    name: str, working: DisparityMap, photo: FloatMap, *, shot: ShotGeometry
) -> tuple[DepthResult, tuple[str, ...], str | None]:
    """Bring a map of the rectified view to the tele photo as it was taken, and into metres.

    Returns:
        The result, what to know of its metres, and why it has none where they would mean nothing.
    """
    pinned = pinned_shot(name, working.disparity_px, shot.known, geometry=shot.geometry, precision=shot.precision)
    geometry = pinned.geometry
    on_tele = disparity_on_tele(working, geometry=geometry)
    moved = moving_mask(shot.moved, hw=photo.shape[:2])
    confidence = np.where(moved, np.float32(0), on_tele.confidence)
    followed_px = follow_edges(on_tele.disparity_px, photo, confidence=confidence, valid=on_tele.valid & ~moved)
    disparity = DisparityMap(followed_px, confidence, on_tele.valid & ~moved)
    result = depth_result_of_rig(
        name, disparity, rig=geometry.rig, precision=pinned.precision, matched_scale=geometry.scale
    )
    has_metres = result.depth_m is not None
    result, doubt = without_depth_behind(result, has_rig=True)
    if doubt is None:
        result, doubt = without_meaningless_metres(result)
    doubts = hardly_known_notes(result) if doubt is None else (doubt,)
    result, unknown = without_unknown_std(result, precision=pinned.precision)
    return result, (*pinned.notes, *doubts, *unknown), doubt if has_metres and result.depth_m is None else None


def _focus_numbers(focus: Focus, result: DepthResult) -> dict[str, float]:
    """Focus of the bokeh in numbers; metres only where they are known."""
    numbers = {"focus_px": focus.disparity_px, "focus_x_px": float(focus.x_px), "focus_y_px": float(focus.y_px)}
    maps = {"focus_m": result.depth_m, "focus_std_m": result.depth_std_m}
    metres = {name: float(m[focus.y_px, focus.x_px]) for name, m in maps.items() if m is not None}
    return numbers | {name: value for name, value in metres.items() if math.isfinite(value)}


def on_photo(working: DisparityMap, photo: FloatMap) -> DisparityMap:
    """Bring a map to the photo's size, and its edges to the photo's edges.

    Args:
        working: of the size the views were matched in.
        photo: (H, W, 3) the ref photo, RGB in [0, 1].

    Returns:
        (H, W) map; disparities are scaled to the photo's px.
    """
    wh = (photo.shape[1], photo.shape[0])
    disparity_px, confidence, valid = working.disparity_px, working.confidence, working.valid
    if disparity_px.shape != photo.shape[:2]:
        disparity_px = resize_disparity(disparity_px, wh=wh)
        # Of the same working pixel as the disparity.
        confidence = np.asarray(cv2.resize(confidence, wh, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.float32)
        valid = cv2.resize(valid.astype(np.uint8), wh, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    followed_px = follow_edges(disparity_px, photo, confidence=confidence, valid=valid)
    return DisparityMap(followed_px, confidence, valid)
