"""What is too short to have a direction never becomes a number that is none, for one ray as for eight at once."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference.packing import put_ray
from support.space import even_space

from raygrid.node.geometry.intersect import MISS, cone
from raygrid.node.geometry.lattice import make_cell, nearest
from raygrid.node.jit.decorators import kernel
from raygrid.node.protocol.packets import SIZE
from raygrid.node.protocol.packing import octahedral, pack_weight, unit_vector
from raygrid.node.tracing.camera import eye_ray
from raygrid.node.tracing.local_geometry import cone_table
from raygrid.node.tracing.shading import refract, unit
from raygrid.node.tracing.spawn import RAY_BATCH, make_spawn_batch, note, origin_beside, put, work_out

SHORT = [(0.0, 0.0, 0.0), (-0.0, 0.0, -0.0), (5e-324, 0.0, 0.0), (0.0, -1e-200, 1e-310), (1e-160, 1e-160, 1e-160)]


@kernel
def units(x, y, z):
    return unit(x, y, z), octahedral(x, y, z)


@pytest.mark.parametrize("vector", SHORT)
def test_no_unit_vector_and_a_code_all_the_same(vector):
    direction, codes = units(*vector)
    assert direction == (0.0, 0.0, 0.0)
    assert all(math.isfinite(part) for part in unit_vector(*codes))


@kernel
def refracted(d, n, cosine, ratio):
    return refract(d, n, cosine, ratio)


@pytest.mark.parametrize("ratio", [1e16, 1e30, 1e200, math.inf])
def test_what_is_seen_head_on_goes_straight_on_whatever_the_index(ratio):
    """n + d cancels, so nothing is left of the direction."""
    assert refracted((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), 1.0, ratio) == (True, (0.0, 0.0, -1.0))


@kernel
def born(spawns, cell, space, g, d, rows, one):
    note(spawns, RAY_BATCH, 2 | (1 << 3) | (5 << 8), 0, (0.1, 0.2, 0.3), g, d, (0.5, 0.5, 0.5))
    work_out(cell, space, spawns, RAY_BATCH)
    put(spawns, RAY_BATCH, 0, rows, 0)
    put_ray(one, 0, 2, 1, 5, origin_beside(space.step, (0.1, 0.2, 0.3), g, d), octahedral(d[0], d[1], d[2]),
            pack_weight(0.5, 0.5, 0.5))  # fmt: skip


@pytest.mark.parametrize("vector", SHORT)
def test_a_ray_without_a_direction_has_the_same_direction_eight_at_once(vector):
    space = even_space((1, 1, 1), (1.0 / (1 << 23),) * 3)
    eight, one = np.zeros(SIZE, np.uint8), np.zeros(SIZE, np.uint8)
    born(make_spawn_batch(), make_cell(space, (0, 0, 0)), space, (0.0, 0.0, 1.0), vector, eight, one)
    assert eight[14:].tobytes() == one[14:].tobytes()  # direction and weight


@kernel
def seen_from(camera, i, j):
    return eye_ray(camera, i, j)[1]


def test_an_eye_without_a_direction_looks_along_z():
    camera = np.zeros((6, 3))
    assert seen_from(camera, 3.0, 4.0) == (0.0, 0.0, 1.0)


def test_a_cone_without_height_is_never_met():
    table = cone_table(np.array([[0.0, 0, 0, 0.5, 0, 0, 0, 0.5], [0.0, 0, 0, 0.5, 1e-200, 0, 0, 0.5]]))
    assert np.isfinite(table).all()
    for row in range(2):
        assert cone(table, row, (0.0, -2.0, 0.0), (0.0, 1.0, 0.0), 0.0) == MISS


@kernel
def lattice_of(x, step):
    return nearest(x, step)


def test_what_is_no_number_lies_on_the_lattice():
    assert lattice_of(math.nan, 1e-7) == 0
    assert lattice_of(-math.inf, 1e-7) == 0
