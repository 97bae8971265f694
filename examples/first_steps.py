"""First steps in Python: from two photos of unequal lenses to metres and a picture with shallow depth of field.

Run it as a script (python examples/first_steps.py [FOLDER]), or cell by cell in an editor that knows ``# %%``.
"""

# %% The rig: here the one that ships as an example; telewide.calibrate("boards/", square_m=0.025) makes your own.
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import telewide

here = Path(__file__).resolve().parent
rig = telewide.load_rig(here.parent / "calib" / "rigs" / "example_phone.yaml")
print(f"tele sees {rig.rig.asymmetry:.1f} times finer than wide; lenses {rig.rig.baseline_m * 1000:.1f} mm apart")

# %% Two photos of one moment, as arrays.
photos = telewide.read_pair(here / "phone" / "captures" / "000")
print(f"tele {photos.tele.shape}, wide {photos.wide.shape}, {photos.tele.dtype}")

# %% Made comparable: rectified, rows and colours fitted to one another, and judged.
shot = telewide.rectify(photos, rig=rig)
print(f"{shot.report.n_matches} points match; verdict: {shot.report.verdict}")

# %% Depth on the tele photo, by the network that comes with telewide; weights=... names one of your own.
depth = telewide.estimate_depth(photos, rig=rig)
assert depth.depth_m is not None, "the rig knows its scale"
print(f"median depth {np.nanmedian(depth.depth_m):.2f} m, {depth.disparity.valid.mean():.0%} measured")

# %% The nearest thing sharp, the rest soft.
picture = telewide.render_bokeh(photos.tele, depth, focus="near", f_number=1.8)
folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
Image.fromarray((picture.clip(0, 1) * 255).round().astype(np.uint8)).save(folder / "bokeh.png")
print(f"wrote {folder / 'bokeh.png'}")
