"""Multiplies vectors and matrices in a fixed order, so that a scene has the same numbers on every computer.

numpy leaves products of matrices, `dot`, `einsum`, inverses and determinants to libraries that choose their instructions, and the
order of their sums, by the processor. Here each product and each sum is rounded once, from the first to the last.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry import F64


def dot(a: F64, b: F64) -> Any:
    """The sums of products along the last axis, (..., n) and (..., n): a number, or an array without that axis."""
    total = a[..., 0] * b[..., 0]
    for k in range(1, b.shape[-1]):
        total = total + a[..., k] * b[..., k]
    return total


def lengths(vectors: F64) -> Any:
    """The lengths along the last axis: a number, or an array without that axis."""
    return np.sqrt(dot(vectors, vectors))


def units(vectors: F64) -> F64:
    """The vectors made one long along the last axis; those without a length are 0."""
    length = lengths(vectors)[..., None]
    return np.asarray(np.where(length > 0.0, vectors / np.where(length > 0.0, length, 1.0), 0.0))


def product(rows: F64, matrix: F64) -> F64:
    """Rows (..., n) times a matrix (n, m): (..., m)."""
    return np.stack([dot(rows, matrix[:, column]) for column in range(matrix.shape[1])], axis=-1)


def cofactors(m: F64) -> F64:
    """The cofactors of a matrix (3, 3), rows of cross products of its rows."""
    return np.stack((np.cross(m[1], m[2]), np.cross(m[2], m[0]), np.cross(m[0], m[1])))


def determinant(matrix: F64) -> float:
    """The determinant of a matrix (3, 3)."""
    return float(dot(matrix[0], cofactors(matrix)[0]))


def inverse(matrix: F64) -> F64:
    """The inverse of a matrix (3, 3). Raises numpy.linalg.LinAlgError if its determinant is 0 or no number."""
    exponents = np.frexp(np.abs(matrix).max(axis=0))[1]  # columns are made about 1, which changes no digit
    scaled = np.ldexp(matrix, -exponents)
    turned = cofactors(scaled)
    divisor = float(dot(scaled[0], turned[0]))
    if divisor == 0.0 or not np.isfinite(divisor):
        raise np.linalg.LinAlgError(f"the determinant is {divisor}")
    return np.asarray(np.ldexp(turned.T / divisor, -exponents[:, None]))


def affine_inverse(matrix: NDArray[Any]) -> F64:
    """The inverse of a matrix (4, 4) whose last row is (0, 0, 0, 1). Raises as `inverse` does."""
    found = np.eye(4)
    found[:3, :3] = inverse(matrix[:3, :3])
    found[:3, 3] = -product(matrix[:3, 3], found[:3, :3].T)
    return found
