"""Depth of other captures that lies beside that of a call, as the page shows it again."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from telewide.bokeh.picture import BokehOptions
from telewide.capture.pair import Capture, CaptureSet, find_captures
from telewide.errors import TelewideError
from telewide.files import fingerprint
from telewide.records import checked, read_record
from telewide.stages.kept_depth import KEPT_NAME, KeptRecord, read_lying
from telewide.stages.pair_record import RECORD_NAME, PairRecord


@dataclass(frozen=True)
class LyingDepth:
    """Depth of a capture that a former call has made.

    Attributes:
        capture: the photos as taken.
        numbers: what was measured.
        rotated_deg: how far the photos were turned counter-clockwise.
        bokeh: that was asked for; None where none was, or a preview.
    """

    capture: Capture
    numbers: dict[str, float]
    rotated_deg: int
    bokeh: BokehOptions | None


def names_lying(folder: Path) -> frozenset[str]:
    """Names of all captures whose depth was written into a folder.

    Args:
        folder: of the results.
    """
    return frozenset(path.parent.name for path in folder.glob(f"*/{KEPT_NAME}"))


def depth_of_call(capture: Capture, folder: Path, *, rotated_deg: int) -> LyingDepth:
    """Read depth that a call has just made or kept.

    Args:
        capture: the photos as taken.
        folder: of the results.
        rotated_deg: how far the photos were turned counter-clockwise.
    """
    record = read_lying(folder / capture.name)
    if record is None:  # somebody else has changed it since
        return LyingDepth(capture, {}, rotated_deg, None)
    return LyingDepth(capture, record.shown_numbers, rotated_deg, _bokeh_of(record))


def lying_depths(folder: Path, names: Collection[str], *, pairs: Path, captures_root: Path) -> tuple[LyingDepth, ...]:
    """Read depth that is whole, and whose photos and pair are still those that it was made from.

    Args:
        folder: of the results.
        names: of the captures to look for.
        pairs: folder of the corrected pairs.
        captures_root: where photos are looked for that do not lie any more where they did.

    Returns:
        What was found, sorted by name.
    """
    found_in = lru_cache(maxsize=None)(_captures_in)
    found = []
    for name in sorted(names):
        record = read_lying(folder / name)
        if record is None or record.source is None:
            continue
        for place in (Path(record.source).parent, captures_root):
            captures = found_in(place)
            capture = next((one for one in captures.captures if one.name == name), None) if captures else None
            pair = None if capture is None else _pair_of(capture, record, pairs / name / RECORD_NAME)
            if captures is not None and capture is not None and pair is not None:
                turned_deg = captures.facts.rotated_deg if pair.key.get("rig") is None else 0
                found.append(LyingDepth(capture, record.shown_numbers, turned_deg, _bokeh_of(record)))
                break
    return tuple(found)


def _captures_in(folder: Path) -> CaptureSet | None:
    try:
        return find_captures(folder)
    except TelewideError:
        return None


def _pair_of(capture: Capture, record: KeptRecord, path: Path) -> PairRecord | None:
    """The pair that a depth was made from, if it is still that of these photos."""
    try:
        pair = read_record(path, PairRecord)
        photos = {"tele_sha256": fingerprint(capture.tele_path), "wide_sha256": fingerprint(capture.wide_path)}
        is_same = record.key.get("pair_sha256") == fingerprint(path)
    except TelewideError:
        return None
    return pair if is_same and photos.items() <= pair.key.items() else None


def _bokeh_of(record: KeptRecord) -> BokehOptions | None:
    try:
        asked = checked(record.key.get("bokeh") if record.bokeh is None else record.bokeh.asked, BokehOptions)
    except (TelewideError, ValueError):
        return None
    return None if asked.is_preview else asked
