"""One capture's depth: matched, brought to the photo's own size and edges, written, and measured; or kept.

Letters: H W image.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from telewide.bokeh.picture import HELD_BACK, BokehOptions
from telewide.capture.carried import read_carried
from telewide.capture.pair import Capture, CaptureFacts, Problem, read_pair, read_truth
from telewide.capture.photo_store import HeldPhoto, PhotoStore
from telewide.capture.pictures import PictureFacts, write_picture
from telewide.cores import return_freed_memory
from telewide.depth.export import ALWAYS, DEFAULT_FORMATS, IN_OWN_COLOURS, WITH_FACTS, file_names, write_depth
from telewide.depth.formats.contents import WrittenDepth
from telewide.depth.formats.numpy_archive import NPZ_NAME, read_result
from telewide.depth.precision_notes import ALL_NEGATIVE
from telewide.depth.result import DepthResult, stood_upright
from telewide.drawing import upright
from telewide.errors import InputError, TelewideError, UsageError, within_memory
from telewide.files import fingerprint, is_file
from telewide.folders import fresh_folder, refuse_links
from telewide.geometry.arrays import FloatMap
from telewide.matching.matcher import Match
from telewide.matching.window import Window, within_width
from telewide.metrics import end_point_error_px, three_pixel_error
from telewide.points.held_out import HeldOut, match_errors_px, summarise_errors
from telewide.records import as_read
from telewide.stages.beyond_frame import BeyondFrame, beyond_frame
from telewide.stages.capture_bokeh import (
    CaptureBokeh,
    bokeh_names,
    bokeh_of_capture,
    has_own_colours,
    no_bokeh_note,
    no_exr_note,
    read_in_own_colours,
    software,
    with_lying_kinds,
)
from telewide.stages.kept_depth import (
    BOKEH_NAMES,
    DEPTH_NAMES,
    KEPT_NAME,
    OF_SET,
    PREVIEW_BOKEH_NAME,
    BokehPart,
    DepthPart,
    KeptDepth,
    former_bokeh,
    former_part,
    listed_files,
    lost_of_former,
    put_in_place,
    read_kept,
    read_kept_depth,
    refuse_foreign_files,
    refuse_results_of_another,
    unstripped_of,
    write_kept,
)
from telewide.stages.photo_depth import ShotGeometry, depth_on_photo


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
        is_depth_kept: whether the depth was there already, and only what is made of it was made.
    """

    name: str
    paths: tuple[Path, ...]
    notes: tuple[str, ...]
    numbers: Mapping[str, float]
    is_kept: bool = False
    withheld: str | None = None
    is_depth_kept: bool = False

    @property
    def shortcomings(self) -> tuple[str, ...]:
        """The notes that tell of less than was asked for, or that near and far may be exchanged."""
        telling = (no_bokeh_note(self.name, ""), no_exr_note(self.name), f"{self.name}: {HELD_BACK}")
        return tuple(
            note
            for note in self.notes
            if note == self.withheld or note.startswith(telling) or ALL_NEGATIVE in note.removeprefix(self.name)
        )


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

    def of_all(self, captures_root: Path, *, elsewhere: str) -> InputError | UsageError:
        """Return the error to raise where no capture of a set is left.

        Args:
            captures_root: folder of the set.
            elsewhere: the option that puts the results elsewhere, for the one that the hint names.
        """
        message = f"{captures_root}: no depth could be computed; {self.name}: {self.error.message}"
        return type(self.error)(message, hint=self.error.hint and self.error.hint.replace("`out`", elsewhere))


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
    formats: tuple[str, ...] | None = None,
    is_stripped: bool = False,
) -> DepthOutcome | DepthFailure:
    """Make depth, and bokeh if asked, of one capture; what lies there already is not made again.

    Args:
        source: the photos as taken.
        held_out: the pair made from them, with the matches to judge by.
        folder: where the files go.
        facts: what the owner states.
        match: makes the disparity.
        window: disparities to search, px.
        bokeh: None for no bokeh picture.
        key: everything the files depend on but the truth, as plain data.
        shot: of a pair that was rectified with a rig; None for photos that were rectified when they came.
        photos: where the tele photo may be kept; None decodes it.
        formats: of the depth files, the npz among them; None for those that lie there, the usual ones where none do.
        is_stripped: whether they are to say nothing of the photo but its colour profile.

    Returns:
        The files, and what was measured; or why there are none: one bad capture does not stop the others.
    """
    photos = photos or PhotoStore(max_bytes=0)
    try:
        refuse_links(folder.parent, folder)
        key = {**key, "truth_sha256": source.truth_path and fingerprint(source.truth_path)}
        if (kept := read_kept(folder, key)) is not None:
            return replace(_outcome(source.name, folder, kept), is_kept=True)
        bokeh = with_lying_kinds(bokeh, folder)
        _refuse_others_files(folder, source, (*file_names(formats or DEFAULT_FORMATS), *bokeh_names(bokeh), KEPT_NAME))
        with within_memory("its depth"):
            found = _kept(folder, source, photos, key=key, turned_deg=0 if shot is not None else facts.rotated_deg)
            found = found or _matched(source, held_out, photos, facts=facts, match=match, window=window, shot=shot)
            picture = found.bokeh(source, bokeh, beyond=beyond_frame(held_out, shot, photos))
        asked = found.asked(source, formats, bokeh_names(bokeh), folder=folder, is_stripped=is_stripped)
        return _put(found, picture, folder, asked=asked, key=key)
    except (InputError, UsageError) as error:
        return DepthFailure(source.name, error)


