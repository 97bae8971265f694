"""Record of what was made of one capture, beside its files, so that the same is not computed twice: ``depth.json``."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import Field, JsonValue

from telewide.depth.export import FORMATS, file_names
from telewide.depth.formats.numpy_archive import NPZ_NAME
from telewide.errors import TelewideError, UsageError
from telewide.files import changing, fingerprint, is_file, is_folder, temporary_name
from telewide.records import Figure, Line, Name, Record, as_read, checked, read_json, read_record, write_record
from telewide.text import shortened

FORMAT = 14
KEPT_NAME = "depth.json"
BOKEH_NAME = "bokeh.jpg"
EXR_BOKEH_NAME = "bokeh.exr"
BOKEH_NAMES = (BOKEH_NAME, "bokeh.tif", EXR_BOKEH_NAME)
PREVIEW_BOKEH_NAME = "bokeh_preview.jpg"
DEPTH_NAMES = file_names(FORMATS)
FILE_NAMES = (*DEPTH_NAMES, *BOKEH_NAMES, PREVIEW_BOKEH_NAME)
"""Of all files of one capture; some are left out where they cannot be made."""
MADE_OF_DEPTH = ("bokeh", "formats", "is_stripped")
"""Keys of what is made of a depth that is known; the depth itself does not depend on them."""
OF_SET = "of_set"
"""Key of what was measured on all captures of a call: their names, and what they gave; see :func:`of_set`."""


class DepthPart(Record):
    """Of the results of one capture, what holds whatever is made of its depth.

    Attributes:
        npz_sha256: fingerprint of ``depth.npz``, from which the depth is taken again; None where it was not written.
        formats: of the depth files that lie there.
        is_stripped: whether they say nothing of the photo.
        notes: on the depth, its metres for instance.
        file_notes: on the depth files that lie there.
        numbers: measured of the depth.
    """

    npz_sha256: str | None = None
    formats: tuple[str, ...] = ()
    is_stripped: bool = False
    notes: tuple[Line, ...] = ()
    file_notes: tuple[Line, ...] = ()
    numbers: dict[str, Figure] = Field(default_factory=dict)


class BokehPart(Record):
    """Of the results of one capture, what holds of the bokeh that lies there, whatever previews are made beside it.

    Attributes:
        asked: its options.
        notes: what it is focused on.
        numbers: of its focus.
    """

    asked: JsonValue = None
    notes: tuple[Line, ...] = ()
    numbers: dict[str, Figure] = Field(default_factory=dict)


@dataclass(frozen=True)
class KeptDepth:
    """Results of one capture.

    Attributes:
        files: names of the files in its folder.
        notes: what was left out, and why.
        numbers: what was measured; NaN where it could not be.
        withheld: what is not among the files because it would mean nothing, and why; None where all is there.
        depth: what of these is of the depth alone.
        is_whole: whether all the files are there as they were written.
        of_set: the captures that were matched together with this one, and what they gave, as the key holds it.
        unstripped: names of the bokeh files that say of the photo what its EXIF says.
        bokeh: what of these is of the bokeh that lies there; None where none does.
    """

    files: tuple[str, ...]
    notes: tuple[str, ...]
    numbers: Mapping[str, float]
    withheld: str | None = None
    depth: DepthPart = field(default_factory=DepthPart)
    is_whole: bool = True
    of_set: JsonValue = None
    unstripped: tuple[str, ...] = ()
    bokeh: BokehPart | None = None


class KeptRecord(Record):
    """Content of ``depth.json``; what is missing in it was not written.

    Attributes:
        format: version of the file.
        key: everything the files depend on.
        source: the tele photo.
        files_bytes: sizes of the files by their names; None while they are put in place.
        files: the names alone, as older versions wrote them.
        notes: what was left out, and why.
        numbers: what was measured.
        withheld: what is not among the files, and why.
        depth: what of these is of the depth alone.
        unstripped: names of the bokeh files that say of the photo what its EXIF says.
        bokeh: what of these is of the bokeh that lies there.
    """

    format: int = 0
    key: dict[str, JsonValue] = Field(default_factory=dict)
    source: Name | None = None
    files_bytes: dict[str, int | None] = Field(default_factory=dict)
    files: tuple[str, ...] = Field(default=(), exclude=True)
    notes: tuple[Line, ...] = ()
    numbers: dict[str, Figure] = Field(default_factory=dict)
    withheld: Line | None = None
    depth: DepthPart = Field(default_factory=DepthPart)
    unstripped: tuple[str, ...] = ()
    bokeh: BokehPart | None = None

    @property
    def shown_notes(self) -> tuple[str, ...]:
        """Notes on the depth and the bokeh that lie there; of a preview only where it is alone."""
        if self.bokeh is None:
            return self.notes
        asked = self.key.get("bokeh")
        is_preview = isinstance(asked, dict) and asked.get("is_preview") is True
        of_call = (*self.depth.file_notes, *self.depth.notes) if is_preview else self.notes
        return tuple(dict.fromkeys((*of_call, *self.bokeh.notes)))

    @property
    def shown_numbers(self) -> dict[str, float]:
        """Numbers likewise."""
        return self.numbers if self.bokeh is None else {**self.depth.numbers, **self.bokeh.numbers}


class SetFacts(Record):
    """Facts for a capture's depth that come from all captures of its call.

    Attributes:
        captures: names of those captures.
        facts: what they gave.
    """

    captures: frozenset[str]
    facts: dict[str, JsonValue]


def of_set(captures: Collection[str], facts: Mapping[str, object]) -> dict[str, object]:
    """Return facts that come from a set of captures, for the key `OF_SET`.

    They are compared by a call on all of those captures, with others or without. A call that leaves some of them out
    takes depth as it was made with all of them: the window, for instance, still holds what the fewer need.

    Args:
        captures: names of all that the facts come from.
        facts: as plain data.
    """
    return {"captures": sorted(captures), "facts": facts}


def read_kept(folder: Path, key: Mapping[str, object]) -> KeptDepth | None:
    """Read what lies in a folder, if it was made from the same and is still whole.

    Args:
        folder: of one capture.
        key: everything the files depend on, as plain data.

    Returns:
        What was made, or None where it has to be made (again).
    """
    record = _record_in(folder)
    if record is None or record.format != FORMAT or not _is_same(record.key, as_read(key)):
        return None
    return _as_kept(record) if _is_whole(folder, record) else None


def former_part(folder: Path) -> DepthPart | None:
    """Read what a former call wrote of the depth in a folder, whatever it was made from; None where nothing tells.

    Args:
        folder: of one capture.
    """
    record = _record_in(folder)
    return None if record is None else record.depth


def lost_of_former(folder: Path, names: Collection[str], *, name: str, key: Mapping[str, object]) -> tuple[str, ...]:
    """Say what a former call left that what is about to be put in its place does without.

    Args:
        folder: of one capture.
        names: of the files that are put there.
        name: of the capture.
        key: everything these depend on.

    Returns:
        A sentence on files, and one on a distance that was known.
    """
    record = _record_in(folder)
    if record is None:
        return ()
    kept = {*names, PREVIEW_BOKEH_NAME}  # which a bokeh is meant to replace
    lost = [file for file in record.files_bytes if file not in kept and is_file(folder / file)]
    told = [f"{name}: removed, for this call makes none: {', '.join(lost)}"] if lost else []
    known = record.key.get("known")
    if isinstance(known, dict) and not known.get("is_focus") and key.get("known") is None:
        parts = [known.get(part) for part in ("x_px", "y_px", "distance_m")]
        point = ",".join(f"{part:g}" for part in parts if isinstance(part, int | float))
        told.append(f"{name}: what lay here was pinned by --distance {point}; without it metres are the rig's alone")
    return tuple(told)


def read_kept_depth(folder: Path, key: Mapping[str, object]) -> KeptDepth | None:
    """Read what lies in a folder, if its depth was made from the same, whatever else was made of it.

    Args:
        folder: of one capture.
        key: everything the files depend on, as plain data.

    Returns:
        What was made, with ``depth.npz`` as it was written; None where there is no such depth.
    """
    try:
        record = read_record(folder / KEPT_NAME, KeptRecord)
        sha256 = record.depth.npz_sha256
        is_same = _is_same(record.key, as_read(key), apart_from=MADE_OF_DEPTH)
        if record.format != FORMAT or not is_same or sha256 is None:
            return None
        if not is_file(folder / NPZ_NAME) or fingerprint(folder / NPZ_NAME) != sha256:
            return None
    except TelewideError:  # not there, or corrupt: it is made again
        return None
    return replace(_as_kept(record), is_whole=_is_whole(folder, record))


def _is_same(
    kept: Mapping[str, JsonValue], asked: Mapping[str, JsonValue], *, apart_from: Collection[str] = ()
) -> bool:
    left_out = {*apart_from, OF_SET}
    own, own_asked = ({name: key[name] for name in key.keys() - left_out} for key in (kept, asked))
    return own == own_asked and _is_of_same_set(kept.get(OF_SET), asked.get(OF_SET))


def _is_of_same_set(kept: JsonValue, asked: JsonValue) -> bool:
    """Whether the facts of a set are as they were, or the call is on a part of that set."""
    if kept is None or asked is None:
        return kept == asked
    try:
        former, now = (checked(value, SetFacts) for value in (kept, asked))
    except ValueError:
        return False
    return not former.captures <= now.captures or former.facts == now.facts


def _as_kept(record: KeptRecord) -> KeptDepth:
    files = tuple(record.files_bytes)
    return KeptDepth(
        files,
        record.notes,
        record.numbers,
        withheld=record.withheld,
        depth=record.depth,
        of_set=record.key.get(OF_SET),
        unstripped=record.unstripped,
        bokeh=record.bokeh,
    )


def former_bokeh(folder: Path) -> BokehPart | None:
    """Read what a former call wrote of its bokeh in a folder; None where nothing tells.

    Args:
        folder: of one capture.
    """
    record = _record_in(folder)
    return None if record is None else record.bokeh


def read_lying(folder: Path) -> KeptRecord | None:
    """Read the record of the depth in a folder, whatever it was made from; None where it is not whole.

    Args:
        folder: of one capture.
    """
    record = _record_in(folder)
    if record is None:
        return None
    has_depth = record.format == FORMAT and NPZ_NAME in record.files_bytes
    return record if has_depth and _is_whole(folder, record) else None


def unstripped_of(folder: Path) -> frozenset[str]:
    """Names of the bokeh files in a folder that were made without ``--strip``; empty where nothing tells.

    Args:
        folder: of one capture.
    """
    record = _record_in(folder)
    return frozenset() if record is None else frozenset(record.unstripped)


def matcher_of(folder: Path) -> str | None:
    """Name of the matcher that made the depth in a folder; None where none lies there.

    Args:
        folder: of one capture.
    """
    record = _record_in(folder)
    if record is None:
        return None
    is_there = record.format == FORMAT and record.depth.npz_sha256 is not None and is_file(folder / NPZ_NAME)
    name = record.key.get("matcher")
    return name if is_there and isinstance(name, str) else None


def refuse_foreign_files(folder: Path, names: Collection[str]) -> None:
    """Refuse to replace files that telewide did not write.

    Args:
        folder: of one capture.
        names: of the files that are to be written there.

    Raises:
        UsageError: one of them lies there, and no ``depth.json`` beside it lists it.
    """
    listed = listed_files(folder)
    foreign = [name for name in names if name not in listed and os.path.lexists(folder / name)]
    if foreign:
        raise UsageError(
            f"{folder} holds {', '.join(foreign)}, which no {KEPT_NAME} there lists as made by telewide",
            hint="move what is yours, or name another folder with `out`",
        )


def refuse_results_of_another(folder: Path, source: Path) -> None:
    """Refuse to replace what was made of another photo that is still there: two sets may name their captures alike.

    Args:
        folder: of one capture.
        source: its tele photo.

    Raises:
        UsageError: what lies there was made of another photo.
    """
    try:
        made_of = read_record(folder / KEPT_NAME, KeptRecord).source
    except TelewideError:
        return
    if made_of is not None and is_file(Path(made_of)) and not Path(made_of).samefile(source):
        raise UsageError(
            f"{folder} holds the depth of another photo, {shortened(made_of, most=300)}",
            hint="name another folder with `out`",
        )


def listed_files(folder: Path) -> frozenset[str]:
    """Names of the files in a folder that telewide wrote, ``depth.json`` among them; empty where nothing tells.

    A ``depth.json`` that cannot be read was cut off, and stands for all that is ever written beside it. One that names
    something else than that, or a folder, was not written by telewide.
    """
    path = folder / KEPT_NAME
    if not is_file(path):
        return frozenset()
    listed: Collection[str] = FILE_NAMES
    with suppress(TelewideError):
        content = read_json(path)
        try:
            record = checked(content, KeptRecord)
        except ValueError:  # somebody else's
            return frozenset()
        listed = record.files_bytes or record.files
        if not listed:
            return frozenset()
    return frozenset((*(name for name in FILE_NAMES if name in listed and not is_folder(folder / name)), KEPT_NAME))


def put_in_place(staged: Path, folder: Path) -> None:
    """Let all files of a capture appear together, in the place of those listed there; what else lies there stays.

    Where nothing but listed files lies there, one folder is renamed over the other. Beside a file of somebody else's
    the new ones are renamed one by one, and until all are, ``depth.json`` says that they are not whole.

    Args:
        staged: folder with the new files, ``depth.json`` among them, beside the other one.
        folder: of the capture; need not be there.

    Raises:
        MissingPartError: the disk is full.
        UsageError: something else lies in that place, or it cannot be written.
    """
    with changing(folder):
        _put_in_place(staged, folder)


def _put_in_place(staged: Path, folder: Path) -> None:
    if not os.path.lexists(folder):
        staged.rename(folder)
        return
    listed = listed_files(folder)
    if {path.name for path in folder.iterdir()} <= listed:
        former = folder.with_name(temporary_name(".former"))
        folder.rename(former)
        try:
            staged.rename(folder)
        except BaseException:
            former.rename(folder)
            raise
        shutil.rmtree(former, ignore_errors=True)
        return
    new = sorted(path.name for path in staged.iterdir() if path.name != KEPT_NAME)
    for name in listed.difference(new, {KEPT_NAME}):
        (folder / name).unlink(missing_ok=True)
    write_record(folder / KEPT_NAME, KeptRecord(format=FORMAT, files_bytes=dict.fromkeys(new)))
    for name in (*new, KEPT_NAME):
        (staged / name).replace(folder / name)


def _is_file_of(folder: Path, name: str, n_bytes: int | None) -> bool:
    path = folder / name
    return Path(name).name == name and is_file(path) and path.stat().st_size == n_bytes


def write_kept(folder: Path, kept: KeptDepth, *, key: Mapping[str, object], source: Path | None = None) -> None:
    """Remember what was made; called when all its files are written.

    Args:
        folder: of one capture.
        kept: what was made.
        key: everything the files depend on, as plain data.
        source: the tele photo.
    """
    record = KeptRecord(
        format=FORMAT,
        key=as_read(key),
        source=None if source is None else str(source.absolute()),
        files_bytes={name: (folder / name).stat().st_size for name in kept.files},
        notes=kept.notes,
        numbers=kept.numbers,
        withheld=kept.withheld,
        depth=kept.depth,
        unstripped=kept.unstripped,
        bokeh=kept.bokeh,
    )
    write_record(folder / KEPT_NAME, record)


def _record_in(folder: Path) -> KeptRecord | None:
    try:
        return read_record(folder / KEPT_NAME, KeptRecord)
    except TelewideError:  # not there, or corrupt: it is made again
        return None


def _is_whole(folder: Path, record: KeptRecord) -> bool:
    return all(_is_file_of(folder, name, n_bytes) for name, n_bytes in record.files_bytes.items())
