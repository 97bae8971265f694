"""The rig of a set of captures: where it lies, and what is refused without one."""

from __future__ import annotations

import logging
from pathlib import Path

from telewide.assets import find_yaml
from telewide.calibration.rig_file import RIG_FILE, StoredRig, read_rig
from telewide.capture.facts import FACTS_FILE
from telewide.capture.importer import is_imported
from telewide.capture.pair import CaptureSet
from telewide.errors import InputError, UsageError
from telewide.files import is_there
from telewide.text import command_line

_log = logging.getLogger("telewide")


def locate_rig(stated: Path | None, captures: CaptureSet) -> StoredRig | None:
    """Find the rig that a set of captures is to be rectified with.

    Args:
        stated: the file its user named, or None.
        captures: the set.

    Returns:
        The named rig; or ``rig.yaml`` (or ``rig.yml``) in the captures' folder, in one of the two above it, or in the
        working folder; None where there is none, or where captures.yaml states that the captures are rectified.

    Raises:
        UsageError: the named file does not exist, or the captures are stated to be rectified.
        InputError: it is no rig.
    """
    lying = lying_rig(captures)
    if captures.facts.rectified:
        if stated is not None:
            states = f"captures.yaml of {captures.root} states that its captures are rectified"
            if not is_there(stated):
                raise UsageError(f"there is no rig file {stated}", hint=f"leave --rig out: {states}")
            raise UsageError(
                f"--rig {stated}: {states}",
                hint="remove 'rectified: true' there, or leave --rig out",
            )
        if lying is not None:
            _log.info("%s is not used: captures.yaml states that the captures are rectified", lying)
        return None
    if stated is not None:
        return read_rig(stated)
    return None if lying is None else read_rig(lying)


def lying_rig(captures: CaptureSet) -> Path | None:
    """Find the rig file that lies by a set of captures, or None; see :func:`locate_rig`."""
    folders = (captures.root, captures.root.absolute().parent, captures.root.absolute().parent.parent, Path.cwd())
    return next((rig for folder in folders if (rig := find_yaml(folder, RIG_FILE.stem))), None)


def where_rig_lies(rig: Path, captures: CaptureSet, *, is_stated: bool) -> str:
    """Name the rig that is used; of one that nobody named, that it lies outside the captures' folder if it does.

    Args:
        rig: its file.
        captures: what is rectified with it.
        is_stated: whether its user named it.
    """
    if is_stated or rig.parent == captures.root:
        return str(rig)
    return f"{rig}, found outside {captures.root}; if it is another phone's, name the right one with --rig"


def refuse_without_rig(captures: CaptureSet, *, rig: StoredRig | None) -> None:
    """Stop before anything is computed where photos straight from a phone have no rig.

    Args:
        captures: what was found.
        rig: what there is to rectify with.

    Raises:
        InputError: no rig lies by them, and they are stated not to be rectified, or all were imported and nobody states
            that they are rectified.
    """
    if rig is None and captures.facts.rectified is False:
        raise InputError(
            f"{captures.root / FACTS_FILE} states that the captures are not rectified, and no rig.yaml lies by them to "
            "rectify them with",
            hint=f"{how_to_calibrate(captures.root)}; or name a rig with --rig",
        )
    folders = [capture.tele_path.parent for capture in captures.captures]
    if rig is None and not captures.facts.rectified and folders and all(map(is_imported, folders)):
        raise InputError(
            f"{captures.root} holds photos as the phone took them, and no rig.yaml lies by them to rectify them with",
            hint=f"{how_to_calibrate(captures.root)}; if they are rectified, state rectified: true in "
            f"{captures.root / 'captures.yaml'}",
        )


def how_to_calibrate(root: Path) -> str:
    """Name the commands that make a rig for the captures of a folder."""
    rig = root / RIG_FILE
    boards = command_line("calibrate", "boards", out=rig)
    scenes = command_line("calibrate", root, from_scenes=True, out=rig)
    return (
        f"calibrate first, from photos of a board: {boards}, or without a board, from eight captures or more: {scenes}"
    )
