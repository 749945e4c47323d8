"""Models the naive machine, with finite buffers and no admission, to see how and why it deadlocks.

The nodes run the machine's own ray step, one packet a turn, in one process and in a fixed order, so the same frame always
deadlocks in the same way. What differs from raygrid is only what is said here:

- Each link has, each way, a buffer of `room` packets at its receiving end, and nothing more.
- A node serves its inputs in turn: each port's buffer first in first out, what was made in it and starts in it, and its
  next primary ray. What its step puts out it must place before it takes anything else. It waits ("blocks") as long
  as the buffer of the next packet to be placed is full.
- What a node has made for itself waits in memory without a bound, so that no node ever waits for itself: every deadlock
  seen here is one of links.
- Without admission a primary ray is born whenever its turn comes. With admission only while fewer than `budget` primary
  rays have living descendants in the whole array.

A blocked node waits for exactly one neighbour, so from any node that can never go on a chain of waiting leads into a
cycle. Packets of all trees alive are at most `budget` times what a tree can have alive at once (`emulator.topology.bounds`); if
that is not above `room`, no buffer can ever be full, no node blocks, and no deadlock is possible.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.analysis.single_step import SingleStep
from raygrid.emulator.topology.bounds import growth_of
from raygrid.emulator.topology.coordinates import Index, beyond, indices
from raygrid.node.errors import ArrayError, SceneError
from raygrid.node.geometry import OPPOSITE, PORTS, SELF, Space, SurfaceSet
from raygrid.node.protocol import BORN, DIED, PRIMARY, RETURN, Frame, PacketKind
from raygrid.node.runtime import NodeState

SOURCES = PORTS + 2  # from which a node takes packets in turn: its ports, what it has born to itself, its primaries
MOST_ROOM = 1 << 20
SAMPLE = slice(1, 5)  # bytes of a packet that name its sample


@dataclass(frozen=True)
class Waiting:
    """A node that cannot go on: it waits until there is room behind a port.

    held     packets that it still has to place before it takes anything in
    ahead    kinds of the packets in the full buffer behind the port, by name
    inputs   packets that wait in its own input buffers, by port
    """

    node: Index
    port: int
    neighbour: Index
    held: int
    ahead: dict[str, int]
    inputs: list[int]


@dataclass(frozen=True)
class Outcome:
    """How a run of the model ended.

    jammed     whether it came to rest with packets alive
    rounds     in which each node had one turn, until the end; closed: after which the first cycle of waiting nodes closed,
               or None
    born, died packets by kind, by name
    stuck      packets alive at the end
    unborn     samples not yet born at the end
    blocked    turns in which a node could only wait
    fullest    most packets that a link's buffer held
    most_trees most primary rays with living descendants at once
    cycle      nodes of the first cycle, each waiting for the next, the last one for the first
    waiting    every node that waits at the end
    """

    room: int
    budget: int | None
    jammed: bool
    rounds: int
    closed: int | None
    born: dict[str, int]
    died: dict[str, int]
    stuck: int
    unborn: int
    blocked: int
    fullest: int
    most_trees: int
    cycle: list[Waiting]
    waiting: list[Waiting]


@dataclass
class _Node:
    """One processor of the model. inputs: ports, SELF's place is PORTS (6)."""

    index: Index
    inputs: list[deque[bytes]] = field(default_factory=lambda: [deque() for _ in range(PORTS + 1)])
    held: deque[tuple[int, bytes]] = field(default_factory=deque)  # (port, packet) still to be placed
    turn: int = 0  # the input to be looked at next
    exhausted: bool = False


