"""``telewide benchmark``: numbers to compare by. A Markdown table on standard output, the same as JSON on request."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telewide.cli.arguments import DeviceOption, RigOption, refuse_filled
from telewide.cli.bokeh import FocusOption
from telewide.cli.console import console_observer, say
from telewide.errors import UsageError
from telewide.files import is_file, is_folder
from telewide.ranges import MAX_SEED, MAX_STEPS

if TYPE_CHECKING:
    from telewide.benchmark.paper.run import PaperOptions
    from telewide.benchmark.paper.system import System
    from telewide.benchmark.paper.tables import Table
    from telewide.benchmark.report import BenchmarkReport
    from telewide.recipe import Recipe
    from telewide.stages.run_folder import RunFolder

benchmark_app = typer.Typer(
    help="Measure speed, memory and errors of every matcher, side by side.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

JsonFileOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the numbers, the machine and the versions to FILE.")
]
RunOption = Annotated[
    list[Path] | None,
    typer.Option("--run", metavar="RUN|FILE", help="Run folder (all its stages) or weights file; may be repeated."),
]
RunOrBoxOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--run",
        metavar="RUN|FILE",
        help="Run folder (all its stages) or weights file; may be repeated. [default: the network in the box]",
    ),
]
StepsOption = Annotated[
    int | None, typer.Option(min=1, max=MAX_STEPS, help="Steps of each training instead, all its stages together.")
]
DataSetsOption = Annotated[
    str | None,
    typer.Option(metavar="NAME,...", help="Protocols or data sets, such as kitti_2012. [default: those of the table]"),
]
FactorsOption = Annotated[
    str | None,
    typer.Option(metavar="FACTOR,...", help="Times fewer pixels a side, such as 2,3. [default: those of the table]"),
]
RestorerOption = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=FILE", help="A restorer's own checkpoint, such as rcan=RCAN_BIX4.pt; may be repeated."),
]

PsmnetOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="A checkpoint of PSMNet's authors for the row psmnet.")
]


@benchmark_app.command(epilog="Example: `telewide benchmark speed --json speed.json`")
def speed(
    *,
    matcher: Annotated[
        list[str] | None,
        typer.Option(help="sgm, network (that in the box) or a network by name; may be repeated. [default: all]"),
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Timed turns of each.")] = 7,
    warm_up: Annotated[int, typer.Option(min=0, help="Turns before them that do not count.")] = 2,
    device: DeviceOption = "auto",
    json_file: JsonFileOption = None,
) -> None:
    """Time a training step and an inference, and measure peak memory, with and without bf16."""
    from telewide.benchmark.speed import SpeedOptions, measure_speed, speed_table

    options = SpeedOptions(matchers=tuple(matcher or ()), device=device, repeats=repeats, warm_up=warm_up)
    report = measure_speed(options, tell=_tell)
    _hand_over(report, speed_table(report), json_file)


@benchmark_app.command(
    epilog="Example: `telewide benchmark middlebury third-size/ --factor 4 --run run --split validation`"
)
def middlebury(
    data_root: Annotated[Path, typer.Argument(help="Folder of the third-size Middlebury 2006 scenes.")],
    *,
    factor: Annotated[float, typer.Option(min=1, help="How many times fewer pixels the soft view has a side.")] = 4.0,
    run: RunOption = None,
    split: Annotated[str, typer.Option(metavar="training|validation|test", help="Which scenes.")] = "validation",
    captures: Annotated[
        Path | None, typer.Option(help="Keep the pairs in this new folder. [default: a temporary one]")
    ] = None,
    device: DeviceOption = "auto",
    json_file: JsonFileOption = None,
) -> None:
    """Measure errors against known disparity, the second view made soft."""
    from telewide.benchmark.contenders import all_contenders
    from telewide.benchmark.datasets.protocols import find_protocol
    from telewide.benchmark.middlebury_scores import PROTOCOL, benchmark_middlebury, middlebury_table

    splits = find_protocol(PROTOCOL).splits
    if split not in splits:
        raise UsageError(f"--split {split}: expected {', '.join(splits)}")
    contenders = all_contenders(run or (), device=device)
    with _new_folder_or_temporary(captures) as folder:
        report = benchmark_middlebury(
            data_root, contenders, scenes=splits[split], factor=factor, captures=folder, tell=_tell
        )
    _hand_over(report, middlebury_table(report), json_file)


@benchmark_app.command(epilog="Example: `telewide benchmark matches captures/ --run run --uncorrected`")
def matches(
    captures: Annotated[Path, typer.Argument(help="Folder of the captures.")],
    *,
    run: RunOption = None,
    uncorrected: Annotated[
        bool, typer.Option("--uncorrected", help="Also judge sgm on the pairs without correction.")
    ] = False,
    rig: RigOption = None,
    device: DeviceOption = "auto",
    json_file: JsonFileOption = None,
) -> None:
    """Count the held-out matches that each matcher misses on your captures; the first run's pairs are used."""
    from telewide.benchmark.contenders import all_contenders, semiglobal_contender
    from telewide.benchmark.matches import Entrant, benchmark_matches, matches_table
    from telewide.stages.run_folder import RunFolder

    sources = run or []
    entrants = [Entrant(contender) for contender in all_contenders(sources, device=device)]
    if uncorrected:
        entrants.insert(1, Entrant(semiglobal_contender(), is_corrected=False))
    trained = dict.fromkeys(_run_of(source) for source in sources)
    with _run_and_recipe(sources, captures) as (folder, recipe):
        report = benchmark_matches(
            captures,
            entrants,
            run=folder,
            recipe=recipe,
            tell=_tell,
            trained_runs=[RunFolder(place) for place in trained],
            rig=rig,
        )
    _hand_over(report, matches_table(report), json_file)


