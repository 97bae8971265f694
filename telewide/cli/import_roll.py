"""``telewide import``: from a phone's camera roll to a folder of captures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telewide.cli.arguments import DEFAULT_RIG, JsonOption, QuietOption
from telewide.cli.console import bar, print_json, say
from telewide.errors import InputError, UsageError
from telewide.text import command_line, counted

if TYPE_CHECKING:
    from rich.table import Table

    from telewide.capture.exif import PhotoFacts
    from telewide.capture.importer import ImportPlan
    from telewide.capture.lens_choice import ChosenLenses, LensPair
    from telewide.capture.lenses import Lens

IMPORT_EPILOG = "Example: `telewide import /media/phone/DCIM captures/ --dry-run`"
_TABLE_WIDTH = 200
_MAX_LISTED = 5


def import_photos(
    dcim: Annotated[Path, typer.Argument(metavar="DCIM", help="Folder of the phone's photos, with folders in it.")],
    captures: Annotated[Path, typer.Argument(help="Folder to put captures into.")] = Path("captures"),
    *,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would be done, and write nothing.")] = False,
    max_seconds: Annotated[float, typer.Option(help="Photos farther apart in time are no pair.")] = 10.0,
    tele_mm: Annotated[
        float | None, typer.Option(help="FocalLength of the tele lens. [default: as the photos tell]")
    ] = None,
    wide_mm: Annotated[
        float | None, typer.Option(help="FocalLength of the wide lens. [default: as the photos tell]")
    ] = None,
    link: Annotated[bool, typer.Option("--link", help="Hard links instead of copies, where possible.")] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Pair the photos of a camera roll by phone, lens and time; a second call adds what is new."""
    from telewide.capture.importer import carry_out, plan_import
    from telewide.capture.lens_choice import LensChoice

    for name, value in (("--max-seconds", max_seconds), ("--tele-mm", tele_mm), ("--wide-mm", wide_mm)):
        if value is not None and not value > 0:
            raise UsageError(f"{name} {value:g}: a number above 0 was expected")
    choice = LensChoice(tele_mm=tele_mm, wide_mm=wide_mm, max_seconds=max_seconds)
    with bar("looking at photos", is_quiet=quiet) as shown:
        plan = plan_import(dcim, captures, choice=choice, tick=shown.reach)
    if not quiet and not as_json:
        _show(plan)
    if not plan.pairs and not plan.known:
        raise _no_pair(dcim, plan, is_shown=not quiet and not as_json)
    if not dry_run:
        with bar("importing", is_quiet=quiet) as shown:
            carry_out(plan, captures, is_linked=link, tick=shown.reach)
    if as_json:
        print_json(_json_of(plan, captures, is_dry=dry_run))
    if not quiet:
        _say_done(plan, dcim, captures, is_dry=dry_run)


def _no_pair(dcim: Path, plan: ImportPlan, *, is_shown: bool) -> InputError:
    listed = () if is_shown else plan.unpaired[:_MAX_LISTED]
    told = "".join(f"\n  {one.photo.path.name}: {one.reason}" for one in listed)
    more = f"\n  and {len(plan.unpaired) - len(listed)} more" if listed and len(plan.unpaired) > len(listed) else ""
    hint = "photograph each scene with both lenses, or state --max-seconds, --tele-mm and --wide-mm"
    return InputError(f"{dcim}: no two photos make a pair of tele and wide{told}{more}", hint=hint)


def _show(plan: ImportPlan) -> None:
    from telewide.cli.terminal import TerminalConsole

    console = TerminalConsole()
    if not console.is_terminal:
        console.width = _TABLE_WIDTH
    if plan.pairs:
        console.print(_table_of_pairs(plan))
    if plan.unpaired:
        console.print(_table_of_unpaired(plan))


def _table_of_pairs(plan: ImportPlan) -> Table:
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("capture", "tele", "wide"):
        table.add_column(heading)
    for heading in ("apart s", "f mm", "35 mm", "ratio"):
        table.add_column(heading, justify="right")
    table.add_column("note")
    for planned in plan.pairs:
        pair = planned.pair
        tele, wide = pair.tele.facts, pair.wide.facts
        table.add_row(
            *(escape(name) for name in (planned.name, pair.tele.path.name, pair.wide.path.name)),
            f"{abs(pair.seconds_apart):.1f}",
            f"{_number(tele.focal_length_mm)} / {_number(wide.focal_length_mm)}",
            f"{_number(tele.f35_mm)} / {_number(wide.f35_mm)}",
            _number(pair.ratio, "2.2f"),
            "; ".join(pair.notes),
        )
    return table


