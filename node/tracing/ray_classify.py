"""Classifies rays that were set up by what a cell has to do with them, eight at once and without a branch.

On an array half of all walks find nothing: the ray meets no box of the root and goes on to the next cell. Which ones do
cannot be foreseen, and a branch for each would cost more than all else that is done for them. So the numbers of rays
are put into lists, and then each list is gone through in a loop of its own.

First rays are held against the box of all that the cell holds. Its planes are the least and greatest of those of the
root's boxes. Times of planes are differences and products, which round monotonically, as are minima and maxima: so a
ray enters it no later than any of these boxes, and leaves it no earlier. A ray that does not meet it meets none of
them, in the very arithmetic in which they are tested (`bvh_boxes.push_boxes`), so nothing that is counted depends on it.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from raygrid.node.geometry.bvh import EMPTY_BOUND
from raygrid.node.geometry.bvh_boxes import WIDE, meets, times
from raygrid.node.geometry.grid_walk import PORTS, leaves_array
from raygrid.node.jit.decorators import part
from raygrid.node.jit.formula import eight
from raygrid.node.jit.lanes import EIGHT, F32, I64, Columns, Lanes, Staged, Three
from raygrid.node.tracing.ray_setup import (
    BOX_HIGH,
    BOX_INVERSE,
    BOX_LOW,
    BOX_PLACE,
    DISTANCE,
    LISTS,
    NOT_AT_START,
    SETUP,
    SETUP_RAYS,
    SETUP_ROOM,
    T_OUT,
    open_root_of,
)

# lists: rays that go on to the next cell; that leave the array, reach their light, or are not at their start; that
# meet boxes of the root; that meet the box of all
PASSING, ENDING, SEARCHED, NEAR_BY = range(LISTS)


@part
def box_of_all(floats):
    """The box round all that a cell holds: six binary32, low planes and high ones; one that no ray meets if that is
    nothing. `floats` as of `surface_tables.Surfaces`."""
    if len(floats) == 0:
        return EMPTY_BOUND, EMPTY_BOUND, EMPTY_BOUND, -EMPTY_BOUND, -EMPTY_BOUND, -EMPTY_BOUND
    return (
        _least_plane(floats, 0),
        _least_plane(floats, WIDE),
        _least_plane(floats, 2 * WIDE),
        _greatest_plane(floats, 3 * WIDE),
        _greatest_plane(floats, 4 * WIDE),
        _greatest_plane(floats, 5 * WIDE),
    )


@part
def _least_plane(floats, row):
    plane = EMPTY_BOUND
    for k in range(WIDE):
        plane = min(plane, floats[0, row + k])
    return plane


@part
def _greatest_plane(floats, row):
    plane = -EMPTY_BOUND
    for k in range(WIDE):
        here = floats[0, row + k]
        plane = max(plane, here if here < EMPTY_BOUND else plane)  # lanes without a child lie nowhere
    return plane


@part
def ends_of_array(index, shape):
    """Mark the ways of a cell that lead to no neighbour, a bit each; NOT_AT_START counts as one."""
    ends = np.int64(1 << NOT_AT_START)
    for port in range(PORTS):
        if leaves_array(index, shape, port):
            ends |= 1 << port
    return ends


@part
def classify(surfaces, many, shadows, box, ends, setup):
    """Put the numbers of all rays that were set up into the lists; how many are PASSING, ENDING and SEARCHED.

    box, ends  as `box_of_all` and `ends_of_array` give them
    """
    lists, met = setup.lists, setup.met
    tops = (np.int64(0), np.int64(0), np.int64(0))
    for j in range(0, many, EIGHT):
        if shadows:  # noqa: SIM108  # a choice in one line is longer
            tops = _classify_shadows(setup, j, many, box, ends, tops)
        else:
            tops = _classify_rays(setup, j, many, box, ends, tops)
    passing, ending, near_by = tops
    searched = np.int64(0)
    for k in range(near_by):
        j = lists[NEAR_BY * SETUP_ROOM + k] & (SETUP_RAYS - 1)
        ending_here = met[j]  # until the root is opened
        missed = open_root_of(surfaces, setup, j) == 0
        lists[PASSING * SETUP_ROOM + passing] = lists[ENDING * SETUP_ROOM + ending] = lists[
            SEARCHED * SETUP_ROOM + searched
        ] = j
        searched += not missed
        ending += missed & (ending_here != 0)
        passing += missed & (ending_here == 0)
    return passing, ending, searched


@part
def unfinished(setup, k, ending):
    """The number of ray k of those that are ENDING, this many, and then of those that are SEARCHED."""
    place = ENDING * SETUP_ROOM + k if k < ending else SEARCHED * SETUP_ROOM + k - ending
    return setup.lists[place & (1024 - 1)] & (SETUP_RAYS - 1)


# --- eight at once -------------------------------------------------------------------------------------


def _meets(singles: Columns, box: Sequence[Lanes]) -> Lanes:
    """Tell whether rays meet a box, in the arithmetic in which they are tested against the root's boxes."""
    origin, inv = singles.three(BOX_PLACE), singles.three(BOX_INVERSE)
    near = [(inv[axis] >= 0.0).choose(box[axis], box[3 + axis]) for axis in range(3)]
    far = [(inv[axis] >= 0.0).choose(box[3 + axis], box[axis]) for axis in range(3)]
    return meets(*times(near, far, origin, inv, singles.read(BOX_LOW), singles.read(BOX_HIGH)))


def _classify(
    setup: Staged, at: Lanes, many: Lanes, box: Sequence[Lanes], ends: Lanes, tops: Three, shadows: bool
) -> list[Lanes]:
    """Append the rays from column `at` on that are below `many` to the lists PASSING, ENDING and NEAR_BY, `tops` long;
    returns their new lengths. Of those near by `met` becomes whether they end here unless they meet anything, of the others 0."""
    way, singles = setup.ways.read(at), Columns(setup.singles, at, SETUP_RAYS)
    numbers = setup.ways.numbered(at)
    valid = numbers < many
    ending = (ends >> way & 1) >= 1
    if shadows:
        known = Columns(setup.known, at, SETUP_RAYS)
        ending = ending.either(known.read(DISTANCE) <= known.read(T_OUT))
    near_by = _meets(singles, box).lacks(way.equals(NOT_AT_START)).both(valid)
    setup.met.write(at, near_by.both(ending).to(I64))
    rest = valid.lacks(near_by)
    chosen = ((PASSING, rest.lacks(ending)), (ENDING, rest.both(ending)), (NEAR_BY, near_by))
    return [
        top + setup.lists.append(top + which * SETUP_ROOM, numbers, those)
        for (which, those), top in zip(chosen, tops, strict=True)
    ]


_TAKES = (SETUP, I64, I64, (F32,) * 6, I64, (I64, I64, I64))


@eight(takes=_TAKES, gives=(I64, I64, I64), carries=True)
def _classify_rays(
    setup: Staged, at: Lanes, many: Lanes, box: Sequence[Lanes], ends: Lanes, tops: Three
) -> list[Lanes]:
    """Classify rays."""
    return _classify(setup, at, many, box, ends, tops, shadows=False)


@eight(takes=_TAKES, gives=(I64, I64, I64), carries=True)
def _classify_shadows(
    setup: Staged, at: Lanes, many: Lanes, box: Sequence[Lanes], ends: Lanes, tops: Three
) -> list[Lanes]:
    """Classify shadow rays, which end where they reach their light, too."""
    return _classify(setup, at, many, box, ends, tops, shadows=True)
