"""Depth as ``telewide depth`` writes it, of any matcher, on pairs that are corrected once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from telewide.capture.pair import find_captures, read_pair
from telewide.depth.result import DepthResult
from telewide.geometry.arrays import FloatMap
from telewide.matching.matcher import Matcher
from telewide.matching.window import Window, joined_window
from telewide.recipe import Recipe
from telewide.stages.depth import shot_geometry
from telewide.stages.pairs import PreparedPair, PreparedSet
from telewide.stages.photo_depth import depth_on_photo
from telewide.stages.prepare import prepare_captures
from telewide.stages.rig import locate_rig, refuse_without_rig
from telewide.stages.run_folder import RunFolder


@dataclass(frozen=True)
class JudgedSet:
    """Captures to judge matchers on.

    Attributes:
        prepared: their corrected pairs.
        window: what every matcher searches, px.
    """

    prepared: PreparedSet
    window: Window

    def depth(self, item: PreparedPair, matcher: Matcher, *, photo: FloatMap) -> DepthResult:
        """Match one pair and bring the result to the photo's own size and edges.

        Args:
            item: the pair.
            matcher: what makes its disparity.
            photo: (H, W, 3) its tele photo.
        """
        pair = read_pair(item.capture)
        working = matcher.match(pair.tele, pair.wide, window=self.window, valid=pair.valid)
        shot = shot_geometry(item, self.prepared, matcher=matcher)
        facts = self.prepared.facts.model_copy(update={"wide_side": item.wide_side})
        return depth_on_photo(working, photo, name=item.capture.name, facts=facts, shot=shot)[0]


def judged_set(
    captures_root: Path, matchers: Sequence[Matcher], *, run: RunFolder, recipe: Recipe, rig: Path | None
) -> JudgedSet:
    """Correct the pairs of a folder, or find them corrected.

    Args:
        captures_root: folder of the captures.
        matchers: what is judged.
        run: its corrected pairs are used; they are made where they are missing.
        recipe: what is corrected.
        rig: rig file, or None for the one that lies by the captures.

    Raises:
        InputError: no capture can be used.
    """
    captures = find_captures(captures_root)
    stored_rig = locate_rig(rig, captures)
    refuse_without_rig(captures, rig=stored_rig)
    prepared = prepare_captures(captures, run, recipe=recipe, rig=stored_rig)
    trained = [matcher.window for matcher in matchers if matcher.window is not None]
    return JudgedSet(prepared, joined_window([prepared.window, *trained]))
