"""EXIF of board photos, read before any of them is decoded: which lens took it, and how the phone was held.

A rig is of two lenses, in the frame of photos that are all held alike. Near and in dim light phones give an enlarged
piece of the wide photo as tele: such photos are set aside. Photos held otherwise than most are turned as their EXIF
orientation says, which is exact.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from telewide.boards.shots import BoardShot
from telewide.capture.exif import UPRIGHT_DEG, PhotoFacts, read_photo_facts
from telewide.capture.lenses import Lens, find_lenses, lens_of, why_cropped
from telewide.errors import InputError, TelewideError

# Of tele's photo and of wide's; None where there is none.
_Held = tuple[int | None, int | None]


def with_checked_facts(shots: Sequence[BoardShot]) -> tuple[BoardShot, ...]:
    """Set photos aside that another lens took, and say by how much the others are to be turned.

    Args:
        shots: as they lie in their folder.

    Returns:
        The same shots, without the photos set aside, which are noted; photos without EXIF stay.

    Raises:
        InputError: no photo of tele, or of wide, is left.
    """
    paths = [path for shot in shots for path in (shot.tele_path, shot.wide_path) if path is not None]
    facts = {path: _facts(path) for path in paths}
    left = tuple(_of_two_lenses(shots, facts))
    for view in ("tele", "wide"):
        n_before = sum(_path(shot, view) is not None for shot in shots)
        if n_before and all(_path(shot, view) is None for shot in left):
            first = next(note for shot in left for note in shot.notes if note.startswith(f"{view}: "))
            raise InputError(
                f"none of the {n_before} {view} photos was taken with the {view} lens; {first}",
                hint="step back or give more light, so that the phone uses its tele lens",
            )
    return _with_turns(left, facts)


def _path(shot: BoardShot, view: str) -> Path | None:
    return shot.tele_path if view == "tele" else shot.wide_path


def _of_two_lenses(shots: Sequence[BoardShot], facts: Mapping[Path, PhotoFacts]) -> Iterator[BoardShot]:
    """Yield the shots without photos of another lens than the others of their folder, and without digital crops."""
    lenses = find_lenses(facts.values())
    taken_by = {path: lens_of(photo, lenses) for path, photo in facts.items()}
    wide = _commonest([taken_by[shot.wide_path] for shot in shots if shot.wide_path])
    tele = _commonest([lens for shot in shots if shot.tele_path and (lens := taken_by[shot.tele_path]) != wide]) or wide
    for shot in shots:
        notes = {
            view: f"{view}: {path} is left out, {why}"
            for view, own in (("tele", tele), ("wide", wide))
            if (path := _path(shot, view)) and (why := _why_not(facts[path], taken_by[path], own))
        }
        yield replace(
            shot,
            tele_path=None if "tele" in notes else shot.tele_path,
            wide_path=None if "wide" in notes else shot.wide_path,
            notes=(*shot.notes, *notes.values()),
        )


def _commonest(lenses: Sequence[Lens | None]) -> Lens | None:
    known = Counter(lens for lens in lenses if lens is not None)
    return known.most_common(1)[0][0] if known else None


def _why_not(photo: PhotoFacts, taken_by: Lens | None, own: Lens | None) -> str | None:
    """Tell why a photo is not of the lens of its folder."""
    if crop := why_cropped(photo, taken_by):
        return crop
    if taken_by is None or own is None or taken_by == own:
        return None
    return f"taken with the {taken_by.focal_words} lens, where the others beside it are of the {own.focal_words} lens"


def _with_turns(shots: Sequence[BoardShot], facts: Mapping[Path, PhotoFacts]) -> tuple[BoardShot, ...]:
    """Note by how much each photo is to be turned to be held as most shots are.

    The two photos of most shots are held alike; where a phone lies flat, it may state another way for each.
    """
    held = {shot.name: _held_deg(shot, facts) for shot in shots}
    joint = Counter(both for both in held.values() if None not in both)
    most = joint.most_common(1)[0][0] if joint else (_most(held.values(), 0), _most(held.values(), 1))

    def turn_deg(shot: BoardShot, lens: int) -> int:
        own_deg, most_deg = held[shot.name][lens], most[lens]
        return 0 if own_deg is None or most_deg is None else (most_deg - own_deg) % 360

    return tuple(replace(shot, tele_turn_deg=turn_deg(shot, 0), wide_turn_deg=turn_deg(shot, 1)) for shot in shots)


def _held_deg(shot: BoardShot, facts: Mapping[Path, PhotoFacts]) -> _Held:
    tele, wide = (
        None if path is None else UPRIGHT_DEG.get(facts[path].orientation) for path in (shot.tele_path, shot.wide_path)
    )
    return tele, wide


def _most(held: Iterable[_Held], lens: int) -> int | None:
    known = Counter(both[lens] for both in held if both[lens] is not None)
    return known.most_common(1)[0][0] if known else None


def _facts(path: Path) -> PhotoFacts:
    try:
        return read_photo_facts(path)
    except TelewideError:  # looking for the board says so in its own words
        return PhotoFacts("unknown")
