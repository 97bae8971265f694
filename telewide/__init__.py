"""telewide: depth and bokeh from the wide and tele lenses of a phone.

The functions below are those of `telewide.api`, loaded when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from telewide.api import (
        calibrate,
        estimate_depth,
        load_rig,
        read_pair,
        rectify,
        render_bokeh,
        save_rig,
        train,
    )

__version__ = "0.1.0"
__all__ = [
    "__version__",
    "calibrate",
    "estimate_depth",
    "load_rig",
    "read_pair",
    "rectify",
    "render_bokeh",
    "save_rig",
    "train",
]


def __getattr__(name: str) -> object:
    """Load the public interface when a function of it is asked for."""
    if name.startswith("_") or name not in __all__:
        raise AttributeError(f"module 'telewide' has no attribute {name!r}")
    return getattr(import_module("telewide.api"), name)


def __dir__() -> list[str]:
    """Name what is public."""
    return sorted(__all__)
