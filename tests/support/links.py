"""Two ends of a link over both transports, and channels that meddle with what passes, for the tests."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import zmq

from raygrid.node.links.link import Arrival, Channel, Link, LinkPhase
from raygrid.node.links.memory_channel import memory_channels
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.protocol.messages import HEADER, IS_DATA, WINDOW
from support.messages import sealed

LEFT = {"machine": "m", "node": [0, 0, 0], "port": 1}
RIGHT = {"machine": "m", "node": [1, 0, 0], "port": 0}
TURNS = 5000  # after so many a talk is taken to hang


class Wire:
    """Both ends of one channel; `wait` waits a while until something has come to either end, or to one of them."""

    def __init__(self, ends: tuple[Channel, Channel], wait: Callable[..., None]) -> None:
        self.ends, self.wait = ends, wait

    def next(self, end: int) -> bytes:
        """The next message at one end, of whoever sent it."""
        for _ in range(TURNS):
            message = self.ends[end].receive()
            if message is not None:
                return message
            self.wait(end)
        pytest.fail("no message crossed the channel")


@contextmanager
def memory_wire() -> Iterator[Wire]:
    """Two queues."""
    yield Wire(memory_channels(), lambda end=None: None)


@contextmanager
def zeromq_wire() -> Iterator[Wire]:
    """Two PAIR sockets over ipc, as nodes have them."""
    directory = tempfile.mkdtemp(prefix="rgtest-", dir="/tmp")
    context: zmq.Context[Any] = zmq.Context(io_threads=1)
    try:
        ends = (ZmqChannel(context, f"ipc://{directory}/0", True), ZmqChannel(context, f"ipc://{directory}/0", False))

        def wait(end: int | None = None) -> None:
            poller = zmq.Poller()
            for one in ends if end is None else (ends[end],):
                poller.register(one.socket, zmq.POLLIN)
            poller.poll(50)

        yield Wire(ends, wait)
    finally:
        context.destroy(linger=0)
        shutil.rmtree(directory)


WIRES = {"memory": memory_wire, "zeromq": zeromq_wire}


class Talk:
    """Two links over a wire; `heard` is what came to the owner of each."""

    def __init__(self, wire: Wire, left: Channel | None = None, right: Channel | None = None, epoch: int = 0) -> None:
        self.wire = wire
        self.links = (
            Link(left or wire.ends[0], "left", epoch, LEFT, RIGHT),
            Link(right or wire.ends[1], "right", epoch, RIGHT, LEFT),
        )
        self.heard: tuple[list[Arrival], list[Arrival]] = ([], [])
        self.grants = True  # whether the owners give credit at once

    def turn(self, end: int) -> bool:
        """One end takes in what there is and sends what waits; whether anything came."""
        link, came = self.links[end], False
        while (arrival := link.receive()) is not None:
            came = True
            self.heard[end].append(arrival)
            if self.grants and arrival.kind in IS_DATA:
                link.grant()
        link.push()
        return came

    def until(self, done: Callable[[], bool], what: str) -> None:
        """Let both ends go on until something holds."""
        for turn in range(TURNS):
            if done():
                return
            came = [self.turn(end) for end in (0, 1)]
            # a channel without room may be one without a peer as yet, so now and then there is a wait all the same
            if not any(came) and (turn % 20 == 0 or not any(link.choked for link in self.links)):
                self.wire.wait()
        pytest.fail(f"{what} has not come about: {self.links[0].state}, {self.links[1].state}")

    def up(self) -> Talk:
        """Both ends up."""
        self.until(lambda: all(link.state is LinkPhase.UP for link in self.links), "both ends up")
        return self

    def closed(self) -> None:
        """Both ends closed."""
        self.until(lambda: all(link.state is LinkPhase.CLOSED for link in self.links), "both ends closed")


class Passing:
    """A channel in front of another one: all that passes goes through `outgoing` and `incoming`."""

    def __init__(self, inner: Channel) -> None:
        self.inner = inner

    def outgoing(self, message: bytes) -> list[bytes]:
        """What is really sent instead."""
        return [message]

    def incoming(self, message: bytes) -> bytes:
        """What really comes out instead."""
        return message

    def send(self, message: bytes | memoryview) -> bool:
        """Hand over; all messages that stand for one are taken, or the test is wrong."""
        sent = [self.inner.send(one) for one in self.outgoing(bytes(message))]
        return all(sent)

    def receive(self) -> bytes | None:
        """The next message."""
        message = self.inner.receive()
        return None if message is None else self.incoming(message)

    def close(self) -> None:
        """Close the inner one."""
        self.inner.close()


class Meddler(Passing):
    """Does something to the nth message of a kind that is sent (1 is the first), once.

    sealed  whether it then gets the right checksum, as if the sender had done it and not the channel
    """

    def __init__(
        self, inner: Channel, kind: int, nth: int, what: Callable[[bytes], list[bytes]], sealed: bool = True
    ) -> None:
        super().__init__(inner)
        self._sealed = sealed
        self._kind, self._left, self._what = kind, nth, what

    def outgoing(self, message: bytes) -> list[bytes]:
        """Meddle if it is the one."""
        if message[0] == self._kind:
            self._left -= 1
            if self._left == 0:
                return [sealed(raw) for raw in self._what(message)] if self._sealed else self._what(message)
        return [message]


class Swapper(Passing):
    """Sends the nth message of a kind only after the one that follows it."""

    def __init__(self, inner: Channel, kind: int, nth: int) -> None:
        super().__init__(inner)
        self._kind, self._left = kind, nth
        self._held: bytes | None = None

    def outgoing(self, message: bytes) -> list[bytes]:
        """Hold one back."""
        if self._held is not None:
            both, self._held = [message, self._held], None
            return both
        if message[0] == self._kind:
            self._left -= 1
            if self._left == 0:
                self._held = message
                return []
        return [message]


class Narrow(Passing):
    """A channel that often has no room: takes a message only when `may` says so."""

    def __init__(self, inner: Channel, may: Callable[[], bool]) -> None:
        super().__init__(inner)
        self._may = may

    def send(self, message: bytes | memoryview) -> bool:
        """Hand over, or not."""
        return self._may() and self.inner.send(message)


class Watched(Passing):
    """Counts data messages that were sent and not yet processed by the peer, and fails above WINDOW."""

    def __init__(self, inner: Channel) -> None:
        super().__init__(inner)
        self.peer: Link | None = None
        self.most_under_way = self.data = self.messages = self.bytes = 0

    def send(self, message: bytes | memoryview) -> bool:
        """Hand over, and look at the window if there was room."""
        if not self.inner.send(message):
            return False
        self.messages += 1
        self.bytes += len(message)
        if message[0] in IS_DATA:
            self.data += 1
            processed = 0 if self.peer is None else self.peer.data_done
            self.most_under_way = max(self.most_under_way, self.data - processed)
            assert self.data - processed <= WINDOW, "more messages are under way than the window holds"
        return True


def renumbered(message: bytes, **fields: int) -> bytes:
    """A message with other numbers in its header: kind, zero, epoch, sequence, credit, count."""
    names = ("kind", "zero", "epoch", "sequence", "credit", "count", "checksum")
    old = dict(zip(names, HEADER.unpack_from(message), strict=True))
    return sealed(HEADER.pack(*(old | fields).values()) + message[HEADER.size :])


@pytest.fixture(params=list(WIRES))
def wire(request: pytest.FixtureRequest) -> Iterator[Wire]:
    """Each transport in turn."""
    with WIRES[request.param]() as made:
        yield made


def payloads(arrivals: list[Arrival]) -> list[bytes]:
    """What came behind the headers."""
    return [arrival.message[HEADER.size :] for arrival in arrivals]


def received(wire: Wire, link: Link, until: Callable[[Arrival], bool] = lambda arrival: True) -> Arrival:
    """Wait until the link of the left end hands out what is wanted, or refuses what came."""
    for _ in range(100):
        arrival = link.receive()
        if arrival is not None and until(arrival):
            return arrival
        link.push()
        wire.wait(0)
    pytest.fail("nothing came")
