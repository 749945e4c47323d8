"""Deals the surfaces of a scene over the corners of an array."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from raygrid.emulator.topology.coordinates import Index
from raygrid.emulator.topology.topology import nearest_corners
from raygrid.node.geometry import Batch, Moves, SurfaceSet, corners, placed
from raygrid.node.runtime import pieces

CHUNK_BYTES = 1 << 16  # surfaces in a message
LOOKED_AT = 1 << 16  # surfaces that are dealt before somebody who gives the frame up is heard


def deal_surfaces(
    surfaces: SurfaceSet, shape: Index, moves: Moves | None, look_up: Callable[[], None] = lambda: None
) -> Iterator[tuple[int, Batch]]:
    """Each surface to the corner nearest to its middle, in messages of about CHUNK_BYTES, corners in turn.

    look_up  called for every message: a million surfaces take a second
    """
    queues: dict[int, deque[Batch]] = {corner: deque() for corner in corners(shape)}
    for batch in surfaces:
        parts = [np.zeros(0, np.int64)]
        for start in range(0, len(batch), LOOKED_AT):
            look_up()
            part = batch.select(np.arange(start, min(start + LOOKED_AT, len(batch))))
            parts.append(nearest_corners(placed(part, moves).bounds().mean(axis=1), shape))
        corner_of = np.concatenate(parts)
        for corner, queue in queues.items():
            for piece in pieces(batch.select(np.flatnonzero(corner_of == corner)), CHUNK_BYTES):
                look_up()
                queue.append(piece)
    while any(queues.values()):
        for corner, queue in queues.items():
            if queue:
                look_up()
                yield corner, queue.popleft()
