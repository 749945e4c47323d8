"""Rays that are set up eight at once are those that are set up one by one, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raygrid.emulator.processes.warm import tiny_frame as one_frame
from raygrid.node.geometry.lattice import LATTICE, make_cell, make_space
from raygrid.node.protocol.frame_tables import LIGHT_COLUMNS, LIGHT_KIND, LIGHT_PLACE
from raygrid.node.protocol.packets import HALF_DIRECTION, PRIMARY, SIZE, put_ray, put_shadow
from raygrid.node.tracing import ray_setup
from raygrid.node.tracing.ray_setup import KNOWN, SETUP_RAYS, make_ray_setup, read_prepared, set_up_rays
from raygrid.node.tracing.step import _set_up

STEPS = (2.0**-24, 1.5 * 2.0**-25, 2.0**-26)
PLANES = [[0, LATTICE // 3, LATTICE], [0, 777, 5_000_000, LATTICE], [0, LATTICE]]
SPACE = make_space(STEPS, PLANES)
CELLS = [make_cell(SPACE, (x, y, 0)) for x in range(2) for y in range(3)]

# what rounding and signs make special: planes themselves, their neighbours, the middle, the ends
coordinates = st.one_of(
    st.sampled_from([0, 1, LATTICE // 3 - 1, LATTICE // 3, LATTICE // 2, 776, 777, 5_000_000, LATTICE - 1]),
    st.integers(0, LATTICE - 1),
)
codes = st.one_of(
    st.sampled_from([0, 1, HALF_DIRECTION - 1, HALF_DIRECTION, HALF_DIRECTION + 1, 2 * HALF_DIRECTION]),
    st.integers(0, 2 * HALF_DIRECTION),
)
places = st.one_of(st.sampled_from([-0.5, 0.0, 0.25]), st.floats(-0.625, 0.625, width=32))
ports = st.integers(0, 7)


def _frame(lights):
    """A frame with these lights, (kind, x, y, z)."""
    table = np.zeros((len(lights), LIGHT_COLUMNS))
    for row, (kind, *place) in zip(table, lights, strict=True):
        row[LIGHT_KIND], row[LIGHT_PLACE : LIGHT_PLACE + 3] = kind, place
    return one_frame()._replace(lights=table, n_lights=len(lights))


def _bits(numbers):
    return np.array(numbers, np.float64).view(np.int64).tolist()


def _same(frame, packets, came_by, cell, shadows):
    """Compare all that is known of the rays of these packets."""
    kind, columns = int(packets[0]) & 7, make_ray_setup()
    many = len(came_by)
    read_prepared(frame, packets, came_by, 0, many, shadows, columns)
    set_up_rays(cell, SPACE, many, shadows, columns)
    known = columns.known.reshape(KNOWN, SETUP_RAYS)
    for k in range(many):
        way, o, d, inv, t_in, t_out, distance = _set_up(cell, SPACE, frame, packets, k * SIZE, int(came_by[k]), kind)
        assert columns.ways[k] == way
        expected = [*o, *d, *inv, t_in, t_out] + ([distance] if shadows else [])
        assert _bits(known[: len(expected), k]) == _bits(np.array(expected))


@given(st.lists(st.tuples(*3 * [coordinates], codes, codes, ports), min_size=1, max_size=20), st.sampled_from(CELLS))
@settings(deadline=None)
def test_rays(rays, cell):
    """Origins beside and on planes, directions along axes and folded ones, from every port."""
    packets = np.zeros(len(rays) * SIZE, np.uint8)
    for k, (x, y, z, a, b, _) in enumerate(rays):
        put_ray(packets, k * SIZE, PRIMARY, 1, k, (x, y, z), (a, b), np.int64(0))
    _same(_frame([(0.0, 0.0, 0.0, 1.0)]), packets, np.array([ray[5] for ray in rays], np.uint8), cell, False)


@given(
    st.lists(st.tuples(st.sampled_from([0.0, 1.0]), places, places, places), min_size=1, max_size=3),
    st.lists(st.tuples(*3 * [coordinates], st.integers(0, 2), ports), min_size=1, max_size=20),
    st.sampled_from(CELLS),
)
@settings(deadline=None)
def test_shadow_rays(lights, rays, cell):
    """Towards points, a point at the ray's own origin too, and directions of which components are zero."""
    packets = np.zeros(len(rays) * SIZE, np.uint8)
    for k, (x, y, z, light, _) in enumerate(rays):
        put_shadow(packets, k * SIZE, 1, k, (x, y, z), light % len(lights), (1.0, 1.0, 1.0))
    _same(_frame(lights), packets, np.array([ray[4] for ray in rays], np.uint8), cell, True)


@pytest.mark.parametrize("many", [1, 7, 8, 9, SETUP_RAYS - 1, SETUP_RAYS])
def test_any_number_of_rays(many):
    """What is left in other columns does not matter."""
    rng = np.random.default_rng(many)
    packets = np.zeros(many * SIZE, np.uint8)
    for k in range(many):
        a, b = rng.integers(0, 2 * HALF_DIRECTION, 2)
        put_ray(packets, k * SIZE, PRIMARY, 1, k, tuple(rng.integers(0, LATTICE, 3)), (a, b), np.int64(0))
    came_by = rng.integers(0, 8, many).astype(np.uint8)
    for cell in CELLS:
        _same(_frame([(0.0, 0.0, 0.0, 1.0)]), packets, came_by, cell, False)


def test_the_columns_are_whole_vectors():
    """Eight rays are set up even if fewer are wanted, so a column of the last of them must exist."""
    assert SETUP_RAYS % ray_setup.EIGHT == 0
