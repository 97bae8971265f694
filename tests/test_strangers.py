"""The table of strangers' files in docs/reliability.md is that of `strangers.table`; ``make soak`` makes it again."""

from __future__ import annotations

from pathlib import Path

from strangers.table import HEAD, TRIED, row


def test_the_table_in_the_docs_is_of_all_that_is_tried(repo: Path) -> None:
    lines = (repo / "docs" / "reliability.md").read_text(encoding="utf-8").splitlines()
    first = lines.index(HEAD) + 2
    table = lines[first : lines.index("", first)]
    for one, found in zip(TRIED, table, strict=True):
        assert found.startswith(row(one, "").removesuffix(" |").rstrip()), one.name
        assert one.said in found.replace("/", "|") or one.said in found, one.name


def test_nothing_is_tried_twice() -> None:
    names = [one.name for one in TRIED]
    assert len(names) == len(set(names))
    for one in TRIED:
        assert len({variant.name for variant in one.variants}) == len(one.variants), one.name
