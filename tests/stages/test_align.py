"""What the photos of a shot state, and what was fitted of it, as it comes back from a file."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from capture.roll import EXIF_IFD, SUBSECOND, TELE, WIDE, exif_of, write_photo
from rigs import phone

from telewide.capture.pair import Capture
from telewide.correction.asymmetry import compare_factors
from telewide.correction.moving import MovedRegion
from telewide.correction.refinement import AT_ONCE_S, ShotRefinement, refined_rig
from telewide.geometry.rectification import rectified_geometry
from telewide.stages.align import Alignment, alignment_as_json, alignment_from_json, read_shot_facts


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


@pytest.fixture
def alignment() -> Alignment:
    """A shot whose lens has moved, one of its parts too."""
    refinement = ShotRefinement(
        vertical_offset_px=1 / 3,
        scale=1.001,
        rotation_vector=np.array([1e-3, -2e-3, 1 / 3000]),
        translation_direction=np.array([0.6, 0.8, 0.0]),
        vertical_offset_std_px=0.02,
        n_matches=120,
        is_fitted=True,
        notes=("the lens has moved",),
    )
    moved = (MovedRegion(np.array([[1.0, 2.0], [30.5, 2.0], [7.0, 1 / 3]]), 3, math.nan),)
    geometry = rectified_geometry(refined_rig(phone(shrink=4), refinement), working_width_px=320)
    return Alignment(refinement, moved, compare_factors(rig=3.0, exif=2.9), geometry)


def test_an_alignment_survives_its_file_exactly(alignment: Alignment) -> None:
    text = alignment_as_json(alignment)
    assert "NaN" not in text
    again = alignment_from_json(text, rig=phone(shrink=4), working_width_px=320)
    for mine, other in ((alignment.refinement, again.refinement), (alignment.moved[0], again.moved[0])):
        for field in dataclasses.fields(mine):
            np.testing.assert_array_equal(getattr(other, field.name), getattr(mine, field.name), err_msg=field.name)
    assert again.asymmetry == alignment.asymmetry
    points_px = np.array([[3.0, 5.0], [400.0, 300.0]])
    expected = alignment.geometry.ref_from_tele(points_px)
    np.testing.assert_array_equal(again.geometry.ref_from_tele(points_px), expected)


@pytest.mark.parametrize("name", ["tele_hw", "refinement", "rotation_vector", "n_matches", "outline_px", "asymmetry"])
@pytest.mark.parametrize("value", [None, [1], "1", True, [["a", 1]]])
def test_a_shot_record_that_holds_something_else_is_refused(alignment: Alignment, name: str, value: object) -> None:
    content = json.loads(alignment_as_json(alignment))
    holder = next(part for part in (content, content["refinement"], content["moved"][0]) if name in part)
    holder[name] = value
    with pytest.raises(ValueError, match=name):
        alignment_from_json(json.dumps(content), rig=phone(shrink=4), working_width_px=320)
