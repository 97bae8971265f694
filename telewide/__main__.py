"""``python -m telewide``: the same as the ``telewide`` command."""

from __future__ import annotations

from telewide.cli import main

if __name__ == "__main__":
    main()
