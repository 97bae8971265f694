"""Commands that a person is shown, against the parser: those of README, docs, recipes and messages."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from telewide.bokeh.highlights import MAX_TIMES
from telewide.bokeh.picture import DEFAULT_STRENGTH_SHARE
from telewide.cli.app import app
from telewide.recipe import load_recipe
from telewide.text import with_options

DOCUMENTS = ("*.md", "docs/*.md", "pipelines/*.yaml", "Makefile")
SHARED_BY = {
    # The messages of a stage are read by whoever runs it: the options they name have to be there in every command.
    "stages/train.py": ("train", "run"),
    "stages/training_record.py": ("train", "run"),
    "training": ("train", "run"),
    "stages/call.py": ("train", "depth", "run"),
    "stages/run_folder.py": ("train", "depth", "run"),
    "stages/pairs.py": ("train", "run"),
    "stages/match.py": ("depth", "run"),
    "stages/prepare.py": ("train", "depth", "run"),
    "stages/align.py": ("train", "depth", "run"),
    "stages/calibrate.py": ("calibrate",),
    "stages/calibrate_scenes.py": ("calibrate",),
    "boards": ("calibrate",),
}
_SPELLED_IN = ("cli", "stages", "pages")
_COMMAND = re.compile(r"\btelewide (?=[a-z])[^`\n#|;:()]*")
_FLAG = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")


def parser_of(words: list[str]) -> tuple[Any, list[str]]:
    """The parser of a subcommand, and the words that are left to it."""
    command, left = typer.main.get_command(app), words
    while hasattr(command, "commands") and left and left[0] in command.commands:
        command, left = command.commands[left[0]], left[1:]
    return command, left


def flags_of(*words: str) -> set[str]:
    command, _ = parser_of(list(words))
    return {flag for parameter in command.params for flag in parameter.opts if flag.startswith("--")} | {"--help"}


def why_refused(line: str) -> str | None:
    """What the parser says against a command line; None where it is content. Capitals are what a person fills in."""
    words = ["1" if re.fullmatch(r"[A-Z][A-Z,_|]*", word) else word for word in shlex.split(line)[1:]]
    command, left = parser_of(words)
    if hasattr(command, "commands"):
        return None if left == ["--help"] or (len(words) < 2 and not left) else f"no command {left}"
    if not left or "--help" in left:  # the command is named, not called
        return None
    try:
        context = command.make_context(words[0], list(left))
    except Exception as error:  # the parser's own kinds differ between its releases
        return str(error)
    if context.params.get("settings"):
        load_recipe(context.params["recipe"], settings=context.params["settings"])
    return None


def shown_in(text: str) -> Iterator[str]:
    """Command lines in a text: spans in backticks, and lines that begin with one."""
    joined = re.sub(r"(?<=\S)\n(?! *\n)", " ", text)
    spans = re.findall(r"`(?:torchrun[^`]*-m )?(telewide [^`]+)`", joined)
    lines = re.findall(r"^(?: {4}|\t)[^#\n]*?\b(telewide (?=[a-z])[^#\n;&]*)", text, re.MULTILINE)
    for shown in [*spans, *lines]:
        if "..." not in shown and "COMMAND" not in shown:
            yield re.sub(r"\$\((\w+)\)", lambda name: "" if name[1] == "RUN_FLAGS" else name[1], shown)


def documents(repo: Path) -> list[Path]:
    return [path for pattern in DOCUMENTS for path in sorted(repo.glob(pattern))]


def test_every_command_in_the_documents_parses(repo: Path) -> None:
    called = [path for path in documents(repo) if path.name != "CHANGELOG.md"]  # which names commands and options
    shown = [(path.name, line) for path in called for line in shown_in(path.read_text(encoding="utf-8"))]
    assert len(shown) > 35
    assert [(name, line, why) for name, line in shown if (why := why_refused(line)) is not None] == []


def sections(repo: Path) -> dict[str, str]:
    """What docs/commands.md says of each command: its section, or its row of a table."""
    text = (repo / "docs" / "commands.md").read_text(encoding="utf-8")
    found = dict(re.findall(r"^## telewide ([a-z-]+)(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))
    rows = re.findall(r"^\| `([a-z]+)[^`]*` \|(.*)$", found["benchmark"], re.MULTILINE)
    return found | {f"benchmark {name}": row for name, row in rows}


def test_every_option_is_documented_where_its_command_is(repo: Path) -> None:
    told, of_all = sections(repo), {"--help", "--quiet", "--json"}
    shared = {"run": told["train"] + told["depth"], "depth": told["train"]}
    shared |= {name: told["benchmark"] for name in told if name.startswith("benchmark ") and name != "benchmark paper"}
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    names = [*commands, *(f"benchmark {name}" for name in commands["benchmark"].commands)]
    missing = {
        (name, flag)
        for name in names
        for flag in flags_of(*name.split()) - of_all
        if not re.search(rf"{flag}(?![a-z-])", told.get(name, "") + shared.get(name, ""))
    }
    assert len(names) > 12
    assert missing == set()


def test_make_bench_measures_all_but_the_published_tables_and_names_its_data(repo: Path) -> None:
    text = (repo / "Makefile").read_text(encoding="utf-8")
    called = re.search(r"^bench:.*\n((?:\t.*\n)+)", text, re.MULTILINE)
    assert called is not None
    known = set(parser_of(["benchmark"])[0].commands)
    assert set(re.findall(r"telewide benchmark (\w+)", called[1])) == known - {"paper"}
    head = text[: text.index("DATA   :=")]
    assert {f"$(DATA)/{name}" for name in re.findall(r"\$\(DATA\)/(\w+)", called[1])} <= set(
        re.findall(r"\$\(DATA\)/\w+", head)
    )


def test_help_states_the_strength_of_a_blur_as_it_is() -> None:
    (strength,) = (each for each in parser_of(["depth"])[0].params if each.name == "strength")
    assert f"{100 * DEFAULT_STRENGTH_SHARE:g} % of the longer side" in strength.help


def test_help_states_the_limit_of_highlights_as_it_is(repo: Path) -> None:
    (highlights,) = (each for each in parser_of(["depth"])[0].params if each.name == "highlights")
    assert f"1 to {MAX_TIMES:g}" in highlights.help
    (told,) = re.findall(r"^\| `--highlights 8` \|(.*)", sections(repo)["depth"], re.MULTILINE)
    assert f"1 to {MAX_TIMES:g}" in told


def sources(repo: Path) -> list[Path]:
    return sorted((repo / "telewide").rglob("*.py"))


def texts_of(tree: ast.AST) -> Iterator[str]:
    """Texts of a module that can be shown, with 1 where a value goes; docstrings apart."""
    skipped = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(node.value)
        if isinstance(node, ast.JoinedStr):
            skipped.update(node.values)
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "1" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in skipped:
            yield node.value


def test_every_command_in_a_message_parses(repo: Path) -> None:
    shown = [
        (path.relative_to(repo).as_posix(), found)
        for path in sources(repo)
        for text in texts_of(ast.parse(path.read_text(encoding="utf-8")))
        for found in _COMMAND.findall(text)
    ]
    known = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    calls = [(name, line) for name, line in shown if line.split()[1].strip(",.") in known]
    refused = []
    for name, line in calls:
        words = line.replace(",", " ").split() if "--" not in line else line.split()
        stated = " ".join(words[:2] if "--" not in line else words).rstrip(".,")
        why = why_refused(stated)
        if why is not None and "--" in line:
            refused.append((name, line, why))
    assert refused == []


def test_composed_commands_exist_with_their_options(repo: Path) -> None:
    """Wherever code composes a command, its name and its options are known to the parser."""
    refused, n_seen = [], 0
    for path in sources(repo):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not node.args or not isinstance(node.args[0], ast.Constant):
                continue
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            if name not in ("command_line", "instead", "Invocation"):
                continue
            n_seen += 1
            command = str(node.args[0].value)
            stated = {f"--{keyword.arg.replace('_', '-')}" for keyword in node.keywords if keyword.arg}
            stated -= {"--options"} if name == "Invocation" else set()
            if "commands" in vars(parser_of([command])[0]) or not stated <= flags_of(command):
                refused.append((path.name, node.lineno, command, sorted(stated)))
    assert n_seen > 10
    assert refused == []


@pytest.mark.parametrize(("place", "commands"), SHARED_BY.items())
def test_an_option_that_a_message_names_exists_in_every_command_that_shows_it(
    place: str, commands: tuple[str, ...], repo: Path
) -> None:
    folder = repo / "telewide" / place
    found = [
        (path.name, flag, command)
        for path in ([folder] if folder.is_file() else sorted(folder.rglob("*.py")))
        for text in texts_of(ast.parse(path.read_text(encoding="utf-8")))
        for flag in _FLAG.findall(with_options(_COMMAND.sub("", text)))
        for command in commands
        if flag not in flags_of(command)
    ]
    assert found == []


def test_below_the_stages_options_are_named_and_not_spelled(repo: Path) -> None:
    """What is called from Python too says `square_m`; the command line makes --square-m of it."""
    known = {flag for command in typer.main.get_command(app).commands for flag in flags_of(command)}  # type: ignore[attr-defined]
    rooms = (*_SPELLED_IN, "text.py", "__main__.py")  # text.py makes options of names
    texts = [
        (path.name, text)
        for path in sorted((repo / "telewide").rglob("*.py"))
        if path.relative_to(repo / "telewide").parts[0] not in rooms
        for text in texts_of(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert [(name, text) for name, text in texts if _FLAG.search(text)] == []
    named = {flag for _, text in texts for flag in _FLAG.findall(with_options(text))}
    assert len(named) > 8
    assert named <= known


def test_options_are_spelled_where_a_person_types_them() -> None:
    assert (
        with_options("measure a square: `square_m`; see `captures/`") == "measure a square: --square-m; see `captures/`"
    )
