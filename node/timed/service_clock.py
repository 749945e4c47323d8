"""Keeps the machine time of one processor: how it spends its ticks. Shared by the simulator and the timed processes (law 10).

A processor serves one packet at a time, in the order (tick of arrival, port, sequence). It decides what to do next
at the tick at which it is free, and sees then what has arrived up to and at that tick. If no packet waits it spawns
its next primary ray, if it has one left; if it has none it waits for the next arrival. What a service costs follows from
the counts of the ray step (`node.protocol.counters`) and a cost model (`Prices`).

A link sends one packet at a time, first come first served. `by_processor`: the processor moves the bytes of one packet
after the other itself and is busy meanwhile; else each link moves its own while the processor goes on. Then a packet
is under way for the link's latency. So arrivals by one port come in the order of their ticks, a port is a queue of its
own, and the order of a node's services depends on nothing but ticks: neither on who runs first nor on wall time.

Packets that start in this node (shadow rays, then other rays) arrive by port SELF at the tick at which the service that
spawned them ends. A decision at tick t may be carried out once nothing can arrive any more at t or before; whatever it sends
arrives at t + `Prices.lookahead` or later.

Records of packets lie in one store of 48 bytes each: tick of arrival, number of the next one in its queue, the
25 bytes, the port, the hops so far. Queues are lists in it, so a node that holds nothing needs one record of `nodes`.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.grid_walk import HOST, PORTS, SELF, SELF_RAYS
from raygrid.node.jit.decorators import lean, part
from raygrid.node.protocol.counters import BORN, COUNTS, DIED, SENT, WALKS
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import KINDS, PRIMARY, SIZE, copy_packet
from raygrid.node.protocol.timestamps import NEVER_TICK
from raygrid.node.tracing.primaries import DONE, spawn_primaries
from raygrid.node.tracing.step import step_one
from raygrid.node.tracing.step_tables import counted_in

Long = NDArray[np.int64]

# a record of the store: words of 8 bytes, and the same memory as bytes
RECORD_WORDS = 6
TICK, NEXT, PACKET = 0, 1, 16  # words, words, bytes
PORT_AT, HOPS_AT, RECORD_BYTES = PACKET + SIZE, PACKET + SIZE + 1, 8 * RECORD_WORDS
MOST_HOPS = 65535

# queues of a node: one for each port, then what starts here, then what has arrived, in order of service
OWN, READY, QUEUES = 6, 7, 8
CLOCK_RECORD = np.dtype(
    [
        ("first_slot", np.int64, QUEUES),  # numbers of records in the store, -1: the queue is empty
        ("last_slot", np.int64, QUEUES),
        ("first_tick", np.int64, QUEUES),  # at which the first packet of the queue arrives
        ("free", np.int64),  # tick at which the node decides next
        ("link_free", np.int64, PORTS + 1),  # of each output: tick at which its link has sent all
        ("busy", np.int64),  # ticks spent on services
        ("served", np.int64),  # packets
        ("waited", np.int64),  # ticks from arrival to service, of all packets
        ("waiting", np.int64),  # packets that have arrived
        ("most_waiting", np.int64),
        ("ended", np.int64),  # tick at which the last service ended
        ("trace", np.int64),  # digest of all services
        # what a walk costs beside its price: tests of every surface held, if a list is searched
        ("list_ticks", np.int64),
        ("sent", np.int64, PORTS + 1),  # packets by each port and to the host
        ("next_primary", np.int64),  # the simulator's place in the list of samples
        ("last_primary", np.int64),
        ("wake", np.int64),  # the simulator's wheel
        ("wake_before", np.int64),
        ("wake_after", np.int64),
        ("walked", np.int64),  # rays walked through the cell
    ]
)


class ServiceClock(NamedTuple):
    """The queues and clocks of n nodes.

    nodes   CLOCK_RECORD (n,)
    words   int64 (records * RECORD_WORDS,); bytes: uint8, the same memory
    spare   int64 (2,): first free record, how many are free
    """

    nodes: NDArray[np.void]
    words: Long
    bytes: NDArray[np.uint8]
    spare: Long


def make_service_clock(n: int, room: int) -> ServiceClock:
    """Empty queues, all clocks at 0, with room for so many packets."""
    nodes = np.zeros(n, CLOCK_RECORD)
    nodes["first_slot"] = nodes["last_slot"] = nodes["wake"] = -1
    nodes["first_tick"] = NEVER_TICK
    words = np.zeros(room * RECORD_WORDS, np.int64)
    words[NEXT::RECORD_WORDS] = np.arange(1, room + 1)
    return ServiceClock(nodes, words, words.view(np.uint8), np.array([0, room], np.int64))


def grown(timed: ServiceClock, room: int) -> ServiceClock:
    """Make room for so many packets, more than before; the rest is the same."""
    before = len(timed.words) // RECORD_WORDS
    words = np.zeros(room * RECORD_WORDS, np.int64)
    words[: len(timed.words)] = timed.words
    new = np.arange(before, room)
    words[RECORD_WORDS * new + NEXT] = np.append(new[1:], timed.spare[0])
    spare = np.array([before, timed.spare[1] + room - before], np.int64)
    return ServiceClock(timed.nodes, words, words.view(np.uint8), spare)


@part
def put(timed, node, queue, tick, port, hops, source, at):
    """Append the 25 bytes at `at` to a queue of a node. There must be a free record."""
    slot = timed.spare[0]
    word, byte = slot * RECORD_WORDS, slot * RECORD_BYTES
    timed.spare[0] = timed.words[word + NEXT]
    timed.spare[1] -= 1
    timed.words[word + TICK] = tick
    timed.words[word + NEXT] = -1
    copy_packet(source, at, timed.bytes, byte + PACKET)
    timed.bytes[byte + PORT_AT] = np.uint8(port)
    timed.bytes[byte + HOPS_AT] = np.uint8(hops & 0xFF)
    timed.bytes[byte + HOPS_AT + 1] = np.uint8(hops >> 8)
    if timed.nodes[node]["first_slot"][queue] < 0:
        timed.nodes[node]["first_slot"][queue] = slot
        timed.nodes[node]["first_tick"][queue] = tick
    else:
        timed.words[timed.nodes[node]["last_slot"][queue] * RECORD_WORDS + NEXT] = slot
    timed.nodes[node]["last_slot"][queue] = slot


@part
def give_back(timed, slot):
    """Let a record be used again."""
    timed.words[slot * RECORD_WORDS + NEXT] = timed.spare[0]
    timed.spare[0] = slot
    timed.spare[1] += 1


@part
def earliest(timed, node):
    """Tick of the earliest packet in the queues of the ports, NEVER_TICK if there is none."""
    first = NEVER_TICK
    for queue in range(READY):
        first = min(first, timed.nodes[node]["first_tick"][queue])
    return first


@part
def queue_arrivals(timed, node, tick):
    """Move what has arrived up to and at `tick` to the queue of service, in the order (tick, port, sequence)."""
    while True:
        best, chosen = tick + 1, -1
        for queue in range(READY):  # SELF comes last: its queue is behind those of the ports
            if timed.nodes[node]["first_tick"][queue] < best:
                best, chosen = timed.nodes[node]["first_tick"][queue], queue
        if chosen < 0:
            break
        slot = timed.nodes[node]["first_slot"][chosen]
        after = timed.words[slot * RECORD_WORDS + NEXT]
        timed.nodes[node]["first_slot"][chosen] = after
        timed.nodes[node]["first_tick"][chosen] = timed.words[after * RECORD_WORDS + TICK] if after >= 0 else NEVER_TICK
        timed.words[slot * RECORD_WORDS + NEXT] = -1
        if timed.nodes[node]["first_slot"][READY] < 0:
            timed.nodes[node]["first_slot"][READY] = slot
        else:
            timed.words[timed.nodes[node]["last_slot"][READY] * RECORD_WORDS + NEXT] = slot
        timed.nodes[node]["last_slot"][READY] = slot
        timed.nodes[node]["waiting"] += 1
    timed.nodes[node]["most_waiting"] = max(timed.nodes[node]["most_waiting"], timed.nodes[node]["waiting"])


@part
def take(timed, node, tick):
    """The record of the packet that is served next, at `tick`; one must wait."""
    slot = timed.nodes[node]["first_slot"][READY]
    timed.nodes[node]["first_slot"][READY] = timed.words[slot * RECORD_WORDS + NEXT]
    timed.nodes[node]["waiting"] -= 1
    timed.nodes[node]["waited"] += tick - timed.words[slot * RECORD_WORDS + TICK]
    return slot


@part
def _mix(digest, word):
    digest = (digest ^ word) * np.int64(0x100000001B3)
    return digest ^ (digest >> 29)


@part
def _note(timed, node, tick, end):
    """Account for a service from tick to end."""
    timed.nodes[node]["busy"] += end - tick
    timed.nodes[node]["served"] += 1
    timed.nodes[node]["free"] = end
    timed.nodes[node]["ended"] = end
    timed.nodes[node]["trace"] = _mix(_mix(timed.nodes[node]["trace"], tick), end)


@part
def serve(timed, node, slot, tick, tables, prices):
    """Serve the packet of a record from `tick` on; returns the tick at which the first byte can be sent.

    tables  `step_tables.StepTables`; its counts become those of this service alone
    What starts here is put into the node's own queue; what is sent lies on
    the outputs, to be given its ticks by `arrival`.
    """
    byte, word = slot * RECORD_BYTES, slot * RECORD_WORDS
    port = np.int64(timed.bytes[byte + PORT_AT])
    digest = timed.nodes[node]["trace"]
    for k in range(3):
        digest = _mix(digest, timed.words[word + PACKET // 8 + k])
    timed.nodes[node]["trace"] = _mix(digest, np.int64(timed.bytes[byte + PACKET + SIZE - 1]) | (port << 8))
    counts, outputs = tables.counts, tables.outputs
    counts[:] = 0
    step_one(tables, timed.bytes, byte + PACKET, port)
    ticks = prices.packet + timed.nodes[node]["list_ticks"] * counts[WALKS]
    for k in range(COUNTS):
        ticks += prices.counts[k] * counts[k]
    timed.nodes[node]["walked"] += counts[WALKS]
    done = tick + ticks
    sent = np.int64(0)
    for output in range(PORTS + 1):
        sent += counts[SENT + output]
        timed.nodes[node]["sent"][output] += counts[SENT + output]
    end = done + prices.by_processor * prices.transmit * sent
    _note(timed, node, tick, end)
    for output in range(SELF, SELF_RAYS + 1):
        for k in range(outputs.held[output]):
            put(timed, node, OWN, end, SELF, 0, outputs.data[output], HEAD + k * SIZE)
        outputs.held[output] = 0
    return done


@part
def arrival(timed, node, output, ready, nth, prices):
    """Tick at which a packet arrives that is the nth (from 0) of a service and can be sent from tick `ready` on."""
    if prices.by_processor != 0:
        return ready + (nth + 1) * prices.transmit + prices.latency
    sent = max(ready, timed.nodes[node]["link_free"][output]) + prices.transmit
    timed.nodes[node]["link_free"][output] = sent
    return sent + prices.latency


@part
def spawned(timed, node, tick, packets, at, ticks):
    """Spawn a ray or pixel packet, lying at `at` of packets, from `tick` on, which takes the node so many ticks."""
    end = tick + ticks
    _note(timed, node, tick, end)
    put(timed, node, OWN, end, SELF, 0, packets, at)


@part
def decides(timed, node, may_spawn):
    """Tick of the next decision of a node as far as it is known, NEVER_TICK if nothing that is known leads to one."""
    free = timed.nodes[node]["free"]
    if may_spawn or timed.nodes[node]["waiting"] > 0:
        return free
    return max(free, earliest(timed, node))


# --- one node as a process ----------------------------------------------------------------------------

CLOCK_IDLE, CLOCK_BLOCKED, CLOCK_FULL = 0, 1, 2  # why `advance` returns


class Stamps(NamedTuple):
    """Ticks of the packets that lie on the outputs of a node.

    ticks  int64 (PORTS + 1, room); held: int64 (PORTS + 1,), how many have theirs
    """

    ticks: Long
    held: Long


@lean
def insert(timed, port, ticks, packets, at, count):
    """Append `count` packets (25 bytes each from byte `at`) that came by a port with their ticks, int64 (count,)."""
    for k in range(count):
        put(timed, 0, port, ticks[k], port, 0, packets, at + k * SIZE)


@lean
def next_decision(timed, may_spawn):
    """Tell what `decides` says of a node that is alone in its process."""
    return decides(timed, 0, may_spawn)


@lean
def advance(timed, horizon, tables, cursor, scratch, stamps, total, prices):
    """Carry out all decisions before tick `horizon`; CLOCK_IDLE, CLOCK_BLOCKED or CLOCK_FULL.

    tables   `step_tables.StepTables`, its counts those of a service; total: int64 (COUNTS,), counts of the frame
    scratch  uint8 (25,), a new primary ray
    CLOCK_FULL: the outputs or the store have no room for what one more service may send.
    """
    outputs, counts, most = tables.outputs, tables.counts, tables.frame.n_lights + 3
    while True:
        tick = decides(timed, 0, cursor[DONE] == 0)
        if tick >= NEVER_TICK:
            return CLOCK_IDLE
        if tick >= horizon:
            return CLOCK_BLOCKED
        room = timed.spare[1]
        for output in range(PORTS + 1):
            room = min(room, stamps.ticks.shape[1] - outputs.held[output])
        if room < most:
            return CLOCK_FULL
        queue_arrivals(timed, 0, tick)
        if timed.nodes[0]["waiting"] == 0:
            if cursor[DONE] == 0 and spawn_primaries(counted_in(tables, total), cursor, scratch, 0, 1) == 1:
                spawned(timed, 0, tick, scratch, 0, prices.counts[BORN + PRIMARY])
            continue
        slot = take(timed, 0, tick)
        done = serve(timed, 0, slot, tick, tables, prices)
        give_back(timed, slot)
        for k in range(COUNTS):
            total[k] += counts[k]
        nth = np.int64(0)
        for output in range(PORTS + 1):
            for k in range(stamps.held[output], outputs.held[output]):
                stamps.ticks[output, k] = arrival(timed, 0, output, done, nth, prices)
                nth += 1
            stamps.held[output] = outputs.held[output]


assert SELF_RAYS == SELF + 1 and HOST == PORTS == OWN and KINDS + BORN == DIED
