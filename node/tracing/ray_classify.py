"""Classifies rays that were set up by what a cell has to do with them, eight at once and without a branch.

On an array half of all walks find nothing: the ray meets no box of the root and goes on to the next cell. Which ones do
cannot be foreseen, and a branch for each would cost more than all else that is done for them. So the numbers of rays
are put into lists, and then each list is gone through in a loop of its own.

First rays are held against the box of all that the cell holds. Its planes are the least and greatest of those of the
root's boxes. Times of planes are differences and products, which round monotonically, as are minima and maxima: so a
ray enters it no later than any of these boxes, and leaves it no earlier. A ray that does not meet it meets none of
them, in the very arithmetic in which they are tested (`bvh_simd.push_boxes`), so nothing that is counted depends on it.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from raygrid.node.geometry.bvh import EMPTY_BOUND
from raygrid.node.geometry.bvh_simd import LEAVE_LATER, WIDE
from raygrid.node.geometry.grid_walk import PORTS, leaves_array
from raygrid.node.jit.decorators import part
from raygrid.node.jit.simd import EIGHT, Lanes, Table, least, most, splat, splats
from raygrid.node.tracing.ray_setup import (
    BOX_HIGH,
    BOX_INVERSE,
    BOX_LOW,
    BOX_PLACE,
    DISTANCE,
    LISTS,
    NOT_AT_START,
    SETUP_RAYS,
    SETUP_ROOM,
    T_OUT,
    open_root_of,
)

if TYPE_CHECKING:
    from raygrid.node.jit.code_types import (
        BaseContext,
        Intrinsic,
        IRBuilder,
        Signature,
        Type,
        Typed,
        TypingContext,
        Value,
        Values,
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
    singles, known, ways, lists, met = setup.singles, setup.known, setup.ways, setup.lists, setup.met
    tops = (np.int64(0), np.int64(0), np.int64(0))
    for j in range(0, many, EIGHT):
        if shadows:
            tops = _classify_shadows(singles, known, ways, lists, met, j, many, box, ends, tops)
        else:
            tops = _classify_rays(singles, known, ways, lists, met, j, many, box, ends, tops)
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


def _meets(singles: Table, box: list[Lanes]) -> Lanes:
    """Tell whether rays meet a box, as `bvh_simd.push_boxes` tells it of eight boxes and a ray."""
    enter, leave = singles.read(BOX_LOW), singles.read(BOX_HIGH)
    for axis in range(3):
        origin, inverse = singles.read(BOX_PLACE + axis), singles.read(BOX_INVERSE + axis)
        low, high = ((box[side + axis] - origin) * inverse for side in (0, 3))
        forwards = inverse >= 0.0
        enter, leave = most(enter, forwards.choose(low, high)), least(leave, forwards.choose(high, low))
    return enter <= leave * LEAVE_LATER


def _append(builder: IRBuilder, lists: Table, which: int, numbers: Lanes, chosen: Lanes, top: Value) -> Value:
    """Append those of eight numbers that are chosen to a list that is `top` long; returns its new length."""
    lists.at(builder.add(top, ir.Constant(top.type, which * SETUP_ROOM))).write(0, numbers.in_front(chosen))
    return builder.add(top, chosen.count())


def _classify(shadows: bool) -> Intrinsic:
    """Make the intrinsic that classifies eight rays, shadow rays or others."""

    def intrinsic_function(
        typingctx: TypingContext,
        singles: Type,
        known: Type,
        ways: Type,
        lists: Type,
        met: Type,
        at: Type,
        many: Type,
        box: Type,
        ends: Type,
        tops: Type,
    ) -> Typed:
        """Append the rays of columns at..at+7 that are below `many` to the lists PASSING, ENDING and NEAR_BY, `tops` long;
        returns their new lengths. Of those near by `met` becomes whether they end here unless they meet anything, of the
        others 0."""

        def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, args: Values) -> Value:
            boxes, numbers, out, found, kept = (
                Table(context, builder, signature.args[k], args[k], args[5], SETUP_RAYS) for k in range(5)
            )
            way = out.read(0)
            counting = Lanes(builder, ir.Constant(way.value.type, list(range(EIGHT)))) + splat(builder, args[5])
            valid = counting < splat(builder, args[6])
            not_at_start = way.equals(NOT_AT_START)
            ending = (splat(builder, args[8]) >> way & 1) >= 1
            if shadows:
                ending = ending.either(numbers.read(DISTANCE) <= numbers.read(T_OUT))
            near_by = _meets(boxes, splats(builder, args[7])).lacks(not_at_start).both(valid)
            kept.write(0, near_by.both(ending).as_long())
            rest = valid.lacks(near_by)
            tops = [builder.extract_value(args[9], k) for k in range(3)]
            chosen = ((PASSING, rest.lacks(ending)), (ENDING, rest.both(ending)), (NEAR_BY, near_by))
            after = [
                _append(builder, found, which, counting, those, top)
                for (which, those), top in zip(chosen, tops, strict=True)
            ]
            return context.make_tuple(builder, signature.return_type, after)

        three = types.UniTuple(types.int64, 3)
        tables = singles, known, ways, lists, met
        return three(*tables, types.int64, types.int64, types.UniTuple(types.float32, 6), types.int64, three), codegen

    return intrinsic(intrinsic_function)


# kernels call them without the first argument
_classify_rays: Intrinsic = _classify(False)
_classify_shadows: Intrinsic = _classify(True)
