"""Cuts all surfaces of a scene into triangles, for files that know nothing else. Round surfaces become SEGMENTS flat sides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.cameras import Vector, nearest_axis, usual_front
from raygrid.host.scene.linear_algebra import product
from raygrid.host.scene.polygons import Ints, triangulate
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, AddedKind, Batch, Kind, SurfaceSet

SEGMENTS = 64  # round the axis; half as many from pole to pole: off a ball by 1/830 of its radius
MOST_TRIANGLES = 20_000_000
ROUND = (Kind.SPHERE, Kind.CYLINDER, Kind.CONE)


@dataclass(frozen=True)
class TriangleSet:
    """Triangles in the scene's coordinates.

    corners    float64 (n, 3, 3)
    normals    of the corners, float64 (n, 3, 3); None: the triangles are flat
    materials  rows of the scene's table, int64 (n,)
    """

    corners: F64
    normals: F64 | None
    materials: Ints


def tessellated(surfaces: SurfaceSet, where: str) -> list[TriangleSet]:
    """All surfaces as triangles. Raises SceneError for those of programs, and for too many triangles."""
    unknown = surfaces.count(AddedKind.PROGRAMMED)
    if unknown:
        raise SceneError(f"{where}: {unknown} surfaces of a program came, wanted a scene without for a file of meshes")
    each = 2 * SEGMENTS * (SEGMENTS // 2)
    many = sum(len(batch) * (each if batch.kind in ROUND else 1) for batch in surfaces)
    if many > MOST_TRIANGLES:
        raise SceneError(f"{where}: the scene makes about {many:,} triangles, wanted at most {MOST_TRIANGLES:,}")
    return [part for batch in surfaces for part in _parts(batch)]


def _parts(batch: Batch) -> Iterator[TriangleSet]:
    data, materials = batch.data.astype(np.float64), batch.materials.astype(np.int64)
    if batch.kind == Kind.TRIANGLE:
        yield TriangleSet(data.reshape(-1, 3, 3), None, materials)
    elif batch.kind == Kind.SMOOTH:
        yield TriangleSet(data[:, :9].reshape(-1, 3, 3), data[:, 9:].reshape(-1, 3, 3), materials)
    elif batch.kind == Kind.POLYGON:
        rows, owner, _ = triangulate(data, batch.starts)
        yield TriangleSet(data[rows], None, materials[owner])
    elif batch.kind == Kind.SPHERE:
        points, normals = _unit_sphere()
        for row, material in zip(data, materials, strict=True):
            yield _turned(points * abs(row[3]) + row[:3], normals, int(material), row[3] < 0.0)
    else:
        for row, material in zip(data, materials, strict=True):
            points, normals = _side(row)
            yield _turned(points, normals, int(material), min(row[3], row[7]) < 0.0)


def _turned(corners: F64, normals: F64, material: int, inside: bool) -> TriangleSet:
    """Triangles of a round surface, of one of which only the inside shows with their fronts there."""
    if inside:
        corners, normals = corners[:, ::-1], -normals[:, ::-1]
    return TriangleSet(corners, normals, np.full(len(corners), material))


def _unit_sphere() -> tuple[F64, F64]:
    """Triangles of the unit sphere about the y axis, and their normals, (n, 3, 3), fronts outside."""
    turn = np.linspace(0.0, 2.0 * np.pi, SEGMENTS + 1)
    down = np.linspace(0.0, np.pi, SEGMENTS // 2 + 1)
    ring = np.sin(down)[:, None]
    grid = np.stack((ring * np.sin(turn), np.broadcast_to(np.cos(down)[:, None], ring.shape[:1] + turn.shape),
                     ring * np.cos(turn)), axis=2)  # fmt: skip
    grid[:, -1] = grid[:, 0]
    grid[0], grid[-1] = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)
    faces = _strip(grid)
    corners = faces[np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1) > 1e-9]
    return corners, corners


def _strip(grid: F64) -> F64:
    """The triangles between rows of points, (rows, columns, 3), one row above the next, columns to the right."""
    above, below = grid[:-1], grid[1:]
    one = np.stack((above[:, :-1], below[:, :-1], below[:, 1:]), axis=2)
    other = np.stack((above[:, :-1], below[:, 1:], above[:, 1:]), axis=2)
    return np.asarray(np.concatenate((one.reshape(-1, 3, 3), other.reshape(-1, 3, 3))))


def _side(row: F64) -> tuple[F64, F64]:
    """Triangles of the side of a cylinder or cone (end, radius, end, radius), and their normals, fronts outside."""
    base, apex = row[:3], row[4:7]
    wide, narrow = abs(row[3]), abs(row[7])
    axis = apex - base
    height = float(np.linalg.norm(axis))
    axis = axis / height
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    turn = np.linspace(0.0, 2.0 * np.pi, SEGMENTS + 1)[:, None]
    ring = np.cos(turn) * across + np.sin(turn) * np.cross(axis, across)
    ring[-1] = ring[0]
    faces = _strip(np.stack((apex + narrow * ring, base + wide * ring)))
    slanted = ring * height + axis * (wide - narrow)
    slanted /= np.linalg.norm(slanted, axis=1, keepdims=True)
    normals = _strip(np.stack((slanted, slanted)))
    kept = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1) > 0.0
    return faces[kept], normals[kept]


def upright(scene: Scene, up: Vector) -> tuple[F64, str] | None:
    """The rotation, (3, 3), of 0, 1 and -1, by which a scene stands in a file as what reads that has it, and what to say of it.

    up  the axis that points up there; what is the front as a rule (`cameras.usual_front`) stays it
    Returns None if the scene stands so already: the axis nearest to what is up in it is that one.
    """
    own, wanted = nearest_axis(scene.up), nearest_axis(up)
    if (own == wanted).all():
        return None
    frames = [np.stack((np.cross(axis, front := np.array(usual_front(axis))), axis, front)) for axis in (own, wanted)]
    turn = np.asarray(product(frames[1].T, frames[0]) + 0.0)
    names = [f"{'-' if axis.sum() < 0.0 else '+'}{'xyz'[int(np.argmax(np.abs(axis)))]}" for axis in (own, wanted)]
    return turn, f"turned, as what is up is {names[0]} in the scene and {names[1]} in files of this kind"


def joined(parts: list[TriangleSet], materials: int) -> Iterator[tuple[int, F64, NDArray[np.float64] | None]]:
    """(material, corners, normals or None): of each material the flat triangles, then the smooth ones."""
    flat = [part for part in parts if part.normals is None]
    smooth = [part for part in parts if part.normals is not None]
    for kind in (flat, smooth):
        if not kind:
            continue
        corners = np.concatenate([part.corners for part in kind])
        normals = None if kind is flat else np.concatenate([part.normals for part in kind if part.normals is not None])
        rows = np.concatenate([part.materials for part in kind])
        order = np.argsort(rows, kind="stable")
        ends = np.searchsorted(rows[order], np.arange(materials + 1))
        for material in range(materials):
            mine = order[ends[material] : ends[material + 1]]
            if len(mine):
                yield material, corners[mine], None if normals is None else normals[mine]
