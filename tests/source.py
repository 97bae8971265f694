"""The package's own source, parsed once, for the tests that check how it is written."""

from __future__ import annotations

import ast
import functools
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "telewide"


@dataclass(frozen=True)
class Module:
    """One source file: dotted name below ``telewide`` (``matching.volume``), path and syntax tree."""

    name: str
    path: Path
    tree: ast.Module


FunctionNode = ast.FunctionDef | ast.AsyncFunctionDef


def module_from_text(text: str, *, name: str = "sample") -> Module:
    """A module that is in no file, to show that a check finds what it should."""
    return Module(name, Path(f"{name}.py"), ast.parse(text))


@functools.cache
def modules() -> tuple[Module, ...]:
    """All modules but the empty-named package itself."""
    return tuple(
        Module(_dotted(path), path, ast.parse(path.read_text(), filename=str(path)))
        for path in sorted(PACKAGE.rglob("*.py"))
        if "_shipped" not in path.parts
    )


def _dotted(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(module: Module, *, at_load_only: bool = False) -> Iterator[tuple[str, int]]:
    """Every module named by an import statement, with its line; ``from a import b`` gives ``a`` and ``a.b``."""
    nodes = _run_at_load(module.tree) if at_load_only else ast.walk(module.tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            yield ("." * node.level + base, node.lineno)
            yield from ((f"{base}.{alias.name}", node.lineno) for alias in node.names)


def _run_at_load(node: ast.AST) -> Iterator[ast.AST]:
    """What runs when the module is imported: no function bodies, no ``if TYPE_CHECKING``."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        yield child
        yield from _run_at_load(child)


def public_functions(module: Module) -> Iterator[tuple[str, FunctionNode, bool]]:
    """(qualified name, node, is_method) of functions and methods whose names carry no underscore, and ``__init__``."""
    for node in module.tree.body:
        if isinstance(node, FunctionNode) and not node.name.startswith("_"):
            yield node.name, node, False
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for inner in node.body:
                if isinstance(inner, FunctionNode) and (not inner.name.startswith("_") or inner.name == "__init__"):
                    yield f"{node.name}.{inner.name}", inner, not _is_static(inner)


def _is_static(function: FunctionNode) -> bool:
    return any(isinstance(d, ast.Name) and d.id == "staticmethod" for d in function.decorator_list)


def functions(module: Module) -> Iterator[FunctionNode]:
    """Every function, private and inner ones too."""
    return (node for node in ast.walk(module.tree) if isinstance(node, FunctionNode))


def parameters(function: FunctionNode) -> list[ast.arg]:
    """All named parameters of a function."""
    return [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]


def identifiers(module: Module) -> Iterator[tuple[str, int]]:
    """Every name the module makes or uses: variables, attributes, arguments, keywords, functions, classes, aliases."""
    for node in ast.walk(module.tree):
        line = getattr(node, "lineno", 0)
        if isinstance(node, ast.Name):
            yield node.id, line
        elif isinstance(node, ast.Attribute):
            yield node.attr, line
        elif isinstance(node, ast.arg) or (isinstance(node, ast.keyword) and node.arg):
            yield node.arg, line
        elif isinstance(node, FunctionNode | ast.ClassDef):
            yield node.name, line
        elif isinstance(node, ast.alias) and node.asname:
            yield node.asname, line


def calls(module: Module) -> Iterator[tuple[str, ast.Call]]:
    """Every call, with the last word of what is called (``F.interpolate(...)`` gives ``interpolate``)."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func).rpartition(".")[2], node


def at(module: Module, line: int, what: str) -> str:
    """One finding, as an editor can jump to it."""
    return f"{module.path}:{line}: {what}"


def modules_loaded_by(script: str) -> set[str]:
    """Names in ``sys.modules`` after a fresh interpreter ran a script."""
    report = "\nimport json, sys\nsys.stderr.write('LOADED' + json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script + report], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stderr.rpartition("LOADED")[2]))
