"""Which photos of a camera roll show one scene through tele and wide.

Photos are told apart by maker, model and FocalLength; of the two lenses that make the most pairs, each photo goes with
the photo nearest in time, if that one's nearest is it. Every other photo gets a reason.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from telewide.capture.exif import PhotoFacts, seconds_between
from telewide.capture.lenses import Lens, find_lenses, lens_of, why_cropped

_SAME_CHOICE = 0.05


@dataclass(frozen=True)
class RollPhoto:
    """A photo of a camera roll.

    Attributes:
        path: the file; the RAW, where there are twins.
        facts: what it states; what a RAW leaves out is taken from its twin.
        twin: the JPEG or HEIC that the phone wrote beside the RAW.
    """

    path: Path
    facts: PhotoFacts
    twin: RollPhoto | None = None


@dataclass(frozen=True)
class RollPair:
    """Two photos that belong together.

    Attributes:
        tele: of the lens with the smaller field of view.
        wide: of the other one.
    """

    tele: RollPhoto
    wide: RollPhoto

    @property
    def seconds_apart(self) -> float:
        """How long after tele wide was taken, s; negative where it came first."""
        tele, wide = self.tele.facts.taken, self.wide.facts.taken
        return seconds_between(tele, wide) if tele and wide else math.nan

    @property
    def ratio(self) -> float | None:
        """Of the 35 mm equivalents, tele over wide: about the asymmetry."""
        tele_mm, wide_mm = self.tele.facts.f35_mm, self.wide.facts.f35_mm
        return tele_mm / wide_mm if tele_mm and wide_mm else None

    @property
    def notes(self) -> tuple[str, ...]:
        """What its owner should know of it."""
        tele, wide = self.tele.facts, self.wide.facts
        is_turned = tele.hw and wide.hw and (tele.hw[0] > tele.hw[1]) != (wide.hw[0] > wide.hw[1])
        notes = ["one is upright, the other lies on its side"] if is_turned else []
        if (tele.kind == "raw") != (wide.kind == "raw"):
            notes.append("one is RAW, the other is not: their lens distortion differs")
        return tuple(notes)


@dataclass(frozen=True)
class Unpaired:
    """A photo without partner.

    Attributes:
        photo: which.
        reason: why.
    """

    photo: RollPhoto
    reason: str


@dataclass(frozen=True)
class _Series:
    """Photos of one lens by name, and when each was taken, s."""

    photos: tuple[RollPhoto, ...]
    seconds: NDArray[np.float64]


@dataclass(frozen=True)
class LensChoice:
    """Which lenses to pair; None leaves it to the photos.

    Attributes:
        tele_mm: FocalLength of tele.
        wide_mm: FocalLength of wide.
        max_seconds: photos farther apart are no pair.
    """

    tele_mm: float | None = None
    wide_mm: float | None = None
    max_seconds: float = 10.0


def pair_photos(
    photos: Sequence[RollPhoto], *, choice: LensChoice
) -> tuple[tuple[RollPair, ...], tuple[Unpaired, ...]]:
    """Pair the photos of a camera roll.

    Args:
        photos: of any cameras and lenses.
        choice: which lenses, and how far apart in time.

    Returns:
        The pairs in the order of time, and the photos without partner by name.
    """
    lenses = find_lenses(photo.facts for photo in photos)
    usable: dict[str, list[tuple[RollPhoto, Lens]]] = defaultdict(list)
    pairs: list[RollPair] = []
    unpaired: list[Unpaired] = []
    for photo in photos:
        lens = lens_of(photo.facts, lenses)
        reason = _why_unusable(photo.facts, lens)
        if lens is None or reason is not None:
            unpaired.append(Unpaired(photo, reason or ""))
        else:
            usable[photo.facts.camera].append((photo, lens))
    for members in usable.values():
        found, left = _pair_one_camera(members, choice)
        pairs += found
        unpaired += left
    pairs.sort(key=lambda pair: (str(pair.tele.facts.taken), pair.tele.path))
    return tuple(pairs), tuple(sorted(unpaired, key=lambda left: left.photo.path))


def _why_unusable(facts: PhotoFacts, lens: Lens | None) -> str | None:
    if facts.focal_length_mm is None:
        return "states no focal length: was its EXIF removed?"
    if facts.taken is None:
        return "states no time"
    return why_cropped(facts, lens)


def _pair_one_camera(
    members: Sequence[tuple[RollPhoto, Lens]], choice: LensChoice
) -> tuple[list[RollPair], list[Unpaired]]:
    by_lens = _series_by_lens(members)
    lenses = _choose_lenses(by_lens, choice)
    if lenses is None:
        reason = _why_no_lenses(list(by_lens), choice)
        return [], [Unpaired(photo, reason) for photo, _ in members]
    wide, tele = lenses
    pairs = [
        _alike(RollPair(by_lens[tele].photos[i], by_lens[wide].photos[j]))
        for i, j in _mutual_nearest(by_lens[tele], by_lens[wide], choice.max_seconds)
    ]
    left = list(_reasons(by_lens[tele], by_lens[wide], choice.max_seconds))
    left += _reasons(by_lens[wide], by_lens[tele], choice.max_seconds)
    told = f"pairs are made of {wide.focal_length_mm:g} and {tele.focal_length_mm:g} mm"
    for lens in by_lens.keys() - {wide, tele}:
        reason = f"taken with the {lens.focal_length_mm:g} mm lens; {told}"
        left += [Unpaired(photo, reason) for photo in by_lens[lens].photos]
    return pairs, left


def _series_by_lens(members: Sequence[tuple[RollPhoto, Lens]]) -> dict[Lens, _Series]:
    """Sort the photos of one camera by lens, and by name; time zones count where all photos have one."""
    has_zones = all(photo.facts.taken is not None and photo.facts.taken.tzinfo for photo, _ in members)
    groups: dict[Lens, list[tuple[Path, float, RollPhoto]]] = defaultdict(list)
    for photo, lens in members:
        taken = photo.facts.taken or datetime.min
        seconds = (taken if has_zones else taken.replace(tzinfo=UTC)).timestamp()
        groups[lens].append((photo.path, seconds, photo))
    series = {}
    for lens, group in groups.items():
        group.sort(key=lambda entry: entry[0])
        series[lens] = _Series(tuple(entry[2] for entry in group), np.array([entry[1] for entry in group]))
    return series


def _choose_lenses(by_lens: dict[Lens, _Series], choice: LensChoice) -> tuple[Lens, Lens] | None:
    """Return wide and tele: as asked for, or those that make the most pairs, then those with the longest lenses."""
    ordered = sorted(by_lens, key=lambda lens: (lens.f35_mm or 0.0, lens.focal_length_mm))
    candidates = [
        (wide, tele)
        for wide, tele in combinations(ordered, 2)
        if _is_asked_for(tele, choice.tele_mm) and _is_asked_for(wide, choice.wide_mm)
    ]
    counts = {pair: len(_mutual_nearest(by_lens[pair[1]], by_lens[pair[0]], choice.max_seconds)) for pair in candidates}
    return max(candidates, key=lambda pair: (counts[pair], *(ordered.index(lens) for lens in pair[::-1])), default=None)


def _is_asked_for(lens: Lens, asked_focal_mm: float | None) -> bool:
    return asked_focal_mm is None or abs(lens.focal_length_mm - asked_focal_mm) <= _SAME_CHOICE * asked_focal_mm


def _why_no_lenses(lenses: Sequence[Lens], choice: LensChoice) -> str:
    found = " and ".join(f"{lens.focal_length_mm:g} mm" for lens in lenses)
    if len(lenses) > 1:
        asked = " and ".join(f"{asked:g} mm" for asked in (choice.wide_mm, choice.tele_mm) if asked is not None)
        return f"the lenses asked for, {asked}, are not both there: {found}"
    return f"its camera's photos here are all from one lens, {found}"


def _mutual_nearest(tele: _Series, wide: _Series, max_seconds: float) -> list[tuple[int, int]]:
    """Return which photo of tele goes with which of wide."""
    forth, back = _nearest(tele, wide), _nearest(wide, tele)
    apart = np.abs(tele.seconds - wide.seconds[forth])
    return [(i, int(j)) for i, j in enumerate(forth) if back[j] == i and apart[i] <= max_seconds]


def _reasons(own: _Series, others: _Series, max_seconds: float) -> Iterator[Unpaired]:
    """Say why photos have no partner among the others."""
    forth, back = _nearest(own, others), _nearest(others, own)
    for i, (photo, j) in enumerate(zip(own.photos, forth, strict=True)):
        apart, name = abs(own.seconds[i] - others.seconds[j]), others.photos[j].path.name
        if apart > max_seconds:
            nearest = f"the nearest photo of the other lens, {name}, is {apart:.1f} s away"
            yield Unpaired(photo, f"{nearest}; {max_seconds:g} s at most are allowed")
        elif back[j] != i:
            yield Unpaired(photo, f"{name} is nearer to {own.photos[back[j]].path.name}")


def _nearest(own: _Series, others: _Series) -> NDArray[np.intp]:
    """Return for each photo the index of the one nearest in time; of equally near ones the first by name."""
    return np.array([np.abs(others.seconds - second).argmin() for second in own.seconds], dtype=np.intp)


def _alike(pair: RollPair) -> RollPair:
    """Take the twin of a RAW whose partner is no RAW."""
    tele, wide = pair.tele, pair.wide
    if (tele.facts.kind == "raw") == (wide.facts.kind == "raw"):
        return pair
    return RollPair(tele.twin or tele, wide.twin or wide)
