"""The flood: every node retains exactly what touches its cell, and gets no description twice."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.array import forwards, haphazard
from support.cases import steady
from support.scenes import inside, mixed_scene, space_of
from support.space import EVEN_STEP, UNEVEN_STEP, cells, even_space, neighbour, spaces
from support.surfaces import batch, random_rows, rows_on_planes, shuffled_ids

from raygrid.emulator.driver import dealing
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.geometry.lattice import HALF, make_cell
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.spanning_tree import branches, corners
from raygrid.node.geometry.surfaces import Kind, SurfaceSet

SHAPES = ["1x1x1", "2x2x2", "4x3x1", "3x3x3", "5x4x2", "uneven 4x4x4"]


def load_and_listen(space, surfaces, order=forwards):
    """An array that has loaded the surfaces, and how often each node was handed each description."""
    array = MemoryArray(space.shape, order=order)
    handed = {processor.index: Counter() for processor in array.processors}
    for processor in array.processors:
        retain, counter = processor.node_state.retain, handed[processor.index]

        def listen(batch, boxes, retain=retain, counter=counter):
            counter.update(batch.ids.tolist())
            return retain(batch, boxes)

        processor.node_state.retain = listen
    array.driver.ready()
    array.driver.load(space, surfaces)
    return array, handed


def check_retained(array, space, surfaces, handed) -> None:
    """Each node holds what touches its cell, by asking of every surface, and was handed nothing twice."""
    for processor in array.processors:
        cell = make_cell(space, processor.index)
        low, high = np.array(cell.low_at), np.array(cell.high_at)
        touching = {int(i) for group in surfaces for i in group.ids[meets(group, low, high)]}
        kept = [int(i) for group in processor.node_state.retained for i in group.ids]
        assert sorted(kept) == sorted(touching)
        assert max(handed[processor.index].values(), default=1) == 1, "a description came twice"


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("step", [EVEN_STEP, UNEVEN_STEP], ids=["cube", "box"])
def test_each_node_retains_what_touches_its_cell(shape, step):
    surfaces, space = mixed_scene(7, step, 25).surfaces, space_of(shape, step)
    array, handed = load_and_listen(space, surfaces)
    check_retained(array, space, surfaces, handed)
    array.driver.end()


@steady(20)
@given(spaces(), st.integers(0, 2**32 - 1))
def test_each_node_retains_what_touches_its_cell_of_any_space(space, seed):
    """1 to 5 uneven cells an axis, some as thin as allowed; some surfaces lie in planes between them."""
    rng = np.random.default_rng(seed)
    half = HALF * np.array(space.step)
    lines = [(space.planes[axis, : space.shape[axis]] - HALF) * space.step[axis] for axis in range(3)]
    groups = []
    for kind in Kind:
        reach = float(half.min()) * 0.9
        rows = [*random_rows(kind, rng, 4, reach), *rows_on_planes(kind, rng, 3, lines, size=0.3 * reach)]
        groups.append(inside(batch(kind, rows), space.step))
    surfaces = shuffled_ids([group for group in groups if len(group)], rng)
    array, handed = load_and_listen(space, surfaces, haphazard(seed))
    check_retained(array, space, surfaces, handed)


def test_the_host_deals_each_surface_once_and_no_node_gets_it_from_two():
    """Handed out over all corners, received by nodes that it comes near to only."""
    surfaces = mixed_scene(5, EVEN_STEP, 30).surfaces
    array, handed = load_and_listen(space_of("4x3x1", EVEN_STEP), surfaces)
    received = sum(handed.values(), Counter())
    assert set(received) == {int(i) for group in surfaces for i in group.ids}
    assert sum(received.values()) < 0.5 * 12 * len(surfaces)
    dealt = {corner: link.data_sent for corner, link in array.driver.links.items()}
    assert set(dealt) == {0, 1, 2, 3}
    assert min(dealt.values()) > 0


def test_local_surfaces_are_not_handed_to_all():
    surfaces = mixed_scene(3, EVEN_STEP, 40).surfaces
    small = SurfaceSet(tuple(group.select(np.ptp(group.bounds(), axis=1).max(axis=1) < 0.05) for group in surfaces))
    assert len(small) > 20
    array, handed = load_and_listen(space_of("5x4x2", EVEN_STEP), small)
    received = sum(sum(counter.values()) for counter in handed.values())
    # a path along the tree of the nearest corner is at most 5 nodes long here; a flood to all would reach 40
    assert received < 6 * len(small)
    array.driver.end()


def test_the_end_of_loading_is_not_believed_too_soon():
    """A wave that misses a surface in one node, and counts the copy that this node has handed on, finds as many sent as
    received while another copy is still under way. The nodes of 2x2x1 take turns so that this happens."""
    array = MemoryArray((2, 2, 1), order=lambda n: turns())
    _, above, beside, far = array.processors
    surfaces, space = mixed_scene(1, EVEN_STEP, 1).surfaces, space_of("2x2x1", EVEN_STEP)
    corner = np.array([[0.6, 0.6, 0.3, -0.1, 0.6, 0.2, 0.6, -0.1, 0.3]])  # by the far one
    surfaces = SurfaceSet((batch(Kind.TRIANGLE, list(corner)),))
    from_host, answers = far.links[HOST].channel, far.links[2].send_order
    hear, waves = from_host.receive, []
    from_host.receive = lambda: hear() if array.driver.waves < 2 or len(waves) >= 3 else None  # ready, space, loaded
    far.links[2].send_order = lambda *order: (waves.append(order), answers(*order))

    def turns():
        if len(waves) < 3:
            return [0, 2, 1, 3]
        if not far.links[HOST].received or far.flood.received == 0:
            return [3]
        return [1, 0] if array.driver.waves == 3 else [0, 1, 2, 3]

    array.driver.ready()
    array.driver.load(space, surfaces)
    for processor in (above, beside, far):
        assert len(processor.node_state.retained) == 1
        assert len(processor.node_state.surfaces.triangles) == 1, "the tables were made without it"


def test_messages_of_one_surface_and_a_world_in_one_corner(monkeypatch):
    monkeypatch.setattr(dealing, "CHUNK_BYTES", 1)
    rows = [0.02 * row + 0.45 for row in random_rows(Kind.TRIANGLE, np.random.default_rng(1), 60)]
    surfaces, space = SurfaceSet((batch(Kind.TRIANGLE, rows),)), even_space((3, 3, 3))
    array, handed = load_and_listen(space, surfaces, haphazard(1))
    check_retained(array, space, surfaces, handed)
    holders = [processor.index for processor in array.processors if processor.node_state.retained]
    assert holders == [(2, 2, 2)]
    assert sum(sum(counter.values()) for counter in handed.values()) == 60


@pytest.mark.parametrize("shape", [*itertools.product(range(1, 4), repeat=3), (5, 4, 2), (1, 7, 2)])
def test_each_corner_s_tree_reaches_each_cell_once(shape):
    space = even_space(shape)
    by_index = cells(space)
    for corner, start in corners(shape).items():
        reached = Counter([start])
        waiting = [start]
        while waiting:
            index = waiting.pop()
            for branch in branches(corner, space, by_index[index]):
                onward = neighbour(index, branch.port)
                reached[onward] += 1
                waiting.append(onward)
        assert reached == Counter(dict.fromkeys(by_index, 1))


def test_all_kinds_were_flooded():
    assert {group.kind for group in mixed_scene(7, EVEN_STEP, 25).surfaces} == set(Kind)
