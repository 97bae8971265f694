"""The command line: parse, call one function, say what was written."""

from telewide.cli.app import main

__all__ = ["main"]
