"""From a phone's camera roll to a folder of captures.

    CAPTURES/<name>/tele.<suffix>  wide.<suffix>   the photos, byte for byte
    CAPTURES/<name>/pair.json                      where they came from and what they state

<name> is that of the tele photo. A folder appears whole or not at all. What pair.json names is not imported again.
"""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import stat
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from telewide.capture.corrupt import why_corrupt
from telewide.capture.exif import PhotoFacts, read_photo_facts
from telewide.capture.facts import FACTS_FILE
from telewide.capture.formats import PHOTO_SUFFIXES, RAW_SUFFIXES
from telewide.capture.layout import TRUTH
from telewide.capture.lens_choice import ChosenLenses, LensChoice
from telewide.capture.pairing import PairedRoll, RollPair, RollPhoto, Unpaired, pair_photos
from telewide.capture.view_files import VIEWS, visible_entries
from telewide.errors import InputError, TelewideError, UsageError
from telewide.files import is_folder, refuse_other_than_folder, replacing
from telewide.folders import fresh_folder
from telewide.records import Name, Record, read_record, write_record

FORMAT = 1
PAIR_FILE = "pair.json"
# Pixel phones: PXL_1.RAW-01.COVER.jpg is the twin of PXL_1.RAW-02.ORIGINAL.dng.
_TWIN_MARK = re.compile(r"\.RAW-\d+.*$", re.IGNORECASE)
_MAX_DEPTH = 40
_TOO_DEEP = f"the folder lies {_MAX_DEPTH} levels deep; what it holds is not looked at"

# Names that mean something else in a folder of captures.
_TAKEN_NAMES = frozenset({*VIEWS, TRUTH, FACTS_FILE})

# Name of a file, its bytes, when it was taken: what tells a photo that was imported already. Phones count names anew,
# and all RAW photos of a phone have the same number of bytes.
_SourceKey = tuple[str, int, str]
Tick = Callable[[int, int], None]


class BroughtPhoto(Record):
    """Record of one photo: its name now and before, and what it states."""

    file: Name
    source: Name
    bytes: int
    taken: str | None
    image_pipeline: Name | None = None
    focal_length_mm: float | None = None
    f35_mm: float | None = None
    hw: tuple[int, int] | None = None


class ImportRecord(Record):
    """Content of ``pair.json``: the two photos of an imported capture, and the time between them."""

    format: int = FORMAT
    seconds_apart: float
    tele: BroughtPhoto
    wide: BroughtPhoto


@dataclass(frozen=True)
class PlannedPair:
    """A pair to be imported.

    Attributes:
        name: of its folder.
        pair: the photos.
    """

    name: str
    pair: RollPair


@dataclass(frozen=True)
class ImportPlan:
    """Plan of an import.

    Attributes:
        pairs: to be imported.
        unpaired: photos left where they are, and why.
        known: names of captures there already whose photos are in the roll.
        lenses: which lenses were paired, one for every camera with two.
    """

    pairs: tuple[PlannedPair, ...]
    unpaired: tuple[Unpaired, ...]
    known: tuple[str, ...]
    lenses: tuple[ChosenLenses, ...] = ()


def plan_import(dcim: Path, captures: Path, *, choice: LensChoice, tick: Tick | None = None) -> ImportPlan:
    """Look through a camera roll for pairs; nothing is written.

    Args:
        dcim: the camera roll, with any folders in it.
        captures: where captures are or will be.
        choice: which lenses, and how far apart in time.
        tick: called with how many of how many photos have been looked at.

    Returns:
        What to import, and why the rest stays.

    Raises:
        UsageError: there is no such folder, or both are one.
        InputError: there are no photos in it, or the folder of the captures cannot be opened.
    """
    _check_folders(dcim, captures)
    files, unread = _photo_files(dcim, captures)
    photos, corrupt = _read_roll(files, tick)
    lying = visible_entries(captures) if is_folder(captures) else []
    imported = _imported(lying)
    known = {photo.path: name for photo in photos for key in _keys(photo) if (name := imported.get(key))}
    roll = _pair_whole(photos, choice, frozenset(known))
    taken = {*_TAKEN_NAMES, *(entry.name.casefold() for entry in lying)}
    planned = tuple(PlannedPair(_free_name(pair.tele.path, taken), pair) for pair in roll.pairs)
    unpaired = sorted([*roll.unpaired, *unread, *corrupt], key=lambda one: one.photo.path)
    return ImportPlan(planned, tuple(unpaired), tuple(sorted(set(known.values()))), roll.lenses)


