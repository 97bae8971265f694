"""Rig files: what was written is read, and whatever cannot be a rig is refused in words."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from calibration.known_rig import phone

from telewide.calibration.quality import CalibrationQuality, Check
from telewide.calibration.result import CameraStd, TransformStd
from telewide.calibration.rig_file import RigFacts, StoredRig, read_rig, write_stored_rig
from telewide.errors import InputError, UsageError

QUALITY = CalibrationQuality(
    tele_rms_px=0.31,
    wide_rms_px=0.29,
    epipolar_p50_px=0.4,
    epipolar_p90_px=1.1,
    epipolar_p99_px=1.7,
    cross_validation_px=float("nan"),
    checks=(
        Check("joint views", "warn", 9.0, 12.0, "Take 3 more.", unit="shots", bound="at least"),
        Check("odd/even difference", "warn", float("nan"), 4.5, ""),
    ),
    verdict="usable",
)


def stored(rng: np.random.Generator) -> StoredRig:
    rig = phone()
    n = len(rig.tele.distortion)
    spread = rng.normal(size=(6, 6)) * 1e-5
    std = [CameraStd(*np.abs(rng.normal(size=3)).tolist(), np.abs(rng.normal(size=n)) / 7, aspect=1e-7) for _ in "tw"]
    transform = TransformStd(np.full(3, 1 / 3), np.abs(rng.normal(size=3)) * 1e-6, 1e-7 / 3, spread @ spread.T)
    facts = RigFacts(
        "jpeg:Phone",
        1.2,
        True,
        "chessboard_9x6",
        orientations=(6, 1),
        created_utc="2026-01-01T00:00:00+00:00",
        notes=("a",),
    )
    return StoredRig(rig, *std, transform, QUALITY, facts, n_joint_views=9, left_out=("joint03 (tele): blurred",))


def assert_equal(found: object, expected: object) -> None:
    """Equality of nested dataclasses, NaN equal to NaN, numbers bit for bit."""
    assert type(found) is type(expected)
    if hasattr(expected, "__dataclass_fields__"):
        for field in fields(expected):  # type: ignore[arg-type]
            assert_equal(getattr(found, field.name), getattr(expected, field.name))
    elif isinstance(expected, tuple) and not isinstance(found, str):
        assert len(found) == len(expected)  # type: ignore[arg-type]
        for mine, theirs in zip(found, expected, strict=True):  # type: ignore[call-overload]
            assert_equal(mine, theirs)
    else:
        np.testing.assert_array_equal(found, expected)


def test_what_is_read_is_what_was_written(tmp_path: Path, rng: np.random.Generator) -> None:
    expected = stored(rng)
    write_stored_rig(tmp_path / "new" / "rig.yaml", expected)
    assert_equal(read_rig(tmp_path / "new" / "rig.yaml"), expected)


def test_what_is_not_known_stays_unknown(tmp_path: Path, rng: np.random.Generator) -> None:
    rig = replace(phone(), is_scale_known=False)
    bare = StoredRig(rig, None, None, None, QUALITY, RigFacts(source="scenes"))
    write_stored_rig(tmp_path / "rig.yaml", bare)
    found = read_rig(tmp_path / "rig.yaml")
    assert_equal(replace(found, facts=replace(found.facts, created_utc=None)), bare)
    assert found.facts.created_utc is not None


def test_errors_are_named_for_what_they_are(tmp_path: Path, rng: np.random.Generator) -> None:
    write_stored_rig(tmp_path / "rig.yaml", stored(rng))
    text = (tmp_path / "rig.yaml").read_text()
    assert "tele_rms_px: 0.31" in text
    assert "wide_rms_px: 0.29" in text
    assert "baseline_m:" in text


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        (("tele", "fx_px"), -3, "tele.fx_px"),
        (("tele", "fx_px"), "long", "tele.fx_px"),
        (("tele", "fx_px"), 1e6, "tele is .* at most 64 times"),
        (("tele", "fy_px"), 1e12, "tele is .* at most 64 times"),
        (("wide", "cx_px"), 1e9, "wide is .* within 16 times"),
        (("wide", "width_px"), 10**10, "wide.width_px"),
        (("wide", "width_px"), 10**400, "cannot be read as int"),
        (("wide", "distortion"), [1e30, 0.0, 0.0, 0.0], "wide.distortion"),
        (("wide_from_tele", "translation_m"), [1e300, 0.0, 0.0], "translation_m"),
        (("wide_from_tele", "translation_m"), [0.0, 0.0, 0.0], "translation_m of"),
        (("wide", "cy_px"), float("nan"), "wide.cy_px"),
        (("wide", "distortion"), [0.1, 0.2, 0.3], "wide.distortion"),
        (("wide", "focal"), 3, "wide.focal"),
        (("wide_from_tele", "rotation"), [[1, 0, 0], [0, 1, 0], [0, 0, 2]], "wide_from_tele.rotation"),
        (("wide_from_tele", "translation_m"), [9.8, 1.5, -1.2], "translation_m"),
        (("quality", "verdict"), "superb", "quality.verdict"),
        (("baseline_m",), 0.5, "baseline_m"),
        (("format",), 2, "format"),
        (("tele",), None, "tele"),
    ],
)
def test_a_bad_value_is_refused_by_its_key(
    path: tuple[str, ...], value: object, named: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    write_stored_rig(tmp_path / "rig.yaml", stored(rng))
    data = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=named) as caught:
        read_rig(tmp_path / "rig.yaml")
    assert "rig.yaml" in caught.value.message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("# only a remark\n", "is empty"),
        ("- 1\n- 2\n", "no keys and values"),
        ("just words", "no keys and values"),
        ("format: 1\ntele: [", "cannot be read as YAML: line 2: expected"),
        ("\x00\x01", "cannot be read as YAML"),
    ],
)
def test_what_is_no_rig_file_is_refused_with_a_way_to_get_one(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(InputError, match=r"rig\.yaml") as caught:
        read_rig(tmp_path / "rig.yaml")
    assert said in caught.value.message
    assert "\n" not in caught.value.message
    assert "calibrate" in (caught.value.hint or "")
    assert "`from_scenes`" in (caught.value.hint or "")


def test_a_folder_in_the_place_of_a_rig_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        read_rig(tmp_path)


def test_checks_of_an_older_file_are_read_without_their_unit(tmp_path: Path, rng: np.random.Generator) -> None:
    write_stored_rig(tmp_path / "rig.yaml", stored(rng))
    data = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    for check in data["quality"]["checks"]:
        del check["unit"], check["bound"]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(data))
    first = read_rig(tmp_path / "rig.yaml").quality.checks[0]
    assert (first.found_words, first.limit_words) == ("9", "limit 12")


def test_a_file_that_is_not_there_is_the_users_slip(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no rig file"):
        read_rig(tmp_path / "rig.yaml")


def test_nothing_in_a_rig_file_is_run(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("!!python/object/apply:os.mkdir ['" + str(tmp_path / "made") + "']\n")
    with pytest.raises(InputError):
        read_rig(tmp_path / "rig.yaml")
    assert not (tmp_path / "made").exists()


def test_a_line_break_in_what_somebody_wrote_begins_no_line(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "rig.yaml"
    write_stored_rig(path, stored(rng))
    data = yaml.safe_load(path.read_text())
    data |= {"notes": ["one\nerror: two"], "image_pipeline": "raw:\nerror: three", "left_out": ["a\nb"]}
    path.write_text(yaml.safe_dump(data))
    read = read_rig(path)
    assert read.facts.notes == ("one\\nerror: two",)
    assert read.facts.image_pipeline == "raw:\\nerror: three"
    assert read.left_out == ("a\\nb",)