@benchmark_app.command(
    epilog="Example: `telewide benchmark marks captures/ --marks marks.yaml --run run --sheets sheets`"
)
def marks(
    captures: Annotated[Path, typer.Argument(help="Folder of the captures.")],
    *,
    marks: Annotated[Path, typer.Option(metavar="FILE", help="Marks made by hand on the tele photos, YAML.")],
    run: RunOption = None,
    sheets: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="A picture of each capture in this new folder: marks, and disparities at one scale."
        ),
    ] = None,
    rig: RigOption = None,
    device: DeviceOption = "auto",
    json_file: JsonFileOption = None,
) -> None:
    """Judge depth by marks made by hand: flatness of plain planes, thin things, places of depth edges."""
    from telewide.benchmark.contenders import all_contenders
    from telewide.benchmark.marked import benchmark_marks, marks_table
    from telewide.benchmark.marks import read_marks

    if sheets is not None:
        refuse_filled(sheets)
    made_by_hand, sources = read_marks(marks), run or []
    contenders = all_contenders(sources, device=device)
    with _run_and_recipe(sources, captures) as (folder, recipe):
        report = benchmark_marks(
            captures,
            contenders,
            made_by_hand,
            run=folder,
            recipe=recipe,
            tell=_tell,
            rig=rig,
            sheets=sheets,
        )
    _hand_over(report, marks_table(report), json_file)
    if sheets is not None:
        _tell(f"wrote pictures to {sheets}")


