"""Find the captures in a folder.

Four layouts are recognised, also mixed in one folder::

    <name>/tele.*           <name>/wide.*           a folder per capture
    <name>_tele.*           <name>_wide.*           also -T/-W, _3x/_1x
    tele/<name>.*           wide/<name>.*           a folder per view
    tele.*                  wide.*                  the given folder is one capture

A true disparity map, where there is one, is ``<name>/truth.pfm``, ``<name>_truth.pfm`` or ``truth/<name>.pfm``.
Which file of several is taken: `telewide.capture.view_files`.
What is wrong with one capture, such as a folder without a photo, is a `Problem` and leaves the others alone.
"""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from telewide.assets import find_yaml
from telewide.capture.facts import FACTS_FILE, CaptureFacts, read_facts
from telewide.capture.formats import HEAD_BYTES, READ_KINDS, UNREAD_SUFFIXES, format_by_head, read_bytes
from telewide.capture.view_files import (
    VIEWS,
    best_photos,
    is_photo_name,
    is_picture,
    is_same_file,
    joined_by_case,
    listed,
    one_spelling,
    passed_over,
    photos_among,
    visible_entries,
)
from telewide.errors import InputError, UsageError
from telewide.files import is_file, is_folder, refuse_other_than_folder

_TRUTH_SUFFIX = ".pfm"
TRUTH = "truth"
_THE_SAME = "are the same picture; two different photos were expected"
_UNREAD, _CLOSED, _OTHER, _BARE = "unread", "closed", "other", "bare"
_ALIKE = 0.6  # of names, by difflib
_MAX_LISTED = 5
_ROLE_SUFFIX = re.compile(
    r"(?P<name>.+?)(?:[ _.-](?P<word>tele|wide|truth)|[_-](?P<letter>[tw])|[_-](?P<zoom>\d+x))",
    re.IGNORECASE | re.DOTALL,
)
_WHERE_TO_PUT = "name the folder that holds your photos, or put them into captures/<name>/tele.jpg and wide.jpg"
_LAYOUTS = "<name>/tele.* with <name>/wide.*, <name>_tele.* with <name>_wide.*, or tele/<name>.* with wide/<name>.*"

# (name of a capture, its layout) -> role (tele, wide, truth) -> the files that could be it
_Candidates = dict[tuple[str, str], dict[str, list[Path]]]


@dataclass(frozen=True)
class Capture:
    """The two photos of one scene.

    Attributes:
        name: unique in its set; fit for a folder name.
        tele_path: photo of the tele camera.
        wide_path: photo of the wide camera.
        truth_path: PFM with the true disparity of the reference view, if there is one.
        valid_paths: of a rectified pair: pictures that are white where the tele and the wide photo reach; None where
            the photos fill the views.
    """

    name: str
    tele_path: Path
    wide_path: Path
    truth_path: Path | None = None
    valid_paths: tuple[Path, Path] | None = None


@dataclass(frozen=True)
class Problem:
    """Fault of one capture.

    Attributes:
        name: of the capture.
        message: what is wrong, with the files.
        is_skipped: True where the capture is left out, False where it is used all the same.
    """

    name: str
    message: str
    is_skipped: bool = True


@dataclass(frozen=True)
class CaptureSet:
    """The captures of one folder.

    Attributes:
        root: the folder.
        captures: sorted by name, never empty.
        facts: what ``captures.yaml`` states of all of them.
        problems: what was left out or chosen, and why.
    """

    root: Path
    captures: tuple[Capture, ...]
    facts: CaptureFacts
    problems: tuple[Problem, ...]


def find_captures(folder: Path, *, advised: Callable[[Path], str] = str) -> CaptureSet:
    """Find the captures in a folder, whatever its layout.

    Args:
        folder: holds captures in any of the layouts above, or is one capture.
        advised: writes the call that takes another folder, which is advised where a photo was named.

    Returns:
        The captures with the facts of ``captures.yaml``.

    Raises:
        UsageError: there is no such folder.
        InputError: no capture is left, or ``captures.yaml`` cannot be used.
    """
    if is_picture(folder):
        hint = f"name the folder that holds it: {advised(_folder_of(folder))}"
        raise UsageError(f"{folder} is a file; a folder with captures was expected", hint=hint)
    refuse_other_than_folder(folder, expected="a folder with captures", hint=_WHERE_TO_PUT)
    candidates = _candidates(folder)
    captures, problems = _choose(candidates)
    if not captures:
        raise _nothing_found(folder, problems)
    facts_path = _facts_path(folder, captures)
    facts = CaptureFacts() if facts_path is None else read_facts(facts_path)
    return CaptureSet(folder, tuple(captures), facts, tuple(problems))


