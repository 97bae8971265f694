"""The tour of the code against the code: what it names is there, and no package is left out. Oracle: syntax trees."""

from __future__ import annotations

import ast
import re

import pytest
from source import PACKAGE, modules

TOUR = (PACKAGE.parent / "docs" / "tour.md").read_text(encoding="utf-8")
_PATH = re.compile(r"`([a-z_0-9/]+\.(?:py|yaml|js))`")
_NAME_OF_PATH = re.compile(r"`([a-z_0-9/]+\.py)`\s+`(\w+)`")
_NAME_IN_PATH = re.compile(r"`(\w+)` (?:in|\|) `([a-z_0-9/]+\.py)`")


@pytest.mark.parametrize("path", sorted(set(_PATH.findall(TOUR)) - {"rig.yaml"}))
def test_files_are_there(path: str) -> None:
    assert (PACKAGE / path).is_file()


def named() -> list[tuple[str, str]]:
    return [*_NAME_OF_PATH.findall(TOUR), *((path, name) for name, path in _NAME_IN_PATH.findall(TOUR))]


@pytest.mark.parametrize(("path", "name"), named())
def test_functions_are_in_their_files(path: str, name: str) -> None:
    module = next(module for module in modules() if module.path == PACKAGE / path)
    defined = {node.name for node in module.tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    assigned = [target for node in module.tree.body if isinstance(node, ast.Assign) for target in node.targets]
    defined |= {target.id for target in assigned if isinstance(target, ast.Name)}
    assert name in defined


def test_enough_is_named_to_find_ones_way() -> None:
    assert len(named()) >= 25


def test_every_package_is_met() -> None:
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    met = {path.split("/")[0] for path in re.findall(r"`([a-z_]+/[a-z_0-9/.]*)`", TOUR)}
    assert packages - met == set()