@benchmark_app.command(epilog="Example: `telewide benchmark bokeh captures/ --run run --json bokeh.json`")
def bokeh(
    captures: Annotated[Path, typer.Argument(help="Folder of the captures.")],
    *,
    run: RunOrBoxOption = None,
    focus: FocusOption = "auto",
    rig: RigOption = None,
    device: DeviceOption = "auto",
    json_file: JsonFileOption = None,
) -> None:
    """Judge bokeh by sgm and networks: specks along outlines, and PSNR on rooms of `telewide simulate --thin-lens`."""
    from telewide.assets import BOX_WEIGHTS
    from telewide.benchmark.bokeh import benchmark_bokeh, bokeh_table
    from telewide.benchmark.contenders import all_contenders
    from telewide.bokeh.picture import BokehOptions

    sources = run or []
    contenders = all_contenders(sources or [BOX_WEIGHTS], device=device)
    with _run_and_recipe(sources, captures) as (folder, recipe):
        report = benchmark_bokeh(
            captures,
            contenders,
            run=folder,
            recipe=recipe,
            tell=_tell,
            bokeh=BokehOptions(focus=focus),
            rig=rig,
        )
    _hand_over(report, bokeh_table(report), json_file)


@benchmark_app.command(epilog="Example: `telewide benchmark metres --run run --json metres.json`")
def metres(
    *,
    run: RunOption = None,
    captures: Annotated[int, typer.Option(min=1, help="Still lifes of each kind; three hold every distance.")] = 3,
    boards: Annotated[int, typer.Option(min=1, help="Shots of the board.")] = 14,
    width: Annotated[int, typer.Option(min=96, help="Of all photos, px.")] = 720,
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Same seed, same photos.")] = 0,
    keep: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Keep photos, rigs and depths there, in a new folder. [default: none]"),
    ] = None,
    device: DeviceOption = "auto",
    json_file: JsonFileOption = None,
) -> None:
    """Measure depth in metres from simulated photos, the wide lens still and moving, with and without a cast."""
    from telewide.benchmark.metres import MetresOptions, benchmark_metres, depth_makers, metres_table

    options = MetresOptions(captures=captures, boards=boards, width=width, seed=seed, device=device)
    makers = depth_makers(run or ())
    with console_observer(shows_table=False) as observer, _new_folder_or_temporary(keep) as folder:
        report = benchmark_metres(folder, makers, options, observer=observer)
    _hand_over(report, metres_table(report), json_file)


@benchmark_app.command(
    epilog="Examples: `telewide benchmark paper --table overall --data data/ --systems sgm`, "
    "`telewide benchmark paper --table prior --data data/ --data-sets captures,kitti_2012 --factors 1,3`"
)
def paper(
    *,
    table: Annotated[str | None, typer.Option(metavar="NAME", help="Which table; see --list-tables.")] = None,
    data: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Holds the data sets.")] = None,
    systems: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Rows; see --list-systems. [default: those of the table]")
    ] = None,
    damages: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Of the second view. [default: those of the table]")
    ] = None,
    data_sets: DataSetsOption = None,
    factors: FactorsOption = None,
    budget: Annotated[float, typer.Option(metavar="MIN", min=0.01, help="Minutes of each training.")] = 8.0,
    steps: StepsOption = None,
    restorer_weights: RestorerOption = None,
    psmnet_weights: PsmnetOption = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many; the mean is shown.")] = 1,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Keeps cells, and the table in three formats.")] = Path(
        "paper"
    ),
    device: DeviceOption = "auto",
    list_tables: Annotated[bool, typer.Option("--list-tables", help="Print the tables and leave.")] = False,
    list_systems: Annotated[bool, typer.Option("--list-systems", help="Print the systems and leave.")] = False,
) -> None:
    """Reproduce a table of the publication on the data sets you have; kept cells are not computed again."""
    from telewide.benchmark.paper.run import PaperOptions
    from telewide.benchmark.paper.system import Budget
    from telewide.benchmark.paper.systems import SYSTEMS
    from telewide.benchmark.paper.tables import find_table, load_tables, with_columns

    if list_tables or list_systems:
        _list(load_tables() if list_tables else SYSTEMS)
        return
    if table is None or data is None:
        raise UsageError("--table and --data were expected", hint="--list-tables names the tables")
    wanted = with_columns(find_table(table), data_sets=_names(data_sets), factors=_factors(factors))
    options = PaperOptions(
        data,
        out,
        systems=_names(systems),
        damages=_names(damages),
        budget=Budget(budget, steps),
        seeds=seeds,
        device=device,
        weights=_weights(restorer_weights or (), psmnet_weights),
    )
    _make_table(wanted, options)


