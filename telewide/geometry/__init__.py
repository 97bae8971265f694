"""Cameras, disparity and depth: pure functions on arrays."""
