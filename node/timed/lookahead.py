"""How far a node may go: questions to its neighbours, and theirs to it.

Null messages alone (Chandy and Misra; Bryant) make idle neighbours push each other's promises forward by a lookahead
at a time, which takes thousands of messages where one node has work and the others have none. So a promise here comes
as the answer to a question, and the answer knows who asks.

A node that may not decide yet at tick T asks those neighbours whose promises end at T or before: "will anything arrive
here at T or before, if I send nothing more?" A node h hops away from the origin of a question can only matter by a
decision at T - h * lookahead or before, its limit. It

    - waits until its own next decision, as far as it is known, lies behind its limit,
    - asks those of its other neighbours whose promises do not reach behind its limit,
    - answers YES when they have, or NO if it has meanwhile decided something before its limit after all.

A question that comes by a second way is answered YES at once: the origin waits for the first answer anyway. If all
answers are YES nothing arrives at the origin at T or before. Why: the earliest decision that contradicts would have
been brought about by a packet from a neighbour, decided before the neighbour's own limit: then that neighbour was
not yet part of the question, but its answer came after the packet on the same link, and the packet was seen; or it
was, and answered NO. The node whose next decision is the earliest of all finds nobody who must wait, so somebody can
always go on. On NO the origin asks again, but then somebody has gone on.

This is the carrier of a null message (W. Cai and S. J. Turner, "An algorithm for distributed discrete-event simulation:
the carrier null message approach", 1990) in a grid, where all ways round are known beforehand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from raygrid.node.protocol.timestamps import ASK, LAST_TICK, NO, YES, LookaheadRequest

Index = tuple[int, int, int]
Post = Callable[[int, LookaheadRequest], None]


@dataclass
class PendingRequest:
    """A question of another node that this one takes part in. limit: see the module."""

    number: int
    tick: int
    limit: int
    parent: int
    waiting: set[int]
    failed: bool = False
    answered: bool = False


@dataclass
class Lookahead:
    """All questions that a node has to do with, in one frame.

    ports    of the neighbours
    post     sends an enquiry by a port; its promise is filled in there
    decision the node's next decision as far as it is known (`node.timed.service_clock.decides`)
    bound    of each port: nothing arrives by it before this tick
    """

    index: Index
    frame: int
    lookahead: int
    ports: list[int]
    post: Post
    decision: Callable[[], int]
    bound: dict[int, int]
    number: int = 0
    tick: int = -1  # of the own question that is not answered yet
    waiting: set[int] = field(default_factory=set)
    failed: bool = False
    held: list[tuple[int, LookaheadRequest]] = field(default_factory=list)
    engaged: dict[Index, PendingRequest] = field(default_factory=dict)

    def horizon(self) -> int:
        """Nothing that is not here can arrive before this tick."""
        return min(self.bound.values(), default=LAST_TICK)

    def ask(self, tick: int) -> None:
        """The node may not decide yet at this tick: ask, unless it has done so."""
        if tick == self.tick:
            return
        self.number += 1
        self.tick, self.failed = tick, False
        self.waiting = {port for port in self.ports if self.bound[port] <= tick}
        for port in self.waiting:
            self.post(port, LookaheadRequest(self.frame, ASK, self.index, self.number, tick, 0))

    def take(self, port: int, lookahead_request: LookaheadRequest) -> None:
        """A question or an answer came by a port."""
        if lookahead_request.answer == ASK:
            self.held.append((port, lookahead_request))
            return
        if lookahead_request.origin == self.index:
            self._own_answer(port, lookahead_request)
            return
        found = self.engaged.get(lookahead_request.origin)
        if found is not None and found.number == lookahead_request.number and port in found.waiting:
            found.waiting.discard(port)
            found.failed = found.failed or lookahead_request.answer == NO
            self._maybe_answer(lookahead_request.origin, found)

    def _own_answer(self, port: int, lookahead_request: LookaheadRequest) -> None:
        if lookahead_request.number != self.number or port not in self.waiting:
            return
        self.waiting.discard(port)
        self.failed = self.failed or lookahead_request.answer == NO
        if self.waiting:
            return
        if not self.failed:
            for other in self.ports:
                self.bound[other] = max(self.bound[other], self.tick + 1)
        self.tick = -1

    def decided(self, first: int) -> None:
        """The node has carried out decisions, the first at this tick."""
        for found in self.engaged.values():
            if not found.answered and first <= found.limit:
                found.failed = True
        if self.tick >= 0 and first <= self.tick:
            self.tick, self.number = -1, self.number + 1  # what is answered now is answered to nobody

    def turn(self) -> None:
        """Take part in the questions that came, as far as the node's own next decision allows."""
        held, self.held = self.held, []
        for port, lookahead_request in held:
            self._consider(port, lookahead_request)

    def _consider(self, port: int, lookahead_request: LookaheadRequest) -> None:
        found = self.engaged.get(lookahead_request.origin)
        if lookahead_request.origin == self.index or (found is not None and found.number == lookahead_request.number):
            self.post(port, lookahead_request._replace(answer=YES))
            return
        if found is not None and (found.number - lookahead_request.number) & 0xFFFFFFFF < 1 << 31:
            self.post(port, lookahead_request._replace(answer=NO))  # the origin asks something else by now
            return
        hops = sum(abs(here - there) for here, there in zip(self.index, lookahead_request.origin, strict=True))
        limit = lookahead_request.tick - hops * self.lookahead
        if self.decision() <= limit:
            self.held.append((port, lookahead_request))
            return
        waiting = {other for other in self.ports if other != port and self.bound[other] <= limit}
        engagement = PendingRequest(lookahead_request.number, lookahead_request.tick, limit, port, waiting)
        self.engaged[lookahead_request.origin] = engagement
        for other in waiting:
            self.post(other, lookahead_request)
        self._maybe_answer(lookahead_request.origin, engagement)

    def _maybe_answer(self, origin: Index, found: PendingRequest) -> None:
        if found.waiting or found.answered:
            return
        found.answered = True
        sure = not found.failed and self.decision() > found.limit
        self.post(found.parent, LookaheadRequest(self.frame, YES if sure else NO, origin, found.number, found.tick, 0))
