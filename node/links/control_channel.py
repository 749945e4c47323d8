"""Carries messages between the host and a node: the reset line on its way down, probe samples on their way up (law 9).

A control channel is a pair of unix SOCK_SEQPACKET sockets, made when the node is forked. It has no name in the file
system, so nobody but its two owners can speak on it. Messages are msgpack maps. Neither end ever blocks: messages for which
there is no room are dropped and counted, and messages that are none are refused and counted, never obeyed.
"""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import Any

from raygrid.node.errors import ProtocolError
from raygrid.node.protocol.codec import pack_map, read_map

LONGEST_CONTROL_MESSAGE = 1 << 16  # bytes


class ControlChannel:
    """One end of a control channel.

    closed   nothing more can be sent or received: the other end is gone
    dropped  messages that were not sent, because there was no room
    refused  what came and was no map, or too long
    """

    def __init__(self, descriptor: int) -> None:
        self._socket = socket.socket(fileno=descriptor)
        self._socket.setblocking(False)
        self.closed = False
        self.dropped = self.refused = 0

    def fileno(self) -> int:
        """The descriptor to poll; -1 after `close`."""
        return self._socket.fileno()

    def send(self, message: Mapping[str, object]) -> bool:
        """Send a message now; False if there is no room, or nobody to receive it. Raises ProtocolError if it is too long."""
        data = pack_map(message)
        if len(data) > LONGEST_CONTROL_MESSAGE:
            raise ProtocolError(f"a control message has {len(data)} bytes, wanted at most {LONGEST_CONTROL_MESSAGE}")
        if self.closed:
            return False
        try:
            self._socket.send(data, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            self.dropped += 1
            return False
        except OSError:  # the other end is gone: receive will find out, after what had come before
            return False
        return True

    def receive(self) -> dict[str, Any] | None:
        """The next message, None if there is none now or the channel is closed."""
        while not self.closed:
            try:
                data = self._socket.recv(LONGEST_CONTROL_MESSAGE + 1)
            except BlockingIOError:
                return None
            except OSError:
                data = b""
            if not data:
                self.closed = True
            elif len(data) > LONGEST_CONTROL_MESSAGE:
                self.refused += 1
            else:
                try:
                    return read_map(data, "a control message")
                except ProtocolError:
                    self.refused += 1
        return None

    def close(self) -> None:
        """Close this end. May be called twice."""
        self.closed = True
        self._socket.close()
