"""Holds the host's ends of the control channels: the reset line down, what nodes say of themselves up (law 9)."""

from __future__ import annotations

import select

from raygrid.emulator.processes.control import Message
from raygrid.emulator.topology.coordinates import Index
from raygrid.node.links import ControlChannel


class ControlChannels:
    """Keeps all control channels of an array, by the nodes' coordinates. `fileno` can be polled for all of them at once."""

    def __init__(self) -> None:
        self._channels: dict[Index, ControlChannel] = {}
        self._index_of: dict[int, Index] = {}
        self._epoll = select.epoll()
        self.refused = 0  # messages that were none, of channels that are closed by now too

    def fileno(self) -> int:
        """Readable when a node has said something."""
        return self._epoll.fileno()

    def add(self, index: Index, descriptor: int) -> None:
        """Take over the descriptor of a new node's channel, instead of any that there was."""
        self.remove(index)
        self._channels[index] = ControlChannel(descriptor)
        self._index_of[descriptor] = index
        self._epoll.register(descriptor, select.EPOLLIN)

    def remove(self, index: Index) -> None:
        """Close the channel to a node that is gone."""
        channel = self._channels.pop(index, None)
        if channel is not None:
            self.refused += channel.refused
            self._unwatch(channel)
            channel.close()

    def send(self, index: Index, message: Message) -> bool:
        """Say something to a node; False if there is no room, or nobody."""
        channel = self._channels.get(index)
        return channel is not None and channel.send(message)

    def receive(self) -> list[tuple[Index, Message]]:
        """What the nodes have said, with who said it; without waiting."""
        received: list[tuple[Index, Message]] = []
        for descriptor, _ in self._epoll.poll(0):
            index = self._index_of[descriptor]
            channel = self._channels[index]
            while (message := channel.receive()) is not None:
                received.append((index, message))
            if channel.closed:  # the fork server tells of the end; this would stay readable for ever
                self._unwatch(channel)
        return received

    def close(self) -> None:
        """Close all."""
        for index in list(self._channels):
            self.remove(index)
        self._epoll.close()

    def _unwatch(self, channel: ControlChannel) -> None:
        if self._index_of.pop(channel.fileno(), None) is not None:
            self._epoll.unregister(channel.fileno())
