"""Carries messages between front end and fork server: msgpack maps behind a length (u32, little-endian) on a stream socket.

A message may bring descriptors along (SCM_RIGHTS). The two sides trust each other, as one started the other.
"""

from __future__ import annotations

import array
import os
import socket
from collections import deque
from collections.abc import Sequence
from typing import Any

import msgpack

from raygrid.node.errors import ProtocolError
from raygrid.node.protocol import Splitter, framed

Message = dict[str, Any]

LONGEST_MESSAGE = 1 << 28  # bytes
MOST_DESCRIPTORS = 250  # in one message; the kernel takes at most 253
INT_BYTES = array.array("i").itemsize
RIGHTS_ROOM = socket.CMSG_SPACE(MOST_DESCRIPTORS * INT_BYTES)


def close_all(descriptors: list[int]) -> None:
    """Close and forget them."""
    while descriptors:
        os.close(descriptors.pop())


class ForkServerChannel:
    """Carries messages over a stream socket, without ever blocking; both ends use it.

    closed       nothing more will come
    unsent       bytes that wait for room
    descriptors  that have come, in the order of the messages that brought them; the caller takes and closes them
    """

    def __init__(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        self.socket = stream
        self.closed = False
        self.descriptors: list[int] = []
        self._out: deque[tuple[bytearray, list[int]]] = deque()
        self._splitter = Splitter(_read, LONGEST_MESSAGE)

    @property
    def unsent(self) -> int:
        """Bytes that wait for room in the socket."""
        return sum(len(piece) for piece, _ in self._out)

    def send(self, message: Message, descriptors: Sequence[int] = ()) -> None:
        """Send now or, by later calls of flush, when there is room. Raises ProtocolError if it is too long.

        descriptors  at most MOST_DESCRIPTORS to go with the message; closed here when they are sent
        """
        body = msgpack.packb(message)
        if len(body) > LONGEST_MESSAGE:
            raise ProtocolError(
                f"a message to or from the fork server has {len(body)} bytes, at most {LONGEST_MESSAGE}"
            )
        if descriptors or not self._out or self._out[-1][1]:
            self._out.append((bytearray(), list(descriptors)))
        self._out[-1][0].extend(framed(body))
        self.flush()

    def flush(self) -> None:
        """Send what waits, as far as there is room."""
        while self._out:
            piece, descriptors = self._out[0]
            rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", descriptors))] if descriptors else []
            try:
                sent = self.socket.sendmsg([piece], rights, socket.MSG_NOSIGNAL)
            except BlockingIOError:
                return
            except (BrokenPipeError, ConnectionResetError):
                self._forget_unsent()  # receive will find the end, after what had come before it
                return
            del piece[:sent]
            close_all(descriptors)
            if not piece:
                self._out.popleft()

    def close(self) -> None:
        """Close the socket, and the descriptors that nobody took or that were not sent."""
        self._forget_unsent()
        close_all(self.descriptors)
        self.socket.close()

    def _forget_unsent(self) -> None:
        for _, descriptors in self._out:
            close_all(descriptors)
        self._out.clear()

    def receive(self) -> list[Message]:
        """All messages that have come. Raises ProtocolError if they are no messages."""
        while not self.closed:
            try:
                piece, rights, _, _ = self.socket.recvmsg(1 << 16, RIGHTS_ROOM, socket.MSG_CMSG_CLOEXEC)
            except BlockingIOError:
                break
            except ConnectionResetError:
                piece, rights = b"", []
            for _, _, data in rights:
                self.descriptors.extend(array.array("i", data[: len(data) // INT_BYTES * INT_BYTES]))
            self.closed = not piece
            self._splitter.feed(piece)
        return list(iter(self._splitter.next, None))


def _read(body: bytes) -> Message:
    # Lists come out as tuples: coordinates are then the same on both sides, and nobody changes a config.
    message = msgpack.unpackb(body, use_list=False, strict_map_key=False)
    if not isinstance(message, dict):
        raise ProtocolError(f"a message came as {type(message).__name__}, wanted a map")
    return message
