"""Solids before a background, cast ray by ray for two pinhole views with exact disparity."""
