"""Pairing of the photos of a camera roll that show one scene through tele and wide.

Photos are told apart by maker, model and FocalLength; of the two lenses chosen, each photo goes with the photo nearest
in time, if that one's nearest is it. Every other photo gets a reason.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from telewide.capture.exif import PhotoFacts
from telewide.capture.lens_choice import ChosenLenses, LensChoice, choose_lenses
from telewide.capture.lenses import Lens, find_lenses, lens_of, why_cropped
from telewide.capture.moments import SAME_S, mutual_nearest, utc_seconds


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
        seconds_apart: how long after tele wide was taken, s; negative where it came first.
    """

    tele: RollPhoto
    wide: RollPhoto
    seconds_apart: float

    @property
    def ratio(self) -> float | None:
        """Of the 35 mm equivalents, tele over wide: about the asymmetry."""
        tele_mm, wide_mm = self.tele.facts.f35_mm, self.wide.facts.f35_mm
        return tele_mm / wide_mm if tele_mm and wide_mm else None

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences its owner should know."""
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
class PairedRoll:
    """Pairs of a camera roll, and the photos left over.

    Attributes:
        pairs: in the order of time.
        unpaired: photos without partner, by name.
        lenses: which lenses were paired, one for every camera with two.
    """

    pairs: tuple[RollPair, ...]
    unpaired: tuple[Unpaired, ...]
    lenses: tuple[ChosenLenses, ...]


@dataclass(frozen=True)
class _Series:
    """Photos of one lens by name, and when each was taken, s."""

    photos: tuple[RollPhoto, ...]
    seconds: NDArray[np.float64]

    def fresh(self, known: frozenset[Path]) -> _Series:
        """Return those that are not known yet."""
        keep = [i for i, photo in enumerate(self.photos) if photo.path not in known]
        return _Series(tuple(self.photos[i] for i in keep), self.seconds[keep])


def pair_photos(photos: Sequence[RollPhoto], *, choice: LensChoice, known: frozenset[Path] = frozenset()) -> PairedRoll:
    """Pair the photos of a camera roll.

    Args:
        photos: of any cameras and lenses.
        choice: which lenses, and how far apart in time.
        known: photos that were paired before: they tell the lenses, and go with no other photo.

    Returns:
        The pairs, and why the other photos have no partner.
    """
    lenses = find_lenses(photo.facts for photo in photos)
    usable: dict[str, list[tuple[RollPhoto, Lens]]] = defaultdict(list)
    pairs: list[RollPair] = []
    unpaired: list[Unpaired] = []
    chosen: list[ChosenLenses] = []
    for photo in photos:
        lens = lens_of(photo.facts, lenses)
        reason = _why_unusable(photo.facts)
        if reason is None and (reason := why_cropped(photo.facts, lens)) is None and lens is not None:
            usable[photo.facts.camera].append((photo, lens))
        elif photo.path not in known:
            unpaired.append(Unpaired(photo, reason or "its lens cannot be told"))
    for members in usable.values():
        found = _pair_one_camera(_series_by_lens(members), choice, known)
        pairs += found.pairs
        unpaired += found.unpaired
        chosen += found.lenses
    pairs.sort(key=lambda pair: (str(pair.tele.facts.taken), pair.tele.path))
    return PairedRoll(tuple(pairs), tuple(sorted(unpaired, key=lambda left: left.photo.path)), tuple(chosen))


def _why_unusable(facts: PhotoFacts) -> str | None:
    if facts.focal_length_mm is None:
        return "states no focal length: was its EXIF removed?"
    return "states no time" if facts.taken is None else None


def _pair_one_camera(by_lens: dict[Lens, _Series], choice: LensChoice, known: frozenset[Path]) -> PairedRoll:
    lenses = choose_lenses({lens: series.seconds for lens, series in by_lens.items()}, choice)
    fresh = {lens: series.fresh(known) for lens, series in by_lens.items()}
    if lenses is None:
        reason = _why_no_lenses(list(by_lens), choice)
        left = [Unpaired(photo, reason) for series in fresh.values() for photo in series.photos]
        return PairedRoll((), tuple(left), ())
    wide, tele = lenses.chosen.wide, lenses.chosen.tele
    partners = mutual_nearest(fresh[tele].seconds, fresh[wide].seconds, max_s=choice.max_seconds)
    pairs = [_pair(fresh[tele], i, fresh[wide], j) for i, j in partners]
    left = list(_reasons(fresh[tele], fresh[wide], dict(partners), choice.max_seconds))
    left += _reasons(fresh[wide], fresh[tele], {j: i for i, j in partners}, choice.max_seconds)
    told = f"pairs are made of {wide.focal_words} and {tele.focal_words}"
    for lens in by_lens.keys() - {wide, tele}:
        reason = f"taken with the {lens.focal_words} lens; {told}"
        left += [Unpaired(photo, reason) for photo in fresh[lens].photos]
    return PairedRoll(tuple(pairs), tuple(left), (lenses,))


def _series_by_lens(members: Sequence[tuple[RollPhoto, Lens]]) -> dict[Lens, _Series]:
    """Sort the photos of one camera by lens, and by name."""
    ordered = sorted(members, key=lambda member: member[0].path)
    seconds = utc_seconds([photo.facts.taken for photo, _ in ordered if photo.facts.taken is not None])
    rows: dict[Lens, list[int]] = defaultdict(list)
    for row, (_, lens) in enumerate(ordered):
        rows[lens].append(row)
    return {lens: _Series(tuple(ordered[row][0] for row in own), seconds[own]) for lens, own in rows.items()}


def _why_no_lenses(lenses: Sequence[Lens], choice: LensChoice) -> str:
    found = " and ".join(lens.focal_words for lens in lenses)
    if len(lenses) > 1:
        asked = " and ".join(f"{asked:g} mm" for asked in (choice.wide_mm, choice.tele_mm) if asked is not None)
        return f"the lenses asked for, {asked}, are not both there: {found}"
    return f"its camera's photos here are all from one lens, {found}"


def _reasons(own: _Series, others: _Series, partners: dict[int, int], max_seconds: float) -> Iterator[Unpaired]:
    """Say why photos have no partner among the others.

    Args:
        own: photos of one lens.
        others: photos of the other one.
        partners: which of the others goes with which of the own.
        max_seconds: photos farther apart are no pair.
    """
    taken_by = {j: i for i, j in partners.items()}
    for i, photo in enumerate(own.photos):
        if i in partners:
            continue
        if not others.photos:
            yield Unpaired(photo, "no photo of the other lens is left to go with it")
            continue
        apart_s = np.abs(others.seconds - own.seconds[i])
        j = int(apart_s.argmin())
        name = others.photos[j].path.name
        nearest = taken_by.get(j, int(np.abs(own.seconds - others.seconds[j]).argmin()))
        rival = own.photos[nearest].path.name
        if apart_s[j] > max_seconds:
            far = f"the nearest photo of the other lens, {name}, is {apart_s[j]:.1f} s away"
            yield Unpaired(photo, f"{far}; {max_seconds:g} s at most are allowed")
        elif abs(others.seconds[j] - own.seconds[nearest]) < apart_s[j] - SAME_S:
            yield Unpaired(photo, f"{name} is nearer to {rival}")
        else:
            yield Unpaired(photo, f"{name} is as near to {rival} and goes with that one")


def _pair(tele: _Series, i: int, wide: _Series, j: int) -> RollPair:
    """Pair two photos; of a RAW whose partner is no RAW the twin."""
    photos = tele.photos[i], wide.photos[j]
    seconds_apart = float(wide.seconds[j] - tele.seconds[i])
    if (photos[0].facts.kind == "raw") != (photos[1].facts.kind == "raw"):
        photos = photos[0].twin or photos[0], photos[1].twin or photos[1]
    return RollPair(*photos, seconds_apart)
