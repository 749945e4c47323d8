"""Each intersection kernel against the oracle's equations, and against answers known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from oracle import OracleScene, SceneBuilder, intersect_one
from oracle.examples import AHEAD, HAND
from support.distance import crossing_number
from support.kernels import built, meet_each
from support.surfaces import (
    F64,
    Generator,
    batch,
    castle,
    gear,
    outline,
    placed,
    points_on,
    random_rows,
    sizes_of,
    unit_vectors,
)

from raygrid.node.geometry.intersect import GRAZING
from raygrid.node.geometry.lattice import SLACK
from raygrid.node.geometry.surfaces import Batch, Kind, SurfaceSet

INF = math.inf


def in_oracle(rows: Batch) -> OracleScene:
    """The same surfaces, in the same precision, for the oracle; numbered by row."""
    builder = SceneBuilder()
    m = builder.material()
    for k in range(len(rows)):
        if rows.kind == Kind.POLYGON:
            builder.polygon(rows.data[rows.starts[k] : rows.starts[k + 1]], m)
            continue
        row = rows.data[k].astype(np.float64)
        if rows.kind == Kind.TRIANGLE:
            builder.triangle(row.reshape(3, 3), m)
        elif rows.kind == Kind.SMOOTH:
            builder.smooth_triangle(row[:9].reshape(3, 3), row[9:].reshape(3, 3), m)
        elif rows.kind == Kind.SPHERE:
            builder.sphere(row[:3], row[3], m)
        else:
            builder.cone(row[:3], row[3], row[4:7], row[7], m)
    return builder.build(AHEAD)


def first(roots: list[float], lower: float) -> float:
    """The first root not below `lower`."""
    return min((t for t in roots if t >= lower), default=INF)


def shoot(rows: Batch, origins: F64, directions: F64, lower: float | F64 = 0.0) -> F64:
    """t of ray k with surface k."""
    lowers = np.broadcast_to(np.asarray(lower, np.float64), len(rows)).copy()
    t = meet_each(built(SurfaceSet((rows,))), rows.ids, origins, directions, lowers)
    return np.where(t >= lowers, t, INF)


def one(kind: Kind, row: F64, origin: F64, direction: F64, lower: float = 0.0) -> float:
    """t of one ray with one surface."""
    d = np.array([direction], float)
    d /= np.linalg.norm(d)
    return float(shoot(batch(kind, [np.array(row, float)]), np.array([origin], float), d, lower)[0])


# --- many, against the oracle --------------------------------------------------------------------------------


def aims(rows: Batch, rng: Generator) -> tuple[F64, F64]:
    """A ray for each surface, from in front of it, behind it, on it or within it, along an axis or not."""
    n, sizes = len(rows), sizes_of(rows)[:, None]
    target = points_on(rows, rng) + sizes * rng.normal(size=(n, 3)) * rng.choice([0.0, 0.01, 0.3], (n, 1))
    d = unit_vectors(rng, n)
    along_axis = rng.random(n) < 0.25
    d[along_axis] = np.eye(3)[rng.integers(0, 3, along_axis.sum())] * rng.choice([-1.0, 1.0], (along_axis.sum(), 1))
    beside = ~along_axis & (rng.random(n) < 0.25)
    d[beside, rng.integers(0, 3, beside.sum())] = 0.0
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    away = rng.uniform(-0.3, 1.0, (n, 1)) * np.where(rng.random((n, 1)) < 0.5, 1.0, sizes)
    return target - away * d, d


def is_marginal(scene: OracleScene, k: int, o: F64, d: F64, lower: float, size: float) -> bool:
    """Whether the oracle gives rays next to this one, as far off as rounding may be, different answers."""
    surfaces = scene.surfaces
    vertices = surfaces.points[surfaces.first[k] : surfaces.first[k] + surfaces.point_count[k]]
    inward = vertices.mean(0) - vertices  # needles are so thin that other ways lead past them
    ways = np.concatenate((np.eye(3), inward / np.maximum(np.linalg.norm(inward, axis=1), 1e-300)[:, None]))
    near = 1e-10 + 1e-7 * size
    answers = set()
    for shift in np.concatenate([far * ways for far in (0.0, near, -near, near / 1e3, -near / 1e3)]):
        roots = intersect_one(scene, k, o + shift, d)
        answers.add((len(roots), len([t for t in roots if t >= lower]), len([t for t in roots if t > lower + near])))
    return len(answers) > 1


@pytest.mark.parametrize("kind", list(Kind), ids=lambda kind: kind.name.lower())
def test_random_rays_against_the_oracle(kind):
    """Every ray agrees, but for those that a shift by rounding would already decide otherwise: few, and counted."""
    rng = np.random.default_rng(1000 + kind)
    rows = batch(kind, random_rows(kind, rng, 4000))
    origins, directions = aims(rows, rng)
    lowers = np.where(rng.random(len(rows)) < 0.5, 0.0, rng.uniform(0.0, 0.5, len(rows)))
    t = shoot(rows, origins, directions, lowers)
    scene, sizes = in_oracle(rows), sizes_of(rows)
    marginal = hits = 0
    for k in range(len(rows)):
        exact = first(intersect_one(scene, k, origins[k], directions[k]), lowers[k])
        hits += exact < INF
        if t[k] == exact or abs(t[k] - exact) < 1e-9:
            continue
        assert is_marginal(scene, k, origins[k], directions[k], lowers[k], sizes[k]), (
            f"{kind.name} {k}: t {t[k]}, the oracle says {exact}"
        )
        marginal += 1
    assert hits > 1000
    assert marginal < 100


# --- answers known by hand -----------------------------------------------------------------------------------

SHAPES = {  # the oracle's zoo, at a quarter of its size
    "sphere of radius 2": (Kind.SPHERE, [0, 0, 0, 2]),
    "sphere from inside only": (Kind.SPHERE, [0, 0, 0, -2]),
    "cylinder": (Kind.CYLINDER, [0, 0, 0, 1, 0, 0, 2, 1]),
    "cylinder from inside only": (Kind.CYLINDER, [0, 0, 0, -1, 0, 0, 2, -1]),
    "cone": (Kind.CONE, [0, 0, 0, 2, 0, 0, 2, 0]),
    "frustum": (Kind.CONE, [0, 0, 0, 2, 0, 0, 2, 1]),
    "triangle": (Kind.TRIANGLE, [0, 0, 0, 1, 0, 0, 0, 1, 0]),
}


@pytest.mark.parametrize(("shape", "origin", "direction", "roots"), HAND)
def test_all_hits_by_hand(shape, origin, direction, roots):
    """Every root in turn is the first hit of a ray that starts between it and the one before."""
    kind, row = SHAPES[shape]
    origin, direction = np.array(origin) / 4.0, np.array(direction, float)
    lengths = [t * np.linalg.norm(direction) / 4.0 for t in roots]
    lower = -9.0
    for length in (*lengths, INF):
        seen = one(kind, np.array(row) / 4.0, origin, direction, lower)
        assert seen == pytest.approx(length, abs=1e-15)
        lower = length + 1e-6


X, Y, Z = np.eye(3)
UNIT_TRIANGLE = [0, 0, 0, 0.5, 0, 0, 0, 0.5, 0]
SQUARE = np.array([[0, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0]])

BY_HAND = [  # what, kind, row, origin, direction, lower, t
    ("sphere: from inside the far side", Kind.SPHERE, [0, 0, 0, 0.5], [0, 0, 0], X, 0.0, 0.5),
    ("sphere: wholly behind", Kind.SPHERE, [0, 0, 0, 0.25], [0.5, 0, 0], X, 0.0, INF),
    ("sphere: on it, outwards", Kind.SPHERE, [0, 0, 0, 0.25], [0.25, 0, 0], X, 1e-7, INF),
    ("sphere: on it, inwards", Kind.SPHERE, [0, 0, 0, 0.25], [0.25, 0, 0], -X, 1e-7, 0.5),
    ("sphere: tangent", Kind.SPHERE, [0, 0, 0, 0.25], [-0.5, 0.25, 0], X, 0.0, 0.5),
    ("sphere: beside", Kind.SPHERE, [0, 0, 0, 0.25], [-0.5, 0.25 + 1e-15, 0], X, 0.0, INF),
    ("sphere: near hit below the bound", Kind.SPHERE, [0, 0, 0, 0.25], [-0.5, 0, 0], X, 0.26, 0.75),
    ("sphere: hollow, from outside", Kind.SPHERE, [0, 0, 0, -0.25], [-0.5, 0, 0], X, 0.0, 0.75),
    ("sphere: hollow, from inside", Kind.SPHERE, [0, 0, 0, -0.25], [0, 0, 0], X, 0.0, 0.25),
    ("sphere: small and far", Kind.SPHERE, [0.5, 0, 0, 1e-6], [-0.5, 0, 0], X, 0.0, 1.0 - 1e-6),
    ("sphere: of no size", Kind.SPHERE, [0, 0, 0, 0.0], [-0.5, 1e-9, 0], X, 0.0, INF),
    ("triangle: inside", Kind.TRIANGLE, UNIT_TRIANGLE, [0.125, 0.125, 0.5], -Z, 0.0, 0.5),
    ("triangle: from behind", Kind.TRIANGLE, UNIT_TRIANGLE, [0.125, 0.125, -0.5], Z, 0.0, 0.5),
    ("triangle: long edge", Kind.TRIANGLE, UNIT_TRIANGLE, [0.25, 0.25, 0.5], -Z, 0.0, 0.5),
    ("triangle: short edge", Kind.TRIANGLE, UNIT_TRIANGLE, [0.25, 0.0, 0.5], -Z, 0.0, 0.5),
    ("triangle: vertex", Kind.TRIANGLE, UNIT_TRIANGLE, [0.5, 0.0, 0.5], -Z, 0.0, 0.5),
    ("triangle: past an edge", Kind.TRIANGLE, UNIT_TRIANGLE, [0.25, -1e-17, 0.5], -Z, 0.0, INF),
    ("triangle: in its plane", Kind.TRIANGLE, UNIT_TRIANGLE, [-0.25, 0.125, 0.0], X, 0.0, INF),
    ("triangle: parallel above", Kind.TRIANGLE, UNIT_TRIANGLE, [-0.25, 0.125, 1e-9], X, 0.0, INF),
    ("triangle: without area", Kind.TRIANGLE, [0, 0, 0, 0.25, 0, 0, 0.5, 0, 0], [0.25, 0, 0.5], -Z, 0.0, INF),
    ("triangle: a point", Kind.TRIANGLE, [0] * 9, [0, 0, 0.5], -Z, 0.0, INF),
    ("polygon: inside", Kind.POLYGON, SQUARE, [0.25, 0.25, 0.5], -Z, 0.0, 0.5),
    ("polygon: lower edge belongs to it", Kind.POLYGON, SQUARE, [0.25, 0.0, 0.5], -Z, 0.0, 0.5),
    ("polygon: left edge belongs to it", Kind.POLYGON, SQUARE, [0.0, 0.25, 0.5], -Z, 0.0, 0.5),
    ("polygon: upper edge does not", Kind.POLYGON, SQUARE, [0.25, 0.5, 0.5], -Z, 0.0, INF),
    ("polygon: right edge does not", Kind.POLYGON, SQUARE, [0.5, 0.25, 0.5], -Z, 0.0, INF),
    ("polygon: in its plane", Kind.POLYGON, SQUARE, [-0.25, 0.25, 0.0], X, 0.0, INF),
    ("polygon: behind", Kind.POLYGON, SQUARE, [0.25, 0.25, 0.5], Z, 0.0, INF),
    ("cylinder: from outside", Kind.CYLINDER, [0, 0, 0, 0.25, 0, 0, 0.5, 0.25], [-0.5, 0, 0.25], X, 0.0, 0.25),
    ("cylinder: tangent", Kind.CYLINDER, [0, 0, 0, 0.25, 0, 0, 0.5, 0.25], [-0.5, 0.25, 0.25], X, 0.0, 0.5),
    ("cylinder: beside", Kind.CYLINDER, [0, 0, 0, 0.25, 0, 0, 0.5, 0.25], [-0.5, 0.25 + 1e-15, 0.25], X, 0.0, INF),
    ("cylinder: at the rim", Kind.CYLINDER, [0, 0, 0, 0.25, 0, 0, 0.5, 0.25], [-0.5, 0, 0.5], X, 0.0, 0.25),
    ("cylinder: above the rim", Kind.CYLINDER, [0, 0, 0, 0.25, 0, 0, 0.5, 0.25], [-0.5, 0, 0.5 + 1e-15], X, 0.0, INF),
    ("cylinder: along the axis", Kind.CYLINDER, [0, 0, 0, 0.25, 0, 0, 0.5, 0.25], [0, 0, -0.5], Z, 0.0, INF),
    ("cylinder: along its side", Kind.CYLINDER, [0, 0, 0, 0.25, 0, 0, 0.5, 0.25], [0.25, 0, -0.5], Z, 0.0, INF),
    (
        "cylinder: hollow, from outside",
        Kind.CYLINDER,
        [0, 0, 0, -0.25, 0, 0, 0.5, -0.25],
        [-0.5, 0, 0.25],
        X,
        0.0,
        0.75,
    ),
    ("cone: from outside", Kind.CONE, [0, 0, 0, 0.5, 0, 0, 0.5, 0], [-0.75, 0, 0.25], X, 0.0, 0.5),
    ("cone: near hit below the bound", Kind.CONE, [0, 0, 0, 0.5, 0, 0, 0.5, 0], [-0.75, 0, 0.25], X, 0.6, 1.0),
    ("cone: just past the apex", Kind.CONE, [0, 0, 0, 0.5, 0, 0, 0.5, 0], [-0.75, 0, 0.5 + 1e-12], X, 0.0, INF),
    ("cone: its mirror image", Kind.CONE, [0, 0, 0, 0.5, 0, 0, 0.5, 0], [-0.75, 0, 0.75], X, 0.0, INF),
    (
        "cone: parallel to a generator",
        Kind.CONE,
        [0, 0, 0, 0.5, 0, 0, 0.5, 0],
        [-0.75, 0, -0.5],
        X + Z,
        0.0,
        0.875 * 2**0.5,
    ),
    ("cone: apex down", Kind.CONE, [0, 0, 0, 0, 0, 0, 0.5, 0.5], [-0.75, 0, 0.25], X, 0.0, 0.5),
]


@pytest.mark.parametrize(
    ("kind", "row", "origin", "direction", "lower", "t"), [c[1:] for c in BY_HAND], ids=[c[0] for c in BY_HAND]
)
def test_by_hand(kind, row, origin, direction, lower, t):
    assert one(kind, row, origin, direction, lower) == pytest.approx(t, abs=1e-15)


@pytest.mark.parametrize("direction", [Z, -Z, X, X + Y + Z, np.array([0.3, -0.2, -0.9])])
def test_apex_of_a_cone(direction):
    """The apex is one point: a ray at it hits it or slips by, but is never found anywhere else."""
    origin = np.array([0, 0, 0.25]) - 0.5 * direction / np.linalg.norm(direction)
    t = one(Kind.CONE, [0, 0, -0.25, 0.125, 0, 0, 0.25, 0.0], origin, direction)
    assert t == INF or abs(t - 0.5) < 1e-7


def test_grazing_rays_meet_flat_surfaces_down_to_the_stated_angle():
    """GRAZING is the sine of the least angle between ray and plane at which a ray meets a surface."""
    for slope, seen in ((2.0 * GRAZING, True), (0.5 * GRAZING, False)):
        d = np.array([1.0, 0.0, -slope])
        origin = np.array([0.125 - 0.25, 0.125, 0.25 * slope])
        for kind, row in ((Kind.TRIANGLE, np.array(UNIT_TRIANGLE)), (Kind.POLYGON, SQUARE)):
            t = one(kind, row, origin, d)
            assert (abs(t - 0.25) < SLACK) if seen else t == INF


# --- polygons: a ray straight down on a point is exact, so points may lie exactly on edges and vertices --------


def down_on(polygons: Batch, points: F64, drop: int) -> NDArray[np.bool_]:
    """Whether each point (n, 2) of the plane lies in each polygon (m, n), all flat along axis `drop`."""
    u, v = (drop + 1) % 3, (drop + 2) % 3
    origins = np.zeros((len(points), 3))
    origins[:, u], origins[:, v], origins[:, drop] = points[:, 0], points[:, 1], 0.5
    d = np.tile(-np.eye(3)[drop], (len(points), 1))
    tables = built(SurfaceSet((polygons,)))
    n = len(points)
    t = [meet_each(tables, np.full(n, k), origins, d, np.zeros(n)) for k in range(len(polygons))]
    assert set(np.unique(t)) <= {0.5, INF}
    return np.array(t) < INF


def flat(outlines: list[F64], drop: int) -> Batch:
    """Outlines (n, 2) as polygons through the origin, along axis `drop`."""
    rows = []
    for points in outlines:
        row = np.zeros((len(points), 3))
        row[:, (drop + 1) % 3], row[:, (drop + 2) % 3] = points[:, 0], points[:, 1]
        rows.append(row)
    return batch(Kind.POLYGON, rows)


def nasty_points(points: F64, rng: Generator, n: int) -> F64:
    """Points everywhere, on edges, at the heights of vertices, and one rounding off these."""
    low, high = points.min(0), points.max(0)
    many = rng.uniform(low - 0.05, high + 0.05, (n, 2))
    third = n // 3
    k, along = rng.integers(0, len(points), third), rng.choice([0.0, 1.0, 0.5, rng.random()], (third, 1))
    many[:third] = points[k] + along * (points[k - 1] - points[k])
    many[third : 2 * third, 1] = points[rng.integers(0, len(points), third), 1]
    many[: 2 * third, 1] = np.nextafter(many[: 2 * third, 1], many[: 2 * third, 1] + rng.integers(-1, 2, 2 * third))
    return many


@pytest.mark.parametrize("drop", [0, 1, 2])
def test_strips_of_polygons_change_the_work_not_the_answer(drop):
    rng = np.random.default_rng(31 + drop)
    outlines = [0.4 * gear(144), 0.4 * gear(36), *(0.8 * castle(rng, m) for m in (1, 2, 5, 30))]
    outlines += [rng.uniform(0.05, 0.5) * outline(rng, m) for m in (3, 4, 6, 7, 8, 25, 100, 500)]
    polygons = flat(outlines, drop)
    for k, points in enumerate(outlines):
        many = nasty_points(points, rng, 3000)
        seen = down_on(polygons.select(np.array([k])), many, drop)[0]
        np.testing.assert_array_equal(seen, crossing_number(points, many[:, 0], many[:, 1]))


@pytest.mark.parametrize("drop", [0, 1, 2])
def test_a_point_of_a_tiling_is_never_lost(drop):
    """Also on the edges and vertices that polygons share: it lies in one of them, and in no other.

    Neighbours decide by the same numbers, so a point lies in an odd number of them; in three only where the
    rounded edges cross, within rounding of the vertex in which they meet.
    """
    rng = np.random.default_rng(41 + drop)
    rim, middle = 0.4 * gear(40), np.array([0.01, -0.02])
    cuts = np.sort(rng.choice(len(rim), 9, replace=False))
    slices = []
    for start, stop in zip(cuts, np.roll(cuts, -1), strict=True):
        part = np.arange(start, (stop - start) % len(rim) + start + 1) % len(rim)
        slices.append(np.concatenate((middle[None], rim[part])))
    corners = np.concatenate([*slices, rim])
    many = np.concatenate([nasty_points(corners, rng, 3000), nasty_points(slices[3], rng, 3000)])
    times_found = down_on(flat(slices, drop), many, drop).sum(0)
    at_vertex = np.abs(many[:, None] - np.concatenate((rim, middle[None]))).max(2).min(1) < 1e-16
    inside = crossing_number(rim, many[:, 0], many[:, 1])
    np.testing.assert_array_equal(times_found % 2 == 1, inside)
    np.testing.assert_array_equal(times_found[~at_vertex], inside[~at_vertex])
    assert at_vertex.sum() > 100


def test_a_tilted_polygon_in_a_far_corner():
    """Planes are taken about the first vertex, so a small polygon far from the origin keeps its shape."""
    rng = np.random.default_rng(5)
    normal = np.array([0.3, -0.5, 0.81])
    normal /= np.linalg.norm(normal)
    shape = outline(rng, 9)
    row = placed(shape, np.array([0.49, -0.48, 0.47]), normal, 1e-5)
    inner = placed(0.9 * shape, np.array([0.49, -0.48, 0.47]), normal, 1e-5)
    outer = placed(1.1 * shape, np.array([0.49, -0.48, 0.47]), normal, 1e-5)
    for points, hit in ((inner, True), (outer, False)):
        for p in points:
            assert (one(Kind.POLYGON, row, p + 0.3 * normal, -normal) < INF) == hit
