"""Modules that a result depends on, found from where it is computed by following imports, and their fingerprint.

An entry is the name of a module below ``telewide``, or ``module:name`` for one line of a module's table, such as
``matching.networks:lite``: of what the lines of a table reach, only what the named ones reach counts. Imports inside
functions count like others. What cannot change a score is not followed, nor what some rows alone run, unless an entry
names it.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from telewide.files import is_file
from telewide.training.stages import Stage

PACKAGE = Path(__file__).resolve().parents[2]

CANNOT_MATTER = (
    # What reads and writes files, words messages, and draws.
    *("archives", "assets", "cores", "errors", "files", "folders", "npz", "records", "text", "yaml_files"),
    *("drawing", "pages", "cli", "training.log", "training.reporter", "training.weights_card"),
    *("benchmark.report", "benchmark.networks", "benchmark.paper.pictures"),
    # What reads options and rows: their values are in the facts of every result.
    *("options", "ranges", "recipe", "training.options", "benchmark.learned"),
    *("benchmark.paper.tables", "benchmark.paper.learned_rows", "benchmark.paper.sources"),
    # What reads scenes: their content is.
    *("benchmark.datasets", "capture"),
    # The program around what computes.
    *("api", "pipeline", "stages"),
)
"""Modules, and packages with all in them, whatever imports them."""
YET_COUNTED = ("capture.images", "capture.pair", "capture.pfm", "stages.match")
"""Modules of those packages that compute, or that hand over what is learned from."""
FOR_SOME_ROWS = (
    *("benchmark.paper.coarseness", "benchmark.paper.corrected", "benchmark.paper.restored", "benchmark.spaces"),
    *("training.spaces", "training.world_samples", "training.retaken"),
)
"""Modules that only those rows run which name them as entries."""
TABLES = {
    "benchmark.paper.systems": "_WITHOUT_LEARNING",
    "matching.networks": "NETWORKS",
    "restoration.restorers": "RESTORERS",
    "training.spaces": "SPACES",
}
"""Modules whose lines are alternatives, and the dict that holds them."""
BOX_NETWORK = "guided"
"""Network whose weights come with telewide."""
SURVEYING = ("stages.surfaces", f"matching.networks:{BOX_NETWORK}")
"""Where captures are matched to be taken again."""


@dataclass(frozen=True)
class _Source:
    """One module.

    Attributes:
        text: of its file.
        imports: modules of telewide that it names, but for what only lines of its table reach.
        lines: by the name of a line of its table, the modules that the line reaches.
    """

    text: bytes
    imports: frozenset[str]
    lines: Mapping[str, frozenset[str]]


def training_entries(network: str, stages: Sequence[Stage]) -> tuple[str, ...]:
    """Name where the first stages of a training are computed; what later stages run does not count.

    Args:
        network: its name.
        stages: from the first to the one that is asked about.
    """
    entries = ["benchmark.paper.learner", f"matching.networks:{network}"]
    entries += [f"training.spaces:{stage.space}" for stage in stages if stage.is_teaching_space]
    if any(stage.options.exact for stage in stages):
        entries += ["training.world_samples", "training.retaken"]
    return tuple(entries)


def find_modules(entries: Iterable[str], *, package: Path = PACKAGE) -> tuple[str, ...]:
    """Find the modules that entries depend on, themselves among them, in order.

    Args:
        entries: see above.
        package: folder of telewide.
    """
    lines: dict[str, list[str]] = {}
    for entry in entries:
        module, _, line = entry.partition(":")
        lines.setdefault(module, []).append(line)
    found: set[str] = set()
    waiting = list(lines)
    while waiting:
        module = waiting.pop()
        if module not in found:
            found.add(module)
            source = _read(package, module)
            by_lines = frozenset[str]().union(*(source.lines.get(line, ()) for line in lines.get(module, ())))
            waiting += [name for name in source.imports if is_counted(name) and name not in FOR_SOME_ROWS]
            waiting += [name for name in by_lines if is_counted(name)]
    return tuple(sorted(found))


def source_fingerprint(entries: Iterable[str], *, package: Path = PACKAGE) -> str:
    """Fingerprint the text of all modules that entries depend on.

    Args:
        entries: see above.
        package: folder of telewide.
    """
    digest = hashlib.sha256()
    for module in find_modules(entries, package=package):
        digest.update(f"{module} {hashlib.sha256(_read(package, module).text).hexdigest()} ".encode())
    return digest.hexdigest()


def is_counted(module: str) -> bool:
    """Whether a module is none of those that cannot change a score."""
    return module in YET_COUNTED or not any(f"{module}.".startswith(f"{name}.") for name in CANNOT_MATTER)


@cache
def _read(package: Path, module: str) -> _Source:
    text = _file(package, module).read_bytes()
    tree = ast.parse(text)
    imported = tuple(_imported(tree, package))
    lines = _lines(tree, TABLES[module], dict(imported)) if module in TABLES else {}
    of_lines = frozenset[str]().union(*lines.values())
    return _Source(text, frozenset(name for _, name in imported) - of_lines, lines)


def _file(package: Path, module: str) -> Path:
    return package.joinpath(*module.split(".")).with_suffix(".py")


def _imported(tree: ast.Module, package: Path) -> Iterator[tuple[str, str]]:
    """The names that imports bind anywhere in a module, and the modules of telewide that they are from."""
    top = f"{package.name}."
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            pairs = [(alias.asname or alias.name, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            whole = [(alias.asname or alias.name, f"{node.module}.{alias.name}") for alias in node.names]
            pairs = [(bound, name if _is_module(name, package) else str(node.module)) for bound, name in whole]
        else:
            continue
        yield from ((bound, name.removeprefix(top)) for bound, name in pairs if _is_module(name, package))


def _is_module(name: str, package: Path) -> bool:
    top, _, rest = name.partition(".")
    return top == package.name and bool(rest) and is_file(_file(package, rest))


def _lines(tree: ast.Module, table: str, names: Mapping[str, str]) -> dict[str, frozenset[str]]:
    """Modules that each line of a table reaches, by itself and through the functions of the table's module."""
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}

    def reached(node: ast.AST, seen: frozenset[str]) -> Iterator[str]:
        for part in ast.walk(node):
            if isinstance(part, ast.Name) and part.id in names:
                yield names[part.id]
            elif isinstance(part, ast.Name) and part.id in functions and part.id not in seen:
                yield from reached(functions[part.id], seen | {part.id})

    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if [getattr(target, "id", None) for target in targets] == [table]:
            value = getattr(node, "value", None)
            if isinstance(value, ast.Dict):
                keyed = zip(value.keys, value.values, strict=True)
                return {ast.literal_eval(key): frozenset(reached(line, frozenset())) for key, line in keyed if key}
    raise ValueError(f"no dict {table} where a table was expected")
