"""telewide: depth and bokeh from the wide and tele lenses of a phone."""

__version__ = "0.1.0"
