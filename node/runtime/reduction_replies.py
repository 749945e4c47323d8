"""Takes care of reductions in Python: where compiled code may not, and what it could not send."""

from __future__ import annotations

from collections.abc import Callable

from raygrid.node.errors import ProtocolError
from raygrid.node.links.link import Link
from raygrid.node.protocol.messages import MessageKind
from raygrid.node.runtime import reduction


class Reductions:
    """The reductions of one node.

    reduction  how the one stands that is under way, as compiled code sees it; state  the same in Python
    """

    def __init__(self, links: dict[int, Link], parent: int, children: list[int]) -> None:
        self.reduction = reduction.make_reduction(parent, tuple(children))
        self.state = reduction.ReductionState.view(self.reduction.state)
        self._request = reduction.TraceFields.view(self.reduction.request)
        self._links, self._children = links, children

    @property
    def pending(self) -> bool:
        """Whether one is under way here."""
        return self.state.pending != 0

    @property
    def waits_for_node(self) -> bool:
        """Whether one is under way that waits for nobody but this node."""
        return reduction.waits_for_node(self.state)

    def left(self, now: float) -> float:
        """Seconds until this node replies although it is busy."""
        return max(0.0, self.state.deadline / reduction.NANO - now)

    def begin(self, message: bytes, now: float) -> reduction.TraceFields:
        """A request has come from the parent, at `now` seconds: hand it on. Raises ProtocolError."""
        self._request.take(reduction.read_request(message))
        reduction.begin(self.state, self._request, self.reduction.sums, int(now * reduction.NANO))
        self.state.fresh = 0
        self.notify_children()
        return self._request

    def take_reply(self, port: int, message: bytes) -> None:
        """A child has replied. Raises ProtocolError if it was not asked."""
        wave, sums = reduction.read_reply(message)
        if not reduction.awaits_reply(self.state, port, wave):
            raise ProtocolError(f"a reply to wave {wave} came by port {port}, wanted none")
        self.reduction.sums[:] += sums
        self.state.replied |= 1 << port

    def notify_children(self) -> None:
        """Hand a request on to the children that have not been told of it."""
        payload = reduction.pack_fields(self._request)
        for port in self._children:
            if self.state.to_notify >> port & 1:
                self._links[port].send_payload(MessageKind.REDUCE, payload)
        self.state.to_notify = 0

    def maybe_reply(self, now: float, idle: Callable[[], bool], own_sums: Callable[[], reduction.Long]) -> None:
        """Reply once nobody else is waited for, and this node is idle or the time is up."""
        if self.state.to_notify:
            self.notify_children()
        if not self.waits_for_node or (int(now * reduction.NANO) < self.state.deadline and not idle()):
            return
        payload = reduction.pack_reply(self.state.wave, self.reduction.sums + own_sums())
        self.state.pending = 0
        self._links[self.state.parent_port].send_payload(MessageKind.REDUCED, payload)
