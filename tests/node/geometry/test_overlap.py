"""Retention: what can be hit in a cell is retained there, and what comes nowhere near is not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.distance import crossing_number, distance
from support.kernels import built, meet_each
from support.surfaces import (
    F64,
    Generator,
    batch,
    castle,
    frame_of,
    gear,
    points_on,
    random_rows,
    rows_on_planes,
    unit_vectors,
)

from raygrid.node.geometry.bvh import INFLATE
from raygrid.node.geometry.intersect import GRAZING
from raygrid.node.geometry.lattice import SLACK
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.surfaces import Batch, Kind, SurfaceSet

FLAT = (Kind.TRIANGLE, Kind.SMOOTH, Kind.POLYGON)
PLANES = [np.array([-1 / 3, -0.25, 0.0, 0.125, 1 / 3]).astype(np.float32).astype(np.float64)] * 3


def normals_of(rows: Batch) -> F64:
    """Unit normals of flat surfaces."""
    found = []
    for k in range(len(rows)):
        points = (
            rows.data[rows.starts[k] : rows.starts[k + 1]]
            if rows.kind == Kind.POLYGON
            else rows.data[k, :9].reshape(3, 3)
        )
        points = points.astype(np.float64) - points[0]
        normal = np.cross(points, np.roll(points, -1, axis=0)).sum(0)
        found.append(normal / max(float(np.linalg.norm(normal)), 1e-300))
    return np.array(found)


def grazing_ways(rows: Batch, rng: Generator) -> F64:
    """Directions that stand at 1e-9 to 1e-3 to each flat surface."""
    ways = np.zeros((len(rows), 3))
    for k, normal in enumerate(normals_of(rows)):
        u, v = frame_of(normal) if normal.any() else frame_of(np.array([0.0, 0.0, 1.0]))
        angle, slope = rng.uniform(0, 2 * math.pi), rng.choice([-1, 1]) * 10.0 ** rng.uniform(-9.2, -3)
        ways[k] = math.cos(angle) * u + math.sin(angle) * v + slope * normal
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)


def hits(rows: Batch, d: F64, rng: Generator) -> tuple[F64, F64]:
    """(which surfaces are hit, the points) by rays along d, aimed at the surfaces from far and near."""
    n = len(rows)
    aimed = points_on(rows, rng) + rng.choice([0.0, 1e-12, 1e-7], (n, 1)) * rng.normal(size=(n, 3))
    origins = aimed - rng.choice([3.0, 1.0, 0.1, 1e-3], (n, 1)) * rng.uniform(0, 1, (n, 1)) * d
    t = meet_each(built(SurfaceSet((rows,))), rows.ids, origins, d, np.full(n, 1e-7))
    hit = np.flatnonzero((t >= 1e-7) & (t < 4.0))
    return hit, origins[hit] + t[hit, None] * d[hit]


def ways_at(rows: Batch, rng: Generator) -> F64:
    """Directions of rays: any, along axes, and for flat surfaces mostly grazing."""
    d = unit_vectors(rng, len(rows))
    straight = rng.random(len(rows)) < 0.2
    d[straight] = np.eye(3)[rng.integers(0, 3, straight.sum())]
    if rows.kind in FLAT:
        grazing = rng.random(len(rows)) < 0.7
        d[grazing] = grazing_ways(rows, rng)[grazing]
    return d


@pytest.mark.parametrize("kind", list(Kind), ids=lambda kind: kind.name.lower())
def test_what_is_hit_in_a_cell_is_retained_there(kind):
    """Acceptance implies retention, down to a cell that is nothing but the point of the hit.

    Accepted points lie so near to their surfaces that the boxes of the hierarchy hold them, too.
    """
    rng = np.random.default_rng(70 + kind)
    rows = batch(kind, [*random_rows(kind, rng, 1500), *rows_on_planes(kind, rng, 1000, PLANES)])
    seen, farthest = 0, 0.0
    for _ in range(2):
        for k, p in zip(*hits(rows, ways_at(rows, rng), rng), strict=True):
            below, above = rng.choice([0.0, 1e-7, 1e-3, 0.3], (2, 3))
            assert meets(rows.select(np.array([k])), p - below, p + above)[0], f"{kind.name} {k} hit at {p.tolist()}"
            if seen % 8 == 0:
                farthest = max(farthest, distance(rows, int(k), p))
            seen += 1
    assert seen > 2500
    assert farthest < 0.5 * min(SLACK, INFLATE)


@pytest.mark.parametrize("kind", [Kind.TRIANGLE, Kind.POLYGON])
def test_grazing_hits_lie_near_their_surfaces(kind):
    """The bound on the error of a computed point is worst for far origins at the least angle."""
    rng = np.random.default_rng(80 + kind)
    rows = batch(kind, random_rows(kind, rng, 2000, size=(1e-5, 0.4)))
    normals = normals_of(rows)
    sideways = np.array([frame_of(normal if normal.any() else np.eye(3)[2])[0] for normal in normals])
    d = sideways + rng.choice([-1, 1], (2000, 1)) * GRAZING * 10.0 ** rng.uniform(0, 1.5, (2000, 1)) * normals
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    origins = points_on(rows, rng) - rng.uniform(1, 3, (2000, 1)) * d
    t = meet_each(built(SurfaceSet((rows,))), rows.ids, origins, d, np.zeros(2000))
    hit = np.flatnonzero((t >= 0.0) & (t < 4.0))
    assert len(hit) > 500
    assert max(distance(rows, int(k), origins[k] + t[k] * d[k]) for k in hit) < 0.5 * min(SLACK, INFLATE)


# --- retention is tight --------------------------------------------------------------------------------------


def retained(kind: Kind, row: F64, low: list[float], high: list[float]) -> bool:
    """Whether a cell with these bounds keeps the surface."""
    return bool(meets(batch(kind, [np.array(row, float)]), np.array(low, float), np.array(high, float))[0])


def upright(flat: F64, axis: int = 2) -> F64:
    """An outline (n, 2) in the plane through the origin across an axis."""
    row = np.zeros((len(flat), 3))
    row[:, (axis + 1) % 3], row[:, (axis + 2) % 3] = flat[:, 0], flat[:, 1]
    return row


NOTCHED = 0.1 * np.array([(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]) - 0.15
NEAR, FAR = 0.9 * SLACK, 1.1 * SLACK


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("turn", range(4))
def test_a_cell_in_the_notch_of_a_polygon_does_not_keep_it(axis, turn):
    """Whichever way the notch opens, and in either sense of the outline."""
    turned = NOTCHED @ np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), turn)
    cells = {
        "notch": ((-0.03, 0.0), (0.03, 0.1)),
        "arm": ((0.08, 0.0), (0.12, 0.1)),
        "base": ((-0.03, -0.1), (0.03, -0.09)),
    }
    for name, corners in cells.items():
        ends = np.array(corners) @ np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), turn)
        low, high = upright(ends.min(0)[None], axis)[0], upright(ends.max(0)[None], axis)[0]
        for flat in (turned, turned[::-1]):
            row = upright(flat, axis)
            assert retained(Kind.POLYGON, row, low, high) == (name != "notch")
            away = NEAR * np.eye(3)[axis]
            assert retained(Kind.POLYGON, row, low + away, high + away) == (name != "notch")
            away = FAR * np.eye(3)[axis]
            assert not retained(Kind.POLYGON, row, low + away, high + away)


TIGHT = [  # what, kind, row, low, high, retained
    ("triangle: box beyond the long edge", Kind.TRIANGLE,
     [0, 0, 0, 0.5, 0, 0, 0, 0.5, 0], [0.3, 0.3, -0.1], [0.5, 0.5, 0.1], False),
    ("triangle: box over its plane", Kind.TRIANGLE,
     [0, 0, 0, 0.5, 0, 0.5, 0, 0.5, 0.5], [0, 0, 0.1], [0.04, 0.04, 0.5], False),
    ("triangle: box inside its plane's cut", Kind.TRIANGLE,
     [-0.5, -0.5, 0, 0.5, -0.5, 0, 0, 0.5, 0], [-0.01] * 3, [0.01] * 3, True),
    ("triangle: box round a corner", Kind.TRIANGLE,
     [0, 0, 0, 0.5, 0, 0, 0, 0.5, 0], [-0.1] * 3, [1e-3] * 3, True),
    ("triangle: box round all of it", Kind.TRIANGLE,
     [0, 0, 0, 0.5, 0, 0, 0, 0.5, 0], [-0.5] * 3, [0.6] * 3, True),
    ("triangle: an edge through the box", Kind.TRIANGLE,
     [-0.5, 0, 0, 0.5, 0, 0, 0, 0, 0.5], [-0.01] * 3, [0.01] * 3, True),
    ("triangle: in the face of the box", Kind.TRIANGLE,
     [0, 0, 0.25, 0.5, 0, 0.25, 0, 0.5, 0.25], [0, 0, 0], [0.1, 0.1, 0.25], True),
    ("triangle: in the face of the next box", Kind.TRIANGLE,
     [0, 0, 0.25, 0.5, 0, 0.25, 0, 0.5, 0.25], [0, 0, 0.25], [0.1, 0.1, 0.5], True),
    ("triangle: just near", Kind.TRIANGLE,
     [0, 0, 0, 0.5, 0, 0, 0, 0.5, 0], [0, 0, NEAR], [0.1, 0.1, 0.5], True),
    ("triangle: just too far", Kind.TRIANGLE,
     [0, 0, 0, 0.5, 0, 0, 0, 0.5, 0], [0, 0, FAR], [0.1, 0.1, 0.5], False),
    ("triangle: without area", Kind.TRIANGLE,
     [0, 0, 0, 0.25, 0, 0, 0.5, 0, 0], [0.1, -0.1, -0.1], [0.2, 0.1, 0.1], True),
    ("sphere: box inside", Kind.SPHERE,
     [0, 0, 0, 0.5], [-0.1] * 3, [0.1] * 3, False),
    ("sphere: box just inside", Kind.SPHERE,
     [0, 0, 0, 0.5], [0, 0, 0], [0, 0, 0.5 - FAR], False),
    ("sphere: box at the shell", Kind.SPHERE,
     [0, 0, 0, -0.5], [0, 0, 0], [0, 0, 0.5 - NEAR], True),
    ("sphere: box in the corner of its box", Kind.SPHERE,
     [0, 0, 0, 0.5], [0.3, 0.3, 0.3], [0.5, 0.5, 0.5], False),
    ("sphere: box round it", Kind.SPHERE,
     [0, 0, 0, 0.25], [-0.5] * 3, [0.5] * 3, True),
    ("sphere: touches the face of the box", Kind.SPHERE,
     [0, 0, 0.25, 0.25], [0, 0, 0.5], [0.1, 0.1, 0.6], True),
    ("sphere: touches it from below", Kind.SPHERE,
     [0, 0, 0.25, 0.25], [-0.1, -0.1, -0.1], [0.1, 0.1, 0.0], True),
    ("cylinder: slanted, box in the corner of its box", Kind.CYLINDER,
     [0, 0, 0, 0.01, 0.5, 0.5, 0, 0.01], [0.4, 0, 0], [0.5, 0.05, 0.01], False),
    ("cylinder: its line on the face", Kind.CYLINDER,
     [0, 0, 0.1, 0.1, 0.5, 0, 0.1, 0.1], [0.1, -0.1, -0.1], [0.2, 0.1, 0.0], True),
    ("cone: beyond its box", Kind.CONE,
     [0, 0, 0, 0.1, 0, 0, 0.5, 0.0], [-0.1, -0.1, 0.5 + FAR], [0.1, 0.1, 0.6], False),
    ("cone: its apex on the face", Kind.CONE,
     [0, 0, 0, 0.1, 0, 0, 0.5, 0.0], [-0.1, -0.1, 0.5], [0.1, 0.1, 0.6], True),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "row", "low", "high", "kept"), [c[1:] for c in TIGHT], ids=[c[0] for c in TIGHT])
def test_retention_by_hand(kind, row, low, high, kept):
    assert retained(kind, row, low, high) == kept


@pytest.mark.parametrize("kind", [*FLAT, Kind.SPHERE], ids=lambda kind: kind.name.lower())
def test_retained_surfaces_have_a_point_near_the_cell(kind):
    """Cells of all sizes round and beside surfaces: a ball round a cell that is kept touches the surface."""
    rng = np.random.default_rng(90 + kind)
    rows = batch(kind, [*random_rows(kind, rng, 400, size=(1e-3, 0.4)), *rows_on_planes(kind, rng, 400, PLANES)])
    targets = points_on(rows, rng)
    kept = 0
    for k in range(len(rows)):
        half = 10.0 ** rng.uniform(-6, -1) * rng.uniform(0.1, 1, 3)
        middle = targets[k] + rng.choice([0.5, 1.5, 5.0]) * float(np.linalg.norm(half)) * unit_vectors(rng, 1)[0]
        apart = distance(rows, k, middle)
        found = meets(rows.select(np.array([k])), middle - half, middle + half)[0]
        kept += found
        assert found or apart >= half.min() + SLACK * 0.999, "not kept, although it reaches into the cell"
        assert not found or apart <= float(np.linalg.norm(half + SLACK)) * 1.001, "kept, although it is nowhere near"
    assert 100 < kept < 700


@pytest.mark.parametrize("kind", list(Kind), ids=lambda kind: kind.name.lower())
def test_many_at_once_are_as_one_by_one(kind):
    rng = np.random.default_rng(95 + kind)
    rows = batch(kind, [*random_rows(kind, rng, 100), *rows_on_planes(kind, rng, 100, PLANES)])
    low, high = np.array([-0.25, -1 / 3, 0.0]), np.array([0.125, 0.0, 1 / 3])
    together = meets(rows, low, high)
    np.testing.assert_array_equal(together, meets(rows, low, high, rows.bounds()))
    alone = [meets(rows.select(np.array([k])), low, high)[0] for k in range(len(rows))]
    np.testing.assert_array_equal(together, alone)
    assert 10 < together.sum() < 190
    assert len(meets(rows.select(np.zeros(len(rows), bool)), low, high)) == 0


def test_concave_outlines_are_kept_only_where_they_reach():
    """Cell by cell over a fine grid: in a kept cell lies a bit of the outline, or all of it is inside."""
    rng = np.random.default_rng(7)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * 2), axis=-1).reshape(-1, 2) / 25
    for flat in (0.4 * gear(24, depth=0.6), 0.99 * castle(rng, 12)):
        rows, part = batch(Kind.POLYGON, [upright(flat)]), np.linspace(0, 1, 400)[:, None, None]
        rim = (flat + part * (np.roll(flat, -1, axis=0) - flat)).reshape(-1, 2)
        kept = []
        for corner in np.ndindex(25, 25):
            low = np.array(corner) / 25 - 0.5
            kept.append(bool(meets(rows, np.array([*low, -0.01]), np.array([*(low + 1 / 25), 0.01]))[0]))
            points = low + grid
            inside = crossing_number(flat, points[:, 0], points[:, 1]).any()
            on_rim = ((rim >= low - 1e-3) & (rim <= low + 1 / 25 + 1e-3)).all(1).any()
            assert inside <= kept[-1] <= (inside or on_rim)
        assert 200 < sum(kept) < 450


# --- boxes -------------------------------------------------------------------------------------------------


def box_of(rows: Batch, k: int) -> F64:
    """The box of one surface, by its definition."""
    data = (
        rows.data[k].astype(np.float64) if rows.kind != Kind.POLYGON else rows.data[rows.starts[k] : rows.starts[k + 1]]
    )
    if rows.kind == Kind.POLYGON:
        return np.array([data.min(0), data.max(0)])
    if rows.kind == Kind.SPHERE:
        return np.array([data[:3] - abs(data[3]), data[:3] + abs(data[3])])
    if rows.kind in FLAT:
        points = data[:9].reshape(3, 3)
        return np.array([points.min(0), points.max(0)])
    base, apex, axis = data[:3], data[4:7], data[4:7] - data[:3]
    x, y, z = axis * axis
    reach = np.sqrt(np.clip(1.0 - axis * axis / (x + y + z or 1.0), 0.0, 1.0))
    rims = [base - abs(data[3]) * reach, apex - abs(data[7]) * reach]
    rims += [base + abs(data[3]) * reach, apex + abs(data[7]) * reach]
    return np.array([np.minimum(rims[0], rims[1]), np.maximum(rims[2], rims[3])])


def test_boxes_are_those_of_each_surface_to_the_bit():
    rng = np.random.default_rng(96)
    kinds = [batch(kind, random_rows(kind, rng, 60)) for kind in Kind]
    kinds += [batch(Kind.CONE, [np.array([0.1, 0.2, 0.3, 0.1, 0.1, 0.2, 0.3, 0.2])])]  # of no height
    for rows in kinds:
        boxes = rows.bounds()
        assert (boxes.dtype, boxes.shape) == (np.float64, (len(rows), 2, 3))
        np.testing.assert_array_equal(boxes, [box_of(rows, k) for k in range(len(rows))])
        assert rows.select(np.zeros(0, np.intp)).bounds().shape == (0, 2, 3)
    every = np.concatenate([rows.bounds() for rows in kinds])
    np.testing.assert_array_equal(SurfaceSet(tuple(kinds)).bounds(), [every[:, 0].min(0), every[:, 1].max(0)])
