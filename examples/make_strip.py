"""Write the picture at the top of the README from a finished demo: wide, tele, disparity, bokeh of one capture.

Run from the root of the checkout, after ``make demo``: ``python examples/make_strip.py demo 003``. The wide photo is
shown as it was rectified: the part that tele sees, enlarged.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from telewide.capture.images import read_image, write_image
from telewide.depth.preview import colourise, display_range_px
from telewide.pages.contact import strip

if __name__ == "__main__":
    here = Path(__file__).resolve().parent
    run, name = Path(sys.argv[1]), sys.argv[2]
    made = run / "depth" / name
    with np.load(made / "depth.npz", allow_pickle=False) as arrays:
        disparity_px, valid = arrays["disparity"], arrays["valid"]
    colours = colourise(disparity_px, range_px=display_range_px(disparity_px, valid=valid))
    wide, tele = (
        read_image(run / "pairs" / name / "wide.png"),
        read_image(here / "phone" / "captures" / name / "tele.jpg"),
    )
    top, left = ((large - small) // 2 for large, small in zip(wide.shape[:2], tele.shape[:2], strict=True))
    seen = wide[top : top + tele.shape[0], left : left + tele.shape[1]]
    views = (seen, tele, colours, read_image(made / "bokeh.jpg"))
    write_image(here / "strip.jpg", strip(views, ("wide", "tele", "disparity", "bokeh")), quality=88)
    print(here / "strip.jpg")
