"""The ways to match two views, by name; free of torch."""

from __future__ import annotations

from typing import Literal

Method = Literal["joint", "network", "sgm"]
"""A network and semi-global matching together, the network alone, semi-global matching alone."""
