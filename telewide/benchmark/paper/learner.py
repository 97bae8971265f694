"""Systems that learn, made ready to answer: what they see, what they are trained on, and what of it is judged.

Letters: B batch, C channels, H W image.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import torch
from pydantic import JsonValue
from torch import nn
from torch.nn import functional

from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.learned import LearnedSystem
from telewide.benchmark.paper.chain import Chain, Link, train_chain
from telewide.benchmark.paper.coarseness import coarser_by
from telewide.benchmark.paper.corrected import corrected_view
from telewide.benchmark.paper.pairs import write_pairs
from telewide.benchmark.paper.restored import restored_view
from telewide.benchmark.paper.sources import source_fingerprint
from telewide.benchmark.paper.system import (
    BEST,
    LAST,
    Encoder,
    Matcher,
    Place,
    Prepared,
    SecondView,
    Task,
    content_fingerprint,
    enlarged_view,
    undamaged_view,
)
from telewide.benchmark.spaces import match_features
from telewide.errors import InputError
from telewide.geometry.arrays import FloatMap
from telewide.matching.inference import GRID_PX, choose_device, full_precision, match_with_network
from telewide.matching.networks import StereoNetwork, comparable_map, prepare_view, published_psmnet
from telewide.matching.sampling import pad_to_multiple
from telewide.matching.window import Window
from telewide.points.held_out import summarise_errors
from telewide.stages.surfaces import surveyor_of
from telewide.stages.train import USUAL_ASYMMETRY
from telewide.training.checkpoint import STATE_NAME, load_state, load_weights
from telewide.training.judge import Judge
from telewide.training.loop import best_name
from telewide.training.options import TrainOptions
from telewide.training.stages import SPACE_STAGE, Stage, plan_stages


def prepare_learned(system: LearnedSystem, task: Task, place: Place) -> Prepared:
    """Train a system on a task, or take what is kept.

    Args:
        system: what it is made of.
        task: what it may learn from.
        place: where it is kept.

    Raises:
        UsageError: its restorer cannot enlarge by the task's factor.
        InputError: there is nothing to learn from, or a file cannot be read.
        TelewideError: the training diverges.
    """
    recipe, device = system.resolved(seed=task.seed), choose_device(task.device)
    plan = plan_stages(recipe.train)
    if system.restorer is None and (files := task.weights.get(recipe.network)):
        return Prepared({"": _matcher(published_psmnet(files[0]).to(device))})
    view, view_facts = _second_view(system, plan, task, place)
    shown = undamaged_view(task) if plan[-1].options.symmetric_input else view
    pairs = write_pairs(
        task, place, second_view=view, view_facts=view_facts, teaches_by=_teaches_by(recipe.train, plan)
    )
    chain = Chain(
        recipe=recipe,
        first_share=system.first_share,
        task=task,
        place=place,
        pairs=pairs,
        judge=truth_judge(task, shown),
        judge_facts={
            "scenes": [content_fingerprint(scene.read()) for scene in task.validation],
            "undamaged": plan[-1].options.symmetric_input,
        },
        asymmetry=(coarser_by(pairs.captures) or USUAL_ASYMMETRY) if recipe.train.rehearsal.steps else USUAL_ASYMMETRY,
    )
    if system.shows == "space":
        is_taught = any(stage.is_teaching_space for stage in plan)
        link = train_chain(chain, device=device, until=SPACE_STAGE if is_taught else None)
        encoder = space_encoder(_features(link, recipe.network, device))
        return Prepared({"": partial(_match_in_space, encoder)}, shown, encoder, steps=link.steps)
    link = train_chain(chain, device=device)
    return Prepared(_matchers(link, bool(task.validation), device), shown, steps=link.steps)


def _second_view(
    system: LearnedSystem, plan: tuple[Stage, ...], task: Task, place: Place
) -> tuple[SecondView, dict[str, JsonValue]]:
    """Second view of the pairs that a system learns from, and all that it depends on."""
    if all(stage.options.symmetric_input and stage.options.symmetric_loss for stage in plan):
        return undamaged_view(task), {"view": "undamaged"}
    facts: dict[str, JsonValue] = {
        "view": "enlarged",
        "damage": task.damage.model_dump(mode="json", exclude={"description"}),
        "factor": task.factor,
        "seed": task.seed,
        "sources": source_fingerprint(["benchmark.paper.system"]),
    }
    if system.restorer is not None:
        view, restorer_facts = restored_view(system.restorer, task, place)
        return view, {**facts, "view": "restored", **restorer_facts}
    if system.corrects:
        return corrected_view(task), {
            **facts,
            "view": "corrected",
            "by": source_fingerprint(["benchmark.paper.corrected"]),
        }
    return enlarged_view(task), facts


def _teaches_by(options: TrainOptions, plan: tuple[Stage, ...]) -> str | None:
    if any(stage.needs_truth for stage in plan):
        return "truth"
    if not any(stage.needs_surfaces for stage in plan):
        return None
    surveyor = surveyor_of(options)
    return f"surfaces-{surveyor}" if surveyor else "surfaces"


def truth_judge(task: Task, shown: SecondView) -> Judge:
    """Bind the validation scenes of a task into a judge, which knows their truth; every pixel counts the same.

    Args:
        task: names the scenes.
        shown: what a network sees as their second view.

    Returns:
        A function from a network to the shares of `summarise_errors`; NaN where there is no scene.
    """
    pairs: list[StereoTruth] = []  # made when they are first asked for

    def judge(network: StereoNetwork) -> dict[str, float]:
        if not pairs:
            sharp = [(scene.name, scene.read()) for scene in task.validation]
            pairs.extend(replace(truth, right=shown(name, truth)) for name, truth in sharp)
        errors_px = [np.empty(0, np.float32)]
        for truth in pairs:
            found = match_with_network(truth.left, truth.right, network=network, window=task.window)
            known = np.isfinite(truth.disparity_px)
            errors_px.append(np.abs(found.disparity_px - truth.disparity_px)[known])
        return summarise_errors(np.concatenate(errors_px).astype(np.float64))

    return judge


def _matchers(link: Link, has_validation: bool, device: torch.device) -> dict[str, Matcher]:
    """The last weights of a stage and, where something judged them, the best."""
    files = {LAST: f"{link.stage.name}.safetensors"}
    if has_validation:
        files[BEST] = best_name(link.stage)
    networks = {name: load_weights(link.folder / file, device=device)[0] for name, file in files.items()}
    return {name: _matcher(network) for name, network in networks.items()}


def _matcher(network: StereoNetwork) -> Matcher:
    return lambda ref, src, window: match_with_network(ref, src, network=network, window=window).disparity_px


def _match_in_space(encoder: Encoder, ref: FloatMap, src: FloatMap, window: Window) -> FloatMap:
    return match_features(encoder(ref), encoder(src), window=window)


def _features(link: Link, network_name: str, device: torch.device) -> nn.Module:
    """The feature space that a stage taught, or the features of the network itself."""
    if not link.stage.is_teaching_space:
        return load_weights(link.folder / f"{link.stage.name}.safetensors", device=device)[0].features
    state = load_state(link.folder / STATE_NAME, network_name=network_name, device=device, plan=link.plan)
    if state.teacher is None:
        raise InputError(f"{link.folder / STATE_NAME} holds no feature space", hint="remove it, and train again")
    return state.teacher


def space_encoder(features: nn.Module) -> Encoder:
    """Make a module of features show a view in its space, enlarged to the view's own size.

    Args:
        features: a Phi_F, or a feature space; put into eval mode.

    Returns:
        (H, W, 3) in [0, 1] to (H, W, C) float32.
    """
    features.eval()
    device = next(features.parameters()).device

    @torch.inference_mode()
    def encode(view: FloatMap) -> FloatMap:
        height, width = view.shape[:2]
        image_BCHW = torch.from_numpy(np.ascontiguousarray(view.transpose(2, 0, 1)))[None].to(device)
        padded = pad_to_multiple(prepare_view(features, image_BCHW), multiple=GRID_PX)
        with full_precision():
            shown = comparable_map(features, padded)
        whole = functional.interpolate(shown, size=padded.shape[-2:], mode="bilinear", align_corners=False)
        return np.ascontiguousarray(whole[0, :, :height, :width].permute(1, 2, 0).cpu().numpy())

    return encode
