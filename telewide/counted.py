"""How many of something, in words."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """Say how many there are: ``1 capture``, ``2 captures``.

    Args:
        number: how many.
        noun: of one of them; its plural is made with an s.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
