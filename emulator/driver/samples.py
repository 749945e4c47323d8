"""Reads the samples of probes: checks them, and gives them names."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

from raygrid.emulator.topology.coordinates import Index, name_of
from raygrid.node.errors import ProtocolError
from raygrid.node.geometry import HOST
from raygrid.node.protocol import BORN, COUNTS, DIED, HITS, KINDS, SENT, WALKS, PacketKind
from raygrid.node.runtime import ARRIVALS

PHASES = ("idle", "load", "trace", "collect")
PORTS = ("-x", "+x", "-y", "+y", "-z", "+z", "host", "self")  # in the order of node.walk
KIND_NAMES = {int(kind): kind.name.lower() for kind in PacketKind}
QUEUES = ("travellers", "shadows", "rays")
MEMORY = ("surfaces", "pixels", "backlog", "outputs", "pss")
MOST = 1 << 62
COUNTERS = struct.Struct(f"<{COUNTS}q")


@dataclass(frozen=True)
class LinkSample:
    """One end of a link, by messages: how many wait, were sent, and came; and bytes sent."""

    waiting: int
    messages_sent: int
    bytes_sent: int
    messages_received: int


@dataclass(frozen=True)
class NodeSample:
    """How a node stood at one moment. What it counts begins anew with each frame, but for `links` and `cpu`.

    node      its coordinates
    epoch     number of resets before; number: of the sample since the process began, a gap where some were dropped
    time      seconds of the monotonic clock
    phase     one of PHASES
    born, died  packets by kind; sent: packets put out by port
    walks, hits   rays walked through the cell, and those that hit something
    queues    packets that wait by class: travellers (returns and pixels), shadows, rays
    waiting   the same by port of arrival and kind, without those that are 0 (of the newest 32,768 of each class)
    outputs   packets put out and not yet sent, by port
    links     by port
    surfaces  held; memory: bytes by use, pss that of the process
    cpu       seconds of processor time since the process began
    dropped   what the node could not say since its process began, because nobody listened
    """

    node: Index
    epoch: int
    number: int
    time: float
    phase: str
    born: dict[str, int]
    died: dict[str, int]
    sent: dict[str, int]
    walks: int
    hits: int
    queues: dict[str, int]
    waiting: dict[str, dict[str, int]]
    outputs: dict[str, int]
    links: dict[str, LinkSample]
    surfaces: int
    memory: dict[str, int]
    cpu: float
    dropped: int

    @property
    def held(self) -> int:
        """Packets that the node holds."""
        return sum(self.queues.values()) + sum(self.outputs.values())

    @property
    def work(self) -> int:
        """Packets that it has served or seen born in this frame: a measure of what it does."""
        return sum(self.born.values()) + sum(self.died.values()) + sum(self.sent.values())


def read_sample(node: Index, words: dict[str, Any]) -> NodeSample:
    """A sample of what a node said on its control channel. Raises ProtocolError unless it is one."""
    try:
        counts = _counts(words["counts"])
        phase = words["phase"]
        if phase not in PHASES:
            raise ValueError(f"phase {phase!r}")
        return NodeSample(
            node=node,
            epoch=_whole(words["epoch"]),
            number=_whole(words["number"]),
            time=_seconds(words["time"]),
            phase=phase,
            born={name: counts[BORN + kind] for kind, name in KIND_NAMES.items()},
            died={name: counts[DIED + kind] for kind, name in KIND_NAMES.items()},
            sent={PORTS[port]: counts[SENT + port] for port in range(HOST + 1)},
            walks=counts[WALKS],
            hits=counts[HITS],
            queues=dict(zip(QUEUES, _whole_numbers(words["queues"], len(QUEUES)), strict=True)),
            waiting=_by_port_and_kind(words["waiting"]),
            outputs=dict(zip(PORTS, _whole_numbers(words["outputs"], HOST + 1), strict=False)),
            links=_links(words["links"]),
            surfaces=_whole(words["surfaces"]),
            memory={use: _whole(words["memory"][use]) for use in MEMORY},
            cpu=_seconds(words["cpu"]),
            dropped=_whole(words["dropped"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ProtocolError(f"node {name_of(node)} said a sample that is none: {error}") from None


def _counts(raw: Any) -> tuple[int, ...]:
    if not isinstance(raw, bytes) or len(raw) != COUNTERS.size:
        raise ValueError("counts of another length")
    counts: tuple[int, ...] = COUNTERS.unpack(raw)
    if min(counts) < 0:
        raise ValueError("counts below 0")
    return counts


def _whole(value: Any) -> int:
    if type(value) is not int or not 0 <= value < MOST:
        raise ValueError(f"{value!r} for a whole number")
    return value


def _whole_numbers(values: Any, count: int) -> list[int]:
    if not isinstance(values, list) or len(values) != count:
        raise ValueError(f"no list of {count} numbers")
    return [_whole(value) for value in values]


def _seconds(value: Any) -> float:
    if type(value) is not float or not 0.0 <= value < math.inf:
        raise ValueError(f"{value!r} for seconds")
    return value


def _links(values: Any) -> dict[str, LinkSample]:
    if not isinstance(values, list) or len(values) > HOST + 1:
        raise ValueError("links that are none")
    rows = [_whole_numbers(row, 5) for row in values]
    if not all(row[0] <= HOST for row in rows):
        raise ValueError("a link at no port")
    return {PORTS[row[0]]: LinkSample(*row[1:]) for row in rows}


def _by_port_and_kind(values: Any) -> dict[str, dict[str, int]]:
    if not isinstance(values, list) or len(values) % 2 or len(values) > 2 * ARRIVALS * KINDS:
        raise ValueError("packets by port and kind that are none")
    found: dict[str, dict[str, int]] = {}
    for at, many in zip(values[::2], values[1::2], strict=True):
        port, kind = divmod(_whole(at), KINDS)
        if port >= ARRIVALS or kind not in KIND_NAMES:
            raise ValueError(f"packets at place {at}")
        found.setdefault(PORTS[port], {})[KIND_NAMES[kind]] = _whole(many)
    return found
