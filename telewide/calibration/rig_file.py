"""The rig on disk: ``rig.yaml``, a calibration in plain numbers with their units in the names.

What is read equals what was written. Letters: none.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.result import Calibration, CameraStd, TransformStd
from telewide.geometry.rig import StereoRig


@dataclass(frozen=True)
class RigFacts:
    """What is known about how a rig was made.

    Attributes:
        image_pipeline: identity of what made the pictures from the sensor; None where unknown.
        focus_distance_m: where the photos were focused; None where unknown.
        scale_verified: whether the board, or a distance, was measured; otherwise metres are nominal.
        board: name of the board; None without one.
        source: whether it came from photos of a board or of scenes.
        created_utc: ISO time; None writes the present.
        notes: for people.
    """

    image_pipeline: str | None = None
    focus_distance_m: float | None = None
    scale_verified: bool = False
    board: str | None = None
    source: Literal["boards", "scenes"] = "boards"
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


def write_rig(path: Path, calibration: Calibration, *, facts: RigFacts) -> None:
    """Write a calibration as ``rig.yaml``.

    Args:
        path: the file to write or to replace.
        calibration: what :func:`telewide.calibration.solve.calibrate_rig` returned.
        facts: how it was made.

    Raises:
        UsageError: the place cannot be written.
    """
    raise NotImplementedError


def write_stored_rig(path: Path, stored: StoredRig) -> None:
    """Write a rig that did not come from :func:`calibrate_rig`, such as one from scenes.

    Args:
        path: the file to write or to replace.
        stored: the rig with its quality and facts.

    Raises:
        UsageError: the place cannot be written.
    """
    raise NotImplementedError


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
    raise NotImplementedError
