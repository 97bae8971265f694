"""Measured numbers: the same inputs for every method."""