def _folder_of(photo: Path) -> Path:
    """Choose the folder to name instead of a photo: the nearest that holds captures, if one does."""
    for folder in (photo.parent, photo.parent.parent):
        with suppress(InputError):
            if _choose(_candidates(folder))[0]:
                return folder
    return photo.parent


def _candidates(folder: Path) -> _Candidates:
    found: _Candidates = defaultdict(lambda: defaultdict(list))
    own_name = one_spelling(folder.resolve().name) or "capture"
    for entry in visible_entries(folder):
        if is_folder(entry):
            try:
                _add_folder(found, entry)
            except InputError:
                found[one_spelling(entry.name), "folder"][_CLOSED].append(entry)
        elif _is_of_interest(entry):
            _add_file(found, entry, own_name)
    return _joined_by_case(found)


def _add_folder(found: _Candidates, folder: Path) -> None:
    """Add what a folder holds: a view of many captures, or one capture.

    Raises:
        InputError: it cannot be opened.
    """
    role = folder.name.casefold()
    if role in {*VIEWS, TRUTH} and not _has_both_views(folder):
        for file in _files(folder):
            found[one_spelling(file.stem), "split"][_role_or_unread(file, role)].append(file)
    else:
        _add_capture_folder(found, folder)


def _joined_by_case(found: _Candidates) -> _Candidates:
    """Put photos together that miss each other by letter case alone; folders of captures are told apart by it."""
    joined: _Candidates = {}
    for layout in ("folder", "split", "suffix"):
        groups = {name: roles for (name, of), roles in found.items() if of == layout}
        by_name = groups if layout == "folder" else joined_by_case(groups)
        joined |= {(name, layout): roles for name, roles in by_name.items()}
    return joined


def _has_both_views(folder: Path) -> bool:
    """Whether a folder is one capture, whatever its name: of a photo that was called tele, for instance."""
    return {file.stem.casefold() for file in _files(folder)}.issuperset(VIEWS)


def _add_capture_folder(found: _Candidates, folder: Path) -> None:
    key, files = (one_spelling(folder.name), "folder"), _files(folder)
    for file in files:
        role = file.stem.casefold()
        if role in {*VIEWS, TRUTH}:
            found[key][_role_or_unread(file, role)].append(file)
    others = [file for file in files if is_photo_name(file) and file.stem.casefold() not in VIEWS]
    if key in found:
        found[key][_OTHER] = others
    elif others:
        found[key]["unnamed"].extend(files)
    else:
        unread = [file for file in files if _is_unread(file)]
        if unread:
            found[key][_UNREAD] = unread
        elif not any(map(is_folder, visible_entries(folder))):  # else it is a run folder, say
            found[key][_BARE] = [folder]


def _add_file(found: _Candidates, file: Path, own_name: str) -> None:
    stem = one_spelling(file.stem)
    if stem.casefold() in {*VIEWS, TRUTH}:
        found[own_name, "folder"][_role_or_unread(file, stem.casefold())].append(file)
    elif match := _ROLE_SUFFIX.fullmatch(stem):
        found[match["name"], "suffix"][_role_or_unread(file, _role(match))].append(file)


def _role_or_unread(file: Path, role: str) -> str:
    return _UNREAD if _is_unread(file) else role


def _is_unread(file: Path) -> bool:
    return file.suffix.lower() in UNREAD_SUFFIXES


def _role(match: re.Match[str]) -> str:
    if match["word"]:
        return match["word"].casefold()
    if match["letter"]:
        return "tele" if match["letter"] in "tT" else "wide"
    return "wide" if match["zoom"].casefold() == "1x" else "tele"


def _choose(candidates: _Candidates) -> tuple[list[Capture], list[Problem]]:
    captures: dict[str, Capture] = {}
    problems = []
    for (name, _), roles in sorted(candidates.items(), key=lambda item: item[0]):
        message = _why_unusable(roles)
        if "\n" in name:  # every message of it would look like several
            name, message = name.replace("\n", "\\n"), "its name holds a line break; rename it"
        if message is None and name in captures:
            message = f"{_pair(roles)[0]} is not read: {captures[name].tele_path} has the same name"
        if message is not None:
            problems.append(Problem(name, message))
            continue
        tele, wide = _pair(roles)
        for view, taken in zip(VIEWS, (tele, wide), strict=True):
            problems += _ambiguities(name, view, taken, roles[view])
        captures[name] = Capture(name, tele, wide, _truth(roles))
    return list(captures.values()), problems


