"""Photos of several sizes where what their owner states in pixels holds for one size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from telewide.capture.exif import read_photo_facts
from telewide.capture.layout import CaptureSet, Problem
from telewide.errors import TelewideError


def check_sizes(captures: CaptureSet) -> tuple[Problem, ...]:
    """Find captures of another size than most, where ``captures.yaml`` states ``f_px`` or ``doffs_px`` of all.

    Args:
        captures: a set.

    Returns:
        One note for each such capture, which is used all the same; empty where nothing is stated in pixels.
    """
    facts = captures.facts
    stated = [name for name in ("f_px", "doffs_px") if getattr(facts, name) is not None]
    return tuple(_odd_sizes(captures, " and ".join(stated))) if stated else ()


def _odd_sizes(captures: CaptureSet, stated: str) -> Iterator[Problem]:
    sizes: dict[str, tuple[int, int]] = {}
    for capture in captures.captures:
        try:
            hw = read_photo_facts(capture.tele_path).hw
        except TelewideError:  # reading the photo says so in its own words
            continue
        if hw is not None:
            sizes[capture.name] = hw
    usual = Counter(sizes.values()).most_common(1)
    for name, hw in sizes.items():
        if hw != usual[0][0]:
            most = f"{usual[0][0][1]} x {usual[0][0][0]} px"
            told = (
                f"its tele photo is {hw[1]} x {hw[0]} px, most are {most}, and captures.yaml states {stated} of one "
                "size: metres hold for photos of that size only"
            )
            yield Problem(name, told, is_skipped=False)
