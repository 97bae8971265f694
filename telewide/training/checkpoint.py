"""Checkpoints of a training, and how it goes on from them.

    train/state.pt               everything needed to continue: weights, average, optimiser, extractor, counters
    train/weights.safetensors    the result so far, for `telewide depth`
    train/<stage>.safetensors    the result of each finished stage

Both kinds are safe to open: safetensors holds tensors and text, ``state.pt`` is read with ``weights_only=True``.
"""

from __future__ import annotations

import copy
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import torch
from pydantic import JsonValue
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from telewide.errors import InputError, UsageError
from telewide.files import refuse_strange_file, replacing
from telewide.matching.checkpoint_files import check_archive
from telewide.matching.networks import StereoNetwork, build_network
from telewide.records import checked, parse_json
from telewide.text import json_text
from telewide.training.spaces import build_space
from telewide.training.stages import Stage
from telewide.training.weights_card import FORMAT, LENGTH_BYTES, WeightsCard, no_weights, read_card

STATE_NAME = "state.pt"


@dataclass
class BestWeights:
    """The weights of a stage that the held-out matches liked best.

    Attributes:
        step: of the stage, at which they were judged.
        judgement: the figure that decides.
        weights: of the running average.
    """

    step: int
    judgement: float
    weights: dict[str, Tensor]


@dataclass
class TrainingState:
    """A training between two steps; the one mutable thing in it.

    Attributes:
        network: what is being trained.
        average: running average of its weights: the result.
        optimiser: of the stage under way.
        teacher: extractor that the stage under way looks through, frozen, or a feature space, while it is taught.
        stage_index: position in the plan.
        step: steps of this stage that are done.
        judgements: of this stage, one each time the held-out matches were asked.
        best: of this stage so far; None before a judgement that counts.
        stage_judgements: the judgement of each finished stage's result.
        is_finished: whether nothing is left to do.
        best_stage: position of the stage whose weights are the result, once finished.
        trained_s: seconds that all steps took, also those before a resumption; judgements are not counted.
    """

    network: StereoNetwork
    average: StereoNetwork
    optimiser: torch.optim.Optimizer
    teacher: nn.Module | None = None
    stage_index: int = 0
    step: int = 0
    judgements: list[float] = field(default_factory=list)
    best: BestWeights | None = None
    stage_judgements: list[float] = field(default_factory=list)
    is_finished: bool = False
    best_stage: int = 0
    trained_s: float = 0.0


def learner_of(state: TrainingState, stage: Stage) -> nn.Module:
    """Learner of a stage: the network, or the feature space.

    Raises:
        ValueError: there is no feature space yet.
    """
    if not stage.is_teaching_space:
        return state.network
    if state.teacher is None:
        raise ValueError(f"stage {stage.name} teaches a feature space, and there is none")
    return state.teacher


def new_optimiser(network: nn.Module) -> torch.optim.Optimizer:
    """Adam with the paper's betas; the loop sets the learning rate at every step."""
    return torch.optim.Adam(network.parameters(), lr=1e-3, betas=(0.9, 0.999))


def new_state(network_name: str, *, seed: int, device: torch.device, weights: Path | None = None) -> TrainingState:
    """A training that has not begun.

    Args:
        network_name: of the network to train.
        seed: of random weights.
        device: to put its tensors on.
        weights: the file to start from; None for random ones.

    Raises:
        UsageError: the file holds another network.
        InputError: the file is missing or corrupt.
    """
    network = build_network(network_name, seed=seed).to(device)
    if weights is not None:
        started, card = load_weights(weights, device=device)
        if card.network != network_name:
            raise UsageError(
                f"{weights.name} holds the network {card.network}, and the recipe trains {network_name}",
                hint=f"take network={card.network}, or train.start=scratch",
            )
        network.load_state_dict(started.state_dict())
    return TrainingState(network, copy.deepcopy(network), new_optimiser(network))