def carry_out(plan: ImportPlan, captures: Path, *, is_linked: bool = False, tick: Tick | None = None) -> None:
    """Copy the photos of a plan into capture folders, each of which appears whole or not at all.

    Args:
        plan: from `plan_import`.
        captures: created where it does not exist.
        is_linked: make hard links, which take no space, where the file system can.
        tick: called with how many of how many pairs are there.

    Raises:
        UsageError: the place cannot be written.
        InputError: a photo cannot be read.
    """
    for done, planned in enumerate(plan.pairs, start=1):
        try:
            with fresh_folder(captures) as partial:
                tele, wide = (
                    _bring(photo, partial, view, is_linked=is_linked)
                    for view, photo in (("tele", planned.pair.tele), ("wide", planned.pair.wide))
                )
                apart_s = round(planned.pair.seconds_apart, 3)
                write_record(partial / PAIR_FILE, ImportRecord(seconds_apart=apart_s, tele=tele, wide=wide))
                partial.rename(captures / planned.name)
        except OSError as error:
            raise UsageError(f"{captures / planned.name} cannot be written: {error.strerror or error}") from error
        if tick is not None:
            tick(done, len(plan.pairs))


def is_imported(folder: Path) -> bool:
    """Whether a capture folder was made by an import: its photos are as the phone took them."""
    try:
        read_record(folder / PAIR_FILE, ImportRecord)
    except TelewideError:  # no record, or one that cannot be read
        return False
    return True


def _check_folders(dcim: Path, captures: Path) -> None:
    refuse_other_than_folder(dcim, expected="the folder with the phone's photos")
    if os.path.lexists(captures):
        refuse_other_than_folder(captures, expected="a folder for the captures")
    if os.path.realpath(dcim) == os.path.realpath(captures):
        raise UsageError(f"{dcim} is both where photos come from and where captures go", hint="name two folders")


def _photo_files(dcim: Path, captures: Path) -> tuple[list[Path], list[Unpaired]]:
    """Return the photos below a folder, each once, without hidden ones; and what cannot be looked at."""
    files: dict[str, Path] = {}
    closed: list[Unpaired] = []

    def tell(error: OSError) -> None:
        reason = f"the folder cannot be opened: {error.strerror or error}"
        closed.append(Unpaired(RollPhoto(Path(error.filename), PhotoFacts("unknown")), reason))

    # Unlike Path.resolve, realpath takes a link to itself as it is: reading it says what is wrong.
    entered = {os.path.realpath(captures), os.path.realpath(dcim)}
    for folder, below, names in os.walk(dcim, onerror=tell, followlinks=True):
        found, below[:] = sorted(below), []
        if len(Path(folder).parts) - len(dcim.parts) >= _MAX_DEPTH:
            closed.append(Unpaired(RollPhoto(Path(folder), PhotoFacts("unknown")), _TOO_DEEP))
            continue
        for name in found:
            place = os.path.realpath(Path(folder) / name)
            if not name.startswith(".") and place not in entered:
                entered.add(place)
                below.append(name)
        for name in sorted(filter(_is_photo_name, names)):
            if "\n" in name:  # every message of it would look like several
                shown = Path(folder) / name.replace("\n", "\\n")
                closed.append(
                    Unpaired(RollPhoto(shown, PhotoFacts("unknown")), "its name holds a line break; rename it")
                )
                continue
            files.setdefault(os.path.realpath(Path(folder) / name), Path(folder) / name)
    if not files:
        told = "".join(f"; {one.photo.path}: {one.reason}" for one in closed)
        raise InputError(f"{dcim} holds no photos{told}", hint="name the folder of the camera roll, often called DCIM")
    return list(files.values()), closed


def _is_photo_name(name: str) -> bool:
    return not name.startswith(".") and Path(name).suffix.lower() in PHOTO_SUFFIXES


def _read_roll(files: Sequence[Path], tick: Tick | None) -> tuple[list[RollPhoto], list[Unpaired]]:
    """Read what all photos state, and put RAW and twin together."""
    photos, unread = [], []
    for done, path in enumerate(files, start=1):
        try:
            photo = RollPhoto(path, read_photo_facts(path))
            if photo.facts.hw is None and (reason := why_corrupt(path, photo.facts)):
                unread.append(Unpaired(photo, reason))
            else:
                photos.append(photo)
        except TelewideError as error:
            reason = error.message.removeprefix(f"{path} ")
            told = f"{reason} ({error.hint})" if error.hint else reason
            unread.append(Unpaired(RollPhoto(path, PhotoFacts("unknown")), told))
        if tick is not None:
            tick(done, len(files))
    return list(_joined_twins(photos)), unread


