"""Finds the branches of the flood's spanning tree: the neighbours to which a node hands surface descriptions on.

A description enters at one corner and runs along the dimension-ordered tree of that corner: along x in the
corner's row, from there along y, from there along z, always away from the corner. So each cell is reached on
one path only and no node gets a description twice. A branch is taken only if the surface comes near the box
of the cells behind it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.geometry.lattice import HALF, Cell, Space
from raygrid.node.jit.decorators import part


class Branch(NamedTuple):
    """A port of the tree of one corner, and the box of all cells behind it."""

    port: int
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def corner_index(corner: int, shape: tuple[int, int, int]) -> tuple[int, int, int]:
    """Cell of corner 0..7: bit a of the number set means the far end of axis a."""
    return tuple((shape[axis] - 1) * (corner >> axis & 1) for axis in range(3))  # type: ignore[return-value]


def corners(shape: tuple[int, int, int]) -> dict[int, tuple[int, int, int]]:
    """The corners that exist, number -> cell; axes of one cell have one end only."""
    return {
        corner: corner_index(corner, shape)
        for corner in range(8)
        if all(shape[axis] > 1 or not corner >> axis & 1 for axis in range(3))
    }


def towards_corner(index: tuple[int, int, int], shape: tuple[int, int, int]) -> int:
    """The output on the way to the nearest corner, the lower one on a tie; HOST at the corner."""
    for axis in range(3):
        near_low = 2 * index[axis] <= shape[axis] - 1
        if near_low and index[axis] > 0:
            return 2 * axis
        if not near_low and index[axis] < shape[axis] - 1:
            return 2 * axis + 1
    return HOST


towards_corner_part = part(towards_corner)


def branches(corner: int, space: Space, cell: Cell) -> list[Branch]:
    """Branches by which descriptions that entered at this corner go on from this cell."""
    origin = corner_index(corner, space.shape)
    found = []
    for axis in (2, 1, 0):
        away = -1 if corner >> axis & 1 else 1
        onward = cell.index[axis] + away
        if 0 <= onward < space.shape[axis]:
            found.append(port_box(2 * axis + (away > 0), space, cell))
        if cell.index[axis] != origin[axis]:
            break  # the description runs along this axis by now; lower axes were done before
    return found


def port_box(port: int, space: Space, cell: Cell) -> Branch:
    """Cells on from this one behind a port of axis a, at the same place on axes below a, anywhere on those above."""
    axis, away = port >> 1, 1 if port & 1 else -1
    low, high = np.empty(3), np.empty(3)
    for other in range(3):
        first, last = cell.index[other], cell.index[other]
        if other > axis:
            first, last = 0, space.shape[other] - 1
        elif other == axis:
            first, last = (first + 1, space.shape[axis] - 1) if away > 0 else (0, last - 1)
        low[other] = (space.planes[other, first] - HALF) * space.step[other]
        high[other] = (space.planes[other, last + 1] - HALF) * space.step[other]
    return Branch(port, low, high)


def tree_parent(index: tuple[int, int, int]) -> int | None:
    """Port towards the root (0, 0, 0) of the tree of waves; None at the root."""
    for axis in (2, 1, 0):
        if index[axis] > 0:
            return 2 * axis
    return None


def tree_children(index: tuple[int, int, int], shape: tuple[int, int, int]) -> list[int]:
    """Ports away from the root of the tree of waves, the tree of corner 0."""
    found = []
    for axis in (2, 1, 0):
        if index[axis] + 1 < shape[axis]:
            found.append(2 * axis + 1)
        if index[axis] != 0:
            break
    return found
