"""Runs one processor without its sockets: what it does with messages, waves and work.

A wave is a command that enters at the root (0, 0, 0), runs over the tree of neighbour links to every node and comes
back, summing. Every node obeys it and replies once its children have. `trace` travels as a reduction
(`node.runtime.reduction`), of which compiled code takes care while a node traces; all others are maps. What each of them
makes a node do is said in `node.protocol.commands.CommandName`.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

import numpy as np

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.geometry.spanning_tree import tree_children, tree_parent
from raygrid.node.links.link import Arrival, Link, LinkPhase
from raygrid.node.protocol import commands
from raygrid.node.protocol.messages import MessageKind, check_packets, read_order
from raygrid.node.protocol.packets import FAULTS
from raygrid.node.runtime import reduction
from raygrid.node.runtime.event_loop import BACK_OFFS
from raygrid.node.runtime.native_link_table import NativeLinkTable
from raygrid.node.runtime.node_state import NodeState
from raygrid.node.runtime.profile import Profile, counted_as
from raygrid.node.runtime.reduction_replies import Reductions
from raygrid.node.runtime.report import NodeRecord, record_of
from raygrid.node.runtime.self_test import ready_program
from raygrid.node.runtime.surface_flood import SurfaceFlood
from raygrid.node.runtime.waves import MOST_SHOWN, Handler, Wave, WaveReply, do_nothing
from raygrid.node.tracing.batch import BATCH_IDLE

MOST_REASONS = 100  # that are told apart, so that a hostile neighbour cannot fill the memory with them


class Processor:
    """A node as its links see it.

    links     port -> link; HOST too at a corner
    batch     most packets a message
    clock     seconds, for the time that a wave is held
    programs  whether it takes programs
    profile   whether it says where its time goes
    """

    def __init__(
        self,
        index: tuple[int, int, int],
        shape: tuple[int, int, int],
        links: dict[int, Link],
        batch: int,
        clock: Callable[[], float] = time.monotonic,
        programs: bool = False,
        profile: bool = False,
    ) -> None:
        self.index, self.shape, self.links, self.batch, self.clock = index, shape, links, batch, clock
        self.node_state = NodeState(index, shape)
        self.profile = Profile(self.node_state) if profile else None
        self.ended = False
        parent = tree_parent(index)
        self._parent = HOST if parent is None else parent
        self._children = tree_children(index, shape)
        self._programs = programs
        self.flood = SurfaceFlood(self.node_state, links, self._refuse)
        self._wave: Wave | None = None
        self.reductions = Reductions(links, self._parent, self._children)
        self.refused: Counter[str] = Counter()
        self.cpu_at_frame = 0.0
        self.node_state.tuning.flush, self.node_state.tuning.message_packets = min(commands.USUAL_FLUSH, batch), batch
        self._link_table: NativeLinkTable | None = None
        self._ports = list(links.items())
        self.choked = self._up = False
        self.phase = "idle"  # load, trace, collect or idle: for the probes
        self._handlers = self._make_handlers()

    # --- the thin loop's three calls ---------------------------------------------------------------

    @counted_as("receive")
    def receive(self, port: int) -> None:
        """Take in what a link has. Raises ProtocolError if the link itself is broken."""
        link = self.links[port]
        while (arrival := link.receive()) is not None:
            if arrival.kind == MessageKind.PACKETS:
                self._take_packets(port, link, arrival)
            elif arrival.kind == MessageKind.SURFACES:
                self.flood.unread.append((link, arrival))
            elif arrival.kind == MessageKind.DOWN and port == self._parent:
                self._begin_wave(read_order(arrival.message))
            elif arrival.kind == MessageKind.UP and port in self._children:
                reply = read_order(arrival.message)
                if self._wave is not None:
                    self._wave.replies.append(reply)
            elif arrival.kind == MessageKind.REDUCE and port == self._parent:
                self._begin_reduction(arrival.message)
            elif arrival.kind == MessageKind.REDUCED and port in self._children:
                self.reductions.take_reply(port, arrival.message)
            else:
                self._take_other(port, link, arrival)

    def _take_other(self, port: int, link: Link, arrival: Arrival) -> None:
        """A message that only processors of another sort take. Raises ProtocolError."""
        raise ProtocolError(f"link {link.name}: {arrival.kind.name} came on a port where it cannot come from")

    def use_native_links(self, link_table: NativeLinkTable) -> None:
        """Let compiled code serve some of the links while a frame is traced."""
        self._link_table, self.node_state.native = link_table, link_table.native

    @property
    def served_by(self) -> str:
        """What serves the links while a frame is traced: "compiled" or "python"."""
        return "compiled" if self._link_table is not None and self._link_table.is_on else "python"

    def serves_itself(self, port: int) -> bool:
        """Whether `work` receives what comes over a link, so that `receive` need not be called for it."""
        return self._link_table is not None and self.node_state.frame is not None and self._link_table.serves(port)

    def work(self, wait: bool = False) -> bool:
        """Do one piece of work; whether there is more. `wait`: whether to wait for messages where compiled code can."""
        if self.flood.occupied:
            self.flood.work()
        if self.node_state.has_work or (self._link_table is not None and self.node_state.frame is not None):
            self._trace(wait and self._may_wait)
        self._flush()
        if self._wave is not None:
            self._maybe_reply(self._wave)
        elif self.reductions.pending:
            self.reductions.maybe_reply(self.clock(), self._idle, self._own_sums)
        return self.busy

    def _trace(self, wait: bool) -> None:
        """Work on packets, those too that come meanwhile over links that compiled code serves."""
        if self._link_table is None:
            self._work_on_packets(wait)
            return
        self._share_reduction(self._link_table)
        port = self._link_table.end(self._work_on_packets(wait))
        if port is not None:
            self.receive(port)

    def _work_on_packets(self, wait: bool) -> int:
        """What a program raises is refused, with the packets that it was working on. Returns why work ended."""
        try:
            return self.node_state.work(wait) if self.profile is None else self.profile.work(wait)
        except Exception as error:
            if self.node_state.program is None:
                raise
            name = self.node_state.program.program.name
            self._refuse(f"node {self.index}: the program {name} raises: {type(error).__name__}: {error}")
            self.node_state.forget_frame()
            self.node_state.halted = True
            return BATCH_IDLE

    @property
    def _may_wait(self) -> bool:
        """Whether nothing but a message can give this node more to do than packets."""
        replies = self._wave is not None and len(self._wave.replies) == len(self._children)
        return not (replies or self.choked or self._is_occupied)

    @property
    def _is_occupied(self) -> bool:
        """Whether this node has something to do of which compiled code knows nothing."""
        return self.flood.occupied or self.node_state.collecting >= 0

    @property
    def busy(self) -> bool:
        """Whether `work` has something to do now."""
        return self.node_state.has_work or (self.flood.occupied and not self.flood.clogged)

    def wait_limit(self) -> float | None:
        """Seconds after which `work` must be called even if nothing arrives; None: never."""
        if self.reductions.waits_for_node:
            return self.reductions.left(self.clock())
        if self._wave is None or not self._wave.deadline:
            return None
        return max(0.0, self._wave.deadline - self.clock())

    # --- packets -----------------------------------------------------------------------------------

    def _take_packets(self, port: int, link: Link, arrival: Arrival) -> None:
        link.grant()
        if self.node_state.halted:
            return
        if self.node_state.limits is None or port == HOST:
            why = "from the host, which sends none" if port == HOST else "before a frame"
            self._refuse(f"link {link.name}: packets came {why}")
            return
        try:
            check_packets(arrival.message, arrival.items)
        except ProtocolError as error:
            self._refuse(f"link {link.name}: {error}")
            return
        number, bad = self.node_state.work_queues.sort_in(arrival.message, arrival.items, port)
        if bad:
            self._refuse(f"link {link.name}: packet {number} of a message: {FAULTS[bad]}")

    def _refuse(self, why: str) -> None:
        """Count what is refused; the next wave reports it. Reasons are kept apart only while they are few."""
        if len(self.refused) >= MOST_REASONS and why not in self.refused:
            why = f"node {','.join(map(str, self.index))}: for many other reasons"
        self.refused[why] += 1

    @counted_as("send")
    def _flush(self) -> None:
        """Send the outputs that are full enough, all of them when there is nothing else to do."""
        outputs = self.node_state.outputs
        held = outputs.held.tolist()
        least = self.node_state.tuning.flush if self.node_state.has_work else 1
        self.choked = False
        for port, link in self._ports:
            if link.queued or link.urgent:
                link.push()
                self.choked = self.choked or link.choked
            if held[port] >= least:
                link.send_packets(outputs.data[port], held[port], self.batch)
                outputs.held[port] = 0

    # --- waves -------------------------------------------------------------------------------------

    def _begin_wave(self, order: commands.CommandMap) -> None:
        self._refuse_second_wave()
        hold = commands.read_hold(order)
        self._wave = Wave(order.get("do"), order.get("wave"), self.clock() + hold if hold else 0.0)
        for port in self._children:
            self.links[port].send_order(MessageKind.DOWN, order)
        try:
            self._obey(order)
        except ProtocolError as error:
            self._refuse(f"node {self.index}: {error}")

    def _refuse_second_wave(self) -> None:
        if self._wave is not None or self.reductions.pending:
            raise ProtocolError(f"node {self.index}: a wave came before the last one was answered")

    def _make_handlers(self) -> dict[str, Handler]:
        """Command -> what obeys it."""
        return {
            commands.CommandName.READY: Handler(do_nothing),
            commands.CommandName.PROGRAM: Handler(self._make_program_ready),
            commands.CommandName.USE: Handler(lambda _: self.node_state.use_ready()),
            commands.CommandName.SPACE: Handler(self._set_space, phase="load"),
            commands.CommandName.GROUPS: Handler(self.node_state.increments.set_groups, needs="space"),
            commands.CommandName.LOADED: Handler(do_nothing),
            commands.CommandName.MOVE: Handler(self._move, needs="space"),
            commands.CommandName.HAND: Handler(self._hand, needs="space"),
            commands.CommandName.BUILD: Handler(self._build, needs="space"),
            commands.CommandName.FRAME: Handler(self._set_frame, needs="space", phase="trace"),
            commands.CommandName.TRACE: Handler(self._trace_more, needs="frame"),
            commands.CommandName.COLLECT: Handler(self._collect, needs="frame", phase="collect"),
            commands.CommandName.REPORT: Handler(do_nothing, phase="idle"),
            commands.CommandName.HALT: Handler(self._halt, phase="idle"),
            commands.CommandName.END: Handler(do_nothing),
        }

    def _obey(self, order: commands.CommandMap) -> None:
        do = order.get("do")
        handler = self._handlers.get(do) if isinstance(do, str) else None
        if handler is None:
            raise ProtocolError(f"an order came as {do!r}, wanted one that this node knows")
        self.phase = handler.phase or self.phase
        if handler.needs == "space" and self.node_state.space is None:
            raise ProtocolError(f"the order {do!r} came before a space")
        if handler.needs == "frame" and self.node_state.frame is None:
            raise ProtocolError(f"the order {do!r} came before a frame")
        handler.run(order)

    def _make_program_ready(self, order: commands.CommandMap) -> None:
        self.node_state.ready = ready_program(order, self._programs)

    def _set_space(self, order: commands.CommandMap) -> None:
        self.node_state.set_space(commands.read_space(order, self.shape))
        self.node_state.halted = False
        self.flood.begin()
        self.refused.clear()

    def _move(self, order: commands.CommandMap) -> None:
        self.node_state.halted = self.flood.built = False
        self.node_state.move(order)

    def _hand(self, _: commands.CommandMap) -> None:
        self.flood.handed_on += self.node_state.increments.hand()

    def _build(self, _: commands.CommandMap) -> None:
        self.node_state.build()
        self.flood.built = True

    def _set_frame(self, order: commands.CommandMap) -> None:
        self.cpu_at_frame = time.process_time()
        self.node_state.set_frame(commands.read_frame(order))
        if self.profile is not None:
            self.profile.begin_frame()
        for link in self.links.values():
            link.forget_peaks()
        self.node_state.halted = False

    def _trace_more(self, order: commands.CommandMap) -> None:
        self._admit(reduction.trace_request(0, commands.read_trace(order)))

    def _collect(self, _: commands.CommandMap) -> None:
        self.node_state.collecting = 0

    def _halt(self, _: commands.CommandMap) -> None:
        self.node_state.forget_frame()
        self.node_state.increments.give_up()
        for link in self.links.values():
            link.give_up()
        self.refused.clear()
        self.node_state.halted = True

    def _admit(self, request: reduction.TraceFields) -> None:
        """Let more primaries be spawned, and tune the event loop: see `Driver`."""
        tuning = self.node_state.tuning
        self.node_state.quota = max(self.node_state.quota, request.quota)
        tuning.batch_threshold, tuning.back_off = request.batch_threshold, request.back_off // BACK_OFFS
        tuning.flush = max(1, min(request.flush, self.batch))

    def _maybe_reply(self, wave: Wave) -> None:
        """Reply to the wave once the children have and this node is ready to."""
        if len(wave.replies) < len(self._children):
            return
        # a held wave waits for idleness, so that waves are rare under load and quick at the end
        if wave.deadline and self.clock() < wave.deadline and not self._idle():
            return
        if not self._up and any(link.state is LinkPhase.NEW for link in self.links.values()):
            return
        self._up = True
        reply = self._own_reply(with_record=wave.command == commands.CommandName.REPORT)
        for other in wave.replies:
            reply.add(other)
        self._wave = None
        self.links[self._parent].send_order(MessageKind.UP, reply.as_map(wave.number))
        if wave.command == commands.CommandName.END:
            self.ended = True
            for link in self.links.values():
                link.close()

    def _idle(self) -> bool:
        return not self.busy and not self.flood.unread and all(link.waiting == 0 for link in self.links.values())

    def _own_reply(self, with_record: bool) -> WaveReply:
        refusals = [f"{why} ({times} times)" for why, times in self.refused.most_common(MOST_SHOWN)]
        return WaveReply(self._own_sums(), [self.record()] if with_record else [], refusals)

    def _own_sums(self) -> reduction.Long:
        """What this node adds to the sums of a wave."""
        node_state, sums = self.node_state, self._known_sums(list(self.links.values()))
        counts, waiting, outputs = node_state.counts, node_state.work_queues.count, node_state.outputs.held
        reduction.add_own_sums(sums, counts, waiting, outputs, node_state.samples_left, node_state.quota)
        return sums

    def _known_sums(self, links: list[Link]) -> reduction.Long:
        """What compiled code does not know of them, and the messages with data of these links."""
        sums = np.zeros(reduction.SUMS, np.int64)
        sums[reduction.SUM_RECEIVED], sums[reduction.HANDED_ON] = self.flood.received, self.flood.handed_on
        sums[reduction.COLLECTING] = self.node_state.collecting >= 0
        sums[reduction.REFUSED] = sum(self.refused.values())
        sums[reduction.SUM_DATA_SENT] = sum(link.data_sent for link in links)
        sums[reduction.SUM_DATA_DONE] = sum(link.data_done for link in links)
        return sums

    # --- reductions --------------------------------------------------------------------------------

    def _begin_reduction(self, message: bytes) -> None:
        self._refuse_second_wave()
        request = self.reductions.begin(message, self.clock())
        if self.node_state.frame is None:
            self._refuse(f"node {self.index}: the order 'trace' came before a frame")
            return
        self._admit(request)

    def _share_reduction(self, link_table: NativeLinkTable) -> None:
        """Let compiled code take care of reductions while no other wave is under way."""
        unserved = [link for port, link in self._ports if not link_table.shares(port)]
        self.reductions.reduction.known[:] = self._known_sums(unserved)
        queued = any(link.waiting for link in self.links.values())
        link_table.begin(self._wave is None and not self.node_state.halted, self._is_occupied or queued)

    def record(self) -> NodeRecord:
        """What this node says of itself, JSON-able."""
        record = record_of(self.node_state, self.links, self.served_by, self.cpu_at_frame)
        return record if self.profile is None else record | {"profile": self.profile.seconds()}
