"""Write the example captures of this folder: ten still lifes, the first five with their truth.

Run from the root of the checkout: ``python examples/make_captures.py``
"""

from __future__ import annotations

from pathlib import Path

from telewide.simulate.captures import write_captures

if __name__ == "__main__":
    here = Path(__file__).resolve().parent
    for folder in write_captures(here / "captures", count=10, seed=3, image_format="jpg", truth_count=5):
        print(folder)
