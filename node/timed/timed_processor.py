"""Runs a processor that keeps machine time among others that do: conservative, by null messages on demand.

Every link has a channel clock, kept by its other end: nothing arrives by it before this tick (K. M. Chandy and J. Misra,
"Distributed simulation: a case study in design and verification of distributed programs", IEEE TSE 1979; R. E. Bryant,
MIT 1977). A decision at a tick before all channel clocks can be carried out; what happens then is
`node.timed.service_clock`, so neither this computer's scheduler nor the order in which messages come can change anything.

The channel clock travels with every message. A node that may not decide yet sends look-ahead requests
(`node.timed.lookahead`). When nothing is left to do nobody asks, and all is silent.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST, PORTS
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.links.link import Arrival, Link
from raygrid.node.protocol import timestamps
from raygrid.node.protocol.commands import CommandMap
from raygrid.node.protocol.counters import COUNTS
from raygrid.node.protocol.messages import HEAD, MessageKind
from raygrid.node.protocol.packets import FAULTS, SIZE, first_fault
from raygrid.node.runtime.processor import Processor
from raygrid.node.runtime.reduction import TraceFields
from raygrid.node.timed import service_clock
from raygrid.node.timed.lookahead import Lookahead
from raygrid.node.tracing.primaries import DONE

FIRST_CLOCK_ROOM = 4096  # packets of the store; doubled whenever they do not suffice


class TimedProcessor(Processor):
    """Traces in machine time. All else it does as any other processor."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._neighbours = [port for port in self.links if port != HOST]
        self._prices: timestamps.Prices | None = None  # of the frame that is being traced in machine time
        self._started = False
        self._why = service_clock.CLOCK_IDLE
        self._frame_number = 0
        self._channel_clocks = [0] * PORTS  # as the neighbours sent them
        self._lookahead = self._new_lookahead(0)
        self._dirty = False
        self.timed = service_clock.make_service_clock(1, FIRST_CLOCK_ROOM)
        self._scratch, self._counts = np.zeros(SIZE, np.uint8), np.zeros(COUNTS, np.int64)
        self._stamps = self._new_stamps()

    def _new_stamps(self) -> service_clock.Stamps:
        room = (self.node_state.outputs.data.shape[1] - HEAD) // SIZE
        return service_clock.Stamps(np.zeros((PORTS + 1, room), np.int64), np.zeros(PORTS + 1, np.int64))

    def _new_lookahead(self, first: int) -> Lookahead:
        """Begin without requests; nothing arrives before tick `first`."""
        ports = self._neighbours
        lookahead = 1 if self._prices is None else self._prices.lookahead
        bound = dict.fromkeys(ports, first)
        return Lookahead(self.index, self._frame_number, lookahead, ports, self._post_request, self._decision, bound)

    # --- orders ------------------------------------------------------------------------------------

    def _obey(self, order: CommandMap) -> None:
        super()._obey(order)
        do = order.get("do")
        if do == "frame":
            self._begin_frame(order)
        elif do in ("collect", "halt", "space"):
            self._prices, self._started, self._why = None, False, service_clock.CLOCK_IDLE

    def _admit(self, request: TraceFields) -> None:
        super()._admit(request)
        if self._prices is not None:
            self.node_state.quota = 0  # spawning follows machine time, not the root
            self._started = self._dirty = True

    def _begin_frame(self, order: CommandMap) -> None:
        found = timestamps.read_prices(order)
        self._started, self._why = False, service_clock.CLOCK_IDLE
        self._prices = None
        if found is None:
            return
        self._prices, tests = found
        self._frame_number = _wave_of(order)
        self.timed, self._stamps = service_clock.make_service_clock(1, FIRST_CLOCK_ROOM), self._new_stamps()
        held = [sum(len(batch) for batch in self.node_state.retained if batch.kind == kind) for kind in Kind]
        self.timed.nodes[0]["list_ticks"] = int(np.array(held) @ tests)
        first = self._prices.lookahead  # nobody has decided anything yet
        self._channel_clocks = [first] * PORTS
        self._lookahead = self._new_lookahead(first)

    # --- messages ----------------------------------------------------------------------------------

    def _take_other(self, port: int, link: Link, arrival: Arrival) -> None:
        if port == HOST or arrival.kind not in (MessageKind.STAMPED, MessageKind.LOOKAHEAD):
            super()._take_other(port, link, arrival)
            return
        link.grant()
        try:
            if arrival.kind is MessageKind.STAMPED:
                self._take_stamped(port, arrival)
            else:
                request = timestamps.read_lookahead(arrival.message)
                if self._is_current(request.frame):
                    self._advance_channel(port, request.channel_clock)
                    self._lookahead.take(port, request)
        except ProtocolError as error:
            self._refuse(f"link {link.name}: {error}")

    def _is_current(self, frame: int) -> bool:
        return self._prices is not None and frame == self._frame_number

    def _advance_channel(self, port: int, clock: int) -> None:
        if clock < self._channel_clocks[port]:
            raise ProtocolError(f"the channel clock {clock} came after the channel clock {self._channel_clocks[port]}")
        self._channel_clocks[port] = clock
        self._lookahead.bound[port] = max(self._lookahead.bound[port], clock)
        self._dirty = True

    def _take_stamped(self, port: int, arrival: Arrival) -> None:
        message = timestamps.read_stamped(arrival.message, arrival.items)
        if not self._is_current(message.frame):
            raise ProtocolError(f"{arrival.items} packets of another frame came")
        packets = np.frombuffer(arrival.message, np.uint8)
        number, bad = first_fault(packets, message.at, arrival.items, self.node_state.limits)
        if bad:
            raise ProtocolError(f"packet {number} of a message: {FAULTS[bad]}")
        before = self._lookahead.bound[port]
        if message.ticks[0] < before:
            raise ProtocolError(f"a packet came for tick {message.ticks[0]}, when none could before {before}")
        self._make_room(arrival.items)
        service_clock.insert(self.timed, port, message.ticks, packets, message.at, arrival.items)
        self._advance_channel(port, message.channel_clock)

    def _make_room(self, many: int) -> None:
        while self.timed.spare[1] < many:
            self.timed = service_clock.grown(self.timed, 2 * (len(self.timed.words) // 6))

    # --- work --------------------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Tell whether `work` has something to do now."""
        return super().busy or (self._started and (self._dirty or self._why == service_clock.CLOCK_FULL))

    def _idle(self) -> bool:
        return super()._idle() and not (self._started and self._why == service_clock.CLOCK_BLOCKED)

    def work(self, wait: bool = False) -> bool:
        """Carry out what the channel clocks allow, send what came of it, then do one piece of other work."""
        if self._started and self._prices is not None and self.busy:
            self._dirty = False
            self._advance()
            self._send()
            self._lookahead.handle_requests()
            if self._why == service_clock.CLOCK_BLOCKED:
                self._lookahead.ask(self._decision())
        return super().work()

    def _decision(self) -> int:
        """Tick of the next decision as far as it is known."""
        return int(service_clock.next_decision(self.timed, self.node_state.samples_left))

    def _advance(self) -> None:
        node_state, horizon = self.node_state, self._lookahead.horizon()
        tables = node_state.step_tables(node_state.outputs)._replace(counts=self._counts)
        self._make_room(2 * (tables.frame.n_lights + 4))
        first = self._decision()
        self._why = service_clock.advance(
            self.timed, horizon, tables, node_state.cursor, self._scratch, self._stamps, node_state.counts, self._prices
        )
        node_state.samples_left = int(node_state.cursor[DONE]) == 0
        if first < horizon:
            self._lookahead.decided(first)

    def _channel_clock(self, port: int) -> int:
        """Tick before which nothing more is sent to a neighbour, as far as is known now."""
        assert self._prices is not None
        row = self.timed.nodes[0]
        decision = min(self._decision(), max(int(row["free"]), self._lookahead.horizon()))
        after_others = int(row["link_free"][port]) + self._prices.transmit + self._prices.latency
        return min(max(decision + self._prices.lookahead, after_others), timestamps.LAST_TICK)

    def _post_request(self, port: int, request: timestamps.LookaheadRequest) -> None:
        payload = timestamps.pack_lookahead(request._replace(channel_clock=self._channel_clock(port)))
        self.links[port].send_data(MessageKind.LOOKAHEAD, 0, payload)

    def _send(self) -> None:
        """Send packets with their ticks, and the channel clock after them."""
        outputs = self.node_state.outputs
        for port in self._neighbours:
            held = int(outputs.held[port])
            if not held:
                continue
            link, clock, ticks = self.links[port], self._channel_clock(port), self._stamps.ticks[port, :held]
            for first in range(0, held, self.batch):
                last = min(first + self.batch, held)
                known = clock if last == held else int(ticks[last - 1])
                packets = outputs.data[port, HEAD + first * SIZE : HEAD + last * SIZE].tobytes()
                payload = timestamps.pack_stamped(self._frame_number, known, ticks[first:last], packets)
                link.send_data(MessageKind.STAMPED, last - first, payload)
            outputs.held[port] = self._stamps.held[port] = 0

    def _flush(self) -> None:
        if not self._started:
            super()._flush()
            return
        self.choked = False
        for _, link in self._ports:
            if link.queued or link.urgent:
                link.push()
                self.choked = self.choked or link.choked

    def record(self) -> dict[str, Any]:
        """The record of any processor, and how it spent machine time."""
        row = dict(zip(service_clock.CLOCK_RECORD.names or (), self.timed.nodes[0].tolist(), strict=True))
        machine = {
            "served": row["served"],
            "busy_ticks": row["busy"],
            "waited_ticks": row["waited"],
            "most_waiting": row["most_waiting"],
            "walks": row["walked"],
            "ended_tick": row["ended"],
            "sent": row["sent"][:PORTS].tolist(),
            "trace": row["trace"],
        }
        return {**super().record(), "machine": machine}


def _wave_of(order: CommandMap) -> int:
    """The number of the wave, 32 bits of it."""
    wave = order.get("wave", 0)
    return wave & 0xFFFFFFFF if isinstance(wave, int) else 0