def _why_unusable(roles: dict[str, list[Path]]) -> str | None:
    if _CLOSED in roles:
        return f"{roles[_CLOSED][0]} cannot be opened"
    if _BARE in roles:
        return f"{roles[_BARE][0]} holds no photo"
    if "unnamed" in roles:
        told = f"{roles['unnamed'][0].parent} holds neither tele.* nor wide.*"
        return told + "".join(_misspelt(view, roles["unnamed"]) for view in VIEWS)
    for view, other in (VIEWS, VIEWS[::-1]):
        if not photos_among(roles.get(view, [])):
            if roles.get(_UNREAD):
                return f"{listed(roles[_UNREAD])} cannot be read; {READ_KINDS} are read"
            present = roles.get(other) or roles.get("truth") or []
            return f"the {view} view is missing; found {listed(present)}{_misspelt(view, roles.get(_OTHER, []))}"
    tele, wide = _pair(roles)
    return f"{tele} and {wide} {_THE_SAME}" if is_same_file(tele, wide) and _is_photo(tele) else None


def _is_photo(path: Path) -> bool:
    """Whether a file begins as a photo does; whoever reads one that is empty or something else says so."""
    try:
        format_by_head(path, read_bytes(path, at_most=HEAD_BYTES))
    except InputError:
        return False
    return True


def _misspelt(view: str, files: Iterable[Path]) -> str:
    """Words that ask to rename the photo whose name is nearly that of a view; none where there is no such photo."""
    photos = {file.stem.casefold(): file for file in files if is_photo_name(file)}
    near = difflib.get_close_matches(view, photos, n=1, cutoff=_ALIKE)
    return "".join(f"; rename {photos[stem].name} to {view}{photos[stem].suffix} if that is it" for stem in near)


def _ambiguities(name: str, view: str, taken: Path, paths: Iterable[Path]) -> list[Problem]:
    others = passed_over(taken, paths)
    told = f"two files for the {view} view: {taken} is taken, {listed(others)} is not"
    return [Problem(name, told, is_skipped=False)] if others else []


def _pair(roles: dict[str, list[Path]]) -> tuple[Path, Path]:
    best = best_photos({view: roles[view] for view in VIEWS})
    return best["tele"], best["wide"]


def _truth(roles: dict[str, list[Path]]) -> Path | None:
    return next((path for path in roles.get("truth", ()) if path.suffix.lower() == _TRUTH_SUFFIX), None)


def _facts_path(folder: Path, captures: list[Capture]) -> Path | None:
    """Return the facts of this folder; of one capture taken out of a set, those of the set; None without any."""
    stem = Path(FACTS_FILE).stem
    is_one_of_a_set = len(captures) == 1 and captures[0].tele_path.parent == folder
    return find_yaml(folder, stem) or (find_yaml(folder.absolute().parent, stem) if is_one_of_a_set else None)


def _nothing_found(folder: Path, problems: list[Problem]) -> InputError:
    entries = visible_entries(folder)
    for entry in filter(is_folder, entries):
        with suppress(InputError):  # a closed one, which is among the problems
            if _choose(_candidates(entry))[0]:
                return InputError(f"{folder} holds no captures, but {entry} does", hint=f"name {entry} instead")
    hint = f"expected {_LAYOUTS}"
    if problems:
        told = "".join(f"\n  {problem.name}: {problem.message}" for problem in problems[:_MAX_LISTED])
        more = f"\n  and {len(problems) - _MAX_LISTED} more" if len(problems) > _MAX_LISTED else ""
        if all(problem.message.endswith(_THE_SAME) for problem in problems):
            hint = "put the photo of the other lens in the place of one of the two"
        return InputError(f"{folder} holds no capture that can be used:{told}{more}", hint=hint)
    inside = f"it holds {listed(entries)}" if entries else "it is empty"
    return InputError(f"{folder} holds no captures: {inside}", hint=hint)


def _files(folder: Path) -> list[Path]:
    return [entry for entry in visible_entries(folder) if _is_of_interest(entry)]


def _is_of_interest(path: Path) -> bool:
    return is_picture(path) or (path.suffix.lower() == _TRUTH_SUFFIX and is_file(path))
