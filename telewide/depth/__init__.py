"""Depth of a capture: metres and their precision, edges that follow the photo, files."""
