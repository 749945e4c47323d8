"""Makes rotation matrices of unit quaternions, and products, element by element (`node.geometry.rigid_motion` says why)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def rotation_matrices(quaternions: F64) -> F64:
    """The rotation matrices of quaternions w, x, y, z (n, 4), float64 (n, 3, 3)."""
    w, x, y, z = (quaternions[:, k] for k in range(4))
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def products(second: F64, first: F64) -> F64:
    """Quaternions (n, 4) that rotate by the first, then by the second, of length 1."""
    a, b = (tuple(q[:, k] for k in range(4)) for q in (second, first))
    product = np.stack(
        (
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ),
        axis=1,
    )
    p = tuple(product[:, k] for k in range(4))
    return np.asarray(product / np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3])[:, None])
