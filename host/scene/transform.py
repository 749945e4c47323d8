"""Turns, scales and shifts surfaces that are placed in a scene: of a file, or of a node in a tree of nodes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raygrid.host.scene.linear_algebra import cofactors, determinant, inverse, product
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, Batch, Kind, rounded

UNIFORM = 1e-9  # how far a scale may differ along the axes, as a part of it, and still count as the same


def placement(scale: ArrayLike, rotate: ArrayLike) -> F64:
    """The matrix, (3, 3), that scales along the axes and then turns about x, y and z, in that order, by degrees."""
    x, y, z = (math.radians(angle) for angle in np.broadcast_to(np.asarray(rotate, np.float64), 3))
    about_x = np.array(((1, 0, 0), (0, rounded.cos(x), -rounded.sin(x)), (0, rounded.sin(x), rounded.cos(x))))
    about_y = np.array(((rounded.cos(y), 0, rounded.sin(y)), (0, 1, 0), (-rounded.sin(y), 0, rounded.cos(y))))
    about_z = np.array(((rounded.cos(z), -rounded.sin(z), 0), (rounded.sin(z), rounded.cos(z), 0), (0, 0, 1)))
    return np.asarray(product(product(about_z, about_y), about_x) * np.broadcast_to(np.asarray(scale, np.float64), 3))


def moved(batch: Batch, matrix: F64, shift: ArrayLike) -> F64:
    """The data of a batch after x -> matrix x + shift; fronts stay fronts, also when the matrix mirrors.

    Raises SceneError for round surfaces and a matrix that would make them oval.
    """
    data, offset = batch.data.astype(np.float64), np.asarray(shift, np.float64)
    mirrored = determinant(matrix) < 0.0
    if batch.kind == Kind.POLYGON:
        points = product(data, matrix.T) + offset
        return _reversed(points, batch.starts) if mirrored else points
    if batch.kind in (Kind.TRIANGLE, Kind.SMOOTH):
        corners = product(data[:, :9].reshape(-1, 3, 3), matrix.T) + offset
        turned = _inverse(matrix) if data.shape[1] > 9 else matrix
        normals = product(data[:, 9:].reshape(len(data), -1, 3), turned)
        turn = (0, 2, 1) if mirrored else (0, 1, 2)
        parts = [part[:, turn].reshape(len(data), -1) for part in (corners, normals) if part.size]
        return np.concatenate(parts, axis=1) if parts else data
    scale = _uniform_scale(matrix)
    result = data.copy()
    for first in range(0, data.shape[1], 4):
        result[:, first : first + 3] = product(data[:, first : first + 3], matrix.T) + offset
        result[:, first + 3] = data[:, first + 3] * scale
    return result


def placed_faces(
    matrix: F64, points: F64, faces: NDArray[np.int64], normals: F64 | None
) -> tuple[Kind, F64, NDArray[np.int64]]:
    """Triangles of a node: their kind, their data for a builder, and their faces, turned round if the node mirrors.

    matrix   the node's to the world, (4, 4)
    points   (n, 3)
    faces    rows of the points, (t, 3)
    normals  of the points, (n, 3); None: the triangles are flat
    """
    m = matrix[:3, :3]
    if determinant(m) < 0.0:
        faces = faces[:, (0, 2, 1)]  # a mirrored node would turn the fronts inside
    data = (product(points, m.T) + matrix[:3, 3])[faces].reshape(-1, 9)
    if normals is None:
        return Kind.TRIANGLE, data, faces
    # Cofactors turn normals as the inverse transpose does, and exist for flattened nodes too.
    turned = product(normals, cofactors(m).T) * math.copysign(1.0, determinant(m))
    return Kind.SMOOTH, np.concatenate((data, turned[faces].reshape(-1, 9)), axis=1), faces


def _inverse(matrix: F64) -> F64:
    """The inverse, by which normals turn. Raises SceneError if it has none, as of a scale next to nothing."""
    with np.errstate(all="ignore"):
        try:
            found = inverse(matrix)
        except np.linalg.LinAlgError:
            found = np.full((3, 3), np.nan)
    if not np.isfinite(found).all():
        raise SceneError("its scale is so small along an axis that normals cannot be turned with it")
    return np.asarray(found)


def _reversed(points: F64, starts: np.ndarray[tuple[int], np.dtype[np.int64]]) -> F64:
    """The points of polygons, each polygon backwards."""
    rows = np.arange(len(points))
    owner = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    return np.asarray(points[starts[owner] + starts[owner + 1] - 1 - rows])


def _uniform_scale(matrix: F64) -> float:
    squares = product(matrix.T, matrix)
    scale = math.sqrt(float(squares[0, 0]))
    if np.abs(squares - scale * scale * np.eye(3)).max() > UNIFORM * scale * scale:
        raise SceneError("spheres, cylinders and cones can be scaled only by the same number along all axes")
    return scale
