"""Rays that are set up eight at once are those that are set up one by one, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.packing import HALF_DIRECTION, put_ray, put_shadow
from reference.rays import set_up
from support.ray_setup import CELLS, SPACE, codes, coordinates, frame_with, places, ports

from raygrid.node.geometry.lattice import LATTICE
from raygrid.node.protocol.packets import PRIMARY, SIZE
from raygrid.node.tracing import ray_setup
from raygrid.node.tracing.ray_setup import KNOWN, SETUP_RAYS, make_ray_setup, read_prepared, set_up_rays
from raygrid.node.tracing.single_ray import set_up_ray


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
        way, o, d, inv, t_in, t_out, distance = set_up(cell, SPACE, frame, packets, k * SIZE, int(came_by[k]), kind)
        assert columns.ways[k] == way
        alone = set_up_ray(cell, SPACE, frame, packets, k * SIZE, int(came_by[k]), kind)
        assert alone[0] == way
        assert _bits([*alone[1], *alone[2], *alone[3], *alone[4:]]) == _bits([*o, *d, *inv, t_in, t_out, distance])
        expected = [*o, *d, *inv, t_in, t_out] + ([distance] if shadows else [])
        assert _bits(known[: len(expected), k]) == _bits(np.array(expected))


@given(st.lists(st.tuples(*3 * [coordinates], codes, codes, ports), min_size=1, max_size=20), st.sampled_from(CELLS))
@settings(deadline=None)
def test_rays(rays, cell):
    """Origins beside and on planes, directions along axes and folded ones, from every port."""
    packets = np.zeros(len(rays) * SIZE, np.uint8)
    for k, (x, y, z, a, b, _) in enumerate(rays):
        put_ray(packets, k * SIZE, PRIMARY, 1, k, (x, y, z), (a, b), np.int64(0))
    _same(frame_with([(0.0, 0.0, 0.0, 1.0)]), packets, np.array([ray[5] for ray in rays], np.uint8), cell, False)


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
    _same(frame_with(lights), packets, np.array([ray[4] for ray in rays], np.uint8), cell, True)


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
        _same(frame_with([(0.0, 0.0, 0.0, 1.0)]), packets, came_by, cell, False)


def test_the_columns_are_whole_vectors():
    """Eight rays are set up even if fewer are wanted, so a column of the last of them must exist."""
    assert SETUP_RAYS % ray_setup.EIGHT == 0
