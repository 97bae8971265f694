"""Sources of a row: the modules whose functions run when it is computed, as the interpreter itself reports them."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import FrameType

import pytest
from benchmark.paper.small_task import COLUMN, Told, scenes_of, task_of, write_scenes

from telewide.benchmark.learned import LearnedSystem, read_learned_systems
from telewide.benchmark.paper.cells import MEASURING, CellPlan, Cells
from telewide.benchmark.paper.learned_rows import learned_row
from telewide.benchmark.paper.sources import (
    CANNOT_MATTER,
    FOR_SOME_ROWS,
    PACKAGE,
    SURVEYING,
    TABLES,
    YET_COUNTED,
    find_modules,
    is_counted,
    source_fingerprint,
    training_entries,
)
from telewide.benchmark.paper.system import System
from telewide.benchmark.paper.systems import SYSTEMS
from telewide.matching.networks import NETWORKS, build_network
from telewide.restoration.restorers import RESTORERS, build_restorer
from telewide.training.stages import plan_stages

SMALL = ("train.crop_hw=[64, 96]", "train.photometric.captured=1", "train.feature.captured=1")


def small_row(*settings: str, **changes: object) -> System:
    """A row as small as its stages allow."""
    system = {"title": "Small", "network": "lite", "settings": (*SMALL, *settings), **changes}
    return learned_row("small", LearnedSystem.model_validate(system))


def of_space(name: str) -> tuple[str, ...]:
    return "train.stages=1", f"train.feature_space={name}", "train.space.steps=2", "train.space.captured=1"


ROWS = {
    **{name: SYSTEMS[name] for name in ("sgm-opencv", "sgm", "ours", "image-space")},
    "method": small_row("train.stages=1"),
    "contrastive": small_row(*of_space("contrastive"), shows="space"),
    "auto-encoder": small_row(*of_space("auto-encoder")),
    "restored": small_row("train.stages=0", restorer="rcan"),
    "of-the-box": small_row("train.rehearsal.rehearsed=1", network="guided", recipe="default", corrects=True),
}

SLOW = {"restored", "of-the-box", "auto-encoder"}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data")
    write_scenes(root)
    return root


def is_beneath_what_reads(frame: FrameType | None) -> bool:
    """Whether a call serves to read a scene, whose content is in every key, or to draw."""
    while frame is not None:
        if any(part in frame.f_code.co_filename for part in ("telewide/benchmark/datasets/", "paper/pictures.py")):
            return True
        frame = frame.f_back
    return False


@contextmanager
def modules_that_run() -> Iterator[set[str]]:
    """The modules of telewide any of whose functions is called within the block, but for reading scenes and drawing."""
    files: set[str] = set()

    def called(frame: FrameType, event: str, _argument: object) -> None:
        file = frame.f_code.co_filename
        if event == "call" and file.startswith(str(PACKAGE)) and file not in files and not is_beneath_what_reads(frame):
            files.add(file)

    names: set[str] = set()
    sys.setprofile(called)
    try:
        yield names
    finally:
        sys.setprofile(None)
        names.update(".".join(Path(file).relative_to(PACKAGE).with_suffix("").parts) for file in files)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in ROWS]
)
def test_what_runs_for_a_row_is_what_its_key_is_made_of(data: Path, tmp_path: Path, name: str) -> None:
    import_module("telewide.benchmark.paper.learner")  # so that what a module does as it loads is not seen
    cells, row = Cells(tmp_path, Told()), ROWS[name]
    plan = CellPlan(row, COLUMN, task_of(data, steps=4), scenes_of(data, "test"))
    with modules_that_run() as run:
        ((_, rows),) = cells.rows([plan])
    assert rows, cells.problems
    sources = set(find_modules([*row.sources, *MEASURING]))
    # Where a stage rehearses nothing, the worlds of nobody's crops are named and none is cast.
    assert {module for module in run if is_counted(module)} - sources <= {"training.world_samples"}
    assert len(run & sources) > len(sources) / 3


def planted(tmp_path: Path, module: str) -> Path:
    """A copy of the package with a line more in one module."""
    copy = tmp_path / module / PACKAGE.name
    shutil.copytree(PACKAGE, copy, ignore=lambda _, names: [n for n in names if "." in n and not n.endswith(".py")])
    with copy.joinpath(*module.split(".")).with_suffix(".py").open("a") as stream:
        stream.write("\n_PLANTED = 1\n")
    return copy


@pytest.mark.parametrize(
    ("module", "changed"),
    [
        ("matching.path_costs", {"sgm", "ours", "of-the-box"}),
        ("matching.readout", set(ROWS) - {"sgm-opencv", "sgm", "image-space"}),
        ("matching.guided", {"ours", "of-the-box"}),
        ("matching.lite", {"method", "contrastive", "auto-encoder", "restored"}),
        ("training.contrastive", {"contrastive"}),
        ("restoration.rcan", {"restored"}),
        ("restoration.dan", set()),
        ("correction.rows", {"ours", "of-the-box"}),
        ("simulate.raycast.casting", {"of-the-box"}),
        ("benchmark.scores", set()),
        *((module, set()) for module in ("pages.page", "calibration.bundle", "cli.benchmark", "capture.raw", "recipe")),
    ],
)
def test_a_change_makes_those_rows_anew_that_it_can_change(tmp_path: Path, module: str, changed: set[str]) -> None:
    copy = planted(tmp_path, module)
    new = {
        name
        for name, row in ROWS.items()
        if source_fingerprint(row.sources, package=copy) != source_fingerprint(row.sources)
    }
    assert new == changed
    is_measured_anew = source_fingerprint(MEASURING, package=copy) != source_fingerprint(MEASURING)
    assert is_measured_anew == (module == "benchmark.scores")


def test_a_stage_depends_on_what_the_stages_up_to_it_run() -> None:
    def modules_of(name: str, n_stages: int) -> set[str]:
        recipe = read_learned_systems()[name].resolved()
        return set(find_modules(training_entries(recipe.network, plan_stages(recipe.train)[:n_stages])))

    photometric = modules_of("method", 1)
    assert photometric.isdisjoint({"training.spaces", "training.contrastive", "benchmark.spaces"})
    assert photometric == modules_of("basenet-cl", 1) == modules_of("ae-space", 1)
    assert modules_of("cl-space", 2) - photometric == {"training.spaces", "training.contrastive"}
    assert modules_of("basenet-cl", 3) == modules_of("cl-space", 2)


@pytest.mark.parametrize("name", NETWORKS)
def test_a_network_depends_on_the_modules_it_is_made_of(name: str) -> None:
    of_networks = {n: find_modules([f"matching.networks:{n}"]) for n in NETWORKS}
    own = {type(part).__module__.removeprefix("telewide.") for part in build_network(name).modules()}
    assert {module for module in own if module.startswith("matching.")} <= set(of_networks[name])
    assert len(set(of_networks.values())) == len(NETWORKS) - 1, "iresnet and iresnet-s are one file"


@pytest.mark.parametrize("name", RESTORERS)
def test_a_restorer_depends_on_the_modules_it_is_made_of(name: str) -> None:
    own = {type(part).__module__.removeprefix("telewide.") for part in build_restorer(name, factor=2).modules()}
    found = set(find_modules([f"restoration.restorers:{name}"]))
    assert {module for module in own if module.startswith("restoration.")} <= found


def test_what_is_named_exists() -> None:
    named = [*YET_COUNTED, *FOR_SOME_ROWS, *TABLES, *CANNOT_MATTER, *(entry.partition(":")[0] for entry in SURVEYING)]
    for module in named:
        path = PACKAGE.joinpath(*module.split("."))
        assert path.is_dir() or path.with_suffix(".py").is_file(), module
