"""What a training leaves on disk, and how it goes on from there.

    train/state.pt               everything needed to continue: weights, average, optimiser, extractor, counters
    train/weights.safetensors    the result so far, for `telewide depth`
    train/<stage>.safetensors    the result of each finished stage

Both kinds are safe to open: safetensors holds tensors and text, ``state.pt`` is read with ``weights_only=True``.
"""

from __future__ import annotations

import copy
import io
import json
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn

from telewide.errors import InputError
from telewide.files import replacing
from telewide.matching.networks import StereoNetwork, build_network
from telewide.matching.window import Window

FORMAT = "1"
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
        teacher: frozen extractor of the stage before, where the stage under way needs one.
        stage_index: position in the plan.
        step: steps of this stage that are done.
        judgements: of this stage, one each time the held-out matches were asked.
        best: of this stage so far; None before a judgement that counts.
        stage_judgements: the judgement of each finished stage's result.
        is_finished: whether nothing is left to do.
        best_stage: position of the stage whose weights are the result, once finished.
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


def new_optimiser(network: nn.Module) -> torch.optim.Optimizer:
    """Adam with the paper's betas; the loop sets the learning rate at every step."""
    return torch.optim.Adam(network.parameters(), lr=1e-3, betas=(0.9, 0.999))


def new_state(network_name: str, *, seed: int, device: torch.device) -> TrainingState:
    """A training that has not begun."""
    network = build_network(network_name, seed=seed).to(device)
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
    }
    # Written by Python: torch does not say that a disk is full.
    buffer = io.BytesIO()
    torch.save(content, buffer)
    with replacing(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def load_state(path: Path, *, network_name: str, device: torch.device) -> TrainingState:
    """Read a checkpoint.

    Raises:
        InputError: the file is damaged, or of another network.
    """
    state = new_state(network_name, seed=0, device=device)
    try:
        content = torch.load(path, map_location=device, weights_only=True)
        state.network.load_state_dict(content["network"])
        state.average.load_state_dict(content["average"])
        state.optimiser.load_state_dict(content["optimiser"])
        if content["teacher"] is not None:
            state.teacher = frozen_extractor(state.network)
            state.teacher.load_state_dict(content["teacher"])
        if content["best"] is not None:
            state.best = BestWeights(**content["best"])
        for name in ("stage_index", "step", "judgements", "stage_judgements", "is_finished", "best_stage"):
            setattr(state, name, content[name])
    except (RuntimeError, KeyError, TypeError, ValueError, EOFError, pickle.UnpicklingError) as error:
        raise InputError(
            f"{path} is not a checkpoint of a {network_name} training, or is damaged",
            hint="start over with --fresh, or name another run folder with --out",
        ) from error
    return state


def frozen_extractor(network: StereoNetwork) -> nn.Module:
    """A copy of Phi_F in eval mode that never learns."""
    return copy.deepcopy(network.features).eval().requires_grad_(False)


@dataclass(frozen=True)
class WeightsCard:
    """What a weights file says of itself.

    Attributes:
        network: name of the network.
        window: disparities it was trained for, px.
        recipe: resolved recipe, as plain data.
        training: stage, step and judgement the weights come from.
    """

    network: str
    window: Window
    recipe: Mapping[str, object]
    training: Mapping[str, object]


def save_weights(network: StereoNetwork, path: Path, *, card: WeightsCard) -> None:
    """Write weights with their card, whole or not at all."""
    metadata = {
        "format": FORMAT,
        "network": card.network,
        "window": json.dumps(list(card.window)),
        "recipe": json.dumps(card.recipe),
        "training": json.dumps(card.training),
    }
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    content = save(tensors, metadata=metadata)
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def load_weights(path: Path, *, device: torch.device) -> tuple[StereoNetwork, WeightsCard]:
    """Read a network with its card.

    Raises:
        InputError: the file is missing, damaged, or holds something else.
    """
    card = read_card(path)
    try:
        network = build_network(card.network)
        network.load_state_dict(load_file(path))
    except (OSError, SafetensorError, ValueError, RuntimeError) as error:
        raise _no_weights(path) from error
    return network.to(device).eval(), card


def read_card(path: Path) -> WeightsCard:
    """Read what a weights file says of itself.

    Raises:
        InputError: the file is missing, damaged, or holds something else.
    """
    try:
        with safe_open(path, framework="pt") as opened:
            metadata = opened.metadata() or {}
        first, end = json.loads(metadata["window"])
        recipe, training = json.loads(metadata["recipe"]), json.loads(metadata["training"])
        return WeightsCard(metadata["network"], (int(first), int(end)), recipe, training)
    except (OSError, SafetensorError, KeyError, ValueError, TypeError) as error:
        raise _no_weights(path) from error


def _no_weights(path: Path) -> InputError:
    return InputError(
        f"{path} is no weights file of telewide, or is damaged", hint="make one with: telewide train captures/"
    )
