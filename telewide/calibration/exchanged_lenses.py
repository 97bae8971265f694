"""Photos of the two lenses in each other's place: seen from the detected corners, before anything is solved.

Both lenses of a shot see the same board from the same place, so a square spans the larger share of the photo of the
lens that sees less: tele. Only where no shot shows the board in both photos, what EXIF states is asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from telewide.boards.detection import BoardView
from telewide.boards.shots import BoardShot, DetectedShot
from telewide.calibration.sightings import square_px
from telewide.capture.exif import read_photo_facts
from telewide.errors import InputError
from telewide.files import is_folder

WIDER = 1.15
"""A tele lens that sees this much more than the wide one was exchanged with it."""
_MIN_CORNERS = 4


def refuse_exchanged(shots: Sequence[BoardShot], detected: Sequence[DetectedShot]) -> None:
    """Stop where the photos under tele are those of the lens that sees more.

    Args:
        shots: where the photos lie.
        detected: the corners found in them, in the same order.

    Raises:
        InputError: they are exchanged; the message names the folders.
    """
    ratios = [ratio for shot in detected if (ratio := _tele_over_wide(shot)) is not None]
    if ratios:
        ratio = median(ratios)
        reason = f"a square of the board spans {1 / ratio:.1f} times more of the wide photos than of the tele photos"
    else:
        stated = _stated_f35_mm(shots)
        if stated is None:
            return
        ratio = stated[0] / stated[1]
        reason = f"EXIF states {stated[0]:.0f} mm (35 mm equivalent) for tele and {stated[1]:.0f} mm for wide"
    if ratio < 1 / WIDER:
        tele, wide = _places(shots)
        raise InputError(
            f"the photos of the two lenses are exchanged: {reason}",
            hint=f"tele is the lens that sees less: rename {tele} to {wide} and the other way round{_others(tele)}",
        )


def _tele_over_wide(shot: DetectedShot) -> float | None:
    """Ratio of the board's size in tele to that in wide, each as a share of its photo's diagonal."""
    if shot.tele is None or shot.wide is None:
        return None
    common = np.intersect1d(shot.tele.ids, shot.wide.ids)
    if len(common) < _MIN_CORNERS:
        return None
    return _share(shot.tele, common) / _share(shot.wide, common)


def _share(view: BoardView, ids: NDArray[np.int64]) -> float:
    return square_px(view.points_px[np.isin(view.ids, ids)]) / float(np.hypot(*view.hw))


def _stated_f35_mm(shots: Sequence[BoardShot]) -> tuple[float, float] | None:
    """Median 35 mm equivalents of tele and wide, by EXIF; None where one of them is not stated."""
    stated: tuple[list[float], list[float]] = ([], [])
    for shot in shots:
        for found, path in zip(stated, (shot.tele_path, shot.wide_path), strict=True):
            with suppress(InputError):  # no photo: the detection has said so
                f35_mm = None if path is None else read_photo_facts(path).f35_mm
                found += [f35_mm] if f35_mm else []
    return (median(stated[0]), median(stated[1])) if stated[0] and stated[1] else None


def _others(tele: Path) -> str:
    return "" if is_folder(tele) else ", and so in the folders beside it"


def _places(shots: Sequence[BoardShot]) -> tuple[Path, Path]:
    """Names to exchange: two folders, or the two files of the first shot that has both."""
    for shot in shots:
        if shot.tele_path is not None and shot.wide_path is not None:
            is_by_lens = shot.tele_path.parent != shot.wide_path.parent
            return (shot.tele_path.parent, shot.wide_path.parent) if is_by_lens else (shot.tele_path, shot.wide_path)
    tele, wide = (
        next(path for path in paths if path is not None)
        for paths in ((shot.tele_path for shot in shots), (shot.wide_path for shot in shots))
    )
    return tele.parent, wide.parent
