"""Carries messages inside one process: what a PAIR socket does, by two queues. For the in-memory array and the tests."""

from __future__ import annotations

from collections import deque


class MemoryChannel:
    """One end of a channel in memory."""

    def __init__(self, outgoing: deque[bytes], incoming: deque[bytes], room: int) -> None:
        self._outgoing, self._incoming, self._room = outgoing, incoming, room
        self.closed = False

    def send(self, message: bytes | memoryview) -> bool:
        """Hand over a copy of a message; False if the other end's queue is full."""
        if len(self._outgoing) >= self._room:
            return False
        self._outgoing.append(bytes(message))
        return True

    def receive(self) -> bytes | None:
        """The next message, or None if there is none now."""
        return self._incoming.popleft() if self._incoming else None

    def close(self) -> None:
        """Nothing more is handed over."""
        self.closed = True


def memory_channels(room: int = 128) -> tuple[MemoryChannel, MemoryChannel]:
    """The two ends of a channel that holds `room` messages each way."""
    one: deque[bytes] = deque()
    two: deque[bytes] = deque()
    return MemoryChannel(one, two, room), MemoryChannel(two, one, room)
