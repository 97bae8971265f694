"""Directions and rotations that solids are placed with; rotations are ``world_from_local``."""

from __future__ import annotations

import math

import numpy as np

from telewide.geometry.arrays import FloatArray


def unit(v: FloatArray) -> FloatArray:
    """Scale a vector to length 1."""
    return np.asarray(v / max(1e-9, float(np.linalg.norm(v))), np.float64)


def rotation(axis: FloatArray, angle_rad: float) -> FloatArray:
    """Turn about a unit axis, by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + math.sin(angle_rad) * cross + (1 - math.cos(angle_rad)) * cross @ cross
    return np.asarray(turn, np.float64)


def turn_with_z(way: FloatArray) -> FloatArray:
    """Choose a rotation whose third column is ``way``."""
    side = unit(np.cross([0.0, 1.0, 0.0] if abs(way[1]) < 0.9 else [1.0, 0.0, 0.0], way))
    return np.stack([side, np.cross(way, side), way], axis=1)


def upright(rng: np.random.Generator) -> FloatArray:
    """Draw a turn about the vertical, no side wholly averted."""
    return rotation(np.array([0.0, 1.0, 0.0]), rng.uniform(-1.2, 1.2))


def any_turn(rng: np.random.Generator) -> FloatArray:
    """Draw a turn about any axis."""
    return rotation(unit(rng.normal(0, 1, 3)), rng.uniform(0, math.pi))
