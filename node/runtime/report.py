"""What a node answers to a wave: sums, what it refused, and if it is asked for, a record of itself."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import PORTS
from raygrid.node.geometry.surfaces import SURFACE_KINDS, AnyKind
from raygrid.node.protocol.counters import BORN, BOXES, DIED, HITS, SENT, TESTS, WALKS
from raygrid.node.protocol.packets import PacketKind
from raygrid.node.runtime.memory_stats import peak_memory, private_memory
from raygrid.node.runtime.reduction import SUMS

if TYPE_CHECKING:
    from raygrid.node.runtime.node_state import NodeState
    from raygrid.node.runtime.processor import Processor


def record_of(processor: Processor) -> dict[str, Any]:
    """What a node says of itself, JSON-able."""
    counts, node_state, links = processor.node_state.counts, processor.node_state, processor.links
    kinds = list(PacketKind)
    return {
        "index": list(processor.index),
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
        "served_by": processor.served_by,
        "waiting": node_state.work_queues.held + int(node_state.outputs.held.sum()),
        "most_waiting": node_state.work_queues.most_held,
        "most_queued_messages": max((link.most_waiting for link in links.values()), default=0),
        "memory": {**node_state.memory, "links": sum(link.most_waiting_bytes for link in links.values())},
        "busy_seconds": round(time.process_time() - processor.cpu_at_frame, 6),
        "cpu_seconds": round(time.process_time(), 6),
        "peak_memory": peak_memory(),
        "private_memory": private_memory(),
    }


def _held(node_state: NodeState, kind: AnyKind) -> int:
    return sum(len(batch) for batch in node_state.retained if batch.kind == kind)


def read_sums(answer: dict[str, Any]) -> NDArray[np.int64]:
    """The sums of an answer, int64 (SUMS,). Raises ProtocolError if it has none."""
    sums = answer.get("sums")
    if not isinstance(sums, bytes) or len(sums) != 8 * SUMS:
        raise ProtocolError("an answer came without its sums")
    return np.frombuffer(sums, "<i8").astype(np.int64)


def add_answer(answer: dict[str, Any], other: dict[str, Any]) -> None:
    """Sum an answer of a child into one's own. Raises ProtocolError if it is not an answer."""
    nodes, refusals = other.get("nodes"), other.get("refusals")
    if not isinstance(nodes, list) or not isinstance(refusals, list):
        raise ProtocolError("an answer came without its lists")
    answer["sums"] = (read_sums(answer) + read_sums(other)).tobytes()
    answer["nodes"] = answer["nodes"] + nodes
    answer["refusals"] = (answer["refusals"] + refusals)[:3]
