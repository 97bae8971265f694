"""Plant bugs in a copy of the tree, one at a time: do the tests that should catch them? run.py [LIST ...]

A bug names what is wrong, the file, what stands there, what instead, and the tests that fail; of a file the quick ones.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
import scipy.optimize  # noqa: F401  # loaded once, for all runs: most of a short test's time
import torch.utils.data  # noqa: F401
import yaml

REPO = Path(__file__).resolve().parents[2]
NO_SOURCES = (".*", "__pycache__", "demo", "dist", "run")
LEAST_CAUGHT = 0.95
LONGEST_S = 600


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
    for path in sorted(Path(__file__).parent.glob("*.yaml")):
        for entry in yaml.safe_load(path.read_text()):
            yield Bug(**{**entry, "list": path.stem, "tests": tuple(entry["tests"])})


def outcome(folder: Path, tests: tuple[str, ...]) -> str:
    """Run tests in a copy of the tree; one that never ends has caught the bug."""
    # Named so, since rawpy warns in any other process that was forked.
    (run := get_context("fork").Process(target=_run, args=(folder, tests), name="MainProcess")).start()
    run.join(LONGEST_S)
    code = run.exitcode
    run.kill()
    return {None: "caught", 0: "survived", 1: "caught"}.get(code, "broken")


def _run(folder: Path, tests: tuple[str, ...]) -> None:
    os.chdir(folder)
    os.environ |= {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    sys.dont_write_bytecode, sys.path[:0] = True, [str(folder)]
    with Path(os.devnull).open("w") as nothing, redirect_stdout(nothing), redirect_stderr(nothing):
        of_files = [] if all("::" in test for test in tests) else ["-m", "not slow"]
        os._exit(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *of_files, *tests]))


def fate(folder: Path, bug: Bug) -> str:
    """Plant one bug, run its tests, take it out again."""
    text = (path := folder / bug.file).read_text()
    if text.count(bug.before) != 1:
        return "stale"
    path.write_text(text.replace(bug.before, bug.after))
    result, _ = outcome(folder, bug.tests), path.write_text(text)
    return result


def main(lists: list[str]) -> int:
    """Run the bugs of some lists, or of all; 1 where too few are caught, or where tests fail without a bug."""
    chosen, fates = [bug for bug in all_bugs() if not lists or bug.list in lists], []
    if unknown := set(lists) - {bug.list for bug in chosen}:
        sys.exit(f"no list is called {', '.join(sorted(unknown))}; the files beside this one are lists")
    with tempfile.TemporaryDirectory() as name:
        folder = shutil.copytree(REPO, Path(name), ignore=shutil.ignore_patterns(*NO_SOURCES), dirs_exist_ok=True)
        if outcome(folder, tuple(sorted({test for bug in chosen for test in bug.tests}))) != "survived":
            sys.exit("the tests fail without any bug: mend them first")
        for bug in chosen:
            begun_s = time.monotonic()
            fates.append(fate(folder, bug))
            told = f"{fates[-1]:8} {time.monotonic() - begun_s:5.1f} s  {bug.list}: {bug.bug}"
            sys.stderr.write(f"{told}  {bug.survives}\n")
    sys.stdout.write(f"{fates.count('caught')} of {len(fates)} bugs caught\n")
    return 0 if fates.count("caught") >= LEAST_CAUGHT * len(fates) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
