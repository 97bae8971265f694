"""``telewide simulate``: captures of a world that is known exactly."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from telewide.cli.arguments import DEFAULT_RIG, JsonOption, QuietOption, refuse_filled
from telewide.cli.console import bar, print_json, say
from telewide.errors import UsageError
from telewide.ranges import MAX_SEED
from telewide.text import command_line, counted

if TYPE_CHECKING:
    from telewide.simulate.rooms import RoomShots

SIMULATE_EPILOG = (
    "Example: `telewide simulate my-captures --captures 12 --seed 3`; "
    "with boards, rendered: `telewide simulate my-phone --world rooms --boards 20`"
)
_BOARD = "chessboard_9x6"
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
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Same seed, same pictures.")] = 0,
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
        bool, typer.Option("--thin-lens", help="Also what large apertures see, into truth/; pairs, rooms.")
    ] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write captures of a simulated world, with exact disparity beside them."""
    chosen = _world(world, is_phone=phone, has_bokeh=thin_lens)
    of_rooms = {"--samples": samples, "--lenses": lenses, "--raw": raw or None}
    of_pairs = {"--height": height, "--factor": factor, "--scene": scene}
    _refuse_foreign(chosen, {"pairs": of_pairs, "rooms": of_rooms}, boards=boards)
    refuse_filled(out)
    n_boards = {"pairs": 0, "phone": _or(boards, 14), "rooms": _or(boards, 20)}[chosen]
    if chosen == "pairs":
        out = out / "captures" if thin_lens else out
        _simulate_pairs(out, captures, seed, hw=(height, width), factor=factor, scene=scene, has_bokeh=thin_lens)
    elif chosen == "phone":
        from telewide.simulate.phone import write_phone

        write_phone(out, captures=captures, boards=n_boards, seed=seed, width=_or(width, _PAIR_WIDTH_PX))
    else:
        how = _room_shots(width, samples, lenses, is_raw=raw, has_thin_lens=thin_lens)
        _simulate_rooms(out, captures, seed, boards=n_boards, how=how, is_quiet=quiet)
    answer = {"folder": str(out), "world": chosen, "captures": captures, "boards": n_boards, "seed": seed}
    _hand_over(out, answer, as_json=as_json, is_quiet=quiet)


def _world(world: str | None, *, is_phone: bool, has_bokeh: bool) -> str:
    if is_phone and world not in (None, "phone"):
        raise UsageError(f"--phone and --world {world} are two worlds; give one of them")
    chosen = "phone" if is_phone else world or "pairs"
    if chosen not in WORLDS:
        raise UsageError(f"--world {chosen}: expected {', '.join(WORLDS)}")
    if has_bokeh and chosen == "phone":
        raise UsageError("--thin-lens: for --world pairs or rooms; the world is phone")
    return chosen


def _refuse_foreign(chosen: str, own: Mapping[str, Mapping[str, object]], *, boards: int | None) -> None:
    """Refuse options of another world, which would be ignored silently."""
    for world, options in own.items():
        given = [name for name, value in options.items() if value is not None]
        if world != chosen and given:
            raise UsageError(f"{', '.join(given)}: for --world {world}; the world is {chosen}")
    if chosen == "pairs" and boards is not None:
        raise UsageError("--boards: no board is photographed in the world pairs", hint="add --world phone or rooms")


def _is_vertical(lenses: str | None) -> bool | None:
    if lenses not in (None, "beside", "above"):
        raise UsageError(f"--lenses {lenses}: expected beside or above")
    return None if lenses is None else lenses == "above"


def _or(given: int | None, default: int) -> int:
    return default if given is None else given


def _simulate_pairs(
    out: Path,
    captures: int,
    seed: int,
    *,
    hw: tuple[int | None, int | None],
    factor: float | None,
    scene: str | None,
    has_bokeh: bool,
) -> None:
    from telewide.simulate.captures import write_captures

    size = (_or(hw[0], _PAIR_HEIGHT_PX), _or(hw[1], _PAIR_WIDTH_PX))
    by, scene = 3.0 if factor is None else factor, scene or "still-life"
    write_captures(out, count=captures, seed=seed, hw=size, factor=by, scene=scene, has_bokeh=has_bokeh)


def _room_shots(
    width: int | None, samples: int | None, lenses: str | None, *, is_raw: bool, has_thin_lens: bool
) -> RoomShots:
    from telewide.simulate.rooms import DEFAULT_SAMPLES, RoomShots

    return RoomShots(
        width=_or(width, _ROOM_WIDTH_PX),
        samples=_or(samples, DEFAULT_SAMPLES),
        is_vertical=_is_vertical(lenses),
        is_raw=is_raw,
        has_bokeh=has_thin_lens,
    )


def _simulate_rooms(out: Path, captures: int, seed: int, *, boards: int, how: RoomShots, is_quiet: bool) -> None:
    from telewide.simulate.rooms import write_rooms

    with bar("rendering", total=captures + boards, is_quiet=is_quiet) as shown:
        write_rooms(out, captures=captures, boards=boards, seed=seed, how=how, tick=shown.advance)


def _hand_over(out: Path, answer: dict[str, object], *, as_json: bool, is_quiet: bool) -> None:
    if not is_quiet:
        _say(out, counted(cast(int, answer["captures"]), "capture"), has_boards=answer["world"] != "pairs")
    if as_json:
        print_json(answer)


def _say(out: Path, captures: str, *, has_boards: bool) -> None:
    if not has_boards:
        say(f"wrote {captures} to {out}")
        say(f"next: {command_line('train', out)}")
        return
    from telewide.simulate.phone import BOARD_SQUARE_M

    say(f"wrote {captures} and photos of a board to {out}")
    rig = out / DEFAULT_RIG
    calibrate = command_line("calibrate", out / "boards", board=_BOARD, square_m=BOARD_SQUARE_M, out=rig)
    say(f"next: {calibrate}")