def _refuse_others_files(folder: Path, source: Capture, names: tuple[str, ...]) -> None:
    refuse_results_of_another(folder, source.tele_path)
    refuse_foreign_files(folder, names)


def _outcome(name: str, folder: Path, made: KeptDepth) -> DepthOutcome:
    paths = tuple(folder / file for file in made.files)
    return DepthOutcome(name, paths, made.notes, numbers=made.numbers, withheld=made.withheld)


@dataclass(frozen=True)
class _Depth:
    """Photo and depth of one capture, upright, and what is told of it; what lies there already of it, or None."""

    held: HeldPhoto
    turned_deg: int
    result: DepthResult
    notes: tuple[str, ...]
    numbers: Mapping[str, float]
    withheld: str | None = None
    lying: KeptDepth | None = None

    def photo(self) -> FloatMap:
        """Make the photo of what is held of it; a while later it may be needed no more."""
        return upright(self.held.pixels(), rotated_deg=self.turned_deg)

    def bokeh(
        self, source: Capture, options: BokehOptions | None, *, beyond: BeyondFrame | None
    ) -> CaptureBokeh | None:
        if options is None:
            return None
        picture = bokeh_of_capture(
            self.photo, self.result, source, options=options, turned_deg=self.turned_deg, beyond=beyond
        )
        return_freed_memory()
        return picture

    def asked(
        self,
        source: Capture,
        formats: tuple[str, ...] | None,
        pictures: tuple[str, ...],
        *,
        folder: Path,
        is_stripped: bool,
    ) -> _Asked:
        """Tell what is asked for; where no format is named, those that lie there, and stripped where they were."""
        former = former_part(folder) if formats is None else None
        if former is not None:
            formats, is_stripped = former.formats, is_stripped or former.is_stripped
        return _Asked(source, self.turned_deg, formats or DEFAULT_FORMATS, pictures, is_stripped=is_stripped)


@dataclass(frozen=True)
class _Asked:
    """Files that are asked for, and the photos they are made of."""

    source: Capture
    turned_deg: int
    formats: tuple[str, ...]
    pictures: tuple[str, ...]
    is_stripped: bool

    def is_lying_there(self, kept: KeptDepth) -> bool:
        """Whether just these files are kept."""
        is_same = self.is_stripped == kept.depth.is_stripped or not WITH_FACTS.intersection(self.formats)
        return is_same and kept.depth.formats == self.formats and kept.is_whole

    def written(self, folder: Path, depth: _Depth, *, formats: tuple[str, ...]) -> WrittenDepth:
        """Write files of some of the formats."""
        facts = own = None
        if WITH_FACTS.intersection(formats):
            carried = read_carried(self.source.tele_path)
            facts = PictureFacts(software(), of_photo=carried, is_stripped=self.is_stripped)
            if IN_OWN_COLOURS.intersection(formats) and has_own_colours(carried):
                own = read_in_own_colours(self.source, turned_deg=self.turned_deg)
        return write_depth(folder, depth.result, image=depth.photo(), formats=formats, facts=facts, own_colours=own)


