"""Corrected pairs of a capture folder, as the stages after the correction take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from telewide.calibration.rig_file import StoredRig
from telewide.capture.facts import WideSide
from telewide.capture.pair import Capture, CaptureFacts, Problem
from telewide.correction.blur import BlurEstimate, damage_range
from telewide.correction.verdict import PairReport
from telewide.errors import InputError
from telewide.matching.window import Window, check_stated_window, joined_window, measured_window
from telewide.points.held_out import HeldOut
from telewide.stages.align import Alignment
from telewide.stages.pair_record import RECORD_NAME
from telewide.stages.rig import how_to_calibrate
from telewide.text import command_line


@dataclass(frozen=True)
class PreparedPair:
    """A corrected pair in the run folder.

    Attributes:
        source: the capture it was made from.
        capture: the corrected pair, to be read like a capture.
        report: what was measured on the photos.
        scale: working size over the photo's size.
        held_out: its matches that no fit has seen.
        alignment: geometry between the corrected pair and the photos; None where they were rectified when they came.
        blur: how much softer wide is; None where matches are too few to tell.
        wide_side: of photos that were rectified when they came: where wide stands, "left" for a mirrored pair.
        is_kept: whether a former call made it.
    """

    source: Capture
    capture: Capture
    report: PairReport
    scale: float
    held_out: HeldOut
    alignment: Alignment | None = None
    blur: BlurEstimate | None = None
    wide_side: WideSide = "right"
    is_kept: bool = False


@dataclass(frozen=True)
class PreparedSet:
    """All usable pairs of a capture folder.

    Attributes:
        pairs: sorted by name, never empty.
        facts: what the owner states.
        stated_window: disparities to search that the recipe states, px at the working size; None for measured ones.
        problems: captures left out, and why.
        rig: what the photos were rectified with; None without.
        root: the folder.
    """

    pairs: tuple[PreparedPair, ...]
    facts: CaptureFacts
    stated_window: Window | None
    problems: tuple[Problem, ...]
    rig: StoredRig | None = None
    root: Path = field(kw_only=True)

    @property
    def window(self) -> Window:
        """Disparities to search: stated, or measured on all pairs.

        Raises:
            InputError: nothing states them, and there are too few matches to measure them.
        """
        return self.window_with(None)

    def _where_to_look(self) -> str:
        record = self.pairs[0].capture.tele_path.parent / RECORD_NAME
        others = f", and so on for the other {len(self.pairs) - 1}" if len(self.pairs) > 1 else ""
        stating = command_line("train", self.root, set="window_px=[0,64]")
        return f"see what was measured in {record}{others}; a training may be told what to search: {stating}"

    def window_with(self, former: Window | None) -> Window:
        """Disparities to search by what has searched other captures before.

        Args:
            former: what it was trained for or has searched, px; None where nothing is known.

        Returns:
            The stated window, or one that holds both the former and what these pairs need, px.

        Raises:
            InputError: nothing states, measures or remembers a window.
        """
        try:
            ranges_px = [pair.report.disparity_range_px for pair in self.pairs]
            return window_to_search(ranges_px, stated=self.stated_window, former=former)
        except InputError as error:
            hint = error.hint or self._where_to_look()
            if self.rig is None and not self.facts.rectified:
                hint += f"; photos as they were taken need a rig, {how_to_calibrate(self.root)}"
            raise InputError(error.message, hint=hint) from error

    @property
    def damage_factor(self) -> tuple[float, float] | None:
        """Factor by which wide is coarser, least and most over the pairs.

        Measured by their blur; where matches are too few for that, by rig, matches or EXIF; None where nothing tells.
        """
        damage = damage_range([pair.blur for pair in self.pairs if pair.blur is not None])
        if damage is not None:
            return damage.factor
        stated = [pair.alignment.asymmetry.factor for pair in self.pairs if pair.alignment is not None]
        known = [factor for factor in stated if factor is not None]
        return (min(known), max(known)) if known else None


def window_to_search(
    ranges_px: Sequence[tuple[float, float] | None], *, stated: Window | None, former: Window | None
) -> Window:
    """Disparities to search: stated, or what the matches need together with what has been searched before.

    Args:
        ranges_px: least and largest disparity of each pair, px; None where its matches do not tell.
        stated: by whoever asks; None where nobody does.
        former: what a network was trained for or has searched; taken alone where matches do not tell.

    Raises:
        InputError: nothing states, measures or remembers a window.
    """
    if stated is not None:
        return stated
    try:
        measured = measured_window(ranges_px)
        return _believable(measured if former is None else joined_window((former, measured)))
    except InputError:
        if former is None:
            raise
        return former


def _believable(window: Window) -> Window:
    try:
        check_stated_window(window)
    except ValueError as error:
        hint = "state window_px in the recipe, or leave the captures out whose disparities are so large"
        raise InputError(f"{error}: so far apart are the matches of these pairs", hint=hint) from error
    return window
