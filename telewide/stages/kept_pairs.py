"""Corrected pairs as they are kept in the run folder, and the key by which one is found fit to be used again.

run/pairs/<name>/{tele,wide}.png   corrected pair at the working size
run/pairs/<name>/pair.json         what was measured, and from which files it was made
run/pairs/<name>/shot.json         with a rig: what moved in this shot
run/pairs/<name>/*_valid.png       with a rig: white where the tele and the wide photo reach
run/pairs/<name>/matches.npz       matches, in corrected coordinates: fitted to, and held out
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.rig_file import StoredRig
from telewide.capture.exif import read_photo_facts
from telewide.capture.images import write_image
from telewide.capture.pair import Capture, CaptureFacts
from telewide.capture.sizes import narrowed_hw
from telewide.correction.correct import CorrectedPair
from telewide.errors import TelewideError
from telewide.files import fingerprint, read_regular, replacing
from telewide.npz import read_npz
from telewide.points.held_out import HeldOut
from telewide.ranges import MAX_DISPARITY_PX, MAX_SIDE_PX
from telewide.recipe import Recipe
from telewide.records import MAX_JSON_BYTES, as_read, read_record
from telewide.stages.align import Alignment, alignment_from_json, plain_rig
from telewide.stages.pair_record import RECORD_NAME, PairRecord
from telewide.stages.pairs import PreparedPair
from telewide.training.samples import DISPARITY_NAME

FORMAT = 7
SHOT_NAME = "shot.json"
MATCHES_NAME = "matches.npz"
VALID_NAMES = ("tele_valid.png", "wide_valid.png")
_MOST_BYTES_OF_MATCHES = 1 << 26


def write_pair(folder: Path, corrected: CorrectedPair) -> None:
    """Write a corrected pair, its masks and its matches; disparities of what lay there before are removed.

    Args:
        folder: of the pair.
        corrected: what to write.
    """
    write_image(folder / "tele.png", corrected.pair.tele)
    write_image(folder / "wide.png", corrected.pair.wide)
    if corrected.pair.valid is not None:
        for name, mask in zip(VALID_NAMES, (corrected.pair.valid.ref, corrected.pair.valid.src), strict=True):
            write_image(folder / name, mask.astype(np.float32))
    with replacing(folder / MATCHES_NAME) as temporary:
        np.savez(
            temporary,
            held_out_ref_px=corrected.matches_held_out.ref_px,
            held_out_src_px=corrected.matches_held_out.src_px,
            fitted_ref_px=corrected.matches_fit.ref_px,
            fitted_src_px=corrected.matches_fit.src_px,
        )
    for entry in folder.iterdir():
        if DISPARITY_NAME.fullmatch(entry.name):
            entry.unlink()


def key_of(capture: Capture, facts: CaptureFacts, *, recipe: Recipe, rig: StoredRig | None) -> dict[str, object]:
    """Collect all that a prepared pair depends on.

    Args:
        capture: with the photos.
        facts: stated of it.
        recipe: how it is corrected.
        rig: it is rectified with; None where it came rectified.
    """
    return {
        "format": FORMAT,
        "tele_sha256": fingerprint(capture.tele_path),
        "wide_sha256": fingerprint(capture.wide_path),
        "facts": facts.model_dump(),
        "rig": None if rig is None else plain_rig(rig.rig),
        "correction": recipe.correction.model_dump(),
        "working_width_px": recipe.working_width_px,
        "seed": recipe.seed,
    }


def read_kept(
    capture: Capture, folder: Path, *, key: dict[str, object], recipe: Recipe, rig: StoredRig | None
) -> PreparedPair | None:
    """Read the pair as an earlier call left it; None where it is not there, is not whole, or is of something else.

    Args:
        capture: it was made from.
        folder: of the pair.
        key: by `key_of`.
        recipe: how it is corrected.
        rig: it is rectified with; None where it came rectified.
    """
    try:
        record = read_record(folder / RECORD_NAME, PairRecord)
        if record.key != as_read(key):
            return None
        if any(fingerprint(folder / name) != record.files_sha256[name] for name in files_of_pair(rig)):
            return None
        report = record.report
        if max(abs(report.disparity_p02_px), abs(report.disparity_p98_px)) > MAX_DISPARITY_PX:
            raise ValueError("disparities of no pair")
        ref_px, src_px = _read_held_out(folder / MATCHES_NAME)
        alignment = None
        if rig is not None:
            text = read_regular(folder / SHOT_NAME, most_bytes=MAX_JSON_BYTES).decode()
            alignment = alignment_from_json(text, rig=rig.rig, working_width_px=recipe.working_width_px)
        valid_paths = None if rig is None else (folder / VALID_NAMES[0], folder / VALID_NAMES[1])
        corrected = Capture(capture.name, folder / "tele.png", folder / "wide.png", valid_paths=valid_paths)
        _check_size(capture, corrected, alignment, working_width_px=recipe.working_width_px)
    except (TelewideError, ValueError, KeyError, ArithmeticError):  # corrupt: it is made again
        return None
    held_out = HeldOut(corrected, ref_px, ref_px[:, 0] - src_px[:, 0])
    return PreparedPair(
        source=capture,
        capture=corrected,
        report=report,
        scale=record.scale,
        held_out=held_out,
        alignment=alignment,
        blur=record.blur,
        wide_side=record.wide_side,
    )


def _check_size(capture: Capture, pair: Capture, alignment: Alignment | None, *, working_width_px: int) -> None:
    """Refuse a pair of another size than its photos and its rig give: it would be matched, whatever that takes.

    Raises:
        ValueError: it is.
    """
    found = {read_photo_facts(path).hw for path in (pair.tele_path, pair.wide_path, *(pair.valid_paths or ()))}
    facts = read_photo_facts(capture.tele_path)
    if alignment is not None:
        expected = {alignment.geometry.hw}
    elif facts.hw is not None and facts.kind != "raw":  # LibRaw leaves out borders that the tags of a RAW count
        expected = {narrowed_hw(facts.hw, width_px=working_width_px)}
    else:
        expected = {hw for hw in found if hw is not None and hw[1] <= working_width_px}
    if len(found) != 1 or found != expected:
        raise ValueError("a pair of another size than its photos give")


def files_of_pair(rig: StoredRig | None) -> tuple[str, ...]:
    """Name the files that a record vouches for.

    Args:
        rig: the pair is rectified with; None where it came rectified.
    """
    return ("tele.png", "wide.png", MATCHES_NAME, *(() if rig is None else (SHOT_NAME, *VALID_NAMES)))


def _read_held_out(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    stored = read_npz(path, ("held_out_ref_px", "held_out_src_px"), most_bytes=_MOST_BYTES_OF_MATCHES)
    if any(points.dtype.kind != "f" for points in stored):
        raise ValueError("matches that are no real numbers")
    ref_px, src_px = (np.asarray(points, dtype=np.float64) for points in stored)
    if ref_px.shape != src_px.shape or ref_px.ndim != 2 or ref_px.shape[1] != 2:
        raise ValueError("matches are two times N points")
    if not (np.abs(ref_px) <= MAX_SIDE_PX).all() or not (np.abs(src_px) <= MAX_SIDE_PX).all():
        raise ValueError("matches that lie in no picture")
    return ref_px, src_px
