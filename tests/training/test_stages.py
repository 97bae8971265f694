"""The order of training, and what every shipped recipe resolves to: tables written out by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from telewide.recipe import DEFAULT_RECIPE, load_recipe
from telewide.training.options import StageOptions, TrainOptions
from telewide.training.stages import Stage, ending_with, plan_stages

# stage: steps, learning rate, rehearsed, retaken and real crops, loss of the real ones and its weight, alpha, lambda,
# masks, exchange
Line = tuple[int, float, int, int, int, str, float, float, float, bool, bool]
NO_REAL_CROPS = (0, "photometric", 1.0, 3.0, 0.1, True, False)
AS_PUBLISHED = (0, 0, 2, "feature", 1.0, 3.0, 0.5, False, True)
RECIPES: dict[str, tuple[str, float, dict[str, Line]]] = {
    "default": (
        "guided",
        0.9985,
        {"rehearsal": (600, 2e-4, 1, 3, *NO_REAL_CROPS)},
    ),
    "quick": (
        "guided",
        0.995,
        {"rehearsal": (150, 2e-4, 1, 2, *NO_REAL_CROPS)},
    ),
    "box": (
        "guided",
        0.999,
        {"rehearsal": (24000, 5e-4, 4, 0, *NO_REAL_CROPS)},
    ),
    "paper": (
        "psmnet-s",
        0.0,
        {
            "photometric": (1800, 1e-3, 0, 0, 2, "photometric", 1.0, 3.0, 0.1, False, True),
            "feature-1": (400, 1e-4, *AS_PUBLISHED),
            "feature-2": (400, 1e-4, *AS_PUBLISHED),
            "feature-3": (400, 1e-4, *AS_PUBLISHED),
        },
    ),
}


def line_of(options: StageOptions) -> Line:
    return (
        options.steps,
        options.learning_rate,
        options.rehearsed,
        options.retaken,
        options.captured,
        options.captured_loss,
        options.captured_weight,
        options.alpha,
        options.smoothness,
        options.occlusion_masks,
        options.swaps_views,
    )


@pytest.mark.parametrize("name", RECIPES)
def test_a_shipped_recipe_resolves_to_its_stages(name: str) -> None:
    network, average_decay, stages = RECIPES[name]
    recipe = load_recipe(name)
    assert recipe.network == network
    assert recipe.train.average_decay == average_decay
    plan = plan_stages(recipe.train)
    assert {stage.name: line_of(stage.options) for stage in plan} == stages
    assert [stage.name for stage in plan] == list(stages)
    assert [stage.index for stage in plan] == list(range(len(plan)))


def test_a_recipe_that_names_no_network_takes_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("train: {start: box}\n")
    assert load_recipe(str(path)).network == load_recipe(DEFAULT_RECIPE).network


def test_every_shipped_recipe_is_in_the_table(repo: Path) -> None:
    assert {path.stem for path in (repo / "pipelines").glob("*.yaml")} == set(RECIPES)


def test_recipes_for_captures_begin_with_the_network_in_the_box_and_the_papers_does_not() -> None:
    assert {name: load_recipe(name).train.start for name in RECIPES} == {
        **dict.fromkeys(("default", "quick"), "box"),
        **dict.fromkeys(("paper", "box"), "scratch"),
    }


def test_feature_metric_stages_alone_need_the_extractor_of_the_stage_before() -> None:
    for name in RECIPES:
        for stage in plan_stages(load_recipe(name).train):
            assert stage.needs_teacher == stage.name.startswith("feature-")
            assert stage.needs_surfaces == (load_recipe(name).train.start == "box")
            assert not stage.needs_truth


@pytest.mark.parametrize(
    ("options", "needs"),
    [
        ({"captured": 1, "captured_loss": "feature"}, {"teacher"}),
        ({"rehearsed": 1, "captured_loss": "feature"}, set()),
        ({"captured": 1, "captured_loss": "supervised"}, {"truth"}),
        ({"rehearsed": 1, "captured_loss": "supervised"}, set()),
        ({"captured": 1, "captured_loss": "photometric"}, set()),
        ({"retaken": 1}, {"surfaces"}),
    ],
)
def test_what_a_stage_needs_follows_from_its_crops(options: dict[str, object], needs: set[str]) -> None:
    stage = Stage("some", 0, StageOptions.model_validate({"steps": 1, **options}))
    found = {"teacher": stage.needs_teacher, "truth": stage.needs_truth, "surfaces": stage.needs_surfaces}
    assert {name for name, is_needed in found.items() if is_needed} == needs


def test_stages_without_steps_are_left_out_and_the_others_counted_on() -> None:
    stage = {"steps": 5, "captured": 1}
    plan = plan_stages(TrainOptions.model_validate({"stages": 2, "photometric": stage, "feature": stage}))
    assert [(stage.name, stage.index) for stage in plan] == [("photometric", 0), ("feature-1", 1), ("feature-2", 2)]
    assert plan_stages(TrainOptions.model_validate({"stages": 0, "feature": stage})) == ()


@pytest.mark.parametrize("space", ["own", "auto-encoder"])
def test_a_plan_ends_with_any_of_its_stages(space: str) -> None:
    stage, taught = {"steps": 5, "rehearsed": 1}, {"steps": 5, "captured": 1}
    own = {} if space == "own" else {"space": taught, "feature_space": space}
    sections = {"rehearsal": stage, "photometric": taught, "feature": {**taught, "captured_loss": "feature"}, **own}
    options = TrainOptions.model_validate({"stages": 2, **sections})
    plan = plan_stages(options)
    assert len(plan) == (4 if space == "own" else 5)
    for stage_ in plan:
        shorter = ending_with(options, stage_)
        names = [(each.name, each.index, each.options) for each in plan_stages(shorter)]
        assert names == [(each.name, each.index, each.options) for each in plan[: stage_.index + 1]]
        TrainOptions.model_validate(shorter.model_dump())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"asymmetry": (4, 2)}, "from the smaller factor to the larger"),
        ({"feature": {"steps": 5, "captured": 1, "captured_loss": "feature"}}, "photometric.steps above 0"),
    ],
)
def test_options_that_contradict_are_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        TrainOptions.model_validate(options)


def test_least_steps_beyond_a_stage_are_its_last() -> None:
    lengths = [StageOptions(steps=steps, least_steps=600, captured=1).counts_from for steps in (300, 600, 900)]
    assert lengths == [300, 600, 600]