def save_state(state: TrainingState, path: Path) -> None:
    """Write a checkpoint, whole or not at all."""
    content = {
        "format": FORMAT,
        "network": state.network.state_dict(),
        "average": state.average.state_dict(),
        "optimiser": state.optimiser.state_dict(),
        "teacher": None if state.teacher is None else state.teacher.state_dict(),
        "stage_index": state.stage_index,
        "step": state.step,
        "judgements": list(state.judgements),
        "best": None if state.best is None else vars(state.best),
        "stage_judgements": list(state.stage_judgements),
        "is_finished": state.is_finished,
        "best_stage": state.best_stage,
        "trained_s": state.trained_s,
    }
    # Written by Python: torch does not say that a disk is full.
    buffer = io.BytesIO()
    torch.save(content, buffer)
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(buffer.getbuffer())


def load_state(
    path: Path, *, network_name: str, device: torch.device, plan: Sequence[Stage] | None = None
) -> TrainingState:
    """Read a checkpoint.

    Args:
        path: the file.
        network_name: of the network that is trained.
        device: to put its tensors on.
        plan: the stages of the training, which the checkpoint must have a place in; None leaves that open.

    Raises:
        UsageError: there is no such file.
        InputError: the file is corrupt, of another network, or of another plan.
    """
    refuse_strange_file(path)
    try:
        check_archive(path)
        content = torch.load(path, map_location=device, weights_only=True)
        state = new_state(network_name, seed=0, device=device)
        for name, module in (("network", state.network), ("average", state.average)):
            module.load_state_dict(_weights_like(content[name], module))
        for name in ("stage_index", "step", "best_stage"):
            setattr(state, name, _count(content[name]))
        stage = None if plan is None else plan[state.stage_index]
        if content["teacher"] is not None:
            state.teacher = _empty_teacher(state, stage).to(device)
            state.teacher.load_state_dict(_weights_like(content["teacher"], state.teacher))
        if stage is not None and stage.is_teaching_space and state.teacher is not None:
            state.optimiser = new_optimiser(state.teacher)
        _take_moments(state, content["optimiser"]["state"])
        for name in ("judgements", "stage_judgements"):
            setattr(state, name, [_figure(value) for value in content[name]])
        state.is_finished = content["is_finished"] is True
        state.trained_s = _seconds(content.get("trained_s", 0.0))  # older versions kept none
        state.best = None if content["best"] is None else _best_weights(state, content["best"])
        if plan is not None:
            _check_place(state, plan)
    except Exception as error:  # torch and pickle fail on corrupt files in a dozen ways
        raise InputError(
            f"{path} is not a checkpoint of this {network_name} training, or is corrupt",
            hint="train again, from the start or in another run folder",
        ) from error
    return state


def _empty_teacher(state: TrainingState, stage: Stage | None) -> nn.Module:
    """Module that the teacher of a checkpoint is read into: it learns in a stage of its own, else it is frozen."""
    if stage is None or stage.space == "own":
        return frozen_extractor(state.network)
    space = build_space(stage.space)
    return space if stage.is_teaching_space else space.eval().requires_grad_(False)


def _take_moments(state: TrainingState, moments: Mapping[int, Mapping[str, Tensor]]) -> None:
    """Take Adam's moments, and nothing that lies beside them; its rates are the loop's."""
    parameters = [parameter for group in state.optimiser.param_groups for parameter in group["params"]]
    taken: dict[int, dict[str, Tensor]] = {}
    for index, kept in moments.items():
        like = parameters[_count(index)]
        mean, square = _numbers_like(kept["exp_avg"], like), _numbers_like(kept["exp_avg_sq"], like)
        if square.min() < 0:
            raise ValueError("a mean of squares below 0")
        n_steps = _count(int(kept["step"]))
        # Copies: what Adam writes to must not lie in one place under two names.
        taken[index] = {"step": torch.tensor(float(n_steps)), "exp_avg": mean.clone(), "exp_avg_sq": square.clone()}
    groups = state.optimiser.state_dict()["param_groups"]
    state.optimiser.load_state_dict({"state": taken, "param_groups": groups})


def _best_weights(state: TrainingState, plain: Mapping[str, object]) -> BestWeights:
    weights = _weights_like(cast(dict[str, Tensor], plain["weights"]), state.average)
    return BestWeights(_count(plain["step"]), _figure(plain["judgement"]), weights)


