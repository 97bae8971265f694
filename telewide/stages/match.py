"""Choice of what matches two corrected views: semi-global matching, or the network of a weights file."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from telewide.assets import BOX_WEIGHTS
from telewide.cores import Device
from telewide.errors import InputError, UsageError
from telewide.files import fingerprint, is_file, is_there
from telewide.matching.matcher import LEARNED_STD, Matcher
from telewide.matching.methods import Method
from telewide.matching.semiglobal import match_semiglobal
from telewide.options import parse_options
from telewide.recipe import Recipe
from telewide.stages.call import Call
from telewide.training.options import WEIGHTS_NAME

if TYPE_CHECKING:
    from telewide.training.checkpoint import WeightsCard


def choose_matcher(call: Call, *, method: Method, weights: Path | None) -> Matcher:
    """Choose the matcher of a call by name; a network is read, and an unfinished training is reported.

    Args:
        call: where no weights are named, its run's newest are taken, and without any those that come with telewide.
        method: how to match.
        weights: a weights file, or None.

    Returns:
        The matcher.

    Raises:
        UsageError: the weights that are named do not exist.
        InputError: the weights cannot be read.
        MissingPartError: cuda was asked for and is not there.
    """
    path = weights or call.folder.weights
    if method != "sgm" and weights is not None and not is_there(weights):  # before torch is imported, for seconds
        raise UsageError(f"{path} does not exist; a weights file was expected")
    if method != "sgm" and weights is None and not is_file(path):
        path = BOX_WEIGHTS
        better = call.invocation.instead("train")
        call.observer.said(f"matched by the network that comes with telewide; made better on your photos: {better}")
    matcher = read_matcher(path, method=method, device=call.device)
    if matcher.doubt is not None:
        goes_on = "" if weights else f"; {call.invocation.instead('train')} goes on"
        call.observer.said(f"{matcher.doubt}{goes_on}")
    return matcher


def read_matcher(weights: Path, *, method: Method, device: Device) -> Matcher:
    """Read a matcher.

    Args:
        weights: a weights file; semi-global matching reads none.
        method: how to match.
        device: of a network: auto, cpu or cuda.

    Returns:
        The matcher; its doubt tells of weights whose training is not finished.

    Raises:
        UsageError: the weights do not exist.
        InputError: they cannot be read.
        MissingPartError: cuda was asked for and is not there.
    """
    if method == "sgm":
        return Matcher("sgm", match_semiglobal)
    from telewide.matching.inference import choose_device, match_with_network
    from telewide.training.checkpoint import load_weights

    network, card = load_weights(weights, device=choose_device(device))
    return Matcher(
        f"{method} {fingerprint(weights)}",
        partial(match_with_network, network=network),
        card.searched_window,
        doubt=_unfinished(weights, card),
        confidence_std=LEARNED_STD if network.has_confidence else None,
    )


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
