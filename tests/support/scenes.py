"""Scenes in machine coordinates with which the ray step is tested: all kinds, all materials, all lights."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raygrid.node.geometry.lattice import HALF, LATTICE, Space, make_space
from raygrid.node.geometry.surfaces import Batch, Kind, SurfaceSet
from raygrid.node.protocol import packing
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.protocol.packing import HALF_DIRECTION
from support.frames import directional_light, make_frame, material, orthographic, perspective, point_light
from support.space import EVEN_STEP, UNEVEN_PLANES, Index, even_planes
from support.surfaces import (
    F64,
    Generator,
    batch,
    outline,
    placed,
    random_rows,
    rows_on_planes,
    shuffled_ids,
    unit_vectors,
)

Step = tuple[float, float, float]
SHAPES = ["1x1x1", "2x2x2", "4x3x1", "3x3x3", "5x4x2", "8x8x8", "uneven 4x4x4"]


def space_of(shape: str, step: Step) -> Space:
    """The world box cut as the name says."""
    if shape.startswith("uneven"):
        return make_space(step, UNEVEN_PLANES)
    return make_space(step, [even_planes(int(n)) for n in shape.split("x")])


def planes_of_shapes(step: Step) -> list[F64]:
    """Where all planes between cells lie, of all shapes, as numbers, on each axis."""
    lines = []
    for axis in range(3):
        at = {k for n in range(2, 9) for k in even_planes(n)} | set(UNEVEN_PLANES[axis])
        lines.append((np.array(sorted(at - {0, LATTICE})) - HALF) * step[axis])
    return lines


class Scene(NamedTuple):
    """What all shapes of an array have in common."""

    surfaces: SurfaceSet
    frame: Frame
    step: Step


def _with_materials(rows: Batch, rng: Generator, materials: int) -> Batch:
    return Batch(rows.kind, rows.ids, rng.integers(0, materials, len(rows)).astype(np.uint16), rows.data, rows.starts)


def inside(rows: Batch, step: Step) -> Batch:
    """Those surfaces that lie strictly inside the world box."""
    half = np.array(step) * (HALF - 64)
    boxes = rows.bounds()
    return rows.select(((boxes[:, 0] > -half) & (boxes[:, 1] < half)).all(1))


def glass_and_mirrors(rng: Generator) -> list[np.ndarray]:
    """Materials of every sort, one sort or many at once."""
    return [
        material(diffuse=(0.8, 0.5, 0.3)),
        material(diffuse=(0.2, 0.3, 0.4), highlight=0.5, shine=17.3),
        material(diffuse=0.1, specular=(0.9, 0.8, 0.7)),
        material(specular=0.3, transmission=(0.6, 0.7, 0.8), ior=1.5),
        material(transmission=1.0, ior=1.0),
        material(diffuse=rng.random(3), highlight=rng.random(3), shine=3.0, specular=0.2, transmission=0.5, ior=0.7),
    ]


def all_lights(step: Step) -> list[np.ndarray]:
    """Inside and outside the world, at infinity, spots, fading, on a plane between cells, and one that is seen."""
    half = HALF * np.array(step)
    return [
        point_light(0.6 * half, (0.5, 0.4, 0.3)),
        point_light([0.0, 0.3 * half[1], 0.0], 0.05, falloff=1),
        point_light(
            3.0 * half, (0.1, 0.5, 0.2), spot=1, axis=-half / np.linalg.norm(half), cos_inner=0.95, cos_outer=0.8
        ),
        directional_light([1, 2, 3], (0.3, 0.2, 0.1), cos_disc=0.97, disc=(5.0, 4.0, 3.0)),
        directional_light([0, 0, 1], 0.25),
    ]


def mixed_scene(seed: int, step: Step, n: int, **facts: Any) -> Scene:
    """n surfaces of each kind, a third of them on planes, seen by an eye in front of the box."""
    rng = np.random.default_rng(seed)
    planes = planes_of_shapes(step)
    materials = glass_and_mirrors(rng)
    batches = []
    for kind in Kind:
        rows = [
            *random_rows(kind, rng, n, reach=0.8 * HALF * min(step), size=(0.01, 0.2)),
            *rows_on_planes(kind, rng, n // 2, planes),
        ]
        batches.append(_with_materials(inside(batch(kind, rows), step), rng, len(materials)))
    size = facts.pop("size", (40, 30))
    half = HALF * np.array(step)
    camera = facts.pop(
        "camera", perspective([0.3 * half[0], 0.4 * half[1], 2.5 * half[2]], [-0.1, -0.15, -1], 50, size)
    )
    frame = make_frame(camera, size, materials=materials, lights=all_lights(step), background=(0.1, 0.2, 0.4), **facts)
    return Scene(shuffled_ids(batches, rng), frame, step)


# --- rays that look for trouble ---------------------------------------------------------------------------


class Rays(NamedTuple):
    """Rays as packets carry them."""

    origins: np.ndarray  # int64 (n, 3)
    codes: np.ndarray  # int64 (n, 2)

    def directions(self) -> F64:
        """What the codes stand for."""
        return np.stack(packing.unit_vector(self.codes[:, 0], self.codes[:, 1]), axis=-1)


def troublesome_rays(rng: Generator, n: int) -> Rays:
    """A quarter born on planes, a quarter parallel to a face, some in or along edges, many at the least slopes."""
    origins = rng.integers(0, LATTICE, (n, 3))
    for axis in range(3):
        at = np.array(sorted({k for cells in range(2, 9) for k in even_planes(cells)} | set(UNEVEN_PLANES[axis])))
        on = rng.random(n) < 0.25 / 2.4  # of three axes, so that a quarter lies on at least one plane
        origins[on, axis] = np.clip(rng.choice(at, on.sum()) - (rng.random(on.sum()) < 0.3), 0, LATTICE - 1)
    codes = rng.integers(0, 2 * HALF_DIRECTION + 1, (n, 2))
    how = rng.random(n)
    flat = how < 0.25
    third = rng.integers(0, 3, n)
    codes[flat & (third == 0), 0] = HALF_DIRECTION  # x = 0
    codes[flat & (third == 1), 1] = HALF_DIRECTION  # y = 0
    rim = flat & (third == 2)  # z = 0, or the least that rounding makes of it
    codes[rim, 1] = HALF_DIRECTION + (HALF_DIRECTION - abs(codes[rim, 0] - HALF_DIRECTION)) * rng.choice(
        [-1, 1], rim.sum()
    )
    steep = (how > 0.25) & (how < 0.4)  # almost along an axis
    codes[steep] = rng.choice([0, HALF_DIRECTION, 2 * HALF_DIRECTION], (steep.sum(), 2)) + rng.integers(
        -3, 4, (steep.sum(), 2)
    )
    return Rays(origins, np.clip(codes, 0, 2 * HALF_DIRECTION))


def grazed(rays: Rays, step: Step, rng: Generator) -> list[F64]:
    """A polygon for each ray that has room for it, in whose plane the ray lies but for a slope of 1e-9 to 1e-6."""
    rows, half = [], HALF * np.array(step)
    at = (rays.origins - HALF) * np.array(step)
    for o, d in zip(at, rays.directions(), strict=True):
        sideways = np.cross(d, unit_vectors(rng, 1)[0])
        normal = sideways / np.linalg.norm(sideways) + rng.choice([-1, 1]) * 10.0 ** rng.uniform(-9, -6) * d
        middle = o + rng.uniform(0.05, 0.3) * d
        if (np.abs(middle) < 0.8 * half).all():
            rows.append(placed(outline(rng, 5), middle, normal / np.linalg.norm(normal), 0.19 * float(half.min())))
    return rows


def squeezed(kind: Kind, row: F64, size: F64) -> F64:
    """A surface of the unit cube in a world box with these edges; round ones stay round."""
    if kind == Kind.POLYGON:
        return row * size
    row, corners = row.copy(), 3 if kind in (Kind.TRIANGLE, Kind.SMOOTH) else 1
    row[: 3 * corners] *= np.tile(size, corners)
    if kind in (Kind.CYLINDER, Kind.CONE):
        row[4:7] *= size
        row[[3, 7]] *= size.min()
    elif kind == Kind.SPHERE:
        row[3] *= size.min()
    return row


def _troublesome_surfaces(rng: Generator, step: Step, grazed_polygons: list[F64]) -> SurfaceSet:
    shape = {Kind.TRIANGLE: (150, 150), Kind.SMOOTH: (10, 10), Kind.POLYGON: (10, 30), Kind.SPHERE: (15, 15)}
    shape |= {Kind.CYLINDER: (10, 10), Kind.CONE: (10, 10)}
    planes, reach, size = planes_of_shapes(step), 0.8 * HALF * min(step), np.ones(3)
    if max(step) > 4 * min(step):  # a flat world: made in the unit cube and squeezed
        size = 2 * HALF * np.array(step)
        planes, reach = [line / edge for line, edge in zip(planes, size, strict=True)], 0.4
    batches = []
    for kind, (free, on_planes) in shape.items():
        rows = [
            *random_rows(kind, rng, free, reach=reach, size=(0.003, 0.2)),
            *rows_on_planes(kind, rng, on_planes, planes),
        ]
        rows = [squeezed(kind, row, size) for row in rows]
        if kind == Kind.POLYGON:
            rows += grazed_polygons
        batches.append(_with_materials(inside(batch(kind, rows), step), rng, 8))
    return shuffled_ids(batches, rng)


def trouble(seed: int, step: Step, n_rays: int) -> tuple[Scene, Rays]:
    """300 triangles, many of them on planes, spheres, cones, polygons; mirrors and some glass; and rays at them.

    Parallel rays of the camera give every ray a pixel of its own, and homes all over the front.
    """
    rng = np.random.default_rng(seed)
    planes = planes_of_shapes(step)
    rays = troublesome_rays(rng, n_rays)
    chosen = rng.integers(0, n_rays, 60)
    surfaces = _troublesome_surfaces(rng, step, grazed(Rays(rays.origins[chosen], rays.codes[chosen]), step, rng))
    materials = [material(diffuse=rng.random(3), specular=rng.uniform(0.5, 1.0, 3)) for _ in range(7)]
    materials.append(material(diffuse=rng.random(3), specular=0.3, transmission=0.6, ior=1.3))
    at = planes[2][len(planes[2]) // 2]
    lights = [
        point_light([0.11, 0.07, at + 1e-9]),
        point_light([planes[0][3], planes[1][5], planes[2][7]], 0.5),
        directional_light([0, 1, 0], 0.3),
    ]
    width = int(np.ceil(np.sqrt(n_rays)))
    size = (width, int(np.ceil(n_rays / width)))
    camera = orthographic([0, 0, 2], [0, 0, -1], 0.9 * HALF * min(step[:2]), size, up=(0, 1, 0))
    frame = make_frame(camera, size, depth=7, materials=materials, lights=lights, background=(0.01, 0.02, 0.03))
    return Scene(surfaces, frame, step), rays


def birth_cells(space: Space, rays: Rays, rng: Generator) -> np.ndarray:
    """Where each ray was born: in the cell of its origin, or beside it by rounding, also diagonally."""
    near = np.clip(rays.origins + rng.integers(-3, 4, rays.origins.shape), 0, LATTICE - 1)
    lines = [space.planes[axis, : space.shape[axis]] for axis in range(3)]
    return np.stack([np.searchsorted(line, near[:, a], "right") - 1 for a, line in enumerate(lines)], axis=1)


__all__ = ["EVEN_STEP", "SHAPES", "Index", "Rays", "Scene", "birth_cells", "mixed_scene", "space_of", "trouble"]
