"""Marks made by hand on tele photos: plain planes, thin things and pieces of depth edge.

Sparse matches are blind to walls, thin things and edges; a person is not. A mark lies on the tele photo as it was
taken, so it stands whatever rig rectified the pair. Its px are those of a photo of the size that the file states,
(0, 0) the centre of its top-left pixel; a photo of another size is scaled.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from telewide.errors import InputError
from telewide.options import Options, parse_options
from telewide.ranges import MAX_DISPARITY_PX, MAX_SIDE_PX
from telewide.yaml_files import read_yaml

Point = tuple[float, float]


def _moving_on(points: tuple[Point, ...]) -> tuple[Point, ...]:
    for point, following in pairwise(points):
        if point == following:
            raise ValueError(f"{point[0]:g}, {point[1]:g} stands twice in succession")
    return points


Polygon = Annotated[tuple[Point, ...], Field(min_length=3)]
Polyline = Annotated[tuple[Point, ...], Field(min_length=2), AfterValidator(_moving_on)]
Offset = Annotated[float, Field(ge=-MAX_SIDE_PX, le=MAX_SIDE_PX)]
Step = Annotated[float, Field(ge=-MAX_DISPARITY_PX, le=MAX_DISPARITY_PX)]
PixelCount = Annotated[int, Field(gt=0)]


class ThinThing(Options):
    """A chair leg, a bar, a cable: narrower than the windows of most matchers."""

    line: Polyline
    """Along its middle."""
    width_px: Annotated[float, Field(gt=0, le=MAX_SIDE_PX)]
    """Across it."""
    ground_px: Annotated[tuple[Offset, ...], Field(min_length=1)]
    """Distance from the line to its ground: to the right of a walk along the line where positive, else left."""
    step_px: tuple[Step, Step]
    """Disparity of the thing less that of its ground, at the line's first and last point. Positive: before it."""

    @model_validator(mode="after")
    def _is_on_one_side(self) -> Self:
        if self.step_px[0] * self.step_px[1] <= 0:
            raise ValueError(f"step_px {list(self.step_px)}: a thing stands before its ground or behind it, all along")
        if any(abs(offset_px) <= self.width_px / 2 for offset_px in self.ground_px):
            raise ValueError(f"ground_px {list(self.ground_px)} lies on the thing, {self.width_px:g} px wide")
        return self


class DepthEdge(Options):
    """A piece of the outline of something with a farther surface behind it."""

    line: Polyline
    """Along the outline."""
    near: Literal["left", "right"]
    """Where the nearer surface lies, for someone walking along the line in the picture."""


class CaptureMarks(Options):
    """All marks of one capture, by their names."""

    planes: dict[str, Polygon] = Field(default_factory=dict)
    """Outlines of plain planes: walls, doors, floors."""
    thin: dict[str, ThinThing] = Field(default_factory=dict)
    """Thin things."""
    edges: dict[str, DepthEdge] = Field(default_factory=dict)
    """Pieces of depth edge."""

    def points(self) -> dict[str, tuple[Point, ...]]:
        """All points of each mark, by a name that says its kind."""
        return {
            **{f"planes.{name}": polygon for name, polygon in self.planes.items()},
            **{f"thin.{name}": thing.line for name, thing in self.thin.items()},
            **{f"edges.{name}": edge.line for name, edge in self.edges.items()},
        }


class Marks(Options):
    """A file of marks."""

    format: Literal[1]
    photo_wh: tuple[PixelCount, PixelCount]
    """Width and height of the photos whose px the marks are in."""
    captures: dict[str, CaptureMarks]
    """Marks of each capture, by its name."""

    @model_validator(mode="after")
    def _lies_on_the_photo(self) -> Self:
        width, height = self.photo_wh
        for capture, marks in self.captures.items():
            for name, points in marks.points().items():
                outside = [(x, y) for x, y in points if not (0 <= x <= width - 1 and 0 <= y <= height - 1)]
                if outside:
                    x, y = outside[0]
                    raise ValueError(f"captures.{capture}.{name}: {x:g}, {y:g} is not on a photo of {width} x {height}")
        return self


def read_marks(path: Path) -> Marks:
    """Read a file of marks.

    Args:
        path: YAML of the form of :class:`Marks`.

    Raises:
        UsageError: there is no such file.
        InputError: no YAML, an unknown key, or a wrong value.
    """
    return parse_options(Marks, read_yaml(path) or {}, source=str(path), error=InputError)
