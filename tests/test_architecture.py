"""The layout holds: layers, no cycles, light start, and the house rules of the public functions."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from source import (
    FunctionNode,
    Module,
    at,
    functions,
    imports,
    module_from_text,
    modules,
    modules_loaded_by,
    public_functions,
)

# The longest matching prefix counts. Each module imports from its own layer and from lower ones. The same table stands
# in CONTRIBUTING.md.
LAYERS = {
    "errors": 0,
    "options": 0,
    "npz": 0,
    "yaml_files": 0,
    "records": 0,
    "ranges": 0,
    "archives": 0,
    "assets": 0,
    "cores": 0,
    "files": 0,
    "folders": 0,
    "metrics": 0,
    "origin": 0,
    "srgb": 0,
    "text": 0,
    "geometry": 0,
    "capture": 1,
    "drawing": 1,
    "simulate": 1,
    "boards": 2,
    "points": 2,
    "calibration": 3,
    "correction": 3,
    "matching": 4,
    "restoration": 4,
    "training": 5,
    "depth": 6,
    "bokeh": 6,
    "recipe": 7,
    "stages": 7,
    "pipeline": 7,
    "api": 7,
    "pages": 7,
    "benchmark": 7,
    "cli": 8,
    "__main__": 8,
}
MAX_POSITIONAL = 3
MAX_UNNAMED = 4
MAX_LINES = 50
HEAVY = ("torch", "cv2", "scipy", "pydantic", "jinja2", "colour", "rawpy")


def layer(name: str) -> int | None:
    """Layer of a module below ``telewide``; None for one that is not in the table."""
    return LAYERS.get(name.split(".")[0])


def own_imports(module: Module) -> Iterator[tuple[str, int]]:
    """Modules of the package that a module imports, anywhere in it, by their names below ``telewide``."""
    known = {other.name for other in modules()}
    for name, line in imports(module):
        if name.startswith("telewide.") and name.removeprefix("telewide.") in known:
            yield name.removeprefix("telewide."), line


def is_torch_allowed(name: str) -> bool:
    """Whether a module may import torch."""
    is_in_place = name.split(".")[0] in {"matching", "restoration", "training"}
    is_in_place |= name in {"stages.train", "stages.box", "benchmark.networks"}
    is_in_place |= name in {f"benchmark.paper.{room}" for room in ("chain", "learner", "restored")}
    is_in_place |= name.startswith("simulate.raycast.")
    return is_in_place and name != "matching.semiglobal"


def layer_findings(module: Module) -> list[str]:
    """Imports that reach into a higher layer."""
    own = layer(module.name) if module.name else max(LAYERS.values())  # the package itself offers the interface
    return [
        at(module, line, f"layer {own} imports {name} of layer {layer(name)}")
        for name, line in own_imports(module)
        if own is None or (layer(name) or 0) > own
    ]


def torch_findings(module: Module) -> list[str]:
    """Imports of torch where it must not be, also inside functions."""
    return [
        at(module, line, f"imports {name}")
        for name, line in imports(module)
        if name.split(".")[0] == "torch" and not is_torch_allowed(module.name)
    ]


def keyword_only_findings(module: Module) -> list[str]:
    """Public functions with more than three positional parameters, or a default that is not keyword-only."""
    findings = []
    for name, function, is_method in public_functions(module):
        positional = [*function.args.posonlyargs, *function.args.args][1 if is_method else 0 :]
        if len(positional) > MAX_POSITIONAL:
            findings.append(at(module, function.lineno, f"{name} has {len(positional)} positional parameters"))
        if function.args.defaults:
            findings.append(at(module, function.lineno, f"{name} has a default that is not keyword-only"))
    return findings


def docstring_findings(module: Module) -> list[str]:
    """Public modules, classes and functions without a docstring."""
    classes = [n for n in module.tree.body if isinstance(n, ast.ClassDef) and not n.name.startswith("_")]
    documented: list[tuple[str, ast.Module | ast.ClassDef | FunctionNode]] = [
        ("the module", module.tree),
        *((node.name, node) for node in classes),
        *((name, node) for name, node, _ in public_functions(module) if node.name != "__init__"),
    ]
    return [
        at(module, getattr(node, "lineno", 1), f"{name} has no docstring")
        for name, node in documented
        if not ast.get_docstring(node)
    ]


def print_findings(module: Module) -> list[str]:
    """Calls of print."""
    return [
        at(module, node.lineno, "print")
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    ]


def all_findings(check: Callable[[Module], list[str]]) -> list[str]:
    """What a check finds in the whole package."""
    return [finding for module in modules() for finding in check(module)]


def test_every_module_has_a_layer() -> None:
    assert [m.name for m in modules() if m.name and layer(m.name) is None] == []


def test_no_module_imports_from_a_higher_layer() -> None:
    assert all_findings(layer_findings) == []
    upward = module_from_text("from telewide.matching.volume import x", name="capture.pair")
    assert layer_findings(upward) != []


def test_no_import_cycle() -> None:
    graph = {module.name: {name for name, _ in own_imports(module)} - {module.name} for module in modules()}
    while graph:
        leaves = {name for name, needs in graph.items() if not needs & graph.keys()}
        assert leaves, f"these import one another: {sorted(graph)}"
        graph = {name: needs for name, needs in graph.items() if name not in leaves}


def test_nobody_imports_the_top_package() -> None:
    def findings(module: Module) -> list[str]:
        return [
            at(module, line, "imports the top package")
            for name, line in imports(module)
            if (name == "telewide" and not _takes_only_the_version(module, line)) or name.startswith(".")
        ]

    assert all_findings(findings) == []
    assert findings(module_from_text("import telewide")) != []
    assert findings(module_from_text("from telewide import metrics")) != []
    assert findings(module_from_text("from telewide import __version__")) == []


def _takes_only_the_version(module: Module, line: int) -> bool:
    return any(
        isinstance(node, ast.ImportFrom) and node.lineno == line and [a.name for a in node.names] == ["__version__"]
        for node in ast.walk(module.tree)
    )


def test_package_inits_hold_a_docstring_only() -> None:
    def findings(module: Module) -> list[str]:
        is_checked = module.path.name == "__init__.py" and module.name not in {"", "cli"}
        return [at(module, 1, "holds code") for _ in module.tree.body[1:] if is_checked]

    assert all_findings(findings) == []


def test_torch_only_where_networks_are() -> None:
    assert all_findings(torch_findings) == []
    assert torch_findings(module_from_text("def f():\n    import torch.nn", name="bokeh.render")) != []
    assert torch_findings(module_from_text("import torch", name="matching.semiglobal")) != []


def test_only_stages_and_above_know_the_run_folder() -> None:
    knows = [m.name for m in modules() if any(name == "telewide.stages.run_folder.RunFolder" for name, _ in imports(m))]
    assert [name for name in knows if (layer(name) or 0) < 7] == []


def test_pages_know_no_stage() -> None:
    reached = [(m.name, name) for m in modules() if m.name.startswith("pages.") for name, _ in own_imports(m)]
    assert [(page, name) for page, name in reached if name.startswith("stages.")] == []


def test_array_types_are_named_in_one_place() -> None:
    def findings(module: Module) -> list[str]:
        named = (node for node in module.tree.body if isinstance(node, ast.Assign))
        usual = re.compile(r"NDArray\[np\.(float64|float32|bool_|uint8|int64)\]")
        return [at(module, node.lineno, "an array type") for node in named if usual.fullmatch(ast.unparse(node.value))]

    assert [f for m in modules() if m.name != "geometry.arrays" for f in findings(m)] == []
    assert findings(module_from_text("Points = NDArray[np.float64]")) != []


def test_colour_science_only_in_correction_colour() -> None:
    assert (
        all_findings(
            lambda m: [
                at(m, n, x) for x, n in imports(m) if x.split(".")[0] == "colour" and m.name != "correction.colour"
            ]
        )
        == []
    )


def test_everything_but_networks_loads_without_torch() -> None:
    names = [m.name for m in modules() if m.name not in {"", "__main__"}]
    light = [f"telewide.{name}" for name in names if not is_torch_allowed(name)]
    loaded = modules_loaded_by(f"import importlib\nfor name in {light!r}: importlib.import_module(name)")
    assert "telewide.metrics" in loaded
    assert "torch" not in loaded


def test_help_starts_light() -> None:
    loaded = modules_loaded_by(
        "import sys\n"
        "sys.argv = ['telewide', '--help']\n"
        "from telewide.cli import main\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code, end.code\n"
    )
    assert "telewide.cli" in loaded
    assert [name for name in HEAVY if name in loaded] == []


def test_what_one_kind_of_system_has_is_imported_where_its_lack_is_answered(repo: Path) -> None:
    """A module of the standard library that macOS or Windows lacks is asked for and not taken for granted."""
    of_one_kind = {"fcntl", "grp", "msvcrt", "pwd", "resource", "termios", "tty", "winreg"}
    wrong, n_seen = [], 0
    for path in sorted((repo / "telewide").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        answered = {
            node
            for tried in ast.walk(tree)
            if isinstance(tried, ast.Try)
            and any(ast.unparse(h.type) == "ImportError" for h in tried.handlers if h.type)
            for part in tried.body
            for node in ast.walk(part)
        }
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            if of_one_kind.intersection(names):
                n_seen += 1
                wrong += [] if node in answered else [(path.name, node.lineno)]
    assert n_seen > 0
    assert wrong == []


def test_no_print() -> None:
    assert all_findings(print_findings) == []
    assert print_findings(module_from_text("def f():\n    print(1)")) != []


def test_options_are_keyword_only() -> None:
    # The commands in cli take their parameters from typer, by name in any case.
    assert [f for m in modules() if not m.name.startswith("cli") for f in keyword_only_findings(m)] == []
    assert keyword_only_findings(module_from_text("def f(a, b=1): ...")) != []
    assert keyword_only_findings(module_from_text("def f(a, b, c, d): ...")) != []
    assert keyword_only_findings(module_from_text("class A:\n    def f(self, a, b, c, *, d=1): ...")) == []


def test_calls_name_what_they_hand_over() -> None:
    def findings(module: Module) -> list[str]:
        own = {n.name for n in module.tree.body if isinstance(n, FunctionNode | ast.ClassDef)}
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("telewide."):
                own |= {alias.asname or alias.name for alias in node.names}
        return [
            at(module, call.lineno, f"{ast.unparse(call.func)} is given {len(call.args)} values without their names")
            for call in ast.walk(module.tree)
            if isinstance(call, ast.Call) and len(call.args) > MAX_UNNAMED
            if ast.unparse(call.func).removeprefix("cls.") in own or ast.unparse(call.func).startswith("self._")
        ]

    assert all_findings(findings) == []
    assert findings(module_from_text("def f(*a): ...\nf(1, 2, 3, 4, 5)")) != []
    assert findings(module_from_text("f(1, 2, 3, 4, 5)")) == []


def test_public_names_have_docstrings() -> None:
    assert all_findings(docstring_findings) == []
    assert len(docstring_findings(module_from_text("class A:\n    def f(self): ...\ndef g(): ...\ndef _h(): ..."))) == 4


def test_docstrings_begin_with_a_verb_or_a_noun() -> None:
    """Those of modules, classes, functions and constants: no question stands in the place of an answer."""

    def findings(module: Module) -> list[str]:
        texts = [
            (node.lineno, node.value.value)
            for node in ast.walk(module.tree)
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        ]
        return [
            at(module, line, text[:40])
            for line, text in texts
            if re.match(r"(What|Which|How|Who|Whose|When|Why)\b", text)
        ]

    assert all_findings(findings) == []
    assert len(findings(module_from_text('"""What it is."""\nX = 1\n"""How far."""\nY = 2\n"""Hows."""\n'))) == 2


def test_every_test_file_opens_with_what_it_is_the_oracle_of(repo: Path) -> None:
    files = (repo / "tests").rglob("test_*.py")
    silent = [path for path in files if not ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))]
    assert silent == []


def test_signatures_are_typed_without_any() -> None:
    def findings(module: Module) -> list[str]:
        return [
            at(module, function.lineno, f"{name} says Any")
            for name, function, _ in public_functions(module)
            if any(isinstance(n, ast.Name) and n.id == "Any" for a in _annotations(function) for n in ast.walk(a))
        ]

    assert all_findings(findings) == []
    assert findings(module_from_text("def f(a: dict[str, Any]) -> int: ...")) != []


def _annotations(function: FunctionNode) -> list[ast.expr]:
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    found = [a.annotation for a in arguments] + [function.returns]
    return [annotation for annotation in found if annotation is not None]


def test_no_assert_and_no_bare_except_in_the_package() -> None:
    assert (
        all_findings(
            lambda m: [
                at(m, n.lineno, "assert or bare except")
                for n in ast.walk(m.tree)
                if isinstance(n, ast.Assert) or (isinstance(n, ast.ExceptHandler) and n.type is None)
            ]
        )
        == []
    )


@pytest.mark.parametrize("word", ["utils", "common", "helpers", "misc"])
def test_no_attic(word: str) -> None:
    assert [m.name for m in modules() if word in m.name.split(".")] == []


def test_no_function_is_hard_to_read_in_one_go() -> None:
    assert (
        all_findings(
            lambda m: [
                at(m, f.lineno, f"{f.name} has {f.end_lineno - f.lineno + 1} lines")
                for f in functions(m)
                if f.end_lineno is not None and f.end_lineno - f.lineno >= MAX_LINES
            ]
        )
        == []
    )


def test_the_pipeline_is_read_on_one_screen(repo: Path) -> None:
    text = (repo / "telewide" / "pipeline.py").read_text()
    assert len(text.splitlines()) <= 150


def test_the_layer_table_of_contributing_is_this_one(repo: Path) -> None:
    text = (repo / "CONTRIBUTING.md").read_text()
    for number in sorted(set(LAYERS.values())):
        row = next(line for line in text.splitlines() if line.startswith(f"| L{number} |"))
        for name in (name for name, own in LAYERS.items() if own == number and name != "__main__"):
            assert f"`{name}" in row, f"{name} is missing from the row of L{number}"