def _weights_like(weights: Mapping[str, Tensor], module: nn.Module) -> dict[str, Tensor]:
    """Return the weights of a checkpoint for a module, each of the size and kind that it has."""
    own = module.state_dict()
    if weights.keys() != own.keys():
        raise ValueError("weights of another network")
    return {name: _numbers_like(weights[name], like) for name, like in own.items()}


def _numbers_like(value: object, like: Tensor) -> Tensor:
    """Return a tensor that is of the size and kind of another one, and holds finite numbers."""
    if not isinstance(value, Tensor) or value.shape != like.shape:
        raise ValueError("something else than a tensor of this size")
    if (value.dtype, value.layout, value.device.type) != (like.dtype, like.layout, like.device.type):
        raise ValueError(f"{value.dtype} on {value.device}, {like.dtype} was expected")
    if not torch.isfinite(value).all():
        raise ValueError("values that are no numbers")
    return value


def _check_place(state: TrainingState, plan: Sequence[Stage]) -> None:
    """Refuse a place in the plan that no training comes to."""
    stage = plan[state.stage_index]
    n_judged = state.stage_index + state.is_finished
    if state.step > stage.options.steps or len(state.judgements) > state.step + 1:
        raise ValueError("more steps or judgements than the stage has")
    if len(state.stage_judgements) != n_judged or state.best_stage >= max(1, n_judged):
        raise ValueError("the finished stages do not go with the stage under way")
    needs_teacher = stage.needs_teacher or stage.is_teaching_space
    if state.step and not state.is_finished and needs_teacher and state.teacher is None:
        raise ValueError("the extractor of the stage before is missing")


def _count(value: object) -> int:
    if type(value) is not int or value < 0:
        raise TypeError(f"{type(value).__name__} is no number of steps")
    return value


def _seconds(value: object) -> float:
    seconds = _figure(value)
    if not 0 <= seconds < math.inf:
        raise ValueError(f"{seconds} is no time")
    return seconds


def _figure(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{type(value).__name__} is no figure")
    return float(value)


def frozen_extractor(network: StereoNetwork) -> nn.Module:
    """A copy of Phi_F in eval mode that never learns."""
    return copy.deepcopy(network.features).eval().requires_grad_(False)


def save_weights(network: StereoNetwork, path: Path, *, card: WeightsCard) -> None:
    """Write weights with their card, whole or not at all."""
    metadata = {
        "format": FORMAT,
        "network": card.network,
        "window": json_text(card.window),
        "recipe": json_text(card.recipe),
        "training": json_text(card.training),
    }
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    content = _with_facts_in_order(save(tensors, metadata=metadata))
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def _with_facts_in_order(content: bytes) -> bytes:
    """Sort what a safetensors file says of itself, which comes in any order: equal weights are equal files."""
    end = LENGTH_BYTES + int.from_bytes(content[:LENGTH_BYTES], "little")
    header = checked(parse_json(content[LENGTH_BYTES:end]), dict[str, dict[str, JsonValue]])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json_text(header).encode()
    text += b" " * (-len(text) % LENGTH_BYTES)  # tensors begin at a multiple of it
    return len(text).to_bytes(LENGTH_BYTES, "little") + text + content[end:]


def load_weights(path: Path, *, device: torch.device) -> tuple[StereoNetwork, WeightsCard]:
    """Read a network with its card.

    Raises:
        UsageError: there is no such file.
        InputError: the file is corrupt, or holds something else.
    """
    card = read_card(path)
    try:
        network = build_network(card.network)
        network.load_state_dict(load_file(path))
        if not all(bool(torch.isfinite(tensor).all()) for tensor in network.state_dict().values()):
            raise ValueError("weights that are no numbers")
    except UsageError as error:
        raise InputError(f"{path}: {error.message}", hint=error.hint) from error
    except (OSError, SafetensorError, ValueError, RuntimeError) as error:
        raise no_weights(path) from error
    return network.to(device).eval(), card
