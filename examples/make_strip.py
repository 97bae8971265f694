"""Write the picture at the top of the README from a finished demo: wide, tele, disparity, bokeh of one capture.

Run from the root of the checkout, after ``make demo``: ``python examples/make_strip.py demo 002``
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from telewide.capture.images import read_image, write_image
from telewide.capture.pair import find_captures, read_pair
from telewide.output.contact import strip
from telewide.output.preview import colourise, display_range_px

if __name__ == "__main__":
    here = Path(__file__).resolve().parent
    run, name = Path(sys.argv[1]), sys.argv[2]
    capture = next(capture for capture in find_captures(here / "captures").captures if capture.name == name)
    pair = read_pair(capture)
    made = run / "depth" / name
    with np.load(made / "depth.npz", allow_pickle=False) as arrays:
        disparity_px, valid = arrays["disparity"], arrays["valid"]
    colours = colourise(disparity_px, range_px=display_range_px(disparity_px, valid=valid))
    views = (pair.wide, pair.tele, colours, read_image(made / "bokeh.jpg"))
    write_image(here / "strip.jpg", strip(views, ("wide", "tele", "disparity", "bokeh")), quality=88)
    print(here / "strip.jpg")
