"""Advances the horizon of a node by look-ahead requests: its own to its neighbours, and theirs to it.

Null messages alone (Chandy and Misra; Bryant) make idle neighbours push each other's channel clocks forward by a
lookahead at a time, which takes thousands of messages where one node has work and the others have none. So a channel
clock here comes with the answer to a request, and the answer knows who asks.

A node that may not decide yet at tick T asks those neighbours whose channel clocks stand at T or before: "will anything
arrive here at T or before, if I send nothing more?" A node h hops away from the origin of a request can only matter by a
decision at T - h * lookahead or before, its limit. It

    - waits until its own next decision, as far as it is known, lies behind its limit,
    - asks those of its other neighbours whose channel clocks do not reach behind its limit,
    - answers YES when they have, or NO if it has meanwhile decided something before its limit after all.

A request that comes by a second way is answered YES at once: the origin waits for the first answer anyway. If all
answers are YES nothing arrives at the origin at T or before. Why: the earliest decision that contradicts would have
been brought about by a packet from a neighbour, decided before the neighbour's own limit: then that neighbour was
not yet part of the request, but its answer came after the packet on the same link, and the packet was seen; or it
was, and answered NO. The node whose next decision is the earliest of all finds nobody who must wait, so somebody can
always go on. On NO the origin asks again, but then somebody has gone on.

This is the carrier of a null message (W. Cai and S. J. Turner, "An algorithm for distributed discrete-event simulation:
the carrier null message approach", 1990) in a grid, where all paths are known beforehand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from raygrid.node.protocol.timestamps import ASK, LAST_TICK, NO, YES, LookaheadRequest

Index = tuple[int, int, int]
Post = Callable[[int, LookaheadRequest], None]


@dataclass
class PendingRequest:
    """A request of another node that this one takes part in. limit: see the module."""

    number: int
    tick: int
    limit: int
    parent: int
    waiting: set[int]
    failed: bool = False
    answered: bool = False


@dataclass
class Lookahead:
    """Handles all look-ahead requests of a node in one frame.

    ports    of the neighbours
    post     sends a request by a port; its channel clock is filled in there
    decision the node's next decision as far as it is known (`node.timed.service_clock.decides`)
    bound    of each port: nothing arrives by it before this tick, as channel clock and answers tell
    """

    index: Index
    frame: int
    lookahead: int
    ports: list[int]
    post: Post
    decision: Callable[[], int]
    bound: dict[int, int]
    number: int = 0
    tick: int = -1  # of the own request that is not answered yet
    waiting: set[int] = field(default_factory=set)
    failed: bool = False
    held: list[tuple[int, LookaheadRequest]] = field(default_factory=list)
    pending: dict[Index, PendingRequest] = field(default_factory=dict)

    def horizon(self) -> int:
        """The tick before which nothing that is not here can arrive."""
        return min(self.bound.values(), default=LAST_TICK)

    def ask(self, tick: int) -> None:
        """Ask the neighbours about a tick at which the node may not decide yet, unless it has done so."""
        if tick == self.tick:
            return
        self.number += 1
        self.tick, self.failed = tick, False
        self.waiting = {port for port in self.ports if self.bound[port] <= tick}
        for port in self.waiting:
            self.post(port, LookaheadRequest(self.frame, ASK, self.index, self.number, tick, 0))

    def take(self, port: int, request: LookaheadRequest) -> None:
        """Take in a request or an answer that came by a port."""
        if request.answer == ASK:
            self.held.append((port, request))
            return
        if request.origin == self.index:
            self._own_answer(port, request)
            return
        found = self.pending.get(request.origin)
        if found is not None and found.number == request.number and port in found.waiting:
            found.waiting.discard(port)
            found.failed = found.failed or request.answer == NO
            self._maybe_answer(request.origin, found)

    def _own_answer(self, port: int, request: LookaheadRequest) -> None:
        if request.number != self.number or port not in self.waiting:
            return
        self.waiting.discard(port)
        self.failed = self.failed or request.answer == NO
        if self.waiting:
            return
        if not self.failed:
            for other in self.ports:
                self.bound[other] = max(self.bound[other], self.tick + 1)
        self.tick = -1

    def decided(self, first: int) -> None:
        """Note that the node has carried out decisions, the first at this tick."""
        for found in self.pending.values():
            if not found.answered and first <= found.limit:
                found.failed = True
        if self.tick >= 0 and first <= self.tick:
            self.tick, self.number = -1, self.number + 1  # what is answered now is answered to nobody

    def handle_requests(self) -> None:
        """Take part in the requests that came, as far as the node's own next decision allows."""
        held, self.held = self.held, []
        for port, request in held:
            self._consider(port, request)

    def _consider(self, port: int, request: LookaheadRequest) -> None:
        found = self.pending.get(request.origin)
        if request.origin == self.index or (found is not None and found.number == request.number):
            self.post(port, request._replace(answer=YES))
            return
        if found is not None and (found.number - request.number) & 0xFFFFFFFF < 1 << 31:
            self.post(port, request._replace(answer=NO))  # the origin asks something else by now
            return
        hops = sum(abs(here - there) for here, there in zip(self.index, request.origin, strict=True))
        limit = request.tick - hops * self.lookahead
        if self.decision() <= limit:
            self.held.append((port, request))
            return
        waiting = {other for other in self.ports if other != port and self.bound[other] <= limit}
        pending = PendingRequest(request.number, request.tick, limit, port, waiting)
        self.pending[request.origin] = pending
        for other in waiting:
            self.post(other, request)
        self._maybe_answer(request.origin, pending)

    def _maybe_answer(self, origin: Index, found: PendingRequest) -> None:
        if found.waiting or found.answered:
            return
        found.answered = True
        sure = not found.failed and self.decision() > found.limit
        self.post(found.parent, LookaheadRequest(self.frame, YES if sure else NO, origin, found.number, found.tick, 0))
