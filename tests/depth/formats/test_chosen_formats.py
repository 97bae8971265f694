"""Names of formats, as the command line takes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from depth.formats.made_depth import made_photo, made_result

from telewide.depth import export
from telewide.depth.export import FORMATS, chosen_formats, file_names, missing_formats, write_depth
from telewide.errors import MissingPartError, UsageError
from telewide.stages.kept_depth import FILE_NAMES


def test_names_are_taken_one_by_one_or_with_commas() -> None:
    assert chosen_formats(()) == ("pfm", "png", "npz")
    assert chosen_formats(("mm, TIFF", "pfm")) == ("pfm", "npz", "mm", "tiff")
    assert set(chosen_formats(("all",))) == {name for name, each in FORMATS.items() if each.is_installed}


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(UsageError, match="unknown format 'tif'") as caught:
        chosen_formats(("tif",))
    assert caught.value.hint == "did you mean tiff?"


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "find_spec", lambda name: None)
    with pytest.raises(MissingPartError, match="needs OpenEXR") as caught:
        chosen_formats(("exr",))
    assert "[exr]" in str(caught.value.hint)
    assert not {"exr", "glb", "ply"} & set(chosen_formats(("all",)))
    told = missing_formats(("png,all",))
    assert ["depth.exr" in line and "[exr]" in line for line in told].count(True) == 1
    assert len(told) == len({"ply", "glb", "exr", "heic"})
    assert missing_formats(("png",)) == ()


def test_every_file_that_is_written_is_known_by_its_name(tmp_path: Path) -> None:
    formats = chosen_formats(("all",))
    names = [p.name for p in write_depth(tmp_path, made_result(), image=made_photo(), formats=formats).paths]
    assert set(names) <= set(file_names(formats)) < set(FILE_NAMES)
    assert len(set(FILE_NAMES)) == len(FILE_NAMES)
    assert sorted(names) == sorted(path.name for path in tmp_path.iterdir())


def test_a_map_of_which_nothing_is_known_is_written_where_it_can_be(tmp_path: Path) -> None:
    from dataclasses import replace

    result = made_result()
    unknown = np.full_like(result.disparity.disparity_px, np.nan)
    blank = replace(result, disparity=replace(result.disparity, disparity_px=unknown), depth_m=unknown)
    written = write_depth(tmp_path, blank, image=made_photo(), formats=chosen_formats(("all",)))
    assert {path.name for path in written.paths} >= {"disparity.pfm", "depth.npz", "depth.tif"}
    assert not {path.name for path in written.paths} & {"gdepth.jpg", "mesh.glb", "points.ply", "photo_depth.png"}
