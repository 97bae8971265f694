"""The lists of planted bugs against the tree: every bug can still be planted, and the tests that catch it are there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from mutants.run import Bug, all_bugs

BUGS = list(all_bugs())


def test_there_are_bugs_for_every_room() -> None:
    assert len(BUGS) >= 60
    assert len({bug.bug for bug in BUGS}) == len(BUGS)


@pytest.mark.parametrize("bug", BUGS, ids=[re.sub(r"\W+", "_", bug.bug) for bug in BUGS])
def test_a_planted_bug_fits_the_tree(bug: Bug, repo: Path) -> None:
    text = (repo / bug.file).read_text()
    assert text.count(bug.before) == 1, "what it replaces stands there once"
    planted = text.replace(bug.before, bug.after)
    assert planted != text
    if bug.file.endswith(".py"):
        ast.parse(planted)
    for test in bug.tests:
        path, _, name = test.partition("::")
        assert not name or f"def {name}(" in (repo / path).read_text()
