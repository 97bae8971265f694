"""Tags of a TIFF, of a DNG, and of other RAW that is built like one: those that are wanted, of believable length.

A few bytes can state thousands of tags of a gigabyte each, all in one place. TIFF 6.0, section 2; BigTIFF: the same
with 64 bits; EXIF: a directory of its own (CIPA DC-008, 4.6.3).
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import BinaryIO

MOST_VALUES = 1 << 20
"""Of a tag of numbers; the places of a million strips or tiles hold any photo."""
MOST_DIRECTORIES = 64
_MOST_ENTRIES = 4096
_MOST_BYTES = 1 << 16
_SUB_DIRECTORIES, _EXIF_DIRECTORY, _GPS_DIRECTORY = 330, 34665, 34853
_TEXTS = {2, 7}
# Letters of `struct` by type; a fraction is two numbers.
_LETTERS = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 6: "b", 7: "s", 8: "h", 9: "i", 10: "ii", 11: "f", 12: "d"}
_LETTERS |= {13: "I", 16: "Q", 17: "q", 18: "Q"}


@dataclass(frozen=True)
class _Layout:
    """Formats of a file: of the number of entries, of an entry, of a place; by byte order and by 32 or 64 bits."""

    count: struct.Struct
    entry: struct.Struct
    place: struct.Struct


@dataclass(frozen=True)
class _Entry:
    """One tag: its number, type, number of values, and where they lie."""

    tag: int
    kind: int
    n_values: int
    place: int

    @property
    def n_bytes(self) -> int:
        return self.n_values * struct.calcsize("=" + _LETTERS.get(self.kind, "s"))


def read_tags(stream: BinaryIO, wanted: Collection[int]) -> dict[int, object]:
    """Read tags of the first directory and of its EXIF directory; those of EXIF take precedence.

    Args:
        stream: the file, open for reading.
        wanted: their numbers.

    Returns:
        Values by number: bytes of a text, a number, or a tuple; a fraction is its numerator and denominator. Tags that
        are longer than a text of EXIF are left out, and what follows where the file is corrupt.
    """
    tags: dict[int, object] = {}
    try:
        layout, place = _opened(stream)
        entries, _ = _directory(stream, layout, place)
        exif = [entry for entry in entries if entry.tag == _EXIF_DIRECTORY]
        for below in exif[:1]:
            (below_place,) = _values(stream, layout, below)[:1]
            entries += _directory(stream, layout, int(below_place))[0]
        for entry in entries:
            if entry.tag in wanted and 0 < entry.n_bytes <= _MOST_BYTES:
                tags[entry.tag] = _value(stream, layout, entry)
    except (ValueError, struct.error, OSError):  # cut off
        return tags
    return tags


def stated_bytes(stream: BinaryIO) -> int:
    """Count the bytes that the tags of the first directory, of EXIF and of GPS state, which their reader takes up.

    Args:
        stream: the file, open for reading; it is left at its beginning.

    Raises:
        ValueError: no TIFF, cut off, or a directory of thousands of tags.
    """
    try:
        layout, place = _opened(stream)
        entries, _ = _directory(stream, layout, place)
        for below in [entry for entry in entries if entry.tag in {_EXIF_DIRECTORY, _GPS_DIRECTORY}]:
            entries = entries + _directory(stream, layout, int(_values(stream, layout, below)[0]))[0]
    except (struct.error, OSError, IndexError) as error:
        raise ValueError("its tags are cut off") from error
    finally:
        stream.seek(0)
    return sum(entry.n_bytes for entry in entries)


def check_directories(stream: BinaryIO, *, judged_later: Collection[int] = ()) -> None:
    """Refuse a file whose tags hold more numbers than any photo needs: decoders make an object of each.

    Args:
        stream: the file, open for reading; it is left at its beginning.
        judged_later: tags whose reader looks at their length before it reads them.

    Raises:
        ValueError: a tag of the first 64 directories, or of those below them, does.
    """
    try:
        layout, place = _opened(stream)
        for entries in _directories(stream, layout, place):
            for entry in entries:
                is_judged = entry.kind not in _TEXTS | {1, 6} and entry.tag not in judged_later
                if is_judged and entry.n_values > MOST_VALUES:
                    raise ValueError(f"its tag {entry.tag} states {entry.n_values} values")
    except (struct.error, OSError):  # cut off, or no TIFF: its decoder says so
        return
    finally:
        stream.seek(0)


def numbers_at(stream: BinaryIO, place: int) -> set[int]:
    """Return the numbers of the tags of a directory, also of those whose values lie beyond the file's end.

    Args:
        stream: the file, open for reading; it is left at its beginning.
        place: where the directory lies, bytes.
    """
    try:
        layout, _ = _opened(stream)
        return {entry.tag for entry in _directory(stream, layout, place)[0]}
    except (ValueError, struct.error, OSError):  # cut off
        return set()
    finally:
        stream.seek(0)


def _directories(stream: BinaryIO, layout: _Layout, place: int) -> Iterator[list[_Entry]]:
    """Each directory once, those below another one after it."""
    waiting, seen = [place], set[int]()
    while waiting and len(seen) < MOST_DIRECTORIES:
        place = waiting.pop(0)
        if place in seen or place == 0:
            continue
        seen.add(place)
        entries, following = _directory(stream, layout, place)
        yield entries
        below = [entry for entry in entries if entry.tag == _SUB_DIRECTORIES and entry.n_values <= MOST_VALUES]
        for entry in below:
            waiting += [int(one) for one in _values(stream, layout, entry)[:MOST_DIRECTORIES]]
        waiting.append(following)


def _opened(stream: BinaryIO) -> tuple[_Layout, int]:
    """Layout of a file, and where its first directory lies."""
    stream.seek(0)
    head = stream.read(16)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None:
        raise struct.error("no TIFF")
    is_big = struct.unpack_from(order + "H", head, 2)[0] == 43
    number = "Q" if is_big else "I"
    layout = _Layout(
        struct.Struct(order + ("Q" if is_big else "H")),
        struct.Struct(f"{order}HH{number}{struct.calcsize(number)}s"),
        struct.Struct(order + number),
    )
    return layout, int(layout.place.unpack_from(head, 8 if is_big else 4)[0])


def _directory(stream: BinaryIO, layout: _Layout, place: int) -> tuple[list[_Entry], int]:
    """The entries of a directory, and where the next one lies; 0 where there is none."""
    stream.seek(place)
    (n_entries,) = layout.count.unpack(stream.read(layout.count.size))
    if n_entries > _MOST_ENTRIES:
        raise ValueError(f"a directory of {n_entries} tags")
    entries = []
    for number in range(n_entries):
        at = place + layout.count.size + number * layout.entry.size
        stream.seek(at)
        tag, kind, n_values, stored = layout.entry.unpack(stream.read(layout.entry.size))
        entry = _Entry(tag, kind, n_values, at + layout.entry.size - len(stored))
        is_here = entry.n_bytes <= len(stored)
        entries.append(entry if is_here else _Entry(tag, kind, n_values, int(layout.place.unpack(stored)[0])))
    stream.seek(place + layout.count.size + n_entries * layout.entry.size)
    following = stream.read(layout.place.size)
    return entries, int(layout.place.unpack(following)[0]) if len(following) == layout.place.size else 0


def _values(stream: BinaryIO, layout: _Layout, entry: _Entry) -> tuple[float, ...]:
    """Numbers of an entry, those of a fraction one after the other; none of an unknown type."""
    letters = _LETTERS.get(entry.kind)
    if letters is None:
        return ()
    stream.seek(entry.place)
    numbers = f"{layout.place.format[0]}{len(letters) * entry.n_values}{letters[0]}"
    return struct.unpack(numbers, stream.read(entry.n_bytes))


def _value(stream: BinaryIO, layout: _Layout, entry: _Entry) -> object:
    if entry.kind in _TEXTS:
        stream.seek(entry.place)
        return stream.read(entry.n_bytes)
    values = _values(stream, layout, entry)
    return values[0] if len(values) == 1 else values
