"""The host's ends of the lines to the nodes: the reset line down, what nodes say of themselves up (law 9)."""

from __future__ import annotations

import select
from typing import Any

from raygrid.emulator.topology.socket_directory import Index
from raygrid.node.links import ControlChannel

Words = dict[str, Any]


class ControlChannels:
    """All lines of an array, by the nodes' coordinates. `fileno` can be polled for all of them at once."""

    def __init__(self) -> None:
        self._lines: dict[Index, ControlChannel] = {}
        self._index_of: dict[int, Index] = {}
        self._epoll = select.epoll()
        self.refused = 0  # words that were none, of lines that are closed by now too

    def fileno(self) -> int:
        """Readable when a node has said something."""
        return self._epoll.fileno()

    def add(self, index: Index, descriptor: int) -> None:
        """Take over the descriptor of a new node's line, instead of any that there was."""
        self.remove(index)
        self._lines[index] = ControlChannel(descriptor)
        self._index_of[descriptor] = index
        self._epoll.register(descriptor, select.EPOLLIN)

    def remove(self, index: Index) -> None:
        """Close the line to a node that is gone."""
        line = self._lines.pop(index, None)
        if line is not None:
            self.refused += line.refused
            self._unwatch(line)
            line.close()

    def send(self, index: Index, words: Words) -> bool:
        """Say something to a node; False if there is no room, or nobody."""
        line = self._lines.get(index)
        return line is not None and line.send(words)

    def receive(self) -> list[tuple[Index, Words]]:
        """What the nodes have said, with who said it; without waiting."""
        heard: list[tuple[Index, Words]] = []
        for descriptor, _ in self._epoll.poll(0):
            index = self._index_of[descriptor]
            line = self._lines[index]
            while (words := line.receive()) is not None:
                heard.append((index, words))
            if line.closed:  # the nursery tells of the end; this would stay readable for ever
                self._unwatch(line)
        return heard

    def close(self) -> None:
        """Close all."""
        for index in list(self._lines):
            self.remove(index)
        self._epoll.close()

    def _unwatch(self, line: ControlChannel) -> None:
        if self._index_of.pop(line.fileno(), None) is not None:
            self._epoll.unregister(line.fileno())
