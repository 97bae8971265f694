"""Calibration boards: printed, photographed, and found in photos."""
