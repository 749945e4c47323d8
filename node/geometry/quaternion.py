"""Multiplies, interpolates and converts unit quaternions, each w, x, y, z unless said otherwise.

Element by element, each operation rounded once and sums in a fixed order (`node.geometry.rigid_motion` says why).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry import rounded

F64 = NDArray[np.float64]


def unit_quaternions(values: F64) -> F64:
    """Scale quaternions (..., 4), their components in any order, to length 1; one without length stays as it is."""
    w, x, y, z = (values[..., k] for k in range(4))
    length = np.sqrt(w * w + x * x + y * y + z * z)[..., None]
    return np.asarray(values / np.where(length == 0.0, 1.0, length))


def rotation_matrices(quaternions: F64) -> F64:
    """Return the rotation matrices of quaternions (n, 4), float64 (n, 3, 3)."""
    w, x, y, z = (quaternions[:, k] for k in range(4))
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def quaternion_products(second: F64, first: F64) -> F64:
    """Return quaternions (..., 4) of length 1 that turn by the first, then by the second."""
    a, b = (tuple(q[..., k] for k in range(4)) for q in (second, first))
    product = np.stack(
        (
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ),
        axis=-1,
    )
    return unit_quaternions(product)


def quaternion_of_angles(degrees: Sequence[float] | F64) -> F64:
    """Return the quaternion (4,) that turns about x, then y, then z, by degrees (3,)."""
    turn = np.array((1.0, 0.0, 0.0, 0.0))
    for axis, angle in enumerate(degrees):
        half = math.radians(float(angle)) / 2.0
        about = np.zeros(4)
        about[0], about[1 + axis] = rounded.cos(half), rounded.sin(half)
        turn = quaternion_products(about, turn)
    return turn


def quaternion_of_matrix(matrix: F64) -> F64:
    """Return the quaternion (4,) of a rotation matrix (3, 3), from the largest of its parts."""
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    k = int(np.argmax([trace, matrix[0, 0], matrix[1, 1], matrix[2, 2]]))
    found = np.empty(4)
    if k == 0:
        found[0] = 1.0 + trace
        found[1:] = matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        found[0] = matrix[m, j] - matrix[j, m]
        found[1 + i] = 1.0 + matrix[i, i] - matrix[j, j] - matrix[m, m]
        found[1 + j] = matrix[j, i] + matrix[i, j]
        found[1 + m] = matrix[m, i] + matrix[i, m]
    return unit_quaternions(found)


def slerp(one: F64, other: F64, part: float) -> F64:
    """Return the quaternion (4,) a part of the way from one to another, at even speed, the short way round.

    Their components may be in any order.
    """
    cosine = float(np.sum(one * other))
    if cosine < 0.0:
        other, cosine = -other, -cosine
    if cosine > 1.0 - 1e-9:
        return unit_quaternions(one + (other - one) * part)
    angle = rounded.acos(min(cosine, 1.0))
    shares = rounded.sin((1.0 - part) * angle), rounded.sin(part * angle)
    return unit_quaternions((shares[0] * one + shares[1] * other) / rounded.sin(angle))
