"""Choice of what matches two corrected views: semi-global matching, or the network of a weights file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from telewide.assets import BOX_WEIGHTS
from telewide.cores import Device
from telewide.errors import InputError, UsageError
from telewide.files import fingerprint, is_file, is_there
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.matcher import LEARNED_STD, WITH_CONFIDENCE, Match, Matcher
from telewide.matching.methods import Method
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import Window
from telewide.options import parse_options
from telewide.recipe import Recipe
from telewide.stages.call import Call
from telewide.stages.kept_depth import matcher_of
from telewide.training.options import WEIGHTS_NAME
from telewide.training.weights_card import WeightsCard, read_card

if TYPE_CHECKING:
    from telewide.matching.networks import StereoNetwork


def choose_matcher(call: Call, *, method: Method, weights: Path | None, out: Path) -> Matcher:
    """Choose the matcher of a call by name; a network is read, and an unfinished training is reported.

    Where the depth of all captures lies there, made by the same weights, the network is read once something has to be
    matched after all, if ever: that takes longer than all the rest.

    Args:
        call: where no weights are named, its run's newest are taken, and without any those that come with telewide.
        method: how to match.
        weights: a weights file, or None.
        out: folder of the results.

    Returns:
        The matcher.

    Raises:
        UsageError: the weights that are named do not exist.
        InputError: the weights cannot be read.
        MissingPartError: cuda was asked for and is not there.
    """
    path, told = weights or call.folder.weights, None
    if method != "sgm" and weights is not None and not is_there(weights):
        raise UsageError(f"{path} does not exist; a weights file was expected")
    if method != "sgm" and weights is None and not is_file(path):
        path = BOX_WEIGHTS
        training = call.invocation.instead("train")
        told = f"matched by the network that comes with telewide; to adapt it to your photos: {training}"
    goes_on = "" if weights else f"; {call.invocation.instead('train')} goes on"
    matcher = read_matcher(
        path, method=method, device=call.device, doubted=lambda doubt: call.observer.said(f"{doubt}{goes_on}")
    )
    if told is not None:
        matcher = replace(matcher, match=_TellingMatch(matcher.match, partial(call.observer.said, told)))
    lying = {matcher_of(out / capture.name) for capture in call.captures.captures}
    if lying != {matcher.name} or call.device == "cuda":
        matcher.load()
    return matcher


class _TellingMatch:
    """A match that tells something before the first pair."""

    def __init__(self, match: Match, tell: Callable[[], None]) -> None:
        self._match, self._tell, self._is_told = match, tell, False

    def __call__(
        self, ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None
    ) -> DisparityMap:
        """Match two views."""
        if not self._is_told:
            self._tell()
            self._is_told = True
        return self._match(ref, src, window=window, valid=valid)


def read_matcher(
    weights: Path, *, method: Method, device: Device, doubted: Callable[[str], None] | None = None
) -> Matcher:
    """Read what a matcher is; its network is read by ``load``, at the latest before the first match.

    Args:
        weights: a weights file; semi-global matching reads none.
        method: how to match.
        device: of a network: auto, cpu or cuda.
        doubted: is told, when the network is read, of weights whose training is not finished.

    Returns:
        The matcher. Its ``load`` raises InputError where the weights cannot be read, and MissingPartError where cuda
        was asked for and is not there.

    Raises:
        UsageError: the weights do not exist.
        InputError: they are no weights.
    """
    if method == "sgm":
        return Matcher("sgm", match_semiglobal)
    card, stamp = read_card(weights), fingerprint(weights)
    network = _Network(weights, device, stamp=stamp, first=partial(_tell_doubt, weights, card, doubted))
    return Matcher(
        f"{method} {stamp}",
        network.match,
        card.searched_window,
        confidence_std=LEARNED_STD if card.network in WITH_CONFIDENCE else None,
        load=network.network,
    )


class _Network:
    """A network that is read from its file when it is first needed."""

    def __init__(self, weights: Path, device: Device, *, stamp: str, first: Callable[[], None]) -> None:
        self._weights, self._device, self._stamp, self._first = weights, device, stamp, first
        self._read: StereoNetwork | None = None

    def network(self) -> StereoNetwork:
        """Return the network, read once."""
        if self._read is not None:
            return self._read
        from telewide.matching.inference import choose_device
        from telewide.training.checkpoint import load_weights

        read, _ = load_weights(self._weights, device=choose_device(self._device))
        if fingerprint(self._weights) != self._stamp:  # a training goes on there
            raise InputError(f"{self._weights} has changed since this call began", hint="run the command again")
        self._first()
        self._read = read
        return read

    def match(self, ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
        """Match two views."""
        from telewide.matching.inference import match_with_network

        return match_with_network(ref, src, network=self.network(), window=window, valid=valid)


def _tell_doubt(weights: Path, card: WeightsCard, doubted: Callable[[str], None] | None) -> None:
    doubt = None if doubted is None else _unfinished(weights, card)
    if doubted is not None and doubt is not None:
        doubted(doubt)


def _unfinished(weights: Path, card: WeightsCard) -> str | None:
    """State of an unfinished training that still writes a weights file; None where it is finished, or nothing tells."""
    from telewide.matching.inference import choose_device
    from telewide.training.checkpoint import STATE_NAME, load_state
    from telewide.training.stages import plan_stages

    state_path = weights.with_name(STATE_NAME)
    if weights.name != WEIGHTS_NAME or not is_file(state_path):
        return None
    try:
        plan = plan_stages(parse_options(Recipe, card.recipe, source=str(weights), error=InputError).train)
        state = load_state(state_path, network_name=card.network, device=choose_device("cpu"), plan=plan)
    except InputError:  # the weights are whole all the same; `telewide train` will say what is wrong
        return None
    if state.is_finished:
        return None
    stage = plan[state.stage_index]
    place = f"{stage.name}, step {state.step} of {stage.options.steps}"
    return f"the training of these weights is not finished ({place})"
