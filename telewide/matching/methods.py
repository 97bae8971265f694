"""The ways to match two views, by name; imports nothing, for the command line."""

from __future__ import annotations

from typing import Literal

Method = Literal["joint", "network", "sgm"]
"""A network and semi-global matching together, the network alone, semi-global matching alone."""