class NaiveMachine:
    """A loaded array of naive nodes. room: packets a buffer; budget: None for no admission.

    Raises SceneError for a room or budget that cannot be, ArrayError if the array cannot be loaded.
    """

    def __init__(self, space: Space, surfaces: SurfaceSet, frame: Frame, room: int, budget: int | None = None) -> None:
        if not 1 <= room <= MOST_ROOM:
            raise SceneError(f"a buffer came with room for {room} packets, wanted 1 to {MOST_ROOM}")
        if budget is not None and budget < 1:
            raise SceneError(f"a budget came as {budget}, wanted 1 primary ray or more")
        self._steps = SingleStep(space, surfaces, frame)
        self._frame, self._room, self._budget = frame, room, budget
        self._nodes = {index: _Node(index) for index in indices(space.shape)}
        self._alive: Counter[bytes] = Counter()  # packets of each tree
        self._blocked = self._fullest = self._most_trees = 0

    @property
    def tracers(self) -> list[NodeState]:
        """The nodes' tables and pixel stores, x fastest."""
        return list(self._steps.nodes.values())

    def run(self) -> Outcome:
        """Until all is traced, or nothing can move any more. Raises ArrayError if packets are lost."""
        rounds, closed, cycle = 0, None, list[Waiting]()
        moved = True
        while moved:
            moved = False
            for node in self._nodes.values():
                moved |= self._take_turn(node)
            rounds += moved
            if closed is None and moved:
                cycle = self._cycle()
                closed = rounds if cycle else None
        counts = self._steps.counts()
        stuck = sum(self._alive.values())
        born, died = _by_kind(counts, BORN), _by_kind(counts, DIED)
        if stuck != sum(born.values()) - sum(died.values()):
            raise ArrayError(f"{born} packets were born and {died} died, but {stuck} are there")
        unborn = self._frame.width * self._frame.height * self._frame.samples - born["primary"]
        unborn -= 0 if stuck else unborn  # those that are left when all is done miss the world box
        waiting = [self._waiting(node) for node in self._nodes.values() if node.held]
        begun, most = (self._room, self._budget), (self._blocked, self._fullest, self._most_trees)
        return Outcome(*begun, stuck > 0, rounds, closed, born, died, stuck, unborn, *most, cycle, waiting)

    # --- turns -------------------------------------------------------------------------------------

    def _take_turn(self, node: _Node) -> bool:
        """Whether the node could do anything."""
        if node.held:
            before = len(node.held)
            self._place(node)
            self._blocked += len(node.held) == before
            return len(node.held) < before
        for _ in range(SOURCES):
            source, node.turn = node.turn, (node.turn + 1) % SOURCES
            packet = None
            if source > PORTS:
                packet = self._next_primary(node)
            elif node.inputs[source]:
                packet = node.inputs[source].popleft()
            if packet is not None:
                self._serve(node, packet, SELF if source >= PORTS else source)
                return True
        return False

    def _next_primary(self, node: _Node) -> bytes | None:
        if node.exhausted or (self._budget is not None and len(self._alive) >= self._budget):
            return None
        packet = self._steps.emit_next(node.index)
        if packet is None:
            node.exhausted = True
            return None
        self._alive[packet[SAMPLE]] += 1
        self._most_trees = max(self._most_trees, len(self._alive))
        return packet

    def _serve(self, node: _Node, packet: bytes, port: int) -> None:
        """Step one packet, and place what comes out of it as far as there is room."""
        served = self._steps.serve(node.index, packet, port)
        tree = packet[SAMPLE]
        self._alive[tree] += len(served.out) - 1
        if not self._alive[tree]:
            del self._alive[tree]
        for output, born in served.out:
            if output < PORTS:
                node.held.append((output, born))
            else:
                node.inputs[PORTS].append(born)
        self._place(node)

    def _place(self, node: _Node) -> None:
        while node.held:
            buffer = self._behind(node.index, node.held[0][0])
            if len(buffer) >= self._room:
                return
            buffer.append(node.held.popleft()[1])
            self._fullest = max(self._fullest, len(buffer))

    def _behind(self, index: Index, port: int) -> deque[bytes]:
        """The buffer at the other end of a link."""
        return self._nodes[beyond(index, port)].inputs[OPPOSITE[port]]

    # --- who waits for whom --------------------------------------------------------------------------

    def _is_blocked(self, node: _Node) -> bool:
        return bool(node.held) and len(self._behind(node.index, node.held[0][0])) >= self._room

    def _cycle(self) -> list[Waiting]:
        """A cycle of nodes each of which waits for the next, or none. Such a cycle can never be left."""
        for first in self._nodes.values():
            chain: list[Index] = []
            node = first
            while self._is_blocked(node) and node.index not in chain:
                chain.append(node.index)
                node = self._nodes[beyond(node.index, node.held[0][0])]
            if node.index in chain:
                return [self._waiting(self._nodes[index]) for index in chain[chain.index(node.index) :]]
        return []

    def _waiting(self, node: _Node) -> Waiting:
        port = node.held[0][0]
        ahead = Counter(PacketKind(packet[0] & 7).name.lower() for packet in self._behind(node.index, port))
        queued = [len(queue) for queue in node.inputs]
        return Waiting(node.index, port, beyond(node.index, port), len(node.held), dict(ahead), queued)


def surely_free(frame: Frame, room: int) -> int:
    """The largest budget of primary rays with which no buffer of this room can ever be full; 0 if there is none."""
    return room // growth_of(frame).packets


def _by_kind(counts: NDArray[np.int64], first: int) -> dict[str, int]:
    return {PacketKind(kind).name.lower(): int(counts[first + kind]) for kind in range(PRIMARY, RETURN + 1)}
