"""Births that are written eight at once are the packets that are written one by one, byte for byte."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.packing import octahedral, pack_weight, put_ray, put_shadow
from reference.rays import origin_beside, towards_start

from raygrid.node.geometry.grid_walk import NO_PORT
from raygrid.node.geometry.lattice import LATTICE, make_cell, make_space
from raygrid.node.protocol.packets import REFLECTED, SHADOW, SIZE
from raygrid.node.protocol.packing import LARGEST_BINARY32
from raygrid.node.tracing.spawn import (
    EIGHT,
    RAY_BATCH,
    SHADOW_BATCH,
    SPAWN_ROOM,
    make_spawn_batch,
    note,
    put,
    starts_behind,
    work_out,
)

STEPS = (2.0**-24, 1.5 * 2.0**-25, 2.0**-26)
SPACE = make_space(STEPS, [[0, LATTICE // 3, LATTICE], [0, 777, 5_000_000, LATTICE], [0, LATTICE]])
CELLS = [make_cell(SPACE, (x, y, 0)) for x in range(2) for y in range(3)]
EDGES = [step * (LATTICE // 2) for step in STEPS]

units = st.tuples(*3 * [st.one_of(st.sampled_from([-1.0, 0.0, 1.0, 1e-9, -1e-9]), st.floats(-1.0, 1.0))]).filter(
    lambda v: sum(x * x for x in v) > 1e-6
)
points = st.tuples(*(st.floats(-edge, edge) for edge in EDGES))
weights = st.tuples(
    *3
    * [
        st.one_of(
            st.sampled_from([0.0, 1.0, 0.5, 2047.5 / 2048, 1.0 - 2.0**-53, 2.0**63, 2.0**64, 1e-30, LARGEST_BINARY32]),
            st.floats(0.0, 2.0),
            st.floats(0.0),
        )
    ]
)


def _unit(v):
    return tuple(float(x) for x in np.array(v) / np.linalg.norm(v))


def _write(spawn_batch, rays, cell):
    """Packets of rays (head, light, p, g, d, weight), and the ports behind which they start."""
    spawns, rows = make_spawn_batch(), np.zeros(len(rays) * SIZE, np.uint8)
    for ray in rays:
        note(spawns, spawn_batch, *ray)
    assert spawns.held[spawn_batch] == len(rays)
    work_out(cell, SPACE, spawns, spawn_batch)
    for k in range(len(rays)):
        put(spawns, spawn_batch, k, rows, k * SIZE)
    return rows.reshape(-1, SIZE), [int(starts_behind(spawns, spawn_batch, k)) for k in range(len(rays))]


def _first(ports):
    return NO_PORT if ports == 0 else (ports & -ports).bit_length() - 1


@given(
    st.lists(st.tuples(points, units, units, weights, st.integers(0, 2**32 - 1)), min_size=1, max_size=20),
    st.sampled_from(CELLS),
)
@settings(deadline=None)
def test_rays(rays, cell):
    """Grazing and along axes, weights from nothing to infinity."""
    noted = [
        (REFLECTED | (3 << 3) | (sample << 8), 0, p, _unit(g), _unit(d), weight) for p, g, d, weight, sample in rays
    ]
    rows, ports = _write(RAY_BATCH, noted, cell)
    for k, (p, _, _, weight, sample) in enumerate(rays):
        g, d = noted[k][3], noted[k][4]
        origin, row = origin_beside(STEPS, p, g, d), np.zeros(SIZE, np.uint8)
        put_ray(row, 0, REFLECTED, 3, sample, origin, octahedral(*d), pack_weight(*weight))
        assert rows[k].tobytes() == row.tobytes()
        assert _first(ports[k]) == towards_start(cell, origin)


@given(
    st.lists(
        st.tuples(points, units, units, weights, st.integers(0, 2**32 - 1), st.integers(0, 65535)),
        min_size=1,
        max_size=20,
    ),
    st.sampled_from(CELLS),
)
@settings(deadline=None)
def test_shadow_rays(rays, cell):
    """Towards any of the lights that a packet can name."""
    noted = [
        (SHADOW | (31 << 3) | (sample << 8), light, p, _unit(g), _unit(d), weight)
        for p, g, d, weight, sample, light in rays
    ]
    rows, ports = _write(SHADOW_BATCH, noted, cell)
    for k, (p, _, _, weight, sample, light) in enumerate(rays):
        origin, row = origin_beside(STEPS, p, noted[k][3], noted[k][4]), np.zeros(SIZE, np.uint8)
        put_shadow(row, 0, 31, sample, origin, light, weight)
        assert rows[k].tobytes() == row.tobytes()
        assert _first(ports[k]) == towards_start(cell, origin)


@pytest.mark.parametrize("spawn_batch", [SHADOW_BATCH, RAY_BATCH])
def test_a_full_brood_says_so(spawn_batch):
    """Where there is room for no more, and only there; the other batch is left alone."""
    spawns = make_spawn_batch()
    ray = (1, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    assert [note(spawns, spawn_batch, *ray) for _ in range(SPAWN_ROOM)] == [False] * (SPAWN_ROOM - 1) + [True]
    assert spawns.held[1 - spawn_batch] == 0
    assert SPAWN_ROOM % EIGHT == 0
