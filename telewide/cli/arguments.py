"""Arguments and options that several commands say alike."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from telewide.cores import Device
from telewide.errors import UsageError
from telewide.files import is_folder
from telewide.matching.methods import Method
from telewide.ranges import MAX_SEED

DEFAULT_RIG = Path("rig.yaml")
DeviceOption = Annotated[Device, typer.Option(help="Where to compute.")]
METHOD_HELP = "network, or sgm: semi-global matching, without a network."
MethodOption = Annotated[Method, typer.Option(help=METHOD_HELP)]
RigOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Rig to rectify with. [default: rig.yaml by the captures or here]")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but warnings and errors.")]
CapturesArgument = Annotated[Path, typer.Argument(help="Folder of the captures.")]
RecipeOption = Annotated[str, typer.Option(help="Recipe: quick, default, paper, or a YAML file.")]
RunFolderOption = Annotated[
    Path | None, typer.Option("--out", help="Run folder. [default: run/ here, else beside the captures]")
]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the recipe; may be repeated.")
]
OnlyOption = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="This capture alone; may be repeated. [default: all]")
]
FormatOption = Annotated[
    list[str] | None,
    typer.Option(
        "--format",
        metavar="NAME,...",
        help="Depth files: pfm, png, npz, mm, tiff, grey, gdepth, dynamic, ply, glb, exr, heic or all. "
        "[default: those that lie there, at first pfm,png,npz]",
    ),
]
DistanceOption = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,M|exif",
        help="A point of the tele photo and its distance, metres; exif: its middle, at the focus EXIF states.",
    ),
]
SeedOption = Annotated[int | None, typer.Option(min=0, max=MAX_SEED, help="Seed of weights and samples.")]


def refuse_filled(folder: Path) -> None:
    """Refuse to write into a folder that holds something: it would be replaced, or stand among what is made.

    Raises:
        UsageError: the folder is not empty, or cannot be opened.
    """
    try:
        is_filled = is_folder(folder) and any(folder.iterdir())
    except OSError as error:
        raise UsageError(f"{folder} cannot be opened: {error.strerror or error}") from error
    if is_filled:
        raise UsageError(
            f"{folder} is not empty; a new folder was expected, for captures in it could be replaced",
            hint="name a folder that is not there yet, or empty this one first",
        )