def _table_of_unpaired(plan: ImportPlan) -> Table:
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("left out")
    table.add_column("taken")
    for heading in ("f mm", "35 mm"):
        table.add_column(heading, justify="right")
    table.add_column("why")
    for one in plan.unpaired:
        facts = one.photo.facts
        taken = facts.taken.strftime("%Y-%m-%d %H:%M:%S") if facts.taken else "-"
        row = (_number(facts.focal_length_mm), _number(facts.f35_mm))
        table.add_row(escape(one.photo.path.name), taken, *row, escape(one.reason))
    return table


def _number(value: float | None, form: str = "g") -> str:
    return "-" if value is None else format(value, form)


def _say_done(plan: ImportPlan, dcim: Path, captures: Path, *, is_dry: bool) -> None:
    done = "would be imported" if is_dry else "imported"
    say(f"{done} into {captures}: {len(plan.pairs)} new, {len(plan.known)} already there")
    if plan.unpaired:
        say(f"left out: {len(plan.unpaired)}")
    for lenses in plan.lenses:
        if lenses.others:
            _say_lenses(lenses, dcim, captures)
    if not is_dry and plan.pairs:
        rig = captures / DEFAULT_RIG
        boards = command_line("calibrate", "boards", out=rig)
        say(f"next: {boards}  (photos of a board, taken with both lenses)")
        say(f"  or without a board: {command_line('calibrate', captures, from_scenes=True, out=rig)}")


def _say_lenses(lenses: ChosenLenses, dcim: Path, captures: Path) -> None:
    """Say which lenses were paired, and which call takes the next best ones, whose photos may have a partner here."""
    chosen, other = lenses.chosen, lenses.others[0]
    say(f"{chosen.wide.camera}: {_lens(chosen.tele)} is paired with {_lens(chosen.wide)}")
    wide_mm, tele_mm = other.wide.focal_length_mm, other.tele.focal_length_mm
    folder = captures.with_name(f"{captures.name}-{tele_mm:g}mm-{wide_mm:g}mm")
    again = command_line("import", dcim, folder, wide_mm=wide_mm, tele_mm=tele_mm)
    count = counted(other.n_pairs, "pair")
    say(f"  {count} of {_lens(other.tele)} and {_lens(other.wide)}, if those are meant: {again}")


def _lens(lens: Lens) -> str:
    equivalent = f" ({lens.f35_mm:.0f} mm equivalent)" if lens.f35_mm else ""
    return f"{lens.focal_words}{equivalent}"


def _json_of(plan: ImportPlan, captures: Path, *, is_dry: bool) -> dict[str, object]:
    return {
        "captures": str(captures),
        "is_dry_run": is_dry,
        "pairs": [
            {
                "name": planned.name,
                "tele": _json_of_photo(planned.pair.tele.path, planned.pair.tele.facts),
                "wide": _json_of_photo(planned.pair.wide.path, planned.pair.wide.facts),
                "seconds_apart": planned.pair.seconds_apart,
                "ratio_35": planned.pair.ratio,
                "notes": list(planned.pair.notes),
            }
            for planned in plan.pairs
        ],
        "unpaired": [
            {**_json_of_photo(one.photo.path, one.photo.facts), "reason": one.reason} for one in plan.unpaired
        ],
        "known": list(plan.known),
        "lenses": [
            {
                "camera": lenses.chosen.wide.camera,
                "chosen": _json_of_lenses(lenses.chosen),
                "others": [_json_of_lenses(other) for other in lenses.others],
            }
            for lenses in plan.lenses
        ],
    }


def _json_of_lenses(pair: LensPair) -> dict[str, object]:
    return {"wide_mm": pair.wide.focal_length_mm, "tele_mm": pair.tele.focal_length_mm, "n_pairs": pair.n_pairs}


def _json_of_photo(path: Path, facts: PhotoFacts) -> dict[str, object]:
    return {
        "file": str(path),
        "camera": facts.camera,
        "focal_length_mm": facts.focal_length_mm,
        "f35_mm": facts.f35_mm,
        "taken": facts.taken.isoformat() if facts.taken else None,
    }
