"""Tests eight boxes against one ray at once: the inner loop of every traversal.

A node of the hierarchy (layout in `node.geometry.bvh`) keeps the six planes of its boxes as rows of eight. The
caller says which row of an axis is the near one, so no lane has to put its two times in order.

Nothing is checked in compiled code: `at` must be the first word of a node, and `keys` must have WIDE free places from `top`.
"""

from __future__ import annotations

from collections.abc import Sequence

from raygrid.node.jit.formula import eight, formula
from raygrid.node.jit.lanes import ARRAY, EIGHT, F32, I64, VECTOR, Lanes, Memory, Three, least, most, within

WIDE = EIGHT  # boxes in a node of the hierarchy
CHILD_COLUMN = 6 * WIDE  # the word of a node at which its children are named
LEAVE_LATER = 1.0 + 2.0**-21  # see `node.geometry.bvh`
FAREST = 1e18  # stands for infinite times, so that a binary32 holds them


@formula(takes=(VECTOR, VECTOR), gives=((F32,) * 6, (I64, I64, I64)))
def for_boxes(o: Three, inv: Three) -> tuple[list[Lanes], list[Lanes]]:
    """(origin and inverse direction in binary32, finite; the words of a node at which each axis' near planes begin)."""
    ray = [at.to(F32) for at in o] + [within(one, -FAREST, FAREST).to(F32) for one in inv]
    return ray, [(one >= 0.0).choose(axis * WIDE, (3 + axis) * WIDE) for axis, one in enumerate(inv)]


def times(near: Three, far: Three, origin: Three, inv: Three, low: Lanes, high: Lanes) -> tuple[Lanes, Lanes]:
    """(when a ray enters, when it leaves) a box, at least low and at most high; near, far  its planes."""
    for axis in range(3):
        low = most(low, (near[axis] - origin[axis]) * inv[axis])
        high = least(high, (far[axis] - origin[axis]) * inv[axis])
    return low, high


def meets(enter: Lanes, leave: Lanes) -> Lanes:
    """Tell whether a box is met. It is left after 0, so a larger factor is a later time."""
    return enter <= leave * LEAVE_LATER


@eight(takes=(ARRAY, I64, (I64, I64, I64), (F32,) * 6, F32, F32, ARRAY, I64), gives=I64, carries=True)
def push_boxes(
    floats: Memory, at: Lanes, near: Three, ray: Sequence[Lanes], low: Lanes, high: Lanes, keys: Memory, top: Lanes
) -> Lanes:
    """Put a key on the stack `keys` for each box of a node that the ray meets; returns where the stack ends then.

    floats     float32 array, the nodes; at  int64, first word of the node
    near       three int64, word of the row of near planes of each axis (of the far ones if the ray runs backwards)
    ray        six float32, origin and inverse direction; low, high  float32, 0 < low
    keys, top  int64 array, and the first free place in it; the WIDE places from there are overwritten

    A key is time << 32 | child: the time is a positive binary32, so keys are in the order of their times.
    """
    planes = [floats.read(at + near[axis]) for axis in range(3)]
    far = [floats.read(at + ((2 * axis + 3) * WIDE - near[axis])) for axis in range(3)]  # the other rows
    enter, leave = times(planes, far, ray[:3], ray[3:], low, high)
    child = floats.read(at + CHILD_COLUMN).bits().to(I64) & 0xFFFFFFFF
    return top + keys.append(top, enter.bits().to(I64) << 32 | child, meets(enter, leave))


@eight(takes=(ARRAY, I64, ARRAY, I64))
def copy_keys(source: Memory, at: Lanes, target: Memory, to: Lanes) -> None:
    """Copy WIDE keys between two int64 arrays, at once."""
    target.write(to, source.read(at))
