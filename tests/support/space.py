"""World boxes cut into cells, for the tests."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from hypothesis import strategies as st

from raygrid.node.geometry.lattice import HALF, LATTICE, THINNEST_CELL, Cell, Space, make_cell, make_space

Index = tuple[int, int, int]
EVEN_STEP = (2.0**-24, 2.0**-24, 2.0**-24)  # a cube of half edge 1/2; powers of two keep sums of steps exact
UNEVEN_STEP = (0.97 / HALF, 0.61 / HALF, 0.33 / HALF)
UNEVEN_PLANES = [
    [0, LATTICE // 10, LATTICE // 10 + THINNEST_CELL, HALF + 12345, LATTICE],
    [0, HALF - 1, HALF + 5_000_001, LATTICE - THINNEST_CELL, LATTICE],
    [0, THINNEST_CELL, HALF, HALF + THINNEST_CELL + 1, LATTICE],
]


def even_planes(cells: int) -> list[int]:
    """An axis cut evenly."""
    return [LATTICE * k // cells for k in range(cells + 1)]


def even_space(shape: Index, step: tuple[float, float, float] = EVEN_STEP) -> Space:
    """A world box cut evenly."""
    return make_space(step, [even_planes(n) for n in shape])


def uneven_space(step: tuple[float, float, float] = EVEN_STEP) -> Space:
    """4x4x4 cells, the thinnest as thin as allowed."""
    return make_space(step, UNEVEN_PLANES)


def indices(space: Space) -> Iterator[Index]:
    """The places of all cells."""
    return itertools.product(*(range(n) for n in space.shape))


def cells(space: Space) -> dict[Index, Cell]:
    """All cells by their place."""
    return {index: make_cell(space, index) for index in indices(space)}


def index_of(space: Space, origin: Index) -> Index:
    """The cell that holds a lattice point, by searching the planes."""
    found = [int(np.searchsorted(space.planes[a, : space.shape[a]], origin[a], "right")) - 1 for a in range(3)]
    return found[0], found[1], found[2]


def neighbour(index: Index, port: int) -> Index:
    """The cell behind a port."""
    moved = list(index)
    moved[port >> 1] += 1 if port & 1 else -1
    return moved[0], moved[1], moved[2]


@st.composite
def planes(draw: st.DrawFn, most: int = 5) -> list[int]:
    """The planes of an axis, some of them as near as they may be."""
    gaps = draw(st.lists(st.one_of(st.just(0), st.integers(0, LATTICE // 8)), max_size=most - 1))
    line = [0]
    for gap in gaps:
        line.append(line[-1] + THINNEST_CELL + gap)
    return [*line, LATTICE]


steps = st.one_of(st.just(EVEN_STEP), st.tuples(*[st.floats(0.01 / HALF, 1.0 / HALF)] * 3))


@st.composite
def spaces(draw: st.DrawFn) -> Space:
    """World boxes of 1 to 5 uneven cells an axis."""
    return make_space(draw(steps), [draw(planes()) for _ in range(3)])


@st.composite
def origins(draw: st.DrawFn, space: Space) -> Index:
    """Lattice points: anywhere, on planes, and one step below planes."""
    point = []
    for axis in range(3):
        line = [int(k) for k in space.planes[axis, : space.shape[axis]]]
        near = st.sampled_from(line).flatmap(lambda k: st.sampled_from([k, max(k - 1, 0), k + 1]))
        point.append(draw(st.one_of(st.integers(0, LATTICE - 1), near)))
    return point[0], point[1], point[2]
