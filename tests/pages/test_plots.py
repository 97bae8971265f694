"""Plots place their points where the axes say, and leave room for their names."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from telewide.pages.axes import Axis
from telewide.pages.plots import MOST_COLOURS, Series, series_plot


def test_lines_lie_where_their_values_are_and_names_stand_beside() -> None:
    points = np.array([[2.0, 10.0], [4.0, 30.0], [6.0, np.nan], [8.0, 20.0]])
    series = [Series("a & b", points, 0), Series("c", points[:1] + 1, MOST_COLOURS + 1, is_dashed=True)]
    figure = ET.fromstring(series_plot(series, x=Axis("x", 0, 10), y=Axis("y", 0, 40), caption="<c>"))
    lines = figure.findall(".//polyline")
    drawn = np.array([pair.split(",") for pair in lines[0].attrib["points"].split()], dtype=float)
    finite = points[np.isfinite(points).all(axis=1)]
    for axis in (0, 1):
        slope, offset = np.polyfit(finite[:, axis], drawn[:, axis], 1)
        np.testing.assert_allclose(drawn[:, axis], slope * finite[:, axis] + offset, atol=0.06)
        assert (slope > 0) == (axis == 0)
    assert lines[0].attrib["class"].split() == ["curve", "series0"]
    assert lines[1].attrib["class"].split() == ["curve", "series1", "dashed"]
    names = {text.text: float(text.attrib["x"]) for text in figure.iter("text") if text.text in {"a & b", "c"}}
    assert set(names) == {"a & b", "c"}
    assert min(names.values()) > drawn[:, 0].max()
    assert figure.find("figcaption").text == "<c>"  # type: ignore[union-attr]


def test_many_lines_make_the_drawing_taller() -> None:
    series = [Series(str(number), np.ones((1, 2)), number) for number in range(30)]
    figure = ET.fromstring(series_plot(series, x=Axis("x", 0, 2), y=Axis("y", 0, 2), caption="c"))
    height = float(figure.find("svg").attrib["viewBox"].split()[3])  # type: ignore[union-attr]
    assert all(float(text.attrib["y"]) < height for text in figure.iter("text"))
