"""Applies increments: from one frame to the next a node moves what it holds, drops what has left, and hands on what arrives.

The order `move` tells every node which groups of surfaces have moved. Every node that holds such a surface knows where
it was and where it is, and so which cells held it and which must hold it now. Then, at the order `hand` (only when all
have moved, or a description could come to a node that does not know its motion yet), descriptions travel:

    owner    the cell of the surface's anchor (`motions.anchors`) before the motion: a holder that all can name
    tree     the dimension-ordered tree of the owner: along x in its row, from there along y, from there along z, both
             ways. The corner trees of `node.geometry.spanning_tree` are such trees, too; each cell is reached by one path
    rule     a node that has the description, as a holder or because it came just now, hands it to its child in the tree
             if the child did not hold it, and the surface now comes near the box of the cells behind that port

A cell newly reached gets it: take the last cell on the tree's path to it that held the surface; from there on nobody
did, so each hands it to the next, as the cell lies behind each of the ports. No node is sent what it holds, as a holder
is never handed anything, nor anything twice, as it has one parent in the tree. How far a surface has moved does not
matter. Trees in dimension order have no cycle of links that wait for each other's credit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.lattice import HALF, LATTICE, Cell, Space, make_cell
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.rigid_motion import Moves, anchors, placed, read_groups, read_move
from raygrid.node.geometry.spanning_tree import Branch, port_box
from raygrid.node.geometry.surfaces import F64, Batch, Kind

Index = tuple[int, int, int]
MOVED = 8  # in the place of the corner (0 to 7) in a message of surfaces: handed on after a motion
MESSAGE_BYTES = 1 << 16  # of descriptions in a message


class Path(NamedTuple):
    """Descriptions at rest that go to the neighbour at a port."""

    port: int
    batch: Batch


class IncrementStep(NamedTuple):
    """Surfaces at rest, where they were, where they are, and the boxes of the latter."""

    rest: Batch
    before: Batch
    now: Batch
    boxes: F64

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> IncrementStep:
        """The chosen rows."""
        return IncrementStep(self.rest.select(rows), self.before.select(rows), self.now.select(rows), self.boxes[rows])


class Increments:
    """What one node knows of moving surfaces. Without groups it does nothing.

    moves    the groups and where they are now, None if nothing moves in this world
    pending  descriptions to be handed on, port and descriptions at rest, a message each
    """

    def __init__(self) -> None:
        self.pending: deque[Path] = deque()
        self.forget()

    def forget(self) -> None:
        """A new world."""
        self.pending.clear()
        self.moves: Moves | None = None
        self._before: Moves | None = None
        self._waiting: list[Path] = []
        self._branches: dict[Index, list[tuple[Branch, Cell]]] = {}

    def give_up(self) -> None:
        """Drop what was to be handed on."""
        self.pending.clear()
        self._waiting = []

    def set_groups(self, order: Mapping[str, object]) -> None:
        """Take the groups of a new world. Raises ProtocolError."""
        self.moves = read_groups(order)

    def place(self, batch: Batch) -> Batch:
        """Descriptions at rest where they are now; the batch itself if none moves."""
        return placed(batch, self.moves)

    def move(
        self, order: Mapping[str, object], space: Space, cell: Cell, retained: list[Batch]
    ) -> tuple[list[Batch], bool]:
        """(what the node still holds of `retained`, at rest; whether any surface in it has moved or left).

        What others need of it waits for `hand`. Raises ProtocolError, with nothing changed, for an order that is
        wrong, and for one by which a surface leaves the world box.
        """
        if self.moves is None:
            raise ProtocolError("the order 'move' came before groups")
        moves = read_move(order, self.moves)
        changed = (moves.motions != self.moves.motions).any(axis=1)
        low, high = np.array(cell.low_at), np.array(cell.high_at)
        waiting: list[Path] = []
        kept, touched = [], False
        for batch in retained:
            moving = moves.groups.among(batch.ids, changed)
            if not moving.any():
                kept.append(batch)
                continue
            rest, touched = batch.select(moving), True
            now = placed(rest, moves)
            step = IncrementStep(rest, placed(rest, self.moves), now, now.bounds())
            check_inside(space, step.now, step.boxes)
            stays = np.ones(len(batch), np.bool_)
            stays[moving] = meets(step.now, low, high, step.boxes)
            kept.append(batch if stays.all() else batch.select(stays))
            waiting += self._ways(step, space, cell)
        self._before, self.moves, self._waiting = self.moves, moves, waiting
        return [batch for batch in kept if len(batch)], touched

    def hand(self) -> int:
        """Begin to hand on; returns how many descriptions that will be."""
        waiting, self._waiting = self._waiting, []
        for way in waiting:
            self.pending.extend(Path(way.port, piece) for piece in pieces(way.batch))
        return sum(len(way.batch) for way in waiting)

    def relay(self, rest: Batch, now: Batch, boxes: F64, space: Space, cell: Cell) -> list[Path]:
        """To whom descriptions go on that came from a neighbour after a motion. Raises ProtocolError."""
        if self._before is None:
            raise ProtocolError("surfaces came as moved, and none has moved yet")
        return self._ways(IncrementStep(rest, placed(rest, self._before), now, boxes), space, cell)

    def _ways(self, step: IncrementStep, space: Space, cell: Cell) -> list[Path]:
        owners = cells_of(anchors(step.before), space)
        # what neither came from nor reaches beyond this cell concerns nobody else; mostly that is all
        inner = (step.boxes[:, 0] > np.array(cell.low_at) + WORLD_EDGE) & (
            step.boxes[:, 1] < np.array(cell.high_at) - WORLD_EDGE
        )
        rows = np.flatnonzero(~inner.all(axis=1))
        found: list[Path] = []
        # by a set, since np.unique imports numpy.ma, 25 ms in each node
        for owner in sorted(set(zip(*owners[rows].T.tolist(), strict=True))):
            mine = step.select(rows[(owners[rows] == owner).all(axis=1)])
            for branch, child in self._tree(owner, space, cell):
                reached = np.flatnonzero(meets(mine.now, branch.low, branch.high, mine.boxes))
                held = meets(mine.before.select(reached), np.array(child.low_at), np.array(child.high_at))
                if not held.all():
                    found.append(Path(branch.port, mine.rest.select(reached[~held])))
        return found

    def _tree(self, owner: Index, space: Space, cell: Cell) -> list[tuple[Branch, Cell]]:
        """The ports of this cell in the tree of an owner, and the neighbours there."""
        if owner not in self._branches:
            found = []
            for port in tree_ports(owner, space.shape, cell.index):
                there = list(cell.index)
                there[port >> 1] += 1 if port & 1 else -1
                found.append((port_box(port, space, cell), make_cell(space, (there[0], there[1], there[2]))))
            self._branches[owner] = found
        return self._branches[owner]


WORLD_EDGE = 2.0**-16  # twice lattice.SLACK: so far inside a cell, a surface comes near no other


def tree_ports(owner: Index, shape: Index, index: Index) -> list[int]:
    """The ports by which the dimension-ordered tree of one cell goes on from another."""
    found = []
    for axis in (2, 1, 0):
        if index[axis] >= owner[axis] and index[axis] + 1 < shape[axis]:
            found.append(2 * axis + 1)
        if index[axis] <= owner[axis] and index[axis] > 0:
            found.append(2 * axis)
        if index[axis] != owner[axis]:
            break  # the path has turned into this axis; lower ones were done before
    return found


def cells_of(points: F64, space: Space) -> NDArray[np.int64]:
    """The cells that hold points (n, 3) of the world box, int64 (n, 3)."""
    at = np.clip(np.floor(points / np.array(space.step) + 0.5) + HALF, 0, LATTICE - 1)
    lines = [space.planes[axis, 1 : space.shape[axis]] for axis in range(3)]
    return np.stack([np.searchsorted(line, at[:, axis], side="right") for axis, line in enumerate(lines)], axis=1)


def check_inside(space: Space, batch: Batch, boxes: F64) -> None:
    """Raise ProtocolError, naming the first, if surfaces leave the world box."""
    half = HALF * np.array(space.step)
    out = ~((boxes[:, 0] >= -half) & (boxes[:, 1] <= half)).all(axis=1)
    if out.any():
        row = int(np.argmax(out))
        raise ProtocolError(
            f"surface {int(batch.ids[row])} leaves the world box: its box is {boxes[row].round(6).tolist()}, "
            f"wanted it within {(-half).round(6).tolist()} and {half.round(6).tolist()} (machine coordinates)"
        )


def pieces(batch: Batch, most: int = MESSAGE_BYTES) -> Iterator[Batch]:
    """Cut a batch into messages of about `most` bytes."""
    if batch.kind == Kind.POLYGON:
        sizes = 10 + 24 * np.diff(batch.starts)
    else:
        sizes = np.full(len(batch), 6 + batch.data.shape[1] * batch.data.dtype.itemsize)
    message = np.cumsum(sizes) // most
    borders = (np.flatnonzero(np.diff(message)) + 1).tolist()
    for first, last in zip([0, *borders], [*borders, len(batch)], strict=True):
        if last > first:
            yield batch.select(np.arange(first, last))
