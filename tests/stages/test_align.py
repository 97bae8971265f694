"""What the photos of a shot state, as the correction of that shot is told it."""

from __future__ import annotations

from pathlib import Path

import pytest
from capture.roll import EXIF_IFD, SUBSECOND, TELE, WIDE, exif_of, write_photo

from telewide.capture.pair import Capture
from telewide.correction.refinement import AT_ONCE_S
from telewide.stages.align import read_shot_facts


@pytest.mark.parametrize(
    ("wide_second", "has_fractions", "is_late"), [(1.0, True, True), (1.0, False, False), (2.0, False, True)]
)
def test_whole_seconds_alone_do_not_make_a_shot_late(
    tmp_path: Path, wide_second: float, has_fractions: bool, is_late: bool
) -> None:
    paths = []
    for name, lens, second in (("tele", TELE, 0.0), ("wide", WIDE, wide_second)):
        exif = exif_of(**lens, second=second)
        if not has_fractions:
            del exif.get_ifd(EXIF_IFD)[SUBSECOND]
        paths.append(write_photo(tmp_path / f"{name}.jpg", exif=exif))
    seconds = read_shot_facts(Capture("one", *paths)).seconds_between
    assert seconds is not None
    assert (seconds > AT_ONCE_S) == is_late
