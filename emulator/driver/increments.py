"""Tells an array, from one frame to the next, what has moved of the surfaces that it holds already.

What goes in is the motion of each group that has moved, from rest to the new frame; where the surfaces go from there is
the nodes' own affair (`node.runtime.increments`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError, SceneError
from raygrid.node.geometry import Batch, Moves, Space, SurfaceSet, fault_of, move_order, placed
from raygrid.node.runtime import check_inside


class HeldSurfaces(NamedTuple):
    """What the nodes of an array hold together.

    surfaces  as they were dealt, those that move at rest
    moves     where those are; None: nothing moves
    dealt     how many descriptions the host has sent since the world was new
    key       by which whoever loaded knows it again: the same key, the same content; "" for none
    """

    space: Space
    surfaces: SurfaceSet
    moves: Moves | None
    dealt: int
    key: str = ""


def is_held(held: HeldSurfaces | None, space: Space, surfaces: SurfaceSet, moves: Moves | None) -> bool:
    """Whether an array that holds `held` needs increments only."""
    if held is None or moves is None or held.moves is None:
        return False
    if held.surfaces is not surfaces or held.moves.groups is not moves.groups:
        return False
    return held.space.step == space.step and np.array_equal(held.space.planes, space.planes)


def check_moves(space: Space, surfaces: SurfaceSet, moves: Moves, changed: NDArray[np.bool_] | None = None) -> None:
    """Raise SceneError for motions that cannot be, and for a surface of a (changed) group that leaves the world box."""
    changed = np.ones(len(moves.motions), np.bool_) if changed is None else changed
    if moves.motions.shape[0] != moves.groups.many:
        raise SceneError(f"{len(moves.motions)} motions came, wanted {moves.groups.many}, one for each group")
    fault = fault_of(moves.motions)
    if fault:
        raise SceneError(f"of the groups' motions {fault}")
    for batch in surfaces:
        now = placed(batch.select(moves.groups.among(batch.ids, changed)), moves)
        _check_inside(space, now)


def _check_inside(space: Space, batch: Batch) -> None:
    try:
        check_inside(space, batch, batch.bounds())
    except ProtocolError as error:
        raise SceneError(str(error)) from None


def increment(held: HeldSurfaces, moves: Moves) -> dict[str, Any] | None:
    """The order that brings the nodes from what they hold to `moves`; None if nothing moves. Raises SceneError."""
    assert held.moves is not None
    if moves.motions.shape != held.moves.motions.shape:
        raise SceneError(f"{len(moves.motions)} motions came, wanted {len(held.moves.motions)}, one for each group")
    changed = (moves.motions != held.moves.motions).any(axis=1)
    if not changed.any():
        return None
    check_moves(held.space, held.surfaces, moves, changed)
    return move_order(np.flatnonzero(changed), moves.motions[changed])
