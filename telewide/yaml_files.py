"""YAML that somebody else wrote: plain data, or one message.

How large it is, how deeply it is nested and how much its aliases stand for is limited before anything is built.
"""

from __future__ import annotations

from pathlib import Path

import yaml

from telewide.errors import InputError, TelewideError
from telewide.files import read_regular

MAX_YAML_BYTES = 1 << 18
MAX_DEPTH = 40
MAX_YAML_NODES = 50_000
_LARGEST_WHOLE = 1 << 63
_MOST_SHOWN = 30
_DATE, _TEXT = "tag:yaml.org,2002:timestamp", "tag:yaml.org,2002:str"
_TOO_DEEP = f"it is nested deeper than {MAX_DEPTH} levels"
_TOO_MANY = f"it holds more than {MAX_YAML_NODES} values"


def read_yaml(path: Path) -> object:
    """Read a YAML file of at most `MAX_YAML_BYTES`.

    Args:
        path: the file.

    Returns:
        Plain data; None where the file is empty. Dates stay texts.

    Raises:
        UsageError: there is no such file.
        InputError: no regular file, or no YAML.
    """
    data = read_regular(path, most_bytes=MAX_YAML_BYTES)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} cannot be read as YAML: it is no text in UTF-8") from error
    return parse_yaml(text, source=f"{path} cannot be read as YAML", error=InputError)


def parse_yaml(text: str, *, source: str, error: type[TelewideError]) -> object:
    """Parse YAML that somebody else wrote.

    Args:
        text: one document.
        source: how the message begins.
        error: what to raise.

    Returns:
        Plain data. Dates stay texts.

    Raises:
        TelewideError: of the given class: no YAML, nested deeper than `MAX_DEPTH`, more than `MAX_YAML_NODES` values
            with every alias written out, an alias inside of what it names, or a value that is not what its tag says.
    """
    try:
        _check_events(text)
        content: object = yaml.load(text, _PlainLoader)
        if _expanded_nodes(content, {}) > MAX_YAML_NODES:
            raise ValueError(_TOO_MANY)
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, RecursionError) as caught:
        mark = getattr(caught, "problem_mark", None)  # where the parser gave up
        place = "" if mark is None else f"line {mark.line + 1}: "
        problem = getattr(caught, "problem", None) or str(caught).partition("\n")[0] or _TOO_DEEP
        raise error(f"{source}: {place}{problem}") from caught
    return content


class _PlainLoader(yaml.SafeLoader):
    """Plain data only: no dates, whose slips would be errors."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Carry out merge keys (``<<``), which copy what they name."""
        super().flatten_mapping(node)
        if len(node.value) > MAX_YAML_NODES:
            raise yaml.constructor.ConstructorError(problem=_TOO_MANY, problem_mark=node.start_mark)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:
        if node.tag == _DATE:
            node.tag = _TEXT
        try:
            value = super().construct_object(node, deep=deep)
            if isinstance(value, int) and abs(value) >= _LARGEST_WHOLE:
                raise ValueError("more than 64 bits")
        except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError) as error:
            kind = str(node.tag).rpartition(":")[2]
            problem = f"{_shortened(str(node.value))} cannot be read as {kind}"
            raise yaml.constructor.ConstructorError(problem=problem, problem_mark=node.start_mark) from error
        return value


def _check_events(text: str) -> None:
    """Refuse what is nested too deeply before it is built: the parser does not recurse, the builder does."""
    depth = 0
    for event in yaml.parse(text, yaml.SafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ValueError(_TOO_DEEP)


def _expanded_nodes(value: object, sizes: dict[int, int], depth: int = 0) -> int:
    """Count the values in plain data with every alias written out.

    Args:
        value: plain data; aliases are shared objects.
        sizes: of the collections that are counted already, by identity; 0 while one is being counted.
        depth: how deep it lies.
    """
    if not isinstance(value, dict | list | set | tuple):
        return 1
    if sizes.get(id(value)) == 0:
        raise ValueError("it contains itself")
    if depth > MAX_DEPTH:
        raise ValueError(_TOO_DEEP)
    if id(value) not in sizes:
        sizes[id(value)] = 0
        inner = [*value, *value.values()] if isinstance(value, dict) else list(value)
        sizes[id(value)] = 1 + sum(_expanded_nodes(one, sizes, depth + 1) for one in inner)
    return sizes[id(value)]


def _shortened(text: str) -> str:
    return repr(text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "...")
