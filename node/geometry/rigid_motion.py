"""Moves groups of surfaces: works out where a motion puts them.

Nodes keep the descriptions of moving surfaces as they are at rest. Where a surface is in a frame is always worked out
from there and the frame's whole motion, by the one function `placed`: nothing drifts, and a node that was told only
what has changed has the same bits as one that was loaded afresh.

A motion is a row of MOTION numbers (float64): a unit quaternion w, x, y, z, a scale above 0, and a shift. It takes the
point p at rest to scale * rotated(p) + shift. `placed` multiplies and adds element by element, each rounded once by
IEEE 754, and sums in a fixed order. (A product of matrices by BLAS may round in another way for another number of rows.)

    groups   before any surface: ranges of ids, (first id, number of ids, group) u32, and the motions of all groups
    move     of a later frame: the groups that move, u32, and their motions
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.quaternion import quaternion_products, rotation_matrices
from raygrid.node.geometry.surfaces import F64, STORED_AS, AddedKind, AnyKind, Batch, Kind

Ints = NDArray[np.int64]
ROTATION, MOTION_SCALE, MOTION_SHIFT, MOTION = 0, 4, 5, 8
MAX_GROUPS = 1 << 16
MAX_RANGES = 1 << 20
FARTHEST = 1e6  # scale and shift of a motion in machine coordinates, which are below 2; as `messages.read_surfaces`
UNIT_ERROR = 1e-9  # how far the length of a quaternion may be from 1
NO_MOTION = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class Groups(NamedTuple):
    """Surfaces that move together: ranges of ids, ascending and apart. Other surfaces stay where they are.

    firsts, ends  int64 (r,), ids first <= id < end
    numbers       int64 (r,), the group
    many          how many groups there are
    """

    firsts: Ints
    ends: Ints
    numbers: Ints
    many: int

    def of(self, ids: NDArray[Any]) -> Ints:
        """The group of each id, int64 (n,), -1 for none."""
        if len(self.firsts) == 0:
            return np.full(len(ids), -1, np.int64)
        row = np.maximum(np.searchsorted(self.firsts, ids, side="right") - 1, 0)
        return np.where((self.firsts[row] <= ids) & (ids < self.ends[row]), self.numbers[row], -1)

    def among(self, ids: NDArray[Any], chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Mark the ids of the chosen groups, a mask of `many`: bool (n,)."""
        number = self.of(ids)
        found: NDArray[np.bool_] = (number >= 0) & np.append(chosen, False)[number]
        return found


class Moves(NamedTuple):
    """The groups of an animation and their places in one frame: motions, float64 (groups.many, MOTION)."""

    groups: Groups
    motions: F64


def make_groups(ids: NDArray[Any], numbers: NDArray[Any], count: int) -> Groups:
    """Groups of ids (n,), each given with the number of its group. Raises ValueError for an id that comes twice."""
    order = np.argsort(ids, kind="stable")
    ids, numbers = np.asarray(ids, np.int64)[order], np.asarray(numbers, np.int64)[order]
    if np.any(np.diff(ids) == 0):
        raise ValueError("an id came in two groups")
    breaks = np.flatnonzero((np.diff(ids) != 1) | (np.diff(numbers) != 0)) + 1
    begins = np.concatenate(([0], breaks)).astype(np.intp)[: len(ids)]
    last = np.append(breaks, len(ids))[: len(begins)] - 1
    return Groups(ids[begins], ids[last] + 1, numbers[begins], count)


def at_rest(count: int) -> F64:
    """Motions of groups that are where they were described."""
    return np.tile(np.array(NO_MOTION), (count, 1))


def fault_of(motions: F64) -> str:
    """Say what is wrong with motions, "" if nothing is."""
    for row, motion in enumerate(motions):
        if not np.isfinite(motion).all():
            return f"motion {row} is {motion.tolist()}, wanted finite numbers"
        if not abs(float(np.sum(motion[:4] ** 2)) - 1.0) <= 2.0 * UNIT_ERROR:
            return f"motion {row} has the quaternion {motion[:4].tolist()}, wanted one of length 1"
        if not (0.0 < motion[MOTION_SCALE] < FARTHEST and (np.abs(motion[MOTION_SHIFT:]) < FARTHEST).all()):
            return (
                f"motion {row} has scale {motion[MOTION_SCALE]:g} and shift {motion[MOTION_SHIFT:].tolist()}, "
                f"wanted a scale above 0, and both below {FARTHEST:g}"
            )
    return ""


