"""Charts put numbers where the axes say, and the ink of their figures stays inside the drawing."""

from __future__ import annotations

import base64
import re
import xml.etree.ElementTree as ET

import cv2
import numpy as np
import pytest

from telewide.pages.axes import Axis, axis_over
from telewide.pages.charts import Bar, Line, bar_list, dot_chart, line_chart
from telewide.pages.photo_charts import arrow_chart, coverage_chart, heat_chart


def parsed(figure: str) -> ET.Element:
    return ET.fromstring(figure)  # inline SVG is written as well-formed XML


def places(path: str) -> np.ndarray:
    return np.array([[float(x), float(y)] for x, y in re.findall(r"M(-?[\d.]+) (-?[\d.]+)", path)])


def test_axis_shares() -> None:
    assert [Axis("m", 2.0, 6.0).share(value) for value in (2.0, 3.0, 6.0, 9.0)] == [0, 0.25, 1, 1]
    assert Axis("m", 0.1, 10.0, is_log=True).share(1.0) == pytest.approx(0.5)
    assert Axis("m", 0.25, 10.0, is_log=True).ticks() == pytest.approx([0.5, 1, 2, 5, 10])


@pytest.mark.parametrize("values", [[], [float("nan")], [3.0, 3.0], [-1.0, 4.0], [0.0, 0.0]])
def test_axis_over_holds_its_values(values: list[float]) -> None:
    axis = axis_over(values, label="x")
    assert axis.low < axis.high
    assert all(axis.low <= value <= axis.high for value in values if value == value)


def test_lines_and_dots_are_affine_in_their_values() -> None:
    x, y = Axis("x", 0.0, 10.0), Axis("y", -5.0, 5.0)
    points = np.array([[1.0, -4.0], [4.0, 0.5], [9.0, 4.5]])
    line = parsed(line_chart([Line("a & b", points)], x=x, y=y, caption="<c>"))
    drawn = np.array([pair.split(",") for pair in line.find(".//polyline").attrib["points"].split()], dtype=float)
    dots = parsed(dot_chart([Line("d", points)], x=x, y=y, caption="c"))
    np.testing.assert_allclose(places(dots.find(".//path").attrib["d"]), drawn)
    for axis in (0, 1):
        slope, offset = np.polyfit(points[:, axis], drawn[:, axis], 1)
        np.testing.assert_allclose(drawn[:, axis], slope * points[:, axis] + offset, atol=0.06)
        assert (slope > 0) == (axis == 0)
    assert "a & b" in [text.text for text in line.iter("text")]
    assert line.find("figcaption").text == "<c>"


def test_bars_grow_with_their_values_and_outliers_do_not_set_the_scale() -> None:
    bars = [Bar("a", 0.2), Bar("b", 0.4), Bar("c<", 90.0, is_out=True), Bar("d", float("nan"))]
    figure = parsed(bar_list(bars, unit="px", caption="c", limit=0.3))
    rects = figure.findall(".//rect")
    widths = [float(rect.attrib["width"]) for rect in rects]
    assert widths[1] == pytest.approx(2 * widths[0], rel=0.01)
    assert widths[1] > 0.5 * widths[2]
    assert [rect.attrib["class"] for rect in rects] == ["bar", "bar", "bar out", "bar"]
    assert "90.00 px (left out)" in "".join(figure.itertext())
    limit = float(figure.find(".//line").attrib["x1"])
    starts = float(rects[0].attrib["x"])
    assert widths[0] < limit - starts < widths[1]


def test_points_keep_their_place_in_the_photo() -> None:
    points_px = np.array([[-0.5, -0.5], [1599.5, 1199.5], [799.5, 599.5]])
    figure = parsed(coverage_chart(points_px, np.array([[0, 4], [1, 0]]), hw=(1200, 1600), caption="c"))
    assert figure.find("svg").attrib["viewBox"] == "0 0 640 480"
    np.testing.assert_allclose(places(figure.find(".//path").attrib["d"]), [[0, 0], [640, 480], [320, 240]])
    cells = [(rect.attrib["x"], rect.attrib["y"]) for rect in figure.findall(".//rect[@class='cell']")]
    assert cells == [("320.0", "0.0"), ("0.0", "240.0")]  # shaded where there are points


def test_arrows_are_enlarged_and_keep_their_direction() -> None:
    figure = arrow_chart(np.zeros((1, 2)), np.array([[0.3, -0.1]]), hw=(320, 640), magnified=50, caption="c")
    assert "l15.0 -5.0" in figure


def test_heat_is_painted_cell_by_cell() -> None:
    values = np.array([[0.0, 1.0], [0.5, np.nan]], dtype=np.float32)
    figure = parsed(heat_chart(values, hw=(300, 400), value_range=(0, 1), unit="px", caption="c"))
    data = figure.find(".//image").attrib["href"].removeprefix("data:image/png;base64,")
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR).astype(int)
    assert picture.shape == (2, 2, 3)
    brightness = picture.sum(axis=2)
    assert brightness[0, 0] < brightness[1, 0] < brightness[0, 1]
    assert np.ptp(picture[1, 1]) == 0  # unknown is grey
