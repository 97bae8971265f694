"""Words of the command line that shape a bokeh picture."""

from __future__ import annotations

import pytest
import typer

from telewide.bokeh.aperture import DISK, Aperture
from telewide.bokeh.picture import BokehOptions
from telewide.cli.app import app
from telewide.cli.bokeh import BokehWords
from telewide.cli.depth import depth_options
from telewide.errors import UsageError
from telewide.stages.depth import DepthOptions


def parsed(*words: str) -> dict[str, object]:
    """Parameters of `telewide depth` as its parser reads them."""
    command = typer.main.get_command(app).commands["depth"]
    return command.make_context("depth", ["captures", *words]).params


def test_no_words_are_the_defaults() -> None:
    assert BokehWords().options() == BokehOptions()
    assert BokehWords().options_if(is_asked=True) == BokehOptions()
    assert BokehWords().options_if(is_asked=False) is None


def test_words_become_options() -> None:
    lens = BokehWords(focus="1.8m", f_number=1.4, f35_mm=85, blades="7,0.3,15", highlights=8).options()
    assert lens == BokehOptions(
        focus="1.8m",
        f_number=1.4,
        equiv_focal_mm=85,
        aperture=Aperture(blades=7, curvature=0.3, rotation_deg=15),
        highlights=8,
    )
    assert BokehWords(strength="24").options() == BokehOptions(strength_px=24)
    assert BokehWords(strength="24 PX").options() == BokehOptions(strength_px=24)
    assert BokehWords(strength="1.5%").options() == BokehOptions(strength_share=0.015)
    assert BokehWords(blades="6").options().aperture == Aperture(blades=6)
    assert BokehWords().options().aperture is DISK


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ({"strength": "0"}, "--strength"),
        ({"strength": "-3%"}, "--strength"),
        ({"strength": "much"}, "--strength"),
        ({"strength": "nan"}, "--strength"),
        ({"strength": "px"}, "--strength px: .* 24px"),
        ({"strength": "3px%"}, "--strength"),
        ({"strength": "24mm"}, "--strength"),
        ({"strength": "9", "f_number": 2.0}, "--f-number and --strength"),
        ({"f_number": 0.0}, "--f-number"),
        ({"f_number": float("inf")}, "--f-number"),
        ({"f35_mm": 50.0}, "--f-number"),
        ({"f35_mm": -1.0, "f_number": 2.0}, "--equiv-focal"),
        ({"blades": "seven"}, "--blades"),
        ({"blades": "7,0.3,15,2"}, "--blades"),
        ({"blades": ""}, "--blades"),
        ({"blades": "3"}, "3 blades"),
        ({"blades": "7,2"}, "curvature"),
        ({"highlights": 0.0}, "--highlights"),
        ({"picture": "png"}, "--picture png"),
        ({"picture": ""}, "--picture"),
        ({"highlights": float("nan")}, "--highlights"),
        ({"preview": True, "picture": "tif"}, "--preview"),
    ],
)
def test_words_that_shape_nothing_are_refused(words: dict[str, object], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        BokehWords(**words).options()


@pytest.mark.parametrize(
    "words",
    [{"focus": "near"}, {"strength": "9"}, {"blades": "6"}, {"highlights": 2.0}, {"preview": True}],
)
def test_words_without_a_picture_are_refused(words: dict[str, object]) -> None:
    with pytest.raises(UsageError, match="bokeh picture") as refusal:
        BokehWords(**words).options_if(is_asked=False)
    assert "--bokeh" in (refusal.value.hint or "")


@pytest.mark.parametrize(("text", "number"), [("1.8", 1.8), ("f/1.8", 1.8), ("F/2", 2.0)])
def test_an_f_number_is_written_as_on_a_lens_or_alone(text: str, number: float) -> None:
    assert parsed("--f-number", text)["f_number"] == number


def test_an_f_number_with_a_comma_is_answered_with_an_example() -> None:
    with pytest.raises(typer.BadParameter, match=r"1\.8 was expected"):
        parsed("--f-number", "1,8")


def test_stripping_needs_a_file_that_says_something() -> None:
    assert asked(bokeh=None, formats=("heic",)).is_stripped
    assert asked(bokeh=BokehOptions(), formats=("pfm",)).is_stripped
    with pytest.raises(UsageError, match="--strip") as refusal:
        asked(bokeh=None, formats=("pfm",))
    assert "heic" in (refusal.value.hint or "")


def asked(*, bokeh: BokehOptions | None, formats: tuple[str, ...]) -> DepthOptions:
    return depth_options(
        method="sgm",
        weights=None,
        bokeh=bokeh,
        out=None,
        device="cpu",
        rig=None,
        distance=None,
        formats=formats,
        is_stripped=True,
    )