def _pair_whole(photos: Sequence[RollPhoto], choice: LensChoice, known: frozenset[Path]) -> PairedRoll:
    """Pair photos whose files are whole; a corrupt one leaves its place to the next."""
    whole: set[Path] = set()
    corrupt: list[Unpaired] = []
    candidates = list(photos)
    while True:
        roll = pair_photos(candidates, choice=choice, known=known)
        chosen = [photo for pair in roll.pairs for photo in (pair.tele, pair.wide) if photo.path not in whole]
        found = [Unpaired(one, reason) for one in chosen if (reason := why_corrupt(one.path, one.facts))]
        if not found:
            return dataclasses.replace(roll, unpaired=(*roll.unpaired, *corrupt))
        corrupt += found
        whole |= {one.path for one in chosen}
        lost = {one.photo.path for one in corrupt}
        candidates = [photo for photo in candidates if photo.path not in lost]


def _joined_twins(photos: Iterable[RollPhoto]) -> Iterator[RollPhoto]:
    by_stem: dict[tuple[Path, str], list[RollPhoto]] = defaultdict(list)
    for photo in photos:
        by_stem[photo.path.parent, _TWIN_MARK.sub("", photo.path.stem).casefold()].append(photo)
    for group in by_stem.values():
        raws = [photo for photo in group if photo.path.suffix.lower() in RAW_SUFFIXES]
        others = [photo for photo in group if photo not in raws]
        if len(raws) == 1 and len(others) == 1:
            raw, twin = raws[0], others[0]
            yield RollPhoto(raw.path, _completed(raw.facts, twin.facts), twin)
        else:
            yield from group


def _completed(facts: PhotoFacts, other: PhotoFacts) -> PhotoFacts:
    """Fill in from the twin what a RAW leaves out; names of the camera come from one of the two."""
    names = ("focal_length_mm", "f35_mm", "taken", "taken_step_s", "digital_zoom_ratio", "subject_distance_m")
    missing = [name for name in names if getattr(facts, name) is None]
    if facts.make is None or facts.model is None:
        missing += ["make", "model"]
    return dataclasses.replace(facts, **{name: getattr(other, name) for name in missing})


def _keys(photo: RollPhoto) -> list[_SourceKey]:
    both = (photo, photo.twin) if photo.twin else (photo,)
    return [(one.path.name, one.path.stat().st_size, _when(one.facts)) for one in both]


def _when(facts: PhotoFacts) -> str:
    return facts.taken.isoformat() if facts.taken else ""


def _imported(folders: Iterable[Path]) -> dict[_SourceKey, str]:
    """Return the photos that lie in capture folders already, by where they came from."""
    found: dict[_SourceKey, str] = {}
    for folder in folders:
        try:
            record = read_record(folder / PAIR_FILE, ImportRecord)
        except TelewideError:  # none, or not of this kind: its photos come again
            continue
        for photo in (record.tele, record.wide):
            found[photo.source, photo.bytes, photo.taken or ""] = folder.name
    return found


def _free_name(tele: Path, taken: set[str]) -> str:
    stem = _TWIN_MARK.sub("", tele.stem)
    name, number = stem, 2
    while name.casefold() in taken:
        name, number = f"{stem}-{number}", number + 1
    taken.add(name.casefold())
    return name


def _bring(photo: RollPhoto, folder: Path, view: str, *, is_linked: bool) -> BroughtPhoto:
    """Bring one photo into a folder and return its record."""
    source, name = photo.path, f"{view}{photo.path.suffix.lower()}"
    if not os.access(source, os.R_OK):
        raise InputError(f"{source} cannot be read")
    with replacing(folder / name) as temporary:
        if not (is_linked and _has_linked(source, temporary)):
            shutil.copy2(source, temporary)
            temporary.chmod(temporary.stat().st_mode | stat.S_IWUSR)  # the copy is the user's, even of a locked photo
    facts = photo.facts
    return BroughtPhoto(
        file=name,
        source=source.name,
        bytes=source.stat().st_size,
        taken=_when(facts) or None,
        image_pipeline=facts.pipeline,
        focal_length_mm=facts.focal_length_mm,
        f35_mm=facts.f35_mm,
        hw=facts.hw,
    )


def _has_linked(source: Path, link: Path) -> bool:
    try:
        os.link(os.path.realpath(source), link)  # the photo itself where the roll holds a symbolic link
    except OSError:  # another file system, or one without links
        return False
    return True
