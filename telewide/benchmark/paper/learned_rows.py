"""Rows of the systems that learn: entries of ``benchmark/learned.yaml``, free of torch until they learn."""

from __future__ import annotations

from pydantic import JsonValue

from telewide.assets import BOX_WEIGHTS
from telewide.benchmark.learned import LearnedSystem
from telewide.benchmark.paper.sources import SURVEYING, training_entries
from telewide.benchmark.paper.system import Place, Prepared, System, Task
from telewide.training.stages import plan_stages

PSMNET = "psmnet"
"""Network whose authors' checkpoints load."""


def learned_row(name: str, system: LearnedSystem) -> System:
    """Make a row of a system that learns.

    Args:
        name: by which it is asked for.
        system: what it is made of.
    """

    def prepare(task: Task, place: Place) -> Prepared:
        from telewide.benchmark.paper.learner import prepare_learned

        return prepare_learned(system, task, place)

    recipe = system.resolved()
    stages = plan_stages(recipe.train)
    entries = training_entries(recipe.network, stages)
    if recipe.train.rehearsal.steps:
        entries += ("benchmark.paper.coarseness",)
    if any(stage.needs_surfaces for stage in stages):
        entries += SURVEYING
    if system.corrects:
        entries += ("benchmark.paper.corrected",)
    if system.restorer:
        entries += ("benchmark.paper.restored", f"restoration.restorers:{system.restorer}")
    if system.shows == "space":
        entries += ("benchmark.spaces",)
    facts: dict[str, JsonValue] = {
        "recipe": recipe.model_dump(mode="json", exclude={"description", "seed"}),
        "system": system.model_dump(mode="json", exclude={"title", "recipe", "settings"}),
    }
    return System(
        name,
        system.title,
        prepare,
        entries,
        files=(BOX_WEIGHTS,) if recipe.train.start == "box" else (),
        facts=facts,
        takes=system.restorer or (PSMNET if recipe.network == PSMNET else None),
    )
