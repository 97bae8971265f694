"""Tables: the published values by their places, and what a file of tables may say."""

from __future__ import annotations

from pathlib import Path

import pytest

from telewide.benchmark.damages import load_damages
from telewide.benchmark.datasets.protocols import find_protocol
from telewide.benchmark.paper.systems import SYSTEMS
from telewide.benchmark.paper.tables import Published, find_table, load_tables
from telewide.errors import InputError, UsageError


def value(table: str, system: str, heading: str) -> Published | None:
    found = find_table(table)
    return found.rows[system][[column.heading for column in found.columns].index(heading)]


def test_values_stand_where_they_are_published() -> None:
    assert value("settings", "basenet", "Inria_SLFD BIC x6") == Published(22.72, None)
    assert value("spaces", "s1-space", "Inria_SLFD BIC x4") == Published(20.91, None, 28.0)
    assert value("stages", "method-k2", "Inria_SLFD BIC x8") == Published(14.30, None)
    assert value("overall", "sgm-opencv", "HCI AG_JPEG x4") == Published(8.62, 1.278)
    assert value("overall", "method", "KITTI2015 IG x4") == Published(10.08, 1.901)
    assert value("overall", "dan-basenet", "Middlebury BIC x4") == Published(6.90, 1.187)
    assert value("large-factor", "method", "KITTI2015 BIC x8") == Published(19.10, 2.545)
    assert value("supervised", "basenet-su", "KITTI2015, trained on Middlebury IG x4") == Published(19.46, 3.965)
    assert value("backbone", "method-iresnet", "HCI BIC x4") == Published(5.83, 0.866)
    assert value("overall", "ours", "HCI BIC x4") is None


def test_what_tables_name_exists() -> None:
    damages = load_damages().damages
    columns = [column for table in load_tables().values() for column in table.columns]
    assert {column.damage for column in columns} <= damages.keys()
    for protocol in {name for column in columns for name in (*column.test, *column.training)}:
        find_protocol(protocol)
    assert {system for table in load_tables().values() for system in table.rows} <= SYSTEMS.keys()


def test_slips(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown table") as caught:
        find_table("overal")
    assert "overall" in (caught.value.hint or "")
    path = tmp_path / "mine.yaml"
    head = "format: 1\ndata_sets: {A: {test: [hci], training: [hci]}}\ntables:\n  t: {title: t, damages: [BIC], "
    for slip, expected in (
        ("data_sets: [A], factors: [2, 4], rows: {sgm: '1.0'}}", "1 values"),
        ("data_sets: [A], factors: [2], rows: {sgm: a/b}}", "such as 12.41/1.849"),
        ("data_sets: [A], factors: [2], rows: {sgm: 1/2/3/4}}", "found 1/2/3/4"),
        ("data_sets: [B], factors: [2], rows: {}}", "does not describe"),
    ):
        path.write_text(head + slip)
        with pytest.raises(InputError, match=expected):
            load_tables(path=path)
