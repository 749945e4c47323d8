"""Numbers the counters of a ray step: packets that were spawned, died and were sent, and what their walks cost.

They are places in an array of int64, summed over the nodes by waves and priced by cost models.
"""

from __future__ import annotations

from raygrid.node.geometry.grid_walk import OUTPUTS
from raygrid.node.geometry.surfaces import SURFACE_KINDS
from raygrid.node.protocol.packets import KINDS

BORN = 0  # spawned, by packet kind
DIED = BORN + KINDS
SENT = DIED + KINDS  # packets put on each output
TESTS = SENT + OUTPUTS  # ray against surface, by kind of surface
WALKS = TESTS + len(SURFACE_KINDS)  # rays walked through this cell
BOXES = WALKS + 1  # nodes of the hierarchy opened
HITS = BOXES + 1
HOMES = HITS + 1  # homes worked out for return packets
MISADDRESSED = HOMES + 1  # returns for a pixel that this node does not hold
COUNTS = MISADDRESSED + 1