def _kept(
    folder: Path, source: Capture, photos: PhotoStore, *, key: Mapping[str, object], turned_deg: int
) -> _Depth | None:
    """Take the depth that lies in a folder, where it was made from the same and can be read; a rig turns no photos."""
    lying = read_kept_depth(folder, key)
    if lying is None:
        return None
    try:
        result = read_result(folder / NPZ_NAME, name=source.name)
    except TelewideError:
        return None
    held, of = photos.hold(source.tele_path), lying.depth
    found = _Depth(held, turned_deg, result, of.notes, numbers=of.numbers, withheld=lying.withheld, lying=lying)
    return found if found.photo().shape[:2] == result.disparity.disparity_px.shape else None


def _matched(
    source: Capture,
    held_out: HeldOut,
    photos: PhotoStore,
    *,
    facts: CaptureFacts,
    match: Match,
    window: Window,
    shot: ShotGeometry | None,
) -> _Depth:
    """Match the pair and bring the depth to its photo."""
    begun_s = time.monotonic()
    pair = read_pair(held_out.capture)
    window = within_width(window, pair.tele.shape[1])
    working = match(pair.tele, pair.wide, window=window, valid=pair.valid)
    del pair
    return_freed_memory()
    numbers = {"match_s": time.monotonic() - begun_s}
    held = photos.hold(source.tele_path)
    result, metric_notes, withheld = depth_on_photo(working, held.pixels(), name=source.name, facts=facts, shot=shot)
    numbers |= summarise_errors(match_errors_px(working.disparity_px, held_out))
    errors, unjudged = _errors_by_truth(source, result, is_mirrored=shot is None and facts.wide_side == "left")
    numbers |= errors
    turned_deg, result = result.rotated_deg, stood_upright(result)
    return_freed_memory()
    numbers["total_s"] = time.monotonic() - begun_s
    notes = (*metric_notes, *unjudged)
    return _Depth(held, turned_deg, result, notes, numbers=numbers, withheld=withheld)


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


def _put(
    depth: _Depth,
    bokeh: CaptureBokeh | None,
    folder: Path,
    *,
    asked: _Asked,
    key: Mapping[str, object],
) -> DepthOutcome:
    """Write all files of one capture, which appear together, and tell what is gone."""
    with fresh_folder(folder.parent) as new:
        written = _write_depth(new, depth, former=folder, asked=asked)
        part = DepthPart(
            npz_sha256=fingerprint(new / NPZ_NAME),
            formats=asked.formats,
            is_stripped=asked.is_stripped,
            notes=depth.notes,
            file_notes=written.notes,
            numbers=dict(depth.numbers),
        )
        names = [path.name for path in written.paths]
        # One of a name that is asked for would pass for it; but what cannot be made replaces nothing.
        replaced = () if bokeh is None or bokeh.files is None else asked.pictures
        lying = [name for name in _bokeh_of(folder, new / NPZ_NAME) if name not in replaced]
        bokeh_files = _write_bokeh(new, bokeh, former=folder, taken=lying)
        names += bokeh_files
        unstripped, left = _unstripped(bokeh_files, bokeh, folder, asked=asked)
        notes = (*written.notes, *depth.notes, *(() if bokeh is None else bokeh.notes), *left)
        numbers = {**depth.numbers, **({} if bokeh is None else bokeh.numbers)}
        made = KeptDepth(
            tuple(names),
            notes,
            numbers,
            withheld=depth.withheld,
            depth=part,
            unstripped=unstripped,
            bokeh=_bokeh_part(names, bokeh, former=folder, asked=key.get("bokeh")),
        )
        if depth.lying is not None:  # the depth stays that of the set it was matched with
            key = {**key, OF_SET: depth.lying.of_set}
        write_kept(new, made, key=key, source=asked.source.tele_path)
        told = lost_of_former(folder, names, name=asked.source.name, key=key)
        if lying and bokeh is not None and bokeh.files is None:
            told += (f"{asked.source.name}: {', '.join(lying)}: there as an earlier call made it",)
        put_in_place(new, folder)
    outcome = _outcome(asked.source.name, folder, replace(made, notes=(*made.notes, *told)))
    return replace(outcome, is_depth_kept=depth.lying is not None)


