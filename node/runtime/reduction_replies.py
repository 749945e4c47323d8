"""What a processor does with tallies in Python: where compiled code may not, and what it could not send."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.links.link import Link
from raygrid.node.protocol.messages import MessageKind
from raygrid.node.runtime.reduction import (
    CHILD_PORTS,
    CURRENT,
    DEADLINE,
    FRESH,
    HOLD,
    PARENT_PORT,
    PENDING,
    REPLIED,
    TO_NOTIFY,
    WAVE,
    make_reduction,
    pack_reply,
    read_reply,
    read_request,
)

NANO = 1_000_000_000


class Reductions:
    """The tallies of one node.

    tally  how the one stands that is under way, shared with compiled code
    """

    def __init__(self, links: dict[int, Link], parent: int, children: list[int]) -> None:
        self.reduction_state = make_reduction(parent, tuple(children))
        self._links, self._children = links, children

    @property
    def pending(self) -> bool:
        """Whether one is under way here."""
        return bool(self.reduction_state.state[PENDING])

    @property
    def waits_for_node(self) -> bool:
        """Whether one is under way that waits for nobody but this node."""
        state = self.reduction_state.state
        return bool(state[PENDING] and not state[TO_NOTIFY] and state[REPLIED] == state[CHILD_PORTS])

    def left(self, now: float) -> float:
        """Seconds until this node answers although it is busy."""
        return max(0.0, int(self.reduction_state.state[DEADLINE]) / NANO - now)

    def begin(self, message: bytes, now: float) -> list[int]:
        """One has come from the parent, at `now` seconds: hand it on. Its fields. Raises ProtocolError."""
        fields, state = read_request(message), self.reduction_state.state
        self.reduction_state.order[:] = fields
        self.reduction_state.sums[:] = 0
        state[PENDING], state[CURRENT], state[REPLIED], state[TO_NOTIFY] = 1, fields[WAVE], 0, state[CHILD_PORTS]
        state[DEADLINE], state[FRESH] = int(now * NANO) + fields[HOLD], 0
        self.tell_children()
        return fields

    def hear(self, port: int, message: bytes) -> None:
        """A child has answered. Raises ProtocolError if it was not asked."""
        number, sums = read_reply(message)
        state = self.reduction_state.state
        if not state[PENDING] or number != state[CURRENT] or state[REPLIED] >> port & 1:
            raise ProtocolError(f"an answer to tally {number} came by port {port}, wanted none")
        self.reduction_state.sums[:] += sums
        state[REPLIED] |= 1 << port

    def tell_children(self) -> None:
        """Hand a tally on to the children that have not been told of it."""
        state, payload = self.reduction_state.state, self.reduction_state.order.astype("<i8").tobytes()
        for port in self._children:
            if state[TO_NOTIFY] >> port & 1:
                self._links[port].send_words(MessageKind.TALLY, payload)
        state[TO_NOTIFY] = 0

    def maybe_answer(self, now: float, idle: Callable[[], bool], own: Callable[[], NDArray[np.int64]]) -> None:
        """Answer once nobody else is waited for, and this node is idle or the time is up. own: this node's sums."""
        state = self.reduction_state.state
        if state[TO_NOTIFY]:
            self.tell_children()
        if not self.waits_for_node or (int(now * NANO) < state[DEADLINE] and not idle()):
            return
        payload = pack_reply(int(state[CURRENT]), self.reduction_state.sums + own())
        state[PENDING] = 0
        self._links[int(state[PARENT_PORT])].send_words(MessageKind.TALLIED, payload)
