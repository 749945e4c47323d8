"""The walk over uneven cells, against exact fractions."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import rays
from support.cases import steady
from support.space import Index, cells, even_planes, even_space, index_of, neighbour, origins, spaces, uneven_space

from raygrid.node.errors import SceneError
from raygrid.node.geometry.grid_walk import (
    HUGE,
    NO_PORT,
    OPPOSITE,
    SELF,
    inverse,
    is_walking,
    leaves_array,
    passage,
    towards_cell,
    towards_start,
)
from raygrid.node.geometry.lattice import (
    HALF,
    LATTICE,
    THINNEST_CELL,
    Cell,
    Space,
    cell_index,
    coordinate,
    make_space,
    nearest,
)
from raygrid.node.protocol.packing import HALF_DIRECTION, unit_vector

Vector = tuple[float, float, float]
Hop = tuple[Index, float, float, int]  # cell, t_in, t_out, exit port


def walked(space: Space, origin: Index, d: Vector, start: Index | None = None) -> list[Hop]:
    """The cells that a ray crosses, as the nodes work it out; `start` is where it was born."""
    grid = cells(space)
    at = tuple(coordinate(k, step) for k, step in zip(origin, space.step, strict=True))
    inv = tuple(inverse(x) for x in d)
    index, port, path = start or index_of(space, origin), SELF, []
    for _ in range(2 * sum(space.shape)):
        cell = grid[index]
        assert path == [] or is_walking(cell, origin, port), "a walking ray was taken for one on its way to its start"
        onward = NO_PORT if is_walking(cell, origin, port) else towards_start(cell, origin)
        if onward == NO_PORT:
            t_in, t_out, onward = passage(cell, at, inv)
            path.append((index, t_in, t_out, onward))
            if leaves_array(index, space.shape, onward):
                return path
        index, port = neighbour(index, onward), OPPOSITE[onward]
    raise AssertionError(f"the ray still walks after {2 * sum(space.shape)} hops")


def check_against_fractions(space: Space, origin: Index, d: Vector, path: list[Hop]) -> None:
    """Every hop crosses the plane that comes next, in exact arithmetic, up to the rounding of two times.

    The computed time of a plane errs by 2^-52 / |d| at most for the places of plane and origin (both below 1) and
    by some 2^-52 of itself for the rest.
    """
    exact_step = [Fraction(step) for step in space.step]
    index = list(index_of(space, origin))
    for cell, _, t_out, port in path:
        assert cell == tuple(index)
        times: dict[int, tuple[Fraction, Fraction]] = {}  # axis -> (exact time of its next plane, most that it is off)
        for axis in range(3):
            if abs(d[axis]) < 1.0 / HUGE:
                continue
            plane = int(space.planes[axis, index[axis] + (d[axis] > 0.0)])
            t = (plane - origin[axis]) * exact_step[axis] / Fraction(d[axis])
            times[axis] = t, Fraction(2) ** -51 * (1 / abs(Fraction(d[axis])) + t)
        axis = port >> 1
        t, off = times[axis]
        assert (port & 1 == 1) == (d[axis] > 0.0)
        assert abs(Fraction(t_out) - t) <= off
        for other, (t_other, off_other) in times.items():
            assert t <= t_other + off + off_other
            if t == t_other and space.step == (space.step[0],) * 3 and abs(d[other]) == abs(d[axis]):
                assert axis <= other  # same numbers, so the same rounding: a true tie, taken in the order x, y, z
        index[axis] += 1 if port & 1 else -1


codes = st.one_of(
    st.integers(0, 2 * HALF_DIRECTION),
    st.sampled_from([0, 1, HALF_DIRECTION - 1, HALF_DIRECTION, HALF_DIRECTION + 1, 2 * HALF_DIRECTION]),
)
packet_directions = st.tuples(codes, codes).map(lambda code: unit_vector(*code))
small = st.sampled_from([0.0, -0.0, 1e-9, -1e-9, 1e-17, -1e-17, 1e-19, -1e-19, 5e-324, 1.0, -1.0, 0.25])
free_directions = (
    st.tuples(*[st.one_of(small, st.floats(-1, 1))] * 3)
    .filter(lambda v: math.hypot(*v) > 1e-3)
    .map(lambda v: tuple(x / math.hypot(*v) for x in v))
)
directions = st.one_of(packet_directions, free_directions)


@steady(400)
@given(st.data(), spaces(), directions)
def test_walk_against_fractions(data, space, d):
    origin = data.draw(origins(space))
    path = walked(space, origin, d)
    check_against_fractions(space, origin, d, path)
    assert len(path) <= sum(space.shape) - 2
    assert path[0][1] <= 0.0
    for (_, t_in, t_out, _), (_, t_in_next, t_out_next, _) in itertools.pairwise(path):
        assert t_in <= t_out, "the intervals of the cells run backwards"
        assert t_in_next == t_out, "the two nodes at a face disagree on its time"
        assert t_out_next >= t_in_next


@steady(300)
@given(st.data(), spaces(), packet_directions)
def test_a_ray_born_in_another_cell_first_goes_to_its_start(data, space, d):
    """Rounding puts an origin into a neighbour, diagonals included; the rule holds however far away that is."""
    origin = data.draw(origins(space))
    home = index_of(space, origin)
    near = [st.integers(max(c - 1, 0), min(c + 1, n - 1)) for c, n in zip(home, space.shape, strict=True)]
    far = [st.integers(0, n - 1) for n in space.shape]
    start = data.draw(st.one_of(st.tuples(*near), st.tuples(*far)))
    assert walked(space, origin, d, start) == walked(space, origin, d)


def test_every_diagonal_birth_around_a_corner():
    """All 27 cells round a thin one, all origins at its corners, all 26 ways to go."""
    space = make_space((2.0**-23,) * 3, [[0, HALF, HALF + THINNEST_CELL, LATTICE]] * 3)
    ways = [(x, y, z) for x in (0, 1, 2) for y in (0, 1, 2) for z in (0, 1, 2) if (x, y, z) != (1, 1, 1)]
    for corner in ((HALF,) * 3, (HALF + THINNEST_CELL - 1,) * 3, (HALF, HALF + THINNEST_CELL - 1, HALF + 7)):
        for way in ways:
            length = math.hypot(*(c - 1 for c in way))
            d = tuple((c - 1) / length for c in way)
            path = walked(space, corner, d)
            check_against_fractions(space, corner, d, path)
            for start in ways:
                assert walked(space, corner, d, start) == path


# --- by hand ----------------------------------------------------------------------------------------------

DIAGONAL = (1 / math.sqrt(3),) * 3


def visited(space: Space, origin: Index, d: Vector) -> list[Index]:
    return [index for index, *_ in walked(space, origin, d)]


def test_ray_along_an_edge_stays_on_the_upper_side():
    space = even_space((2, 2, 4))
    assert visited(space, (HALF, HALF, 0), (0.0, 0.0, 1.0)) == [(1, 1, k) for k in range(4)]
    assert visited(space, (HALF, HALF, LATTICE - 1), (-0.0, -0.0, -1.0)) == [(1, 1, k) for k in (3, 2, 1, 0)]
    assert visited(space, (HALF - 1, HALF, 0), (0.0, 0.0, 1.0)) == [(0, 1, k) for k in range(4)]


def test_ray_through_corners_takes_x_then_y_then_z():
    space = even_space((2, 2, 2))
    assert visited(space, (0, 0, 0), DIAGONAL) == [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)]
    down = tuple(-x for x in DIAGONAL)
    assert visited(space, (HALF, HALF, HALF), down) == [(1, 1, 1), (0, 1, 1), (0, 0, 1), (0, 0, 0)]


def test_ray_from_a_plane_leaves_its_cell_at_once_if_it_goes_down():
    space = even_space((2, 1, 1))
    (first, entered, left, port), second = walked(space, (HALF, 5, 5), (-1.0, 0.0, 0.0))
    assert (first, left, port) == ((1, 0, 0), 0.0, 0)
    assert entered <= 0.0
    assert second == ((0, 0, 0), 0.0, 0.5, 0)
    ((only, entered, left, port),) = walked(space, (HALF, 5, 5), (1.0, 0.0, 0.0))
    assert (only, left, port) == ((1, 0, 0), 0.5, 1)
    assert entered <= 0.0


def test_longest_walk_has_the_stated_number_of_cells():
    space = even_space((5, 4, 2))
    assert len(visited(space, (0, 0, 0), DIAGONAL)) == 5 + 4 + 2 - 2


def test_inverse_is_finite():
    assert inverse(0.0) == inverse(-0.0) == inverse(5e-324) == inverse(-1e-19) == HUGE
    assert inverse(-0.5) == -2.0
    assert abs(inverse(1.0 / HUGE)) <= HUGE


# --- the lattice ------------------------------------------------------------------------------------------


@given(st.tuples(*3 * [st.integers(0, 4)]), st.tuples(*3 * [st.integers(0, 4)]))
def test_towards_cell_is_what_is_said_with_branches(index, target):
    assert towards_cell(index, target) == rays.towards_cell(index, target)


@steady(200)
@given(st.data(), spaces())
def test_cell_index_and_towards_cell(data, space):
    origin, other = data.draw(origins(space)), data.draw(origins(space))
    index, target = index_of(space, origin), index_of(space, other)
    assert index == tuple(cell_index(space.planes, axis, space.shape[axis], origin[axis]) for axis in range(3))
    hops = 0
    while (port := towards_cell(index, target)) != NO_PORT:
        assert not leaves_array(index, space.shape, port)
        index, hops = neighbour(index, port), hops + 1
    assert index == target
    assert hops == sum(abs(a - b) for a, b in zip(index_of(space, origin), target, strict=True))


@steady(200)
@given(st.data(), spaces())
def test_numbers_and_lattice_coordinates(data, space):
    origin = data.draw(origins(space))
    for k, step in zip(origin, space.step, strict=True):
        assert Fraction(coordinate(k, step)) == Fraction(float((k - HALF) * Fraction(step)))
        assert nearest(coordinate(k, step), step) == k
    assert nearest(-1e9, space.step[0]) == 0
    assert nearest(1e9, space.step[0]) == LATTICE - 1


def test_bounds_of_cells_meet():
    for space in (uneven_space(), even_space((3, 1, 2), (0.3 / HALF, 1.0 / HALF, 0.7 / HALF))):
        grid = cells(space)
        for index, cell in grid.items():
            check_bounds(space, grid, index, cell)


def check_bounds(space: Space, grid: dict[Index, Cell], index: Index, cell: Cell) -> None:
    for axis in range(3):
        assert cell.low_at[axis] == coordinate(cell.low[axis], space.step[axis])
        if index[axis] + 1 < space.shape[axis]:
            beyond = grid[neighbour(index, 2 * axis + 1)]
            assert (cell.high[axis], cell.high_at[axis]) == (beyond.low[axis], beyond.low_at[axis])
        else:
            assert cell.high[axis] == LATTICE


@pytest.mark.parametrize(
    "line",
    [[0], [0, LATTICE - 1], [1, LATTICE], [0, HALF, HALF + THINNEST_CELL - 1, LATTICE], [0, HALF, HALF, LATTICE]],
)
def test_planes_that_cannot_be_are_refused(line):
    with pytest.raises(SceneError, match=r"planes of axis y: came .*, wanted ascending from 0 to 16777216, 64 or more"):
        make_space((2.0**-23,) * 3, [even_planes(1), line, even_planes(1)])
