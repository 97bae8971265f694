"""Words of the command line that shape the bokeh picture, said alike by several commands."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from telewide.errors import MissingPartError, UsageError, extra_hint

if TYPE_CHECKING:
    from telewide.bokeh.aperture import Aperture
    from telewide.bokeh.picture import BokehOptions, PictureKind

FocusOption = Annotated[str, typer.Option(metavar="X,Y|2.5m|80cm|near|far|auto|af", help="What is sharp in the bokeh.")]


def _f_number(text: str) -> float:
    """Read "1.8" or "f/1.8"."""
    try:
        return float(text.strip().lower().removeprefix("f/"))
    except ValueError:
        raise typer.BadParameter(f"{text!r}; a number such as 1.8 was expected") from None


FNumberOption = Annotated[
    float | None,
    typer.Option(metavar="N", parser=_f_number, help="Aperture of the lens to imitate; needs the lenses' distance."),
]
EquivFocalOption = Annotated[
    float | None,
    typer.Option("--equiv-focal", metavar="MM", help="Its focal length on 35 mm film; with --f-number. [default: 50]"),
]
StrengthOption = Annotated[
    str | None,
    typer.Option(
        metavar="RADIUS",
        help="Radius of the strongest blur: px of the photo (24 or 24px), or a share of its longer side (1.5%). "
        "[default: 1.2 % of the longer side]",
    ),
]
BladesOption = Annotated[
    str | None,
    typer.Option(
        metavar="N[,ROUND[,DEG]]",
        help="Blades of the opening, 5 to 16, how round they are (0 to 1), and how far it is turned. [default: a disk]",
    ),
]
HighlightsOption = Annotated[
    float | None,
    typer.Option(
        metavar="TIMES",
        help="How many times as bright as white small clipped lights were, 1 to 100; 8, say. [default: 1]",
    ),
]

PictureOption = Annotated[
    str | None,
    typer.Option(
        metavar="KIND,...",
        help="Files of the bokeh: jpg, tif (16 bits), exr (linear, of RAW). [default: jpg, and what lies there]",
    ),
]
StripOption = Annotated[
    bool, typer.Option("--strip", help="Leave EXIF, GPS, date and XMP of the photo out of the files.")
]
PreviewOption = Annotated[
    bool,
    typer.Option(
        "--preview",
        help="A small bokeh_preview.jpg instead, to try focus and blur: takes seconds once the depth is there.",
    ),
]


@dataclass(frozen=True)
class BokehWords:
    """The words as they were given; the defaults are those of the commands."""

    focus: str = "auto"
    f_number: float | None = None
    f35_mm: float | None = None
    strength: str | None = None
    blades: str | None = None
    highlights: float | None = None
    picture: str | None = None
    strip: bool = False
    preview: bool = False

    @classmethod
    def of_call(cls, context: typer.Context) -> BokehWords:
        """Gather them from the options of a command, which have the names of the fields."""
        return cls(**{each.name: context.params[each.name] for each in fields(cls)})

    def options(self) -> BokehOptions:
        """Turn them into the options of the bokeh picture.

        Raises:
            UsageError: two strengths, one that is not above 0, or a word that is none of the known ones.
        """
        from telewide.bokeh.aperture import DISK
        from telewide.bokeh.highlights import MAX_TIMES
        from telewide.bokeh.picture import BokehOptions

        if self.f_number is not None and self.strength is not None:
            raise UsageError("--f-number and --strength both say how strong the blur is; give one of them")
        if self.f35_mm is not None and self.f_number is None:
            raise UsageError("--equiv-focal is of the lens that --f-number imitates", hint="add --f-number")
        for name, value in (("--f-number", self.f_number), ("--equiv-focal", self.f35_mm)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UsageError(f"{name} {value}: a number above 0 was expected")
        if self.highlights is not None and not 1 <= self.highlights <= MAX_TIMES:
            raise UsageError(f"--highlights {self.highlights}: a factor from 1 to {MAX_TIMES:g} was expected")
        if self.preview and self.picture is not None:
            raise UsageError("--preview writes a small JPEG; --picture names files of the full size")
        strength_px, strength_share = (None, None) if self.strength is None else _strength(self.strength)
        return BokehOptions(
            focus=self.focus,
            strength_px=strength_px,
            strength_share=strength_share,
            f_number=self.f_number,
            equiv_focal_mm=self.f35_mm or BokehOptions.equiv_focal_mm,
            aperture=DISK if self.blades is None else _aperture(self.blades),
            highlights=self.highlights,
            kinds=None if self.picture is None else _kinds(self.picture),
            is_stripped=self.strip,
            is_preview=self.preview,
        )

    def options_if(self, *, is_asked: bool) -> BokehOptions | None:
        """Return the options where a picture is asked for; elsewhere None, and words that shape it alone are refused.

        Args:
            is_asked: whether it is.

        Raises:
            UsageError: as of :meth:`options`, or words that shape nothing.
        """
        if is_asked:
            return self.options()
        if self != BokehWords(strip=self.strip):
            raise UsageError(
                "--focus, --f-number, --equiv-focal, --strength, --blades, --highlights, --picture and --preview shape "
                "the bokeh picture",
                hint="add --bokeh",
            )
        return None


def _strength(text: str) -> tuple[float | None, float | None]:
    """Radius in px, or as a share of the longer side."""
    word = text.strip().lower()
    is_share = word.endswith("%")
    try:
        value = float(word.removesuffix("%" if is_share else "px"))
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise UsageError(
            f"--strength {text}: a radius above 0 was expected, in px of the photo such as 24px, or as a share of its "
            "longer side such as 1.5%"
        )
    return (None, value / 100) if is_share else (value, None)


def _kinds(text: str) -> tuple[PictureKind, ...]:
    from telewide.bokeh.picture import PictureKind

    known = get_args(PictureKind)
    named = {word.strip().lower() for word in text.split(",")}
    if not named <= set(known):
        raise UsageError(f"--picture {text}: {', '.join(known)} were expected, several with commas between")
    if "exr" in named and find_spec("OpenEXR") is None:
        raise MissingPartError("--picture exr needs OpenEXR, which is not installed", hint=extra_hint("exr"))
    return tuple(kind for kind in known if kind in named)


def _aperture(text: str) -> Aperture:
    """Opening of so many blades."""
    from telewide.bokeh.aperture import Aperture

    parts = text.split(",")
    try:
        blades, curvature, rotation_deg = int(parts[0]), *(float(part) for part in [*parts[1:], "0", "0"][:2])
    except ValueError:
        parts = []
    if not 1 <= len(parts) <= 3:
        raise UsageError(
            f"--blades {text}: their number was expected, then how round they are and how far turned, such as 7,0.3,15"
        )
    return Aperture(blades=blades, curvature=curvature, rotation_deg=rotation_deg)