def _rotated(matrices: F64, vectors: F64) -> F64:
    """Vectors (n, 3) multiplied by their matrices (n, 3, 3)."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.stack([matrices[:, k, 0] * x + matrices[:, k, 1] * y + matrices[:, k, 2] * z for k in range(3)], axis=1)


def moved_rows(kind: AnyKind, data: F64, motions: F64) -> F64:
    """Rows of a batch's data, float64, after a motion each (n, MOTION); of polygons, rows of points."""
    matrices, scale, shift = (
        rotation_matrices(motions[:, :4]),
        motions[:, MOTION_SCALE : MOTION_SCALE + 1],
        motions[:, MOTION_SHIFT:],
    )
    result = data.copy()
    if kind == AddedKind.PROGRAMMED:
        result[:, :4] = quaternion_products(motions[:, :4], data[:, :4])
        result[:, MOTION_SCALE] = data[:, MOTION_SCALE] * motions[:, MOTION_SCALE]
        result[:, MOTION_SHIFT:MOTION] = _rotated(matrices, data[:, MOTION_SHIFT:MOTION]) * scale + shift
        return result
    points: tuple[int, ...] = (0,)
    normals: tuple[int, ...] = ()
    if kind in (Kind.TRIANGLE, Kind.SMOOTH):
        points, normals = (0, 3, 6), tuple(range(9, data.shape[1], 3))
    elif kind in (Kind.CYLINDER, Kind.CONE):
        points = (0, 4)
    for at in points:
        result[:, at : at + 3] = _rotated(matrices, data[:, at : at + 3]) * scale + shift
    for at in normals:
        result[:, at : at + 3] = _rotated(matrices, data[:, at : at + 3])
    if kind in (Kind.SPHERE, Kind.CYLINDER, Kind.CONE):
        result[:, 3::4] = data[:, 3::4] * scale
    return result


def placed(batch: Batch, moves: Moves | None) -> Batch:
    """The descriptions where a frame has them, in the precision that nodes store; the batch itself if none moves."""
    if moves is None:
        return batch
    number = moves.groups.of(batch.ids)
    if batch.kind == Kind.POLYGON:
        number = np.repeat(number, np.diff(batch.starts))
    rows = np.flatnonzero(number >= 0)
    if len(rows) == 0:
        return batch
    data = batch.data.astype(STORED_AS[batch.kind])  # a copy
    rest = batch.data[rows].astype(np.float64)
    data[rows] = moved_rows(batch.kind, rest, moves.motions[number[rows]])
    return Batch(batch.kind, batch.ids, batch.materials, data, batch.starts)


def anchors(batch: Batch) -> F64:
    """A point of each surface, float64 (n, 3), that lies in its box and, but for rounding, on it or its axis.

    So the cell that holds the point retains the surface: one holder that every node can name.
    """
    if batch.kind == Kind.POLYGON:
        return batch.data[batch.starts[:-1]].astype(np.float64)
    if batch.kind == AddedKind.PROGRAMMED:
        return batch.data[:, MOTION_SHIFT:MOTION].astype(
            np.float64
        )  # the cell of its box's middle retains it by its box
    points = batch.data[:, :3].astype(np.float64)
    if batch.kind == Kind.SPHERE:
        points[:, 0] += np.abs(batch.data[:, 3])
    return points


# --- orders ----------------------------------------------------------------------------------------------


def groups_order(moves: Moves) -> dict[str, Any]:
    """The order that tells nodes which surfaces move, and where they are."""
    groups = moves.groups
    ranges = np.stack((groups.firsts, groups.ends - groups.firsts, groups.numbers), axis=1)
    return {"do": "groups", "ranges": ranges.astype("<u4").tobytes(), "motions": moves.motions.astype("<f8").tobytes()}


def read_groups(order: Mapping[str, object]) -> Moves:
    """The groups of an order. Raises ProtocolError."""
    ranges, motions = _table(order, "ranges", "<u4", 3).astype(np.int64), _table(order, "motions", "<f8", MOTION)
    if len(motions) > MAX_GROUPS or len(ranges) > MAX_RANGES:
        raise ProtocolError(f"{len(motions)} groups of {len(ranges)} ranges came, wanted {MAX_GROUPS} and {MAX_RANGES}")
    firsts, ends, numbers = ranges[:, 0], ranges[:, 0] + ranges[:, 1], ranges[:, 2]
    if (ranges[:, 1] < 1).any() or (ends[:-1] > firsts[1:]).any() or (numbers >= len(motions)).any():
        raise ProtocolError(f"ranges of groups came as {ranges[:8].tolist()}, wanted them ascending, apart and known")
    _check(motions)
    return Moves(Groups(firsts, ends, numbers, len(motions)), motions)


def move_order(groups: NDArray[Any], motions: F64) -> dict[str, Any]:
    """The order that tells nodes the motions of some groups."""
    return {"do": "move", "groups": groups.astype("<u4").tobytes(), "motions": motions.astype("<f8").tobytes()}


def read_move(order: Mapping[str, object], moves: Moves) -> Moves:
    """The moves after an order. Raises ProtocolError."""
    numbers, motions = _table(order, "groups", "<u4", 1)[:, 0].astype(np.int64), _table(order, "motions", "<f8", MOTION)
    once = len(set(numbers.tolist())) == len(numbers)  # np.unique imports numpy.ma, 25 ms of every start
    if len(numbers) != len(motions) or (numbers >= moves.groups.many).any() or not once:
        raise ProtocolError(
            f"{len(motions)} motions came for the groups {numbers[:8].tolist()}, wanted one each for some of the "
            f"{moves.groups.many} groups"
        )
    _check(motions)
    every = moves.motions.copy()
    every[numbers] = motions
    return moves._replace(motions=every)


def _table(order: Mapping[str, object], name: str, dtype: str, columns: int) -> NDArray[Any]:
    data = order.get(name)
    if not isinstance(data, bytes) or len(data) % (np.dtype(dtype).itemsize * columns):
        raise ProtocolError(f"the order {order.get('do')!r} came with {name} that are not rows of {columns} numbers")
    return np.frombuffer(data, dtype).reshape(-1, columns)


def _check(motions: F64) -> None:
    fault = fault_of(motions)
    if fault:
        raise ProtocolError(f"motions came, of which {fault}")
