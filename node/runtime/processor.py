"""One processor without its sockets: what it does with messages, waves and work.

A wave is an order that enters at the root (0, 0, 0), runs over the tree of neighbour links to every node and
comes back, summing. Every node obeys the order and answers once its children have. `trace` travels as a tally
(`node.runtime.reduction`), of which compiled code takes care while a node traces; all others are maps.

    do        what a node does                                  answers when
    ready     nothing                                           its links are up
    program   compile and try a program                         it is done
    use       let it take the place of the one before           at once
    space     new world box and planes, forget all surfaces     at once
    groups    which surfaces move, and where they are           at once
    loaded    nothing                                           at once; sums tell whether descriptions are under way
    move      move what it holds, drop what has left            at once
    hand      hand on what has reached other cells              at once; what it will hand on is counted
    build     make the tables from what it retains              it is done
    frame     begin a frame                                     at once
    trace     may bear `quota` more primaries                   it is idle, or after `hold` seconds
    collect   send its pixels to the nearest corner             it is idle, or after `hold` seconds
    report    nothing                                           at once, with a record of itself
    halt      drop all packets and surfaces, those too that     at once; sums tell whether messages are under way
              still come, until the next space or frame
    end       say BYE on every link                             at once
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.spanning_tree import Branch, branches, tree_children, tree_parent
from raygrid.node.geometry.surfaces import Batch
from raygrid.node.links.link import Arrival, Link, LinkPhase
from raygrid.node.protocol.commands import read_frame, read_space
from raygrid.node.protocol.counters import COUNTS
from raygrid.node.protocol.messages import MessageKind, check_packets, pack_surfaces, read_order, read_surfaces
from raygrid.node.protocol.packets import FAULTS
from raygrid.node.runtime.event_loop import BACK_OFFS, TUNE_BACK_OFF, TUNE_BATCH, TUNE_FLUSH, TUNE_LEAST
from raygrid.node.runtime.increments import MOVED, Path
from raygrid.node.runtime.native_link_table import NativeLinkTable
from raygrid.node.runtime.node_state import USUAL_FLUSH, NodeState
from raygrid.node.runtime.reduction import (
    ALLOWED,
    COLLECTING,
    HANDED_ON,
    HOMES_LEFT,
    REFUSED,
    SUM_DATA_DONE,
    SUM_DATA_SENT,
    SUM_RECEIVED,
    SUM_WAITING,
    SUMS,
)
from raygrid.node.runtime.reduction_replies import Reductions
from raygrid.node.runtime.report import add_answer, record_of
from raygrid.node.runtime.self_test import ready_program
from raygrid.node.tracing.batch import BATCH_IDLE

PHASES = {
    "space": "load",
    "frame": "trace",
    "collect": "collect",
    "report": "idle",
    "halt": "idle",
}  # begun by an order
MOST_REASONS = 100  # that are told apart, so that a hostile neighbour cannot fill the memory with them
CLOGGED = 64  # waiting messages on a link at which no more surfaces are taken in


class Processor:
    """A node as its links see it.

    links   port -> link; HOST too at a corner
    clock   seconds, for the time that a wave is held
    programs  whether it takes programs
    """

    def __init__(
        self,
        index: tuple[int, int, int],
        shape: tuple[int, int, int],
        links: dict[int, Link],
        batch: int,
        clock: Callable[[], float] = time.monotonic,
        programs: bool = False,
    ) -> None:
        self.index, self.shape, self.links, self.batch, self.clock = index, shape, links, batch, clock
        self.node_state = NodeState(index, shape)
        self.ended = False
        parent = tree_parent(index)
        self._parent = HOST if parent is None else parent
        self._children = tree_children(index, shape)
        self._programs = programs
        self._surfaces: deque[tuple[Link, Arrival]] = deque()
        self._branches: dict[int, list[Branch]] = {}
        self._wave: dict[str, Any] | None = None
        self._answers: list[dict[str, Any]] = []
        self._deadline = 0.0
        self.reductions = Reductions(links, self._parent, self._children)
        self._received = self._handed_on = 0
        self._halted = self._built = False
        self.refused: Counter[str] = Counter()
        self.cpu_at_frame = 0.0
        self.node_state.tuning[TUNE_FLUSH], self.node_state.tuning[TUNE_BATCH] = min(USUAL_FLUSH, batch), batch
        self._link_table: NativeLinkTable | None = None
        self._ports = list(links.items())
        self.choked = self._up = False
        self.phase = "idle"  # load, trace, collect or idle: for the probes

    # --- the thin loop's three calls ---------------------------------------------------------------

    def receive(self, port: int) -> None:
        """Take in what a link has. Raises ProtocolError if the link itself is broken."""
        link = self.links[port]
        while (arrival := link.receive()) is not None:
            if arrival.kind == MessageKind.PACKETS:
                self._take_packets(port, link, arrival)
            elif arrival.kind == MessageKind.SURFACES:
                self._surfaces.append((link, arrival))
            elif arrival.kind == MessageKind.DOWN and port == self._parent:
                self._begin_wave(read_order(arrival.message))
            elif arrival.kind == MessageKind.UP and port in self._children:
                self._answers.append(read_order(arrival.message))
            elif arrival.kind == MessageKind.TALLY and port == self._parent:
                self._begin_reduction(arrival.message)
            elif arrival.kind == MessageKind.TALLIED and port in self._children:
                self.reductions.hear(port, arrival.message)
            else:
                self._take_other(port, link, arrival)

    def _take_other(self, port: int, link: Link, arrival: Arrival) -> None:
        """A message that only processors of another sort take. Raises ProtocolError."""
        raise ProtocolError(f"link {link.name}: {arrival.kind.name} came on a port where it cannot come from")

    def wire(self, link_table: NativeLinkTable) -> None:
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
        if self._surfaces:
            self._take_surfaces()
        if self.node_state.increments.pending:
            self._hand_on()
        if self.node_state.has_work or (self._link_table is not None and self.node_state.frame is not None):
            self._trace(wait and self._may_wait)
        self._flush()
        if self._wave is not None:
            self._maybe_answer()
        elif self.reductions.pending:
            self.reductions.maybe_answer(self.clock(), self._idle, self._own_sums)
        return self.busy

    def _trace(self, wait: bool) -> None:
        """Work on packets, those too that come meanwhile over links that compiled code serves."""
        if self._link_table is None:
            self._work_on_packets(wait)
            return
        self._lend_reduction(self._link_table)
        port = self._link_table.end(self._work_on_packets(wait))
        if port is not None:
            self.receive(port)

    def _work_on_packets(self, wait: bool) -> int:
        """What a program raises is refused, with the packets that it was working on. Returns why work ended."""
        try:
            return self.node_state.work(wait)
        except Exception as error:
            if self.node_state.program is None:
                raise
            name = self.node_state.program.program.name
            self._refuse(f"node {self.index}: the program {name} raises: {type(error).__name__}: {error}")
            self.node_state.forget_frame()
            self._halted = True
            return BATCH_IDLE

    @property
    def _may_wait(self) -> bool:
        """Whether nothing but a message can give this node more to do than packets."""
        answers = self._wave is not None and len(self._answers) == len(self._children)
        return not (answers or self.choked or self._is_occupied)

    @property
    def _is_occupied(self) -> bool:
        """Whether this node has something to do of which compiled code knows nothing."""
        return bool(self._surfaces or self.node_state.increments.pending) or self.node_state.collecting >= 0

    @property
    def busy(self) -> bool:
        """Whether `work` has something to do now."""
        held = self._surfaces or self.node_state.increments.pending
        return self.node_state.has_work or (bool(held) and not self._clogged())

    def wait_limit(self) -> float | None:
        """Seconds after which `work` must be called even if nothing arrives; None: never."""
        if self.reductions.waits_for_node:
            return self.reductions.left(self.clock())
        if self._wave is None or not self._deadline:
            return None
        return max(0.0, self._deadline - self.clock())

    # --- packets -----------------------------------------------------------------------------------

    def _take_packets(self, port: int, link: Link, arrival: Arrival) -> None:
        link.grant()
        if self._halted:
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

    def _flush(self) -> None:
        """Send the outputs that are full enough, all of them when there is nothing else to do."""
        outputs = self.node_state.outputs
        held = outputs.held.tolist()
        least = int(self.node_state.tuning[TUNE_FLUSH]) if self.node_state.has_work else 1
        self.choked = False
        for port, link in self._ports:
            if link.queued or link.urgent:
                link.push()
                self.choked = self.choked or link.choked
            if held[port] >= least:
                link.send_packets(outputs.data[port], held[port], self.batch)
                outputs.held[port] = 0

    # --- surfaces ----------------------------------------------------------------------------------

    def _clogged(self) -> bool:
        return any(link.waiting > CLOGGED for link in self.links.values())

    def _take_surfaces(self) -> None:
        """Retain and hand on; the credit goes back only now, so a slow branch slows the flood, not the memory."""
        while self._surfaces and not self._clogged():
            link, arrival = self._surfaces.popleft()
            link.grant()
            if self._halted:
                continue
            space, cell = self.node_state.space, self.node_state.cell
            if space is None or cell is None or self._built:
                self._refuse(
                    f"link {link.name}: surfaces came " + ("after the order to build" if space else "before a space")
                )
                continue
            try:
                corner, batch = read_surfaces(arrival.message, arrival.items)
                self.node_state.check_known(batch)
            except ProtocolError as error:
                self._refuse(f"link {link.name}: {error}")
                continue
            self._received += len(batch)
            placed = self.node_state.increments.place(batch)
            boxes = placed.bounds()
            try:
                ways = self._ways(corner, batch, placed, boxes)
            except ProtocolError as error:
                self._refuse(f"link {link.name}: {error}")
                continue
            if placed is batch:
                self.node_state.retain(batch, boxes)
            else:
                self.node_state.retain(placed, boxes, batch)
            for way in ways:
                self._handed_on += len(way.batch)
                self._send_surfaces(corner, way)

    def _ways(self, corner: int, batch: Batch, placed: Batch, boxes: NDArray[np.float64]) -> list[Path]:
        """To whom descriptions go on: along the corner's tree, or after a motion along that of their owners."""
        space, cell = self.node_state.space, self.node_state.cell
        assert space is not None and cell is not None
        if corner == MOVED:
            return self.node_state.increments.relay(batch, placed, boxes, space, cell)
        if corner not in self._branches:
            self._branches[corner] = branches(corner, space, cell)
        onward = [Path(b.port, batch.select(meets(placed, b.low, b.high, boxes))) for b in self._branches[corner]]
        return [way for way in onward if len(way.batch)]

    def _hand_on(self) -> None:
        """Send descriptions that a motion has brought to other cells."""
        pending = self.node_state.increments.pending
        while pending and not self._clogged():
            self._send_surfaces(MOVED, pending.popleft())

    def _send_surfaces(self, corner: int, way: Path) -> None:
        payload = pack_surfaces(corner, way.batch)
        self.links[way.port].send_data(MessageKind.SURFACES, len(way.batch), payload)

    # --- waves -------------------------------------------------------------------------------------

    def _begin_wave(self, order: dict[str, Any]) -> None:
        self._refuse_second_wave()
        self._wave, self._answers = order, []
        for port in self._children:
            self.links[port].send_order(MessageKind.DOWN, order)
        hold = order.get("hold", 0.0)
        self._deadline = self.clock() + hold if isinstance(hold, float) and 0.0 < hold <= 60.0 else 0.0
        try:
            self._obey(order)
        except ProtocolError as error:
            self._refuse(f"node {self.index}: {error}")

    def _refuse_second_wave(self) -> None:
        if self._wave is not None or self.reductions.pending:
            raise ProtocolError(f"node {self.index}: a wave came before the last one was answered")

    def _obey(self, order: dict[str, Any]) -> None:
        do = order.get("do")
        self.phase = PHASES.get(str(do), self.phase)
        if do == "space":
            self.node_state.set_space(read_space(order, self.shape))
            self._halted = self._built = False
            self._branches = {}
            self._received = self._handed_on = 0
            self.refused.clear()
        elif do in ("build", "frame", "groups", "move", "hand") and self.node_state.space is None:
            raise ProtocolError(f"the order {do!r} came before a space")
        elif do in ("trace", "collect") and self.node_state.frame is None:
            raise ProtocolError(f"the order {do!r} came before a frame")
        elif do == "program":
            self.node_state.ready = ready_program(order, self._programs)
        elif do == "use":
            self.node_state.use_ready()
        elif do == "groups":
            self.node_state.increments.set_groups(order)
        elif do == "move":
            self._halted = self._built = False
            self.node_state.move(order)
        elif do == "hand":
            self._handed_on += self.node_state.increments.hand()
        elif do == "build":
            self.node_state.build()
            self._built = True
        elif do == "frame":
            self.cpu_at_frame = time.process_time()
            self.node_state.set_frame(read_frame(order))
            for link in self.links.values():
                link.forget_peaks()
            self._halted = False
        elif do == "trace":
            quota = order.get("quota")
            if type(quota) is not int or not 0 <= quota < 2**32:
                raise ProtocolError(f"a quota came as {quota!r}, wanted a whole number")
            self._admit(quota, *self._read_tuning(order))
        elif do == "collect":
            self.node_state.collecting = 0
        elif do == "halt":
            self._halt()
        elif do not in ("ready", "loaded", "report", "end"):
            raise ProtocolError(f"an order came as {do!r}, wanted one that this node knows")

    def _halt(self) -> None:
        self.node_state.forget_frame()
        self.node_state.increments.give_up()
        for link in self.links.values():
            link.give_up()
        self.refused.clear()
        self._halted = True

    def _read_tuning(self, order: dict[str, Any]) -> tuple[int, int, int]:
        """(gather, nap in microseconds, flush): how eagerly to take turns and to send. Raises ProtocolError."""
        gather, linger, flush = order.get("gather", 0), order.get("linger", 0.0), order.get("flush", USUAL_FLUSH)
        if type(gather) is not int or type(flush) is not int or not isinstance(linger, float) or not 0 <= linger <= 1:
            raise ProtocolError(
                f"gather, linger and flush came as {gather!r}, {linger!r}, {flush!r}, wanted packets, seconds, packets"
            )
        return gather, int(linger * 1e6), flush

    def _admit(self, quota: int, gather: int, nap: int, flush: int) -> None:
        """Let more primaries be born, and set the pace: see `Driver`."""
        tuning = self.node_state.tuning
        self.node_state.quota = max(self.node_state.quota, quota)
        tuning[TUNE_LEAST], tuning[TUNE_BACK_OFF], tuning[TUNE_FLUSH] = (
            gather,
            nap // BACK_OFFS,
            max(1, min(flush, self.batch)),
        )

    def _maybe_answer(self) -> None:
        """Answer the wave once the children have and this node is ready to."""
        if self._wave is None or len(self._answers) < len(self._children):
            return
        do = self._wave.get("do")
        # a held wave waits for idleness, so that waves are rare under load and quick at the end
        if self._deadline and self.clock() < self._deadline and not self._idle():
            return
        if not self._up and any(link.state is LinkPhase.NEW for link in self.links.values()):
            return
        self._up = True
        answer = self._own_answer(str(do))
        for other in self._answers:
            add_answer(answer, other)
        answer["wave"] = self._wave.get("wave")
        self._wave, self._deadline = None, 0.0
        self.links[self._parent].send_order(MessageKind.UP, answer)
        if do == "end":
            self.ended = True
            for link in self.links.values():
                link.close()

    def _idle(self) -> bool:
        return not self.busy and not self._surfaces and all(link.waiting == 0 for link in self.links.values())

    def _own_answer(self, do: str) -> dict[str, Any]:
        answer: dict[str, Any] = {"sums": self._own_sums().astype("<i8").tobytes(), "nodes": []}
        answer["refusals"] = [f"{why} ({times} times)" for why, times in self.refused.most_common(3)]
        if do == "report":
            answer["nodes"] = [self.record()]
        return answer

    def _own_sums(self) -> NDArray[np.int64]:
        """What this node adds to the sums of a wave."""
        node_state, sums = self.node_state, np.zeros(SUMS, np.int64)
        sums[:COUNTS] = node_state.counts
        sums[HOMES_LEFT] = node_state.samples_left
        sums[SUM_WAITING] = node_state.work_queues.held + node_state.outputs.held.sum()
        sums[SUM_RECEIVED], sums[HANDED_ON], sums[COLLECTING] = (
            self._received,
            self._handed_on,
            node_state.collecting >= 0,
        )
        sums[REFUSED] = sum(self.refused.values())
        sums[ALLOWED] = node_state.quota if node_state.samples_left else 0
        sums[SUM_DATA_SENT] = sum(link.data_sent for link in self.links.values())
        sums[SUM_DATA_DONE] = sum(link.data_done for link in self.links.values())
        return sums

    # --- tallies -----------------------------------------------------------------------------------

    def _begin_reduction(self, message: bytes) -> None:
        self._refuse_second_wave()
        _, quota, _, gather, nap, flush = self.reductions.begin(message, self.clock())
        if self.node_state.frame is None:
            self._refuse(f"node {self.index}: the order 'trace' came before a frame")
            return
        self._admit(quota, gather, nap, flush)

    def _lend_reduction(self, link_table: NativeLinkTable) -> None:
        """Let compiled code take care of tallies while no other wave is under way."""
        known = self.reductions.reduction_state.known
        known[SUM_RECEIVED], known[HANDED_ON], known[COLLECTING] = (
            self._received,
            self._handed_on,
            self.node_state.collecting >= 0,
        )
        known[REFUSED] = sum(self.refused.values())
        strange = [link for port, link in self._ports if not link_table.keeps(port)]
        known[SUM_DATA_SENT] = sum(link.data_sent for link in strange)
        known[SUM_DATA_DONE] = sum(link.data_done for link in strange)
        queued = any(link.waiting for link in self.links.values())
        link_table.begin(self._wave is None and not self._halted, self._is_occupied or queued)

    def record(self) -> dict[str, Any]:
        """What this node says of itself, JSON-able."""
        return record_of(self)
