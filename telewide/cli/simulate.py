"""``telewide simulate``: captures of a world that is known exactly."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telewide.cli.console import bar
from telewide.errors import UsageError
from telewide.text import command_line, counted

if TYPE_CHECKING:
    from telewide.simulate.rooms import RoomShots

SIMULATE_EPILOG = (
    "Example: `telewide simulate my-captures --captures 12 --seed 3`; "
    "with boards, rendered: `telewide simulate my-phone --world rooms --boards 20`"
)
WORLDS = ("pairs", "phone", "rooms")
_PAIR_WIDTH_PX, _PAIR_HEIGHT_PX, _ROOM_WIDTH_PX = 384, 256, 720
_WORLD_HELP = (
    "pairs: rectified, painted; phone: painted, as a phone takes them, and photos of a board; rooms: the same, "
    "rendered (needs the extra simulate). [default: pairs]"
)


def simulate(
    out: Annotated[Path, typer.Argument(help="Folder to write captures into, new or empty.")],
    *,
    world: Annotated[str | None, typer.Option(metavar="pairs|phone|rooms", help=_WORLD_HELP)] = None,
    captures: Annotated[int, typer.Option(help="How many captures.")] = 10,
    boards: Annotated[
        int | None, typer.Option(help="How many photos of the board by each lens; phone and rooms. [default: 14; 20]")
    ] = None,
    seed: Annotated[int, typer.Option(help="Same seed, same pictures.")] = 0,
    width: Annotated[
        int | None, typer.Option(help="Width of tele, px. [default: pairs and phone 384; rooms 720]")
    ] = None,
    height: Annotated[int | None, typer.Option(help="Height of tele, px; pairs. [default: 256]")] = None,
    factor: Annotated[
        float | None, typer.Option(help="How many times fewer pixels wide has along each side; pairs. [default: 3]")
    ] = None,
    scene: Annotated[
        str | None, typer.Option(metavar="still-life|random", help="What is photographed; pairs. [default: still-life]")
    ] = None,
    phone: Annotated[bool, typer.Option("--phone", help="Short for --world phone.")] = False,
    samples: Annotated[int | None, typer.Option(help="Rays per pixel and light; rooms. [default: 6]")] = None,
    lenses: Annotated[
        str | None, typer.Option(metavar="beside|above", help="How the lenses stand; rooms. [default: the seed says]")
    ] = None,
    raw: Annotated[bool, typer.Option("--raw", help="DNG instead of JPEG; rooms.")] = False,
    thin_lens: Annotated[
        bool, typer.Option("--thin-lens", help="Also what a large aperture would blur, into truth/; rooms.")
    ] = False,
) -> None:
    """Write captures of a simulated world, with exact disparity beside them."""
    chosen = _world(world, is_phone=phone)
    own: dict[str, dict[str, object]] = {
        "pairs": {"--height": height, "--factor": factor, "--scene": scene},
        "rooms": {"--samples": samples, "--lenses": lenses, "--raw": raw or None, "--thin-lens": thin_lens or None},
    }
    _refuse_foreign(chosen, own, boards=boards)
    _refuse_filled(out)
    if chosen == "pairs":
        hw = (_or(height, _PAIR_HEIGHT_PX), _or(width, _PAIR_WIDTH_PX))
        _simulate_pairs(out, captures, seed, hw=hw, factor=3.0 if factor is None else factor, scene=scene)
    elif chosen == "phone":
        _simulate_phone(out, captures, seed, boards=_or(boards, 14), width=_or(width, _PAIR_WIDTH_PX))
    else:
        from telewide.simulate.rooms import DEFAULT_SAMPLES, RoomShots

        how = RoomShots(_or(width, _ROOM_WIDTH_PX), _or(samples, DEFAULT_SAMPLES), _is_vertical(lenses), raw, thin_lens)
        _simulate_rooms(out, captures, seed, boards=_or(boards, 20), how=how)


def _world(world: str | None, *, is_phone: bool) -> str:
    if is_phone and world not in (None, "phone"):
        raise UsageError(f"--phone and --world {world} are two worlds; give one of them")
    chosen = "phone" if is_phone else world or "pairs"
    if chosen not in WORLDS:
        raise UsageError(f"--world {chosen}: expected {', '.join(WORLDS)}")
    return chosen


def _refuse_foreign(chosen: str, own: Mapping[str, Mapping[str, object]], *, boards: int | None) -> None:
    """An option of another world would be ignored without a word."""
    for world, options in own.items():
        given = [name for name, value in options.items() if value is not None]
        if world != chosen and given:
            raise UsageError(f"{', '.join(given)}: for --world {world}; the world is {chosen}")
    if chosen == "pairs" and boards is not None:
        raise UsageError("--boards: no board is photographed in the world pairs", hint="add --world phone or rooms")


def _refuse_filled(out: Path) -> None:
    """Captures that lie there would be replaced, or stand among the made ones."""
    try:
        is_filled = out.is_dir() and any(out.iterdir())
    except OSError as error:
        raise UsageError(f"{out} cannot be opened: {error.strerror or error}") from error
    if is_filled:
        raise UsageError(
            f"{out} is not empty; a new folder was expected, for captures in it could be replaced",
            hint="name a folder that is not there yet, or empty this one first",
        )


def _is_vertical(lenses: str | None) -> bool | None:
    if lenses not in (None, "beside", "above"):
        raise UsageError(f"--lenses {lenses}: expected beside or above")
    return None if lenses is None else lenses == "above"


def _or(given: int | None, default: int) -> int:
    return default if given is None else given


def _simulate_pairs(
    out: Path, captures: int, seed: int, *, hw: tuple[int, int], factor: float, scene: str | None
) -> None:
    from telewide.simulate.captures import write_captures

    folders = write_captures(out, count=captures, seed=seed, hw=hw, factor=factor, scene=scene or "still-life")
    typer.echo(f"wrote {counted(len(folders), 'capture')} to {out}", err=True)
    typer.echo(f"next: {command_line('train', out)}", err=True)


def _simulate_phone(out: Path, captures: int, seed: int, *, boards: int, width: int) -> None:
    from telewide.simulate.phone import write_phone

    write_phone(out, captures=captures, boards=boards, seed=seed, width=width)
    _say_phone(out, captures)


def _simulate_rooms(out: Path, captures: int, seed: int, *, boards: int, how: RoomShots) -> None:
    from telewide.simulate.rooms import write_rooms

    with bar("rendering", total=captures + boards) as shown:
        write_rooms(out, captures=captures, boards=boards, seed=seed, how=how, tick=shown.advance)
    _say_phone(out, captures)


def _say_phone(out: Path, captures: int) -> None:
    typer.echo(f"wrote {counted(captures, 'capture')} and photos of a board to {out}", err=True)
    calibrate = command_line("calibrate", board="chessboard_9x6", square_m=0.025)
    typer.echo(f"next: cd {shlex.quote(str(out))} && {calibrate}", err=True)
