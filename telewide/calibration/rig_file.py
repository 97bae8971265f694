"""The rig on disk: ``rig.yaml``, a calibration in plain numbers with their units in the names.

What is read equals what was written. ``null`` stands for a number that is not known. Frames as in `geometry.rig`.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from numpy.typing import NDArray

from telewide.calibration.quality import CalibrationQuality, Check
from telewide.calibration.result import Calibration, CameraStd, TransformStd
from telewide.calibration.rig_sheet import CameraSheet, CameraStdSheet, CheckSheet, QualitySheet, RigSheet, RigStdSheet
from telewide.capture.exif import UPRIGHT_DEG
from telewide.errors import InputError, UsageError
from telewide.files import write_text
from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.options import parse_options
from telewide.yaml_files import read_yaml

RIG_FILE = Path("rig.yaml")
_ANOTHER_RIG = (
    "calibrate anew, from photos of a board or, without one, from captures (`from_scenes`); captures that are "
    "rectified need none: remove the file"
)
_HEADER = """\
# Two lenses and how they stand to each other. Lengths in metres; pixel (0, 0) is the centre of the top-left pixel.
# wide = rotation @ tele + translation_m; x right, y down, z forward. Distortion: k1 k2 p1 p2 k3 k4 k5 k6 (OpenCV).
# std is one standard deviation; rms_px a root mean square distance in pixels of that lens's photos.
"""


@dataclass(frozen=True)
class RigFacts:
    """Facts about how a rig was made.

    Attributes:
        image_pipeline: identity of what made the pictures from the sensor; None where unknown.
        focus_distance_m: where the photos were focused; None where unknown.
        scale_verified: whether the board, or a distance, was measured; otherwise metres are nominal.
        board: name of the board; None without one.
        source: whether it came from photos of a board or of scenes.
        orientations: EXIF orientations of its tele and its wide photos, in which the rig stands; None where unknown.
        created_utc: ISO time; None writes the present.
        notes: for people.
    """

    image_pipeline: str | None = None
    focus_distance_m: float | None = None
    scale_verified: bool = False
    board: str | None = None
    source: Literal["boards", "scenes"] = "boards"
    orientations: tuple[int, int] | None = None
    created_utc: str | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class StoredRig:
    """A rig as it lies in a file.

    Attributes:
        rig: the rig.
        tele_std: how sure the tele camera is; None where unknown.
        wide_std: how sure the wide camera is; None where unknown.
        transform_std: how sure ``wide_from_tele`` is; None where unknown.
        quality: what it is worth.
        facts: how it was made.
        n_joint_views: shots of which both views were used.
        left_out: name and reason of every view that was left out.
    """

    rig: StereoRig
    tele_std: CameraStd | None
    wide_std: CameraStd | None
    transform_std: TransformStd | None
    quality: CalibrationQuality
    facts: RigFacts
    n_joint_views: int = 0
    left_out: tuple[str, ...] = ()

    def as_held(self, orientations: tuple[int, int] | None, *, tele_hw: tuple[int, int]) -> StereoRig:
        """The rig as it stands in photos of a phone that was held otherwise than for the calibration.

        Upside down, wide stands on the other side of tele, and both principal points have moved.

        Args:
            orientations: EXIF orientations of the tele and the wide photo; None where unknown.
            tele_hw: size of the tele photo as it was read; a turn by 90 degrees that it contradicts is not believed, as
                programs that turn a photo for good may leave its orientation out.

        Returns:
            The rig; as it was made where either side does not know how the phone was held.
        """
        made = self.facts.orientations
        known = None not in {UPRIGHT_DEG.get(each) for each in (*(made or ()), *(orientations or ()))}
        if made is None or orientations is None or not known:
            return self.rig
        tele_deg, wide_deg = (
            (UPRIGHT_DEG[found] - UPRIGHT_DEG[own]) % 360 for found, own in zip(orientations, made, strict=True)
        )
        if not (tele_deg or wide_deg):
            return self.rig
        turned = self.rig.turned(tele_deg=tele_deg, wide_deg=wide_deg)
        is_tall, is_made_tall = tele_hw[0] > tele_hw[1], turned.tele.hw[0] > turned.tele.hw[1]
        return self.rig if tele_deg % 180 and is_tall != is_made_tall else turned


def stored_rig(calibration: Calibration, *, facts: RigFacts) -> StoredRig:
    """The part of a calibration that goes into a file.

    Args:
        calibration: what :func:`telewide.calibration.solver.calibrate_rig` returned.
        facts: how it was made.
    """
    used = [{view.shot for view in calibration.views if view.camera == lens and view.is_used} for lens in _LENSES]
    return StoredRig(
        rig=calibration.rig,
        tele_std=calibration.tele_std,
        wide_std=calibration.wide_std,
        transform_std=calibration.transform_std,
        quality=calibration.quality,
        facts=facts,
        n_joint_views=len(used[0] & used[1]),
        left_out=tuple(f"{view.shot} ({view.camera}): {view.reason}" for view in calibration.views if not view.is_used),
    )


_LENSES = ("tele", "wide")


def write_rig(path: Path, calibration: Calibration, *, facts: RigFacts) -> None:
    """Write a calibration as ``rig.yaml``.

    Args:
        path: the file to write or to replace.
        calibration: what :func:`telewide.calibration.solver.calibrate_rig` returned.
        facts: how it was made.

    Raises:
        UsageError: the place cannot be written.
    """
    write_stored_rig(path, stored_rig(calibration, facts=facts))


def write_stored_rig(path: Path, stored: StoredRig) -> None:
    """Write a rig that did not come from a board, such as one from scenes.

    Args:
        path: the file to write or to replace.
        stored: the rig with its quality and facts.

    Raises:
        UsageError: the place cannot be written.
    """
    sheet = _sheet_of(stored)
    text = yaml.safe_dump(sheet.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=120)
    write_text(path, _HEADER + text)


def read_rig(path: Path) -> StoredRig:
    """Read a ``rig.yaml``.

    Args:
        path: the file.

    Returns:
        The rig, exactly as it was written.

    Raises:
        UsageError: there is no such file.
        InputError: not a rig file, another version, or a value no rig has; the message names the key.
    """
    try:
        data = read_yaml(path)
    except UsageError as error:
        raise UsageError(f"there is no rig file {path}", hint="calibrating makes one from photos") from error
    except InputError as error:
        raise InputError(error.message, hint=_ANOTHER_RIG) from error
    if not isinstance(data, dict):
        found = "is empty" if data is None else "holds no keys and values"
        raise InputError(f"{path} {found}; a rig was expected", hint=_ANOTHER_RIG)
    if data.get("format", 1) != 1:
        raise InputError(
            f"{path}: format is {data['format']!r}, this version reads format 1",
            hint="calibrate again, or update telewide",
        )
    return _stored_of(parse_options(RigSheet, data, source=str(path), error=InputError))


def _sheet_of(stored: StoredRig) -> RigSheet:
    facts = asdict(stored.facts)
    if facts["created_utc"] is None:
        facts["created_utc"] = datetime.now(UTC).isoformat(timespec="seconds")
    rig, transform_std = stored.rig, stored.transform_std
    return RigSheet(
        **facts,
        is_scale_known=rig.is_scale_known,
        tele=_camera_sheet(rig.tele, stored.tele_std),
        wide=_camera_sheet(rig.wide, stored.wide_std),
        wide_from_tele={
            "rotation": _rows(rig.wide_from_tele[:3, :3]),
            "translation_m": _row(rig.wide_from_tele[:3, 3]),
            "std": None if transform_std is None else _rig_std_sheet(transform_std),
        },
        baseline_m=rig.baseline_m,
        n_joint_views=stored.n_joint_views,
        left_out=stored.left_out,
        quality=_quality_sheet(stored.quality),
    )


def _camera_sheet(camera: Camera, std: CameraStd | None) -> CameraSheet:
    return CameraSheet(
        width_px=camera.hw[1],
        height_px=camera.hw[0],
        fx_px=float(camera.K[0, 0]),
        fy_px=float(camera.K[1, 1]),
        cx_px=float(camera.K[0, 2]),
        cy_px=float(camera.K[1, 2]),
        distortion=_row(camera.distortion),
        std=None if std is None else CameraStdSheet(**{**asdict(std), "distortion": _row(std.distortion)}),
    )


def _rig_std_sheet(std: TransformStd) -> RigStdSheet:
    return RigStdSheet(
        rotation_deg=_row(std.rotation_deg),
        translation_m=_row(std.translation_m),
        baseline_m=std.baseline_m,
        covariance_rad_m=_rows(std.covariance),
    )


def _quality_sheet(quality: CalibrationQuality) -> QualitySheet:
    figures = {name: _known(value) for name, value in vars(quality).items() if name.endswith("_px")}
    checks = tuple(
        CheckSheet(**{**asdict(check), "value": _known(check.value), "limit": _known(check.limit)})
        for check in quality.checks
    )
    return QualitySheet(verdict=quality.verdict, checks=checks, **figures)


def _stored_of(sheet: RigSheet) -> StoredRig:
    std = sheet.wide_from_tele.std
    R, t = np.array(sheet.wide_from_tele.rotation), np.array(sheet.wide_from_tele.translation_m)
    facts = RigFacts(**{name: getattr(sheet, name) for name in RigFacts.__dataclass_fields__})
    return StoredRig(
        rig=StereoRig(
            tele=_camera_of(sheet.tele),
            wide=_camera_of(sheet.wide),
            wide_from_tele=rigid_transform(rotation=R, translation=t),
            is_scale_known=sheet.is_scale_known,
        ),
        tele_std=_camera_std_of(sheet.tele.std),
        wide_std=_camera_std_of(sheet.wide.std),
        transform_std=None if std is None else _transform_std_of(std),
        quality=_quality_of(sheet.quality),
        facts=replace(facts, notes=tuple(facts.notes)),
        n_joint_views=sheet.n_joint_views,
        left_out=tuple(sheet.left_out),
    )


def _camera_of(sheet: CameraSheet) -> Camera:
    K = np.array([[sheet.fx_px, 0.0, sheet.cx_px], [0.0, sheet.fy_px, sheet.cy_px], [0.0, 0.0, 1.0]])
    return Camera((sheet.height_px, sheet.width_px), K, np.array(sheet.distortion, dtype=np.float64))


def _camera_std_of(sheet: CameraStdSheet | None) -> CameraStd | None:
    if sheet is None:
        return None
    return CameraStd(
        f_px=sheet.f_px,
        cx_px=sheet.cx_px,
        cy_px=sheet.cy_px,
        distortion=np.array(sheet.distortion, dtype=np.float64),
        aspect=sheet.aspect,
    )


def _transform_std_of(sheet: RigStdSheet) -> TransformStd:
    return TransformStd(
        rotation_deg=np.array(sheet.rotation_deg),
        translation_m=np.array(sheet.translation_m),
        baseline_m=sheet.baseline_m,
        covariance=np.array(sheet.covariance_rad_m),
    )


def _quality_of(sheet: QualitySheet) -> CalibrationQuality:
    figures = {name: _number(getattr(sheet, name)) for name in type(sheet).model_fields if name.endswith("_px")}
    checks = tuple(
        Check(**{**each.model_dump(), "value": _number(each.value), "limit": _number(each.limit)})
        for each in sheet.checks
    )
    return CalibrationQuality(**figures, checks=checks, verdict=sheet.verdict)


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def _row(values: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _rows(values: NDArray[np.float64]) -> tuple[tuple[float, ...], ...]:
    return tuple(_row(row) for row in values)
