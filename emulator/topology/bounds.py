"""States what the machine can need at most: packets in flight, and memory of a node (law 6). Held by tests.

Trees. A primary ray, with all that descends from it, is a tree; the tree is alive while any packet of it is. The
driver lets homes emit primaries so that never more trees are alive than the budget, or than there are homes if these
are more (`driver.admission.next_quota` says why).

Packets of a tree. A ray of depth d that hits something dies and emits at most one shadow ray a light, and at most
`branches` rays of depth d + 1 if d is below the frame's depth. A shadow ray, or a ray that leaves the scene, dies
and emits at most one return. So with L lights, depth D and b branches the most packets of a tree alive at once are

    A(D) = max(1, L)        A(d) = max(1, L + b A(d + 1))        A(1) = L (1 + b + ... + b^(D-1)) if L > 0

and likewise the most rays max(1, b^(D-1)), and the most shadow rays the sum above. Nothing in the order of work can
be counted on to keep it lower: what one node emits another one may be slow to serve. So

    packets in flight <= max(budget, homes) x A(1)

and no more than there are samples, times A(1). A test reaches these bounds with a node that is slow on purpose;
in ordinary pictures a few percent of them are used, because the deepest rays are served first.

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

from typing import NamedTuple

import numpy as np

from raygrid.node.geometry import (
    CONE_COLUMNS,
    NODE_WORDS,
    OUTPUTS,
    OWN_COLUMNS,
    PLANE_COLUMNS,
    POLY_COLUMNS,
    STORED_AS,
    STRIDE,
    SURFACE_KINDS,
    AddedKind,
    AnyKind,
    Kind,
)
from raygrid.node.links import MESSAGE_OVERHEAD
from raygrid.node.protocol import HEAD, SIZE, SPECULAR, TRANSMISSION, Frame
from raygrid.node.runtime import OUTPUT_ROOM
from raygrid.node.tracing import ADMIT_AT_ONCE, BYTES_A_PACKET, FIRST_QUEUE_ROOM, PORTION

WORD = 8  # bytes of a float64 or int64
NAMED = 4 + 2  # bytes of a surface's id and material
PIXEL_BYTES = 4 * WORD  # of a pixel in a home's store: three sums and the samples
ENTRIES = 8  # most edges that the strips of a polygon list for each of its points


class Growth(NamedTuple):
    """The most packets of one tree that can be alive at once: rays, shadow rays, and any packets."""

    rays: int
    shadows: int
    packets: int


def branches_of(frame: Frame) -> int:
    """Rays that one hit can emit: 0, 1 or 2."""
    reflects = (frame.materials[:, SPECULAR : SPECULAR + 3] > 0.0).any(axis=1)
    transmits = (frame.materials[:, TRANSMISSION : TRANSMISSION + 3] > 0.0).any(axis=1)
    return int(np.max(reflects.astype(np.int64) + transmits, initial=0))


def growth(depth: int, lights: int, branches: int) -> Growth:
    """How a tree can grow."""
    rays, shadows, packets = 1, lights, max(1, lights)
    for _ in range(depth - 1):
        rays, shadows = max(1, branches * rays), lights + branches * shadows
        packets = max(1, lights + branches * packets)
    return Growth(rays, shadows, packets)


def growth_of(frame: Frame) -> Growth:
    """How a tree of this frame can grow."""
    return growth(frame.depth, frame.n_lights, branches_of(frame))


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
