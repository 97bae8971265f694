"""Plant bugs in copies of the tree, one at a time, and see whether the tests that should catch them do.

    python tests/mutants/run.py              all bugs of tests/mutants/*.yaml
    python tests/mutants/run.py training     those of training.yaml; also any part of a bug's description

Each list holds bugs: what is wrong, the file, what stands there and what stands there instead, the tests that fail.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

REPO = Path(__file__).resolve().parents[2]
LEAST_CAUGHT = 0.95
LONGEST_S = 300
_PYTEST = ("-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider")


@dataclass(frozen=True)
class Bug:
    """One bug of a list; `survives` says why no test catches it."""

    list: str
    bug: str
    file: str
    before: str
    after: str
    tests: tuple[str, ...]
    survives: str = ""


def all_bugs() -> Iterator[Bug]:
    """The bugs of all lists."""
    for path in sorted(Path(__file__).parent.glob("*.yaml")):
        for entry in yaml.safe_load(path.read_text()):
            yield Bug(**{**entry, "list": path.stem, "tests": tuple(entry["tests"])})


def copy_tree(folder: Path) -> None:
    """Copy what git tracks, as it is in the working tree."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=REPO, capture_output=True, text=True, check=True).stdout
    for name in filter(None, names.split("\0")):
        if (REPO / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes((REPO / name).read_bytes())


def outcome(folder: Path, tests: tuple[str, ...]) -> str:
    """Run tests in a copy of the tree."""
    command = [sys.executable, *_PYTEST, *tests]
    variables = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, timeout=LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return "caught"  # by a test that never ends
    return {0: "survived", 1: "caught"}.get(done.returncode, "broken")


def fate(folder: Path, bug: Bug) -> str:
    """Plant one bug, run its tests, take it out again."""
    path = folder / bug.file
    text = path.read_text()
    if text.count(bug.before) != 1:
        return "stale"
    path.write_text(text.replace(bug.before, bug.after))
    result = outcome(folder, bug.tests)
    path.write_text(text)
    return result


def main(words: list[str]) -> int:
    """Run the bugs that the words choose; 1 where too few are caught."""
    chosen = [bug for bug in all_bugs() if not words or any(word in (bug.list, *bug.bug.split()) for word in words)]
    with tempfile.TemporaryDirectory() as folder:
        copy_tree(Path(folder))
        if outcome(Path(folder), tuple(sorted({test for bug in chosen for test in bug.tests}))) != "survived":
            sys.stderr.write("the tests fail without any bug: mend them first\n")
            return 2
        fates = []
        for bug in chosen:
            begun_s = time.monotonic()
            fates.append(fate(Path(folder), bug))
            told = f" ({bug.survives})" if bug.survives else ""
            seconds = time.monotonic() - begun_s
            sys.stderr.write(f"{fates[-1]:8} {seconds:5.1f} s  {bug.list}: {bug.bug}{told}\n")
    caught = fates.count("caught")
    sys.stdout.write(f"{caught} of {len(fates)} bugs caught\n")
    return 0 if caught >= LEAST_CAUGHT * len(fates) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
