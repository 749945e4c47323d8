"""The flood: every node retains exactly what touches its cell, and gets no description twice."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from support_scenes import mixed_scene, space_of
from support_space import EVEN_STEP, UNEVEN_STEP, cells, even_space, neighbour

from raygrid.emulator.memory_array import MemoryArray
from raygrid.node.flood import branches, corners
from raygrid.node.lattice import make_cell
from raygrid.node.overlap import meets
from raygrid.node.surfaces import Kind, SurfaceSet

SHAPES = ["1x1x1", "2x2x2", "4x3x1", "3x3x3", "5x4x2", "uneven 4x4x4"]


def load_and_listen(shape, step, surfaces):
    """An array that has loaded the surfaces, and how often each node was handed each description."""
    space = space_of(shape, step)
    array = MemoryArray(space.shape)
    handed = {processor.index: Counter() for processor in array.processors}
    for processor in array.processors:
        retain, counter = processor.tracer.retain, handed[processor.index]

        def listen(batch, boxes, retain=retain, counter=counter):
            counter.update(batch.ids.tolist())
            return retain(batch, boxes)

        processor.tracer.retain = listen
    array.driver.ready()
    array.driver.load(space, surfaces)
    return space, array, handed


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("step", [EVEN_STEP, UNEVEN_STEP], ids=["cube", "box"])
def test_each_node_retains_what_touches_its_cell(shape, step):
    surfaces = mixed_scene(7, step, 25).surfaces
    space, array, handed = load_and_listen(shape, step, surfaces)
    for processor in array.processors:
        cell = make_cell(space, processor.index)
        low, high = np.array(cell.low_at), np.array(cell.high_at)
        touching = {int(i) for batch in surfaces for i in batch.ids[meets(batch, low, high)]}
        kept = [int(i) for batch in processor.tracer.retained for i in batch.ids]
        assert sorted(kept) == sorted(touching)
        assert max(handed[processor.index].values(), default=1) == 1, "a description came twice"
    array.driver.end()


def test_local_surfaces_are_not_handed_to_all():
    surfaces = mixed_scene(3, EVEN_STEP, 40).surfaces
    small = SurfaceSet(tuple(batch.select(np.ptp(batch.bounds(), axis=1).max(axis=1) < 0.05) for batch in surfaces))
    assert len(small) > 20
    _, array, handed = load_and_listen("5x4x2", EVEN_STEP, small)
    received = sum(sum(counter.values()) for counter in handed.values())
    # a path along the tree of the nearest corner is at most 5 nodes long here; a flood to all would reach 40
    assert received < 6 * len(small)
    array.driver.end()


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 1), (4, 3, 1), (3, 3, 3), (5, 4, 2)])
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
    assert {batch.kind for batch in mixed_scene(7, EVEN_STEP, 25).surfaces} == set(Kind)