def _write_depth(folder: Path, depth: _Depth, *, former: Path, asked: _Asked) -> WrittenDepth:
    """Write the depth files into a folder; what lies in the former one of this very depth is taken over."""
    lying = depth.lying
    if lying is None:
        return asked.written(folder, depth, formats=asked.formats)
    if asked.is_lying_there(lying):
        names = [name for name in lying.files if name in DEPTH_NAMES]
        for name in names:
            _take_over(former / name, folder / name)
        return WrittenDepth(tuple(folder / name for name in names), lying.depth.file_notes)
    _take_over(former / NPZ_NAME, folder / NPZ_NAME)
    written = asked.written(folder, depth, formats=tuple(name for name in asked.formats if name != ALWAYS))
    return WrittenDepth((folder / NPZ_NAME, *written.paths), written.notes)


def _write_bokeh(folder: Path, bokeh: CaptureBokeh | None, *, former: Path, taken: list[str]) -> list[str]:
    """Write the bokeh into a folder, and name its files; earlier ones of the same depth stay until others are made."""
    files = None if bokeh is None else bokeh.files
    new = () if files is None else files.names
    if new in ((), (PREVIEW_BOKEH_NAME,)):
        for name in taken:
            _take_over(former / name, folder / name)
    else:
        taken = []
    if files is not None:
        for name in files.names:
            write_picture(folder / name, files.pixels, facts=files.facts)
    return [*new, *taken]


def _bokeh_part(names: Sequence[str], bokeh: CaptureBokeh | None, *, former: Path, asked: object) -> BokehPart | None:
    """Facts to remember of the bokeh that will lie there: of the one that is made, or of the one that stays."""
    if not set(BOKEH_NAMES).intersection(names):
        return None
    if bokeh is None or bokeh.files is None or bokeh.files.names == (PREVIEW_BOKEH_NAME,):
        return former_bokeh(former)
    return BokehPart(asked=as_read({"bokeh": asked})["bokeh"], notes=bokeh.notes, numbers=bokeh.numbers)


def _unstripped(
    names: list[str], bokeh: CaptureBokeh | None, former: Path, *, asked: _Asked
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Tell which bokeh files say something of the photo, and what to say of those that stayed beside stripped files."""
    files = None if bokeh is None else bokeh.files
    new = frozenset(() if files is None else files.names)
    left = [name for name in names if name not in new and name in unstripped_of(former)]
    is_new_stripped = files is not None and files.facts.is_stripped
    unstripped = tuple(name for name in names if name in left or (name in new and not is_new_stripped))
    if not left or not (asked.is_stripped or is_new_stripped):
        return unstripped, ()
    told = f"{asked.source.name}: made without --strip and still there, with facts of the photo: {', '.join(left)}"
    return unstripped, (f"{told}; --bokeh --strip replaces what was made",)


def _take_over(path: Path, to: Path) -> None:
    """Give a file a second name; a copy where the file system knows none, or the first is a link."""
    if not path.is_symlink():
        with suppress(OSError):
            os.link(path, to)
            return
    shutil.copyfile(path, to)


def _bokeh_of(folder: Path, depth: Path) -> list[str]:
    """Names of the bokeh files there that were made of this very depth."""
    lying = listed_files(folder)
    names = [name for name in (*BOKEH_NAMES, PREVIEW_BOKEH_NAME) if name in lying and is_file(folder / name)]
    former = folder / depth.name
    is_same = bool(names) and depth.name in lying and is_file(former)
    return names if is_same and fingerprint(former) == fingerprint(depth) else []
