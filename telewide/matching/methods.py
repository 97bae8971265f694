"""The ways to match two views, by name; imports nothing, for the command line."""

from __future__ import annotations

from typing import Literal

Method = Literal["network", "sgm"]
"""A network, or semi-global matching."""
