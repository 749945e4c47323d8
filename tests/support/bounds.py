"""States what the machine can need at most, beside the packets of a tree (`emulator.topology.bounds`): packets, and memory.

Pixels. When a pass is collected, every pixel is at once in flight at worst: one packet a pixel and home that has
samples of it.

Flood. Credit for a message of surfaces goes back when the node has handed its surfaces on, and a node takes none while
more than CLOGGED messages wait on a link. So at most WINDOW of them wait to be read for each link, and at most
CLOGGED + 1 on each link on which they go out.

Memory of a node. All packets may be in one node. There each is in a stack of the work queues, in an output, or in a
message that waits in a link; stacks grow by doubling and keep their size until the next frame. Beside that a node
has its surfaces, with the tables made from them, and its pixel store. Not counted are the interpreter, the
compiled kernels, and what ZeroMQ holds: WINDOW messages a direction of each link at most.
"""

from __future__ import annotations

import numpy as np

from raygrid.emulator.topology.bounds import growth_of
from raygrid.node.geometry.bvh import NODE_WORDS
from raygrid.node.geometry.grid_walk import OUTPUTS
from raygrid.node.geometry.intersect import CONE_COLUMNS, PLANE_COLUMNS, POLY_COLUMNS
from raygrid.node.geometry.surface_tables import OWN_COLUMNS
from raygrid.node.geometry.surfaces import STORED_AS, STRIDE, SURFACE_KINDS, AddedKind, AnyKind, Kind
from raygrid.node.links.link import MESSAGE_OVERHEAD
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import SIZE
from raygrid.node.runtime.node_state import OUTPUT_ROOM
from raygrid.node.tracing.batch import ADMIT_AT_ONCE, PORTION
from raygrid.node.tracing.work_queues import BYTES_A_PACKET, FIRST_QUEUE_ROOM

WORD = 8  # bytes of a float64 or int64
NAMED = 4 + 2  # bytes of a surface's id and material
PIXEL_BYTES = 4 * WORD  # of a pixel in a home's store: three sums and the samples
ENTRIES = 8  # most edges that the strips of a polygon list for each of its points


def trees_bound(frame: Frame, budget: int, homes: int) -> int:
    """Primary rays that can be alive, or have living descendants, at once."""
    return min(max(budget, homes), frame.width * frame.height * frame.samples)


def packets_bound(frame: Frame, budget: int, homes: int) -> int:
    """Packets that can be in flight at once while a pass is traced."""
    return trees_bound(frame, budget, homes) * growth_of(frame).packets


def pixel_packets_bound(frame: Frame, homes: int) -> int:
    """Pixel packets that can be in flight at once while a pass is collected."""
    return frame.width * frame.height * min(homes, frame.samples)


def surfaces_bound(counts: dict[str, int], polygon_points: int) -> int:
    """Bytes of the surfaces that a node retains, by kind (names of `Kind` in small letters), and of their tables.

    polygon_points   vertices of all these polygons together
    """
    tables: dict[AnyKind, int] = {
        Kind.TRIANGLE: STRIDE[Kind.TRIANGLE] * 4,
        Kind.SMOOTH: STRIDE[Kind.SMOOTH] * 4,
        Kind.POLYGON: (PLANE_COLUMNS + POLY_COLUMNS + 1) * WORD,
        Kind.SPHERE: STRIDE[Kind.SPHERE] * WORD,
        Kind.CYLINDER: CONE_COLUMNS * WORD,
        Kind.CONE: CONE_COLUMNS * WORD,
        AddedKind.PROGRAMMED: OWN_COLUMNS * WORD,
    }
    inner = NODE_WORDS * 4  # each node of the hierarchy has two children or more, unless it is the only one
    total = 3 * WORD  # ends of tables
    for kind in SURFACE_KINDS:
        described = NAMED + (0 if kind == Kind.POLYGON else STRIDE[kind] * np.dtype(STORED_AS[kind]).itemsize)
        listed = 4 + NAMED
        total += counts.get(kind.name.lower(), 0) * (described + listed + inner + tables[kind])
    a_point = 3 * WORD + ENTRIES * 4 * WORD + WORD  # the point, edges in strips, a strip
    return total + polygon_points * a_point


def memory_bound(frame: Frame, budget: int, homes: int, batch: int, surfaces: int) -> dict[str, int]:
    """Bytes that one node can need at most, by use, as in its record (`Processor.record`).

    batch      most packets a message
    surfaces   bytes of its surfaces, as of `surfaces_bound`
    """
    grown, trees = growth_of(frame), trees_bound(frame, budget, homes)
    pixel_packets = pixel_packets_bound(frame, homes)
    # room is made before it is known what comes
    more = max(batch, ADMIT_AT_ONCE, PORTION * max(frame.n_lights, 2))
    stacks = (max(trees * grown.packets, pixel_packets), trees * grown.shadows, trees * grown.rays)
    room = max(OUTPUT_ROOM, 2 * (frame.n_lights + 2))
    return {
        "surfaces": surfaces,
        "pixels": frame.width * frame.height * PIXEL_BYTES,
        "backlog": sum(max(FIRST_QUEUE_ROOM, 2 * (held + more)) for held in stacks) * BYTES_A_PACKET,
        "outputs": OUTPUTS * (HEAD + room * SIZE),
        "links": max(trees * grown.packets, pixel_packets) * (SIZE + MESSAGE_OVERHEAD),
    }
