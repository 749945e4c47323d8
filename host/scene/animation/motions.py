"""Makes and combines rigid motions with even scaling, rows of MOTION numbers (`node.geometry.rigid_motion`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from raygrid.node.geometry import F64, MOTION_SCALE, MOTION_SHIFT, Kind, moved_rows, quaternion_products


def motion(turn: ArrayLike = (1.0, 0.0, 0.0, 0.0), scale: float = 1.0, shift: ArrayLike = (0.0, 0.0, 0.0)) -> F64:
    """Make the motion, float64 (MOTION,), that turns by a unit quaternion, scales, and shifts."""
    return np.concatenate((np.asarray(turn, np.float64), [scale], np.asarray(shift, np.float64)))


def moved_point(by: F64, point: ArrayLike) -> F64:
    """Apply a motion to a point, (3,)."""
    row = np.array([*np.asarray(point, np.float64), 0.0])[None]
    return moved_rows(Kind.SPHERE, row, by[None])[0, :3]


def turned(by: F64, direction: ArrayLike) -> F64:
    """Turn a direction, (3,), as a motion does."""
    return moved_point(motion(by[:4]), direction)


def after(second: F64, first: F64) -> F64:
    """Make the motion that does `first`, then `second`."""
    return motion(
        quaternion_products(second[:4], first[:4]),
        float(second[MOTION_SCALE] * first[MOTION_SCALE]),
        moved_point(second, first[MOTION_SHIFT:]),
    )


def about(pivot: ArrayLike, turn: F64, scale: float) -> F64:
    """Make the motion that turns and scales about a point that stays."""
    here = motion(turn, scale)
    here[MOTION_SHIFT:] = np.asarray(pivot, np.float64) - moved_point(here, pivot)
    return here
