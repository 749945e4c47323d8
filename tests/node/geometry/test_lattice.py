"""Origins of rays are rounded to lattice points beside the ray, hardly further on than where it begins."""

import numpy as np
import pytest

from raygrid.node.geometry.lattice import HALF, LATTICE, LONGEST_STEP, SLOW, coordinate
from raygrid.node.geometry.lattice import beside_ray as staged
from raygrid.node.jit.formula import formula
from raygrid.node.jit.lanes import LATTICE_POINT, VECTOR
from raygrid.node.tracing.camera import TRIES

STEPS = {
    "cube": (LONGEST_STEP, LONGEST_STEP, LONGEST_STEP),
    "box": (0.9 / HALF, 0.6 / HALF, 0.51 / HALF),
    "wide and low": (0.75 / HALF, 0.75 / HALF, 0.04 / HALF),
    "flat": (1e-4 / HALF, 0.8 / HALF, 0.5 / HALF),
}
AXES = [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (0.0, 0.0, -1.0)]


def beside_ray(step, start, way, tries):
    """`lattice.beside_ray` of plain numbers."""
    run = formula(takes=(VECTOR, VECTOR, VECTOR), gives=LATTICE_POINT)(lambda *given: staged(*given, tries))
    return run(step, start, way)


def ways(rng, count):
    """Unit vectors: along axes, and in all directions."""
    random = rng.normal(size=(count, 3))
    return [*AXES, *map(tuple, (random / np.linalg.norm(random, axis=1, keepdims=True)).tolist())]


def missed(step, start, way, tries):
    """(how far the point lies aside of the ray, how far on along it), in longest steps; checks that it is in the box."""
    point = beside_ray(step, start, way, tries)
    assert all(0 <= k < LATTICE for k in point)
    off = np.array([coordinate(k, s) for k, s in zip(point, step, strict=True)]) - start
    along = off @ way
    return np.linalg.norm(off - along * np.array(way)) / max(step), along / LONGEST_STEP


@pytest.mark.parametrize("name", STEPS)
def test_a_point_beside_the_ray(name):
    step, rng = STEPS[name], np.random.default_rng(7)
    one, many = [], []
    for way in ways(rng, 400):
        start = tuple((rng.uniform(-0.9, 0.9, 3) * np.array(step) * HALF).tolist())
        once, on_once = missed(step, start, way, 1)
        best, on_best = missed(step, start, way, TRIES)
        assert best <= once + 1e-6 <= np.sqrt(0.75) + 2e-6
        # the rounding itself may put it back by half a step an axis
        assert -1.0 <= on_once <= 1.0 / SLOW + 1.0
        assert -1.0 <= on_best <= (TRIES + 1) / SLOW
        one.append(once)
        many.append(best)
    assert np.mean(many) < 0.5 * np.mean(one)


def test_a_point_of_the_lattice_stays_where_it_is():
    """Where steps are powers of two; others are off by a last bit, and the next point is as good."""
    step, rng = STEPS["cube"], np.random.default_rng(8)
    for way in ways(rng, 40):
        point = tuple(int(k) for k in rng.integers(LATTICE // 4, 3 * LATTICE // 4, 3))
        start = tuple(coordinate(k, s) for k, s in zip(point, step, strict=True))
        assert beside_ray(step, start, way, 1) == point


def test_at_the_edge_of_the_world_the_point_stays_inside():
    step = STEPS["cube"]
    for way in AXES:
        for corner in (-1.0, 1.0):
            point = beside_ray(step, (corner * HALF * step[0],) * 3, way, TRIES)
            assert all(0 <= k < LATTICE for k in point)
