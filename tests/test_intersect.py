"""Each intersection kernel against the oracle's equations, and against answers known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracle import OracleScene, SceneBuilder, intersect_one
from oracle.examples import AHEAD, HAND
from raygrid.node.intersect import GRAZING
from raygrid.node.lattice import SLACK
from raygrid.node.surfaces import Batch, Kind, SurfaceSet
from support_kernels import built, meet_each
from support_surfaces import F64, Generator, batch, castle, gear, outline, placed, points_on, random_rows, sizes_of, unit_vectors

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
    near = 1e-10 + 1e-7 * size
    answers = set()
    for shift in np.concatenate((np.zeros((1, 3)), near * np.eye(3), -near * np.eye(3))):
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
    print(kind, hits, marginal)
    assert hits > 600
    assert marginal < 40
