"""Increments: after any of them every node holds what a fresh load gives it, and the picture has the same bits."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.array import haphazard, launched, retained_ids, same, shape_of
from support.cases import steady
from support.frames import make_frame, perspective
from support.motions import holdings, moves_of, next_motions, random_motion, random_motions, troupe
from support.scenes import all_lights, glass_and_mirrors, space_of
from support.space import EVEN_STEP, UNEVEN_STEP, spaces

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.warm import warm
from raygrid.node.errors import ArrayError, SceneError
from raygrid.node.geometry.lattice import make_cell
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.rigid_motion import anchors, at_rest, make_groups, move_order, placed
from raygrid.node.runtime.increments import cells_of, tree_ports

NAMES = ["2x2x2", "4x3x1", "3x3x3"]
SLOW_SHAPES = [pytest.param(name, marks=pytest.mark.slow) for name in NAMES[1:]]
SHAPES = [*NAMES[:2], SLOW_SHAPES[-1]]

pytestmark = pytest.mark.usefixtures("quick_records", "compiled")


@pytest.fixture(scope="module")
def compiled():
    """Every kernel is there before an array counts the seconds in which nothing comes."""
    warm(lambda *_: None)


def frame_of(rng, size=(16, 12)):
    camera = perspective([0.3, 0.4, 1.6], [-0.15, -0.2, -1], 45, size)
    return make_frame(
        camera,
        size,
        depth=4,
        materials=glass_and_mirrors(rng),
        lights=all_lights(EVEN_STEP),
        background=(0.1, 0.2, 0.4),
    )


def picture(array, frame):
    array.driver.trace(frame)
    return array.driver.collect(frame.width * frame.height)


def listen(array):
    """Counts how often each node is handed each description from now on; fails when it holds it already."""
    handed = {processor.index: Counter() for processor in array.processors}
    for processor in array.processors:
        retain, node_state, counter = processor.node_state.retain, processor.node_state, handed[processor.index]

        def told(batch, boxes, rest=None, retain=retain, node_state=node_state, counter=counter):
            held = {int(i) for own in node_state.retained for i in own.ids}
            assert not held & set(batch.ids.tolist()), "a node was handed what it holds"
            counter.update(batch.ids.tolist())
            return retain(batch, boxes) if rest is None else retain(batch, boxes, rest)

        processor.node_state.retain = told
    return handed


def fresh(shape, space, cast, motions):
    """An array that was loaded with the groups where they are."""
    array = MemoryArray(shape)
    array.driver.ready()
    array.driver.load(space, cast.surfaces, moves_of(cast, motions))
    return array


def check_holders(array, space, cast, motions):
    """Every node holds what touches its cell, by asking of every surface."""
    ids = retained_ids(array)
    for processor, held in zip(array.processors, ids, strict=True):
        cell = make_cell(space, processor.index)
        low, high = np.array(cell.low_at), np.array(cell.high_at)
        touching = set()
        for batch in cast.surfaces:
            now = placed(batch, moves_of(cast, motions))
            touching |= {int(i) for i in now.ids[meets(now, low, high)]}
        assert held == touching


@pytest.mark.parametrize("name", [NAMES[0], *SLOW_SHAPES])
def test_a_hundred_random_increments(name):
    """Holdings and pictures against a fresh load after each; motions cross cells, return, and leave nodes empty."""
    rng = np.random.default_rng(11 + NAMES.index(name))
    cast, space, frame = troupe(rng, 5, 4, fixed=0, materials=6), space_of(name, EVEN_STEP), frame_of(rng)
    array, anew = launched(name, order=haphazard(3)), launched(name)
    first = motions = random_motions(rng, cast, space)
    array.driver.load(space, cast.surfaces, moves_of(cast, motions))
    crossed = emptied = 0
    for step in range(100):
        before = retained_ids(array)
        handed = listen(array)
        motions = next_motions(rng, motions, first, cast, space)
        array.driver.move(moves_of(cast, motions))
        for processor in array.processors:
            del processor.node_state.retain  # the listener
        assert max((max(c.values(), default=0) for c in handed.values()), default=0) <= 1, "a description came twice"
        anew.driver.load(space, cast.surfaces, moves_of(cast, motions))
        assert holdings(array) == holdings(anew), step
        if step % 10 == 0:
            assert same(picture(array, frame), picture(anew, frame)), step
        after = retained_ids(array)
        crossed += before != after
        emptied += any(held and not kept for held, kept in zip(before, after, strict=True))
    check_holders(array, space, cast, motions)
    assert same(picture(array, frame), picture(anew, frame))
    assert crossed > 50
    assert emptied > 3
    array.driver.end()


@pytest.mark.parametrize("name", SHAPES)
@steady(34)
@given(seed=st.integers(0, 2**32 - 1), steps=st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=4))
def test_any_increments_give_what_a_fresh_load_gives(name, seed, steps):
    rng = np.random.default_rng(seed)
    cast, space = troupe(rng, int(rng.integers(1, 5)), 2), space_of(name, UNEVEN_STEP if seed & 1 else EVEN_STEP)
    array = launched(name, order=haphazard(seed))
    first = motions = random_motions(rng, cast, space)
    array.driver.load(space, cast.surfaces, moves_of(cast, motions))
    for step in steps:
        motions = next_motions(np.random.default_rng(step), motions, first, cast, space)
        array.driver.move(moves_of(cast, motions))
    assert holdings(array) == holdings(fresh(shape_of(name), space, cast, motions))
    frame = frame_of(rng)
    assert same(picture(array, frame), picture(fresh(shape_of(name), space, cast, motions), frame))


@steady(25)
@given(spaces(), st.integers(0, 2**32 - 1))
def test_increments_in_any_space(space, seed):
    """1 to 5 uneven cells an axis, some as thin as allowed."""
    rng = np.random.default_rng(seed)
    cast = troupe(rng, 3, 2)
    array = MemoryArray(space.shape, order=haphazard(seed))
    array.driver.ready()
    first = motions = random_motions(rng, cast, space)
    # fixed surfaces may lie outside a thin world: only those that move are of interest here
    moving = cast._replace(
        surfaces=type(cast.surfaces)(tuple(b.select(cast.groups.of(b.ids) >= 0) for b in cast.surfaces))
    )
    array.driver.load(space, moving.surfaces, moves_of(moving, motions))
    for _ in range(3):
        motions = next_motions(rng, motions, first, cast, space)
        array.driver.move(moves_of(moving, motions))
    assert holdings(array) == holdings(fresh(space.shape, space, moving, motions))
    check_holders(array, space, moving, motions)


def test_a_motion_across_all_cells_in_one_frame():
    rng = np.random.default_rng(5)
    cast, space = troupe(rng, 1, 6, fixed=0), space_of("5x4x2", EVEN_STEP)
    array = launched("5x4x2")
    motions = at_rest(1)
    size = 0.04
    for corner in ((-1, -1, -1), (1, 1, 1), (-1, 1, -1), (1, -1, 1)):
        motions[0] = random_motion(rng, cast.reaches[0], space, size)
        motions[0, 5:] = 0.44 * np.array(corner)
        if array.driver.held is None:
            array.driver.load(space, cast.surfaces, moves_of(cast, motions))
        else:
            array.driver.move(moves_of(cast, motions.copy()))
        assert holdings(array) == holdings(fresh((5, 4, 2), space, cast, motions))
        holders = [processor.index for processor in array.processors if processor.node_state.retained]
        assert len(holders) == 1
        motions = motions.copy()


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 2, 2), (4, 3, 1), (3, 3, 3), (1, 5, 2)])
def test_each_owner_s_tree_reaches_each_cell_once(shape):
    every = [(x, y, z) for x in range(shape[0]) for y in range(shape[1]) for z in range(shape[2])]
    for owner in every:
        reached, waiting = Counter([owner]), [owner]
        while waiting:
            index = waiting.pop()
            for port in tree_ports(owner, shape, index):
                onward = list(index)
                onward[port >> 1] += 1 if port & 1 else -1
                reached[tuple(onward)] += 1
                waiting.append(tuple(onward))
        assert reached == Counter(dict.fromkeys(every, 1))


@pytest.mark.parametrize("name", ["4x3x1", "3x3x3", "uneven 4x4x4"])
def test_owners_hold_their_surfaces(name):
    rng = np.random.default_rng(2)
    space = space_of(name, EVEN_STEP)
    for batch in troupe(rng, 1, 60).surfaces:
        for row, index in enumerate(cells_of(anchors(batch), space).tolist()):
            cell = make_cell(space, tuple(index))
            assert meets(batch.select(np.array([row])), np.array(cell.low_at), np.array(cell.high_at)).all()


def test_what_does_not_move_sends_nothing():
    rng = np.random.default_rng(8)
    cast, space = troupe(rng, 3, 3), space_of("2x2x2", EVEN_STEP)
    array = fresh((2, 2, 2), space, cast, motions := random_motions(rng, cast, space))
    waves = array.driver.waves
    assert not array.driver.move(moves_of(cast, motions.copy()))
    assert array.driver.waves == waves
    tables = [processor.node_state.surfaces for processor in array.processors]
    motions = motions.copy()
    motions[0, 5:] *= 0.999999
    assert array.driver.move(moves_of(cast, motions))
    assert array.driver.waves == waves + 4
    untouched = [
        processor.node_state.surfaces is old
        for processor, old in zip(array.processors, tables, strict=True)
        if not any((cast.groups.of(b.ids) == 0).any() for b in processor.node_state.retained)
    ]
    assert all(untouched)


# --- what is refused ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        (5, 0.6, r"surface \d+ leaves the world box: its box is .*, wanted it within"),
        (5, np.nan, "motion 1 is .*nan.*, wanted finite numbers"),
        (4, np.inf, "motion 1 is .*inf.*, wanted finite numbers"),
        (4, 0.0, "motion 1 has scale 0 .*, wanted a scale above 0"),
        (4, -1.0, "motion 1 has scale -1 .*, wanted a scale above 0"),
        (0, 2.0, "motion 1 has the quaternion .*, wanted one of length 1"),
    ],
)
def test_a_wrong_motion_is_one_error_and_the_next_frame_is_served(column, value, said):
    rng = np.random.default_rng(8)
    cast, space, frame = troupe(rng, 3, 3, materials=6), space_of("2x2x2", EVEN_STEP), frame_of(rng)
    array = fresh((2, 2, 2), space, cast, motions := random_motions(rng, cast, space))
    wrong = motions.copy()
    wrong[1, column] = value
    with pytest.raises(SceneError, match=said):
        array.driver.move(moves_of(cast, wrong))
    with pytest.raises(SceneError, match=said):
        fresh((2, 2, 2), space, cast, wrong)
    motions = next_motions(rng, motions, motions, cast, space)
    array.driver.move(moves_of(cast, motions))
    assert same(picture(array, frame), picture(fresh((2, 2, 2), space, cast, motions), frame))


@pytest.mark.parametrize("what", ["world", "number", "quaternion", "table"])
def test_nodes_refuse_a_wrong_increment_too_and_serve_the_next_load(what):
    """The driver checks first; a node does not rely on it."""
    rng = np.random.default_rng(8)
    cast, space, frame = troupe(rng, 3, 3, materials=6), space_of("2x2x2", EVEN_STEP), frame_of(rng)
    array = fresh((2, 2, 2), space, cast, motions := random_motions(rng, cast, space))
    wrong, numbers = motions[:1].copy(), np.array([7 if what == "number" else 1])
    wrong[0, 5] = 5.0 if what == "world" else 0.0
    wrong[0, 0] = 3.0 if what == "quaternion" else wrong[0, 0]
    order = move_order(numbers, wrong)
    if what == "table":
        order["motions"] = order["motions"][:-3]
    said = {
        "world": "leaves the world box",
        "number": "wanted one each",
        "quaternion": "length 1",
        "table": "not rows of 8",
    }
    with pytest.raises(ArrayError, match=said[what]):
        array.driver.wave(order)
    array.driver.load(space, cast.surfaces, moves_of(cast, motions))
    assert same(picture(array, frame), picture(fresh((2, 2, 2), space, cast, motions), frame))


def test_an_increment_needs_a_load_of_the_same_groups():
    rng = np.random.default_rng(8)
    cast, space = troupe(rng, 3, 3), space_of("2x2x2", EVEN_STEP)
    array = launched("2x2x2")
    motions = random_motions(rng, cast, space)
    with pytest.raises(ArrayError, match="without a load of the same groups"):
        array.driver.move(moves_of(cast, motions))
    array.driver.load(space, cast.surfaces)
    with pytest.raises(ArrayError, match="without a load of the same groups"):
        array.driver.move(moves_of(cast, motions))
    with pytest.raises(ArrayError, match="came before groups"):
        array.driver.wave(move_order(np.array([0]), motions[:1]))


def test_groups_of_ids():
    groups = make_groups(np.array([5, 6, 7, 9, 2, 10]), np.array([1, 1, 1, 1, 0, 2]), 3)
    assert (groups.firsts.tolist(), groups.ends.tolist(), groups.numbers.tolist()) == (
        [2, 5, 9, 10],
        [3, 8, 10, 11],
        [0, 1, 1, 2],
    )
    assert groups.of(np.arange(12)).tolist() == [-1, -1, 0, -1, -1, 1, 1, 1, -1, 1, 2, -1]
    with pytest.raises(ValueError, match="two groups"):
        make_groups(np.array([1, 1]), np.array([0, 1]), 2)
    assert make_groups(np.zeros(0), np.zeros(0), 0).of(np.arange(3)).tolist() == [-1, -1, -1]
