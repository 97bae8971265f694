"""Rows of the systems that learn: entries of ``benchmark/learned.yaml``, free of torch until they learn."""

from __future__ import annotations

from pydantic import JsonValue

from telewide.assets import BOX_WEIGHTS
from telewide.benchmark.learned import LearnedSystem
from telewide.benchmark.paper.corrected import CORRECTION_SOURCES
from telewide.benchmark.paper.system import Place, Prepared, System, Task

PSMNET = "psmnet"
"""Network whose authors' checkpoints load."""
NETWORK_SOURCES = {
    "guided": ("matching.guided",),
    "iresnet": ("matching.iresnet",),
    "iresnet-s": ("matching.iresnet",),
    "lite": ("matching.lite",),
    "psmnet": ("matching.psmnet_full", "matching.psmnet_blocks"),
    "psmnet-s": ("matching.psmnet", "matching.psmnet_blocks"),
}
"""Modules that a network is made of; one that is not listed depends on all of ``matching``."""
_LEARNING_SOURCES = (
    *(
        "benchmark.paper.chain",
        "benchmark.paper.learner",
        "benchmark.paper.pairs",
        "benchmark.damages",
        "simulate.degrade",
    ),
    *("training.captured_losses", "training.data", "training.loop", "training.losses", "training.objective"),
    *("training.pace", "training.samples", "training.stages"),
    *("matching.inference", "matching.networks", "matching.sampling", "matching.volume", "matching.batch_norm"),
)
_SPACE_SOURCES = {
    "own": (),
    "contrastive": ("training.spaces", "training.contrastive", "matching.psmnet"),
    "auto-encoder": ("training.spaces", "training.auto_encoder"),
}
_RESTORER_SOURCES = ("restoration", "benchmark.paper.restored")


def learned_row(name: str, system: LearnedSystem) -> System:
    """Make a row of a system that learns.

    Args:
        name: by which it is asked for.
        system: what it is made of.
    """

    def prepare(task: Task, place: Place) -> Prepared:
        from telewide.benchmark.paper.learner import prepare_learned

        return prepare_learned(system, task, place, sources=sources)

    recipe = system.resolved()
    sources = (
        *_LEARNING_SOURCES,
        *NETWORK_SOURCES.get(recipe.network, ("matching",)),
        *_SPACE_SOURCES[recipe.train.feature_space],
        *(("simulate.raycast", "training.world_samples") if recipe.train.rehearsal.steps else ()),
        *(CORRECTION_SOURCES if system.corrects else ()),
        *(_RESTORER_SOURCES if system.restorer else ()),
        *(("benchmark.spaces",) if system.shows == "space" else ()),
    )
    facts: dict[str, JsonValue] = {
        "recipe": recipe.model_dump(mode="json", exclude={"description", "seed"}),
        "system": system.model_dump(mode="json", exclude={"title", "recipe", "settings"}),
    }
    return System(
        name,
        system.title,
        prepare,
        sources,
        files=(BOX_WEIGHTS,) if recipe.train.start == "box" else (),
        facts=facts,
        takes=system.restorer or (PSMNET if recipe.network == PSMNET else None),
    )
