"""Ways over the array: to the nearest corner, and over the tree of waves."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest
from support.space import Index, neighbour

from raygrid.node.geometry.grid_walk import HOST, OPPOSITE
from raygrid.node.geometry.spanning_tree import corners, towards_corner, tree_children, tree_parent

SHAPES = [(1, 1, 1), (2, 1, 1), (3, 2, 1), (5, 4, 3)]


def indices(shape: Index) -> Iterator[Index]:
    """The places of all nodes."""
    return itertools.product(*map(range, shape))  # type: ignore[return-value]


@pytest.mark.parametrize("shape", SHAPES)
def test_pixels_reach_the_nearest_corner_on_a_shortest_way(shape):
    places = set(corners(shape).values())
    for index in indices(shape):
        here, hops = index, 0
        while (port := towards_corner(here, shape)) != HOST:
            here, hops = neighbour(here, port), hops + 1
        assert here in places
        assert hops == min(sum(abs(a - b) for a, b in zip(index, corner, strict=True)) for corner in places)


def test_a_tie_goes_to_the_lower_corner():
    assert [towards_corner((k, 0, 0), (3, 1, 1)) for k in range(3)] == [HOST, 0, HOST]


@pytest.mark.parametrize("shape", SHAPES)
def test_the_children_of_a_node_are_those_that_have_it_as_parent(shape):
    for index in indices(shape):
        for port in tree_children(index, shape):
            assert tree_parent(neighbour(index, port)) == OPPOSITE[port]
    assert [index for index in indices(shape) if tree_parent(index) is None] == [(0, 0, 0)]
    assert sum(len(tree_children(index, shape)) for index in indices(shape)) == shape[0] * shape[1] * shape[2] - 1