def _make_table(table: Table, options: PaperOptions) -> None:
    """Compute a table; of several processes one speaks and writes."""
    from telewide.benchmark.paper.means import paper_table
    from telewide.benchmark.paper.run import benchmark_table
    from telewide.benchmark.paper.write import write_table
    from telewide.training.processes import this_process

    if not this_process().is_writer:
        benchmark_table(table, options, tell=lambda _message: None)
        return
    result = benchmark_table(table, options, tell=_tell)
    say(paper_table(table, result.report.rows), is_answer=True)
    for note in result.report.notes:
        _tell(f"note: {note}")
    _tell("wrote " + ", ".join(str(path) for path in write_table(table, result, options.out)))


def _list(known: Mapping[str, Table] | Mapping[str, System]) -> None:
    say("\n".join(f"{name}: {entry.title}" for name, entry in known.items()), is_answer=True)


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def _factors(text: str | None) -> tuple[float, ...]:
    try:
        factors = tuple(float(word) for word in _names(text))
    except ValueError:
        factors = (math.nan,)
    if not all(1 <= factor < math.inf for factor in factors):
        raise UsageError(f"--factors {text}: numbers of at least 1 were expected, such as 2,3")
    return factors


def _weights(stated: Sequence[str], of_psmnet: Path | None) -> dict[str, tuple[Path, ...]]:
    from telewide.benchmark.learned import read_learned_systems
    from telewide.files import is_file

    known = sorted({system.restorer for system in read_learned_systems().values() if system.restorer})
    found: dict[str, tuple[Path, ...]] = {}
    for text in stated:
        name, _, file = text.partition("=")
        if name not in known or not file:
            raise UsageError(f"--restorer-weights {text}: {' or '.join(f'{each}=FILE' for each in known)} was expected")
        if not is_file(Path(file)):
            raise UsageError(f"--restorer-weights {text}: {file} does not exist")
        found[name] = (*found.get(name, ()), Path(file))
    if of_psmnet is not None:
        if not is_file(of_psmnet):
            raise UsageError(f"--psmnet-weights {of_psmnet}: there is no such file")
        found["psmnet"] = (of_psmnet,)
    return found


def _run_of(source: Path) -> Path:
    """The run folder itself, or the one a weights file lies in."""
    return source.absolute().parents[1] if is_file(source) and source.absolute().parent.name == "train" else source


@contextmanager
def _run_and_recipe(sources: Sequence[Path], captures: Path) -> Iterator[tuple[RunFolder, Recipe]]:
    """The first run that holds corrected pairs, or a temporary one, and the recipe to prepare pairs by."""
    from telewide.stages.depth import recipe_of_depth
    from telewide.stages.run_folder import RunFolder

    folders = (_run_of(source) for source in sources)
    with _folder_or_temporary(
        next((folder for folder in folders if is_folder(RunFolder(folder).pairs)), None)
    ) as place:
        yield RunFolder(place), recipe_of_depth(place, captures, weights=sources[0] if sources else None)


@contextmanager
def _new_folder_or_temporary(folder: Path | None) -> Iterator[Path]:
    if folder is not None:
        refuse_filled(folder)
    with _folder_or_temporary(folder) as place:
        yield place


@contextmanager
def _folder_or_temporary(folder: Path | None) -> Iterator[Path]:
    if folder is not None:
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="telewide-") as temporary:
        yield Path(temporary)


def _tell(message: str) -> None:
    say(message)


def _hand_over(report: BenchmarkReport, table: str, json_file: Path | None) -> None:
    from telewide.benchmark.report import write_report_json

    say(table, is_answer=True)
    for note in report.notes:
        _tell(f"note: {note}")
    if json_file is not None:
        write_report_json(report, json_file)
        _tell(f"wrote {json_file}")
