"""The links that compiled code serves (`node.runtime.event_loop`), as Python sees them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from raygrid.node.links import zmq_c_api
from raygrid.node.links.link import REGULAR, SOCKET, Link
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.runtime.event_loop import PYTHON_RECEIVES
from raygrid.node.runtime.native_links import TIMED, no_native_links
from raygrid.node.runtime.reduction import CHILD_PORTS, COMPILED_SERVES, PARENT_PORT, PYTHON_BUSY, Reduction


class NativeLinkTable:
    """Links over PAIR sockets of this process.

    wires   their tables, for `rounds.go`
    """

    def __init__(
        self,
        links: Mapping[int, Link],
        pairs: Mapping[int, ZmqChannel],
        reduction_state: Reduction,
        others: Iterable[int] = (),
        timed: bool = False,
    ) -> None:
        """Take over the books of the links whose channels are these pairs.

        tally  of the node; others  descriptors for which a node waits as well; timed  let the rounds be timed
        """
        self.native = no_native_links(reduction_state)
        self._links: dict[int, Link] = {}
        self._pairs = pairs
        self._message: zmq_c_api.ReceivedMessage | None = None
        calls = zmq_c_api.find_functions()
        if calls is None:
            return
        self.native.calls[:] = calls
        self.native.spent[TIMED] = timed
        self._message = zmq_c_api.ReceivedMessage(self.native.calls)
        for port, link in links.items():
            if link.channel is pairs.get(port):
                link.share_state(self.native.link_states[port])
                self.native.link_states[port, SOCKET] = pairs[port].socket.underlying
                self._links[port] = link
        items = zmq_c_api.poll_items([int(pair.socket.underlying) for pair in pairs.values()], others)
        ports = [port if port in self._links else -1 for port in pairs]
        self.native = self.native._replace(
            items=items, ports=np.array(ports + [-1] * (len(items) - len(ports)), np.int64)
        )

    def begin(self, reductions: bool, occupied: bool) -> None:
        """Before rounds: mark the links that are regular, and whether compiled code may take care of tallies.

        tallies   whether Python leaves them to it, if their links are regular; occupied  as in `Reduction`
        """
        regular = 0
        for port, link in self._links.items():
            self.native.link_states[port, REGULAR] = link.regular
            regular |= link.regular << port
        state = self.native.reduction_state.state
        wanted = int(state[CHILD_PORTS]) | 1 << int(state[PARENT_PORT])
        state[COMPILED_SERVES], state[PYTHON_BUSY] = reductions and regular & wanted == wanted, occupied

    def end(self, why: int) -> int | None:
        """After rounds that ended for this reason: the port of a link of which Python must receive, if there is one."""
        for link in self._links.values():
            link.grant(0)  # credit that could not be told
        if why < PYTHON_RECEIVES:
            return None
        assert self._message is not None
        port = why - PYTHON_RECEIVES
        self._pairs[port].put_back(self._message.copy(), self._message.has_more)
        return port

    @property
    def is_on(self) -> bool:
        """Whether compiled code serves any link."""
        return bool(self._links)

    def keeps(self, port: int) -> bool:
        """Whether the book of a link is one of the tables."""
        return port in self._links

    def serves(self, port: int) -> bool:
        """Whether compiled code would receive what comes at a port now."""
        link = self._links.get(port)
        return link is not None and link.regular

    def close(self) -> None:
        """Serve no link any more."""
        self._links = {}
        self.native.link_states[:, REGULAR] = 0
        if self._message is not None:
            self._message.close()
            self._message = None
