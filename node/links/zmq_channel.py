"""Carries messages over ZeroMQ PAIR sockets. What their settings rest on is in docs/design.md (links).

An endpoint is never used twice: names carry the epoch. Heartbeats stay off (they can abort the survivor of a
dead peer); a message is one part, because endless multipart evades every limit; sends never block.
"""

from __future__ import annotations

import zmq

from raygrid.node.errors import ProtocolError
from raygrid.node.protocol.messages import MAX_MESSAGE, WINDOW

# as plain numbers: looking an enum member up costs more than the call
NOBLOCK, EVENTS, POLLIN, RCVMORE = int(zmq.NOBLOCK), int(zmq.EVENTS), int(zmq.POLLIN), int(zmq.RCVMORE)
RECONNECT_MS = 2  # the connecting end may be there before the binding one


class ZmqChannel:
    """A PAIR socket that carries whole messages (see `node.links.link.Channel`)."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], endpoint: str, bind: bool) -> None:
        self.endpoint = endpoint
        self._put_back: tuple[bytes, bool] | None = None
        self.socket = context.socket(zmq.PAIR)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.MAXMSGSIZE, MAX_MESSAGE)
        # above the link's own window, so that ZeroMQ's back-pressure never acts on data
        self.socket.setsockopt(zmq.SNDHWM, 4 * WINDOW)
        self.socket.setsockopt(zmq.RCVHWM, 4 * WINDOW)
        self.socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        try:
            if bind:
                self.socket.bind(endpoint)
            else:
                self.socket.connect(endpoint)
        except zmq.ZMQError:
            self.close()
            raise

    def send(self, message: bytes | memoryview) -> bool:
        """Hand over a message without blocking; False if there is no room now."""
        try:
            self.socket.send(message, NOBLOCK)
        except zmq.Again:
            return False
        return True

    def receive(self) -> bytes | None:
        """The next message, or None. Raises ProtocolError for a message of several parts."""
        if self._put_back is not None:
            (message, more), self._put_back = self._put_back, None
        elif not int(self.socket.getsockopt(EVENTS)) & POLLIN:  # cheaper than the exception that says so
            return None
        else:
            message, more = self.socket.recv(NOBLOCK), bool(self.socket.getsockopt(RCVMORE))
        if more:
            raise ProtocolError(f"{self.endpoint}: a message of several parts came, wanted one")
        return message

    def put_back(self, message: bytes, more: bool) -> None:
        """Let this message, which was received by other means, be the next one; `more`: if it is but a part."""
        self._put_back = message, more

    def close(self) -> None:
        """Close at once; the link has said its goodbyes."""
        self.socket.close(0)
