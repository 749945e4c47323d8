"""Rays classified eight at once are classified as one by one; and what the step hands on is what it was."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.packing import put_ray, put_shadow
from reference.rays import for_boxes
from support.ray_setup import CELLS, SPACE, codes, coordinates, frame_with, places, ports

from raygrid.node.geometry.bvh import EMPTY_BOUND, NODE_WORDS
from raygrid.node.geometry.bvh_boxes import CHILD_COLUMN, FAREST, WIDE
from raygrid.node.geometry.grid_walk import NO_PORT, leaves_array, towards_cell
from raygrid.node.geometry.lattice import LATTICE, T_MIN
from raygrid.node.protocol.counters import COUNTS
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import PRIMARY, SIZE
from raygrid.node.tracing import ray_classify
from raygrid.node.tracing.local_geometry import empty_surfaces
from raygrid.node.tracing.output_queues import clear, hand_on, hand_on_all, make_outputs
from raygrid.node.tracing.ray_classify import ENDING, PASSING, SEARCHED, box_of_all, classify, ends_of_array, unfinished
from raygrid.node.tracing.ray_setup import (
    NOT_AT_START,
    SETUP_RAYS,
    SETUP_ROOM,
    boxes_of,
    column,
    make_ray_setup,
    read_prepared,
    set_up_rays,
)
from raygrid.node.tracing.traverse import open_root

edges = st.one_of(st.sampled_from([-0.5, -0.25, 0.0, 0.125, 0.5]), st.floats(-0.625, 0.625, width=32))
boxes = st.lists(st.tuples(*6 * [edges]), max_size=WIDE)


def _rooted(some):
    """Surfaces of which only the root of the hierarchy is there, with these boxes; none: nothing at all."""
    surfaces = empty_surfaces()
    if not some:
        return surfaces
    floats = np.zeros((1, NODE_WORDS), np.float32)
    floats[0, :CHILD_COLUMN] = EMPTY_BOUND
    for lane, box in enumerate(some):
        for axis in range(3):
            low, high = sorted((box[axis], box[3 + axis]))
            floats[0, axis * WIDE + lane], floats[0, (3 + axis) * WIDE + lane] = low, high
    floats.view(np.uint32)[0, CHILD_COLUMN : CHILD_COLUMN + WIDE] = np.arange(WIDE)
    return surfaces._replace(floats=floats, words=floats.view(np.uint32))


def _expected(surfaces, ray, shadow, cell):
    """(list, keys of the root) of one ray."""
    way, o, _, inv, t_in, t_out, distance = ray
    keys, met = np.zeros(WIDE, np.int64), 0
    if way == NOT_AT_START:
        return ENDING, keys[:0]
    upper = min(t_out, distance) if shadow else t_out
    if len(surfaces.floats):
        met = open_root(surfaces, keys, 0, o, inv, max(t_in, T_MIN), upper)
    if met:
        return SEARCHED, keys[:met]
    reached = shadow and distance <= t_out
    return (ENDING if reached or leaves_array(cell.index, SPACE.shape, way) else PASSING), keys[:0]


def _compare(surfaces, frame, packets, came_by, cell, shadow):
    setup, many = make_ray_setup(), len(came_by)
    setup.lists[:] = 77  # what is left there does not matter
    read_prepared(frame, packets, came_by, 0, many, shadow, setup)
    set_up_rays(cell, SPACE, many, shadow, setup)
    ends = ends_of_array(cell.index, SPACE.shape)
    found = classify(surfaces, many, shadow, box_of_all(surfaces.floats), ends, setup)
    wanted = [_expected(surfaces, column(setup, j), shadow, cell) for j in range(many)]
    for which, count in zip((PASSING, ENDING, SEARCHED), found, strict=True):
        listed = setup.lists[which * SETUP_ROOM : which * SETUP_ROOM + count].tolist()
        assert sorted(listed) == [j for j in range(many) if wanted[j][0] == which]
    for j in range(many):
        if wanted[j][0] != PASSING:
            assert setup.met[j] == len(wanted[j][1])
        if wanted[j][0] == SEARCHED:
            assert setup.roots[j * WIDE : j * WIDE + setup.met[j]].tolist() == wanted[j][1].tolist()
    _, ending, searched = found
    rest = [unfinished(setup, k, ending) for k in range(ending + searched)]
    assert sorted(rest) == [j for j in range(many) if wanted[j][0] != PASSING]
    assert all(wanted[j][0] == ENDING for j in rest[:ending])


rays = st.lists(st.tuples(*3 * [coordinates], codes, codes, ports), min_size=1, max_size=40)


@given(boxes, rays, st.sampled_from(CELLS))
@settings(deadline=None)
def test_rays(some, rays, cell):
    packets = np.zeros(len(rays) * SIZE, np.uint8)
    for k, (x, y, z, a, b, _) in enumerate(rays):
        put_ray(packets, k * SIZE, PRIMARY, 1, k, (x, y, z), (a, b), np.int64(0))
    came_by = np.array([ray[5] for ray in rays], np.uint8)
    _compare(_rooted(some), frame_with([(0.0, 0.0, 0.0, 1.0)]), packets, came_by, cell, False)


@given(
    boxes,
    st.lists(st.tuples(st.sampled_from([0.0, 1.0]), places, places, places), min_size=1, max_size=3),
    st.lists(st.tuples(*3 * [coordinates], st.integers(0, 2), ports), min_size=1, max_size=40),
    st.sampled_from(CELLS),
)
@settings(deadline=None)
def test_shadow_rays(some, lights, rays, cell):
    packets = np.zeros(len(rays) * SIZE, np.uint8)
    for k, (x, y, z, light, _) in enumerate(rays):
        put_shadow(packets, k * SIZE, 1, k, (x, y, z), light % len(lights), (1.0, 1.0, 1.0))
    _compare(_rooted(some), frame_with(lights), packets, np.array([ray[4] for ray in rays], np.uint8), cell, True)


@given(rays, st.sampled_from(CELLS))
@settings(deadline=None)
def test_what_boxes_are_given(rays, cell):
    """Origin, inverse direction and near planes in binary32, and the times, as `for_boxes` and `open_root` have them."""
    packets, setup = np.zeros(len(rays) * SIZE, np.uint8), make_ray_setup()
    for k, (x, y, z, a, b, _) in enumerate(rays):
        put_ray(packets, k * SIZE, PRIMARY, 1, k, (x, y, z), (a, b), np.int64(0))
    read_prepared(
        frame_with([(0.0, 0.0, 0.0, 1.0)]), packets, np.zeros(len(rays), np.uint8), 0, len(rays), False, setup
    )
    set_up_rays(cell, SPACE, len(rays), False, setup)
    times = setup.singles.reshape(-1, SETUP_RAYS)[6:]
    for j in range(len(rays)):
        _, o, _, inv, t_in, t_out, _ = column(setup, j)
        (ray, near), (wanted, wanted_near) = boxes_of(setup, j), for_boxes(o, inv)
        assert np.array(ray, np.float32).tobytes() == np.array(wanted, np.float32).tobytes()
        assert tuple(near) == tuple(wanted_near)
        assert times[:, j].tolist() == [np.float32(max(t_in, T_MIN)), np.float32(min(t_out, FAREST))]


@pytest.mark.parametrize("many", [1, 7, 8, 9, SETUP_RAYS - 1, SETUP_RAYS])
def test_any_number_of_rays(many):
    rng = np.random.default_rng(many)
    packets = np.zeros(many * SIZE, np.uint8)
    for k in range(many):
        put_ray(
            packets, k * SIZE, PRIMARY, 1, k, tuple(rng.integers(0, LATTICE, 3)), tuple(rng.integers(0, 1 << 24, 2)), 0
        )
    surfaces = _rooted(rng.uniform(-0.5, 0.5, (5, 6)).tolist())
    for cell in CELLS:
        frame = frame_with([(0.0, 0.0, 0.0, 1.0)])
        _compare(surfaces, frame, packets, rng.integers(0, 8, many).astype(np.uint8), cell, False)


@given(boxes.filter(bool))
@settings(deadline=None)
def test_the_box_of_all_is_no_larger_than_it_must_be(some):
    """Lanes without a child do not count."""
    sides = np.sort(np.array(some, np.float32).reshape(-1, 2, 3), axis=1)
    wanted = [*sides[:, 0].min(0), *sides[:, 1].max(0)]
    assert np.array(box_of_all(_rooted(some).floats)).tolist() == np.array(wanted).tolist()


def test_places_of_lists_fit_their_mask():
    assert ray_classify.LISTS * SETUP_ROOM <= 1024
    assert SETUP_RAYS & (SETUP_RAYS - 1) == 0


def test_packets_are_handed_on_as_one_by_one():
    rng = np.random.default_rng(3)
    packets = rng.integers(0, 256, 60 * SIZE).astype(np.uint8)
    numbers, ways = rng.permutation(50), rng.integers(0, 7, SETUP_RAYS)
    one, all_of_them = make_outputs(100, 8), make_outputs(100, 8)
    counts, counts_of_all = np.zeros(COUNTS, np.int64), np.zeros(COUNTS, np.int64)
    for outputs in (one, all_of_them):
        clear(outputs)
        outputs.data[:] = 0  # nobody else writes what is not used yet
    for _ in range(2):
        for j in numbers[5:40]:
            hand_on(packets, (7 + j) * SIZE, ways[j], one, counts)
        hand_on_all(packets, 7, numbers, 5, 35, ways, all_of_them, counts_of_all)
    np.testing.assert_array_equal(one.held, all_of_them.held)
    np.testing.assert_array_equal(one.data, all_of_them.data)
    np.testing.assert_array_equal(counts, counts_of_all)
    assert not all_of_them.data[:, :HEAD].any()


def test_the_way_to_every_cell():
    """x before y before z."""
    here, each = (1, 1, 1), range(3)
    for target in [(x, y, z) for x in each for y in each for z in each]:
        away = [axis for axis in range(3) if target[axis] != here[axis]]
        wanted = 2 * away[0] + int(target[away[0]] > here[away[0]]) if away else NO_PORT
        assert towards_cell(here, target) == wanted
