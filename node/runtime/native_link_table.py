"""Lends the links that compiled code serves (`node.runtime.event_loop`) to it, and takes back what it leaves to Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from raygrid.node.links import zmq_c_api
from raygrid.node.links.link import Link, LinkState
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.runtime.event_loop import PYTHON_RECEIVES
from raygrid.node.runtime.native_links import no_native_links
from raygrid.node.runtime.reduction import Reduction, ReductionState


class NativeLinkTable:
    """Links over PAIR sockets of this process.

    native  their tables, for the event loop
    """

    def __init__(
        self,
        links: Mapping[int, Link],
        pairs: Mapping[int, ZmqChannel],
        reduction: Reduction,
        others: Iterable[int] = (),
    ) -> None:
        """Share the state of the links whose channels are these pairs.

        reduction  of the node; others  descriptors for which a node waits as well
        """
        self.native = no_native_links(reduction)
        self._reduction = ReductionState.view(reduction.state)
        self._links: dict[int, Link] = {}
        self._states: dict[int, LinkState] = {}
        self._pairs = pairs
        self._message: zmq_c_api.ReceivedMessage | None = None
        found = zmq_c_api.find_functions()
        if found is None:
            return
        functions = zmq_c_api.CFunctions.view(self.native.functions)
        functions.take(found)
        self._message = zmq_c_api.ReceivedMessage(functions)
        for port, link in links.items():
            if link.channel is pairs.get(port):
                self._states[port] = link.share_state(self.native.links, port)
                self._states[port].socket = int(pairs[port].socket.underlying)
                self._links[port] = link
        items = zmq_c_api.poll_items([int(pair.socket.underlying) for pair in pairs.values()], others)
        ports = [port if port in self._links else -1 for port in pairs]
        self.native = self.native._replace(
            items=items, ports=np.array(ports + [-1] * (len(items) - len(ports)), np.int64)
        )

    def begin(self, reductions: bool, busy: bool) -> None:
        """Before the event loop: mark the links that are regular, and whether compiled code may take care of reductions.

        reductions  whether Python leaves them to it, if their links are regular; busy  `ReductionState.python_busy`
        """
        regular = 0
        for port, link in self._links.items():
            self._states[port].regular = link.regular
            regular |= link.regular << port
        state = self._reduction
        wanted = state.child_ports | 1 << state.parent_port
        state.compiled_serves, state.python_busy = reductions and regular & wanted == wanted, busy

    def end(self, why: int) -> int | None:
        """After an event loop that ended for this reason: the port of a link of which Python must receive, if there is one."""
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

    def shares(self, port: int) -> bool:
        """Whether compiled code counts in the state of a link."""
        return port in self._links

    def serves(self, port: int) -> bool:
        """Whether compiled code would receive what comes at a port now."""
        link = self._links.get(port)
        return link is not None and link.regular

    def close(self) -> None:
        """Serve no link any more."""
        self._links = {}
        for state in self._states.values():
            state.regular = 0
        if self._message is not None:
            self._message.close()
            self._message = None
