"""Makes the record of a node: what it says of itself when it is asked for."""

from __future__ import annotations

import os
import time
from typing import Any

from raygrid.node.geometry.grid_walk import PORTS
from raygrid.node.geometry.surfaces import SURFACE_KINDS, AnyKind
from raygrid.node.links.link import Link
from raygrid.node.protocol.counters import BORN, BOXES, DIED, HITS, SENT, TESTS, WALKS
from raygrid.node.protocol.packets import PacketKind
from raygrid.node.runtime.memory_stats import peak_memory, private_memory
from raygrid.node.runtime.node_state import NodeState

NodeRecord = dict[str, Any]  # JSON-able


def record_of(node_state: NodeState, links: dict[int, Link], served_by: str, cpu_at_frame: float) -> NodeRecord:
    """What a node says of itself.

    served_by     what serves its links
    cpu_at_frame  seconds of processor time of the process when the frame began
    """
    counts = node_state.counts
    kinds = list(PacketKind)
    return {
        "index": list(node_state.index),
        "program": None if node_state.program is None else node_state.program.program.digest,
        "pid": os.getpid(),
        "surfaces": {kind.name.lower(): _held(node_state, kind) for kind in SURFACE_KINDS},
        "born": {kind.name.lower(): int(counts[BORN + kind]) for kind in kinds},
        "died": {kind.name.lower(): int(counts[DIED + kind]) for kind in kinds},
        "sent": [int(counts[SENT + port]) for port in range(PORTS)],
        "tests": {kind.name.lower(): int(counts[TESTS + kind]) for kind in SURFACE_KINDS},
        "walks": int(counts[WALKS]),
        "boxes": int(counts[BOXES]),
        "hits": int(counts[HITS]),
        "messages": sum(link.messages_sent for link in links.values()),
        "bytes": sum(link.bytes_sent for link in links.values()),
        "stale": sum(link.stale for link in links.values()),
        "served_by": served_by,
        "waiting": node_state.work_queues.held + int(node_state.outputs.held.sum()),
        "most_waiting": node_state.work_queues.most_held,
        "most_queued_messages": max((link.most_waiting for link in links.values()), default=0),
        "memory": {**node_state.memory, "links": sum(link.most_waiting_bytes for link in links.values())},
        "busy_seconds": round(time.process_time() - cpu_at_frame, 6),
        "cpu_seconds": round(time.process_time(), 6),
        "peak_memory": peak_memory(),
        "private_memory": private_memory(),
    }


def _held(node_state: NodeState, kind: AnyKind) -> int:
    return sum(len(batch) for batch in node_state.retained if batch.kind == kind)
