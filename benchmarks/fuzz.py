"""Malformed packets and messages into a running array; no process may end or hang, and the next picture must be right.

    python benchmarks/fuzz.py                              a million
    python benchmarks/fuzz.py --messages 20000 --epochs 10

One node of a 2x2x2 array is hostile: this process plays it, with real links to its three neighbours and the host. It
takes its part in waves like any other, and sends what no node may send. In each epoch a scene is loaded and traced,
and meanwhile come

    packets   messages as a link wants them, numbered and sealed, with packets that are none
    stale     messages of other epochs, with anything in them
    words     anything on the lines of all nodes, from the host
    breaking  last, on each link: a message after which a link cannot go on; the neighbours give up their links

Meanwhile uninvited peers speak to every socket. Then the reset line begins the next epoch. At the end the hostile
node is replaced by an honest one.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import random
import select
import signal
import sys
import time
from collections import Counter
from typing import Any

import msgpack
import numpy as np
import zmq
from faults_bed import SMALL, job, right, truth
from faults_links import _babble, intruder

from raygrid.emulator.driver.admission import Progress
from raygrid.emulator.processes.array import Array
from raygrid.host.render.retry import RECOVERABLE
from raygrid.host.render.session import RenderSession
from raygrid.node.errors import Garbled, ProtocolError
from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.links.link import Link, LinkPhase
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.main import open_links
from raygrid.node.protocol.frame_tables import frame_limits
from raygrid.node.protocol.messages import CHECKSUM_FIELD, SUMMED, MessageKind, pack_message
from raygrid.node.protocol.packets import SIZE, first_fault
from raygrid.node.protocol.reset import NodeConfig
from raygrid.node.runtime.processor import Processor

SHAPE = (2, 2, 2)
PLACE = (1, 1, 1)  # of the hostile node: a leaf of the tree of waves
LIMIT = 120.0  # seconds that an epoch may take
WAIT = 30.0  # seconds for any one thing to happen


class HostileArray(Array):
    """An array of which this process is one node, as long as `hostile`."""

    def __init__(self) -> None:
        super().__init__(SHAPE, patience=WAIT)
        self.hostile = True
        self.node: Processor | None = None
        self._own: dict[int, ZmqChannel] = {}

    def _begin_epoch(self) -> None:
        assert self._node_processes is not None
        self.hang_up_own()
        node_processes, begin = self._node_processes, type(self._node_processes).begin

        def begin_others(configs: dict[Any, Any]) -> int:
            mine = configs.pop(PLACE)
            forked = begin(node_processes, configs)
            self._open(mine)
            return forked

        if self.hostile:
            node_processes.begin = begin_others  # type: ignore[method-assign]
        elif "begin" in vars(node_processes):
            del node_processes.begin  # type: ignore[method-assign]
        super()._begin_epoch()

    def _open(self, config: dict[str, Any]) -> None:
        assert self._context is not None
        for link in config["links"]:
            self._own[link["port"]] = ZmqChannel(self._context, link["endpoint"], link["bind"])
        self.node = Processor(PLACE, SHAPE, open_links(NodeConfig.of(config), self._own), self.batch)

    def hang_up_own(self) -> None:
        """Close the hostile node's links."""
        for pair in self._own.values():
            pair.close()
        self._own, self.node = {}, None

    def turn(self) -> None:
        """One turn of the hostile node."""
        if self.node is not None:
            for port in self.node.links:
                self.node.receive(port)
            self.node.work()

    def _pump(self, seconds: float) -> None:
        self.turn()
        super()._pump(
            0.0 if self.node is not None and self.node.busy else min(seconds, 0.002) if self.node else seconds
        )

    def neighbours(self) -> list[Link]:
        """The hostile node's links to other nodes."""
        assert self.node is not None
        return [link for port, link in self.node.links.items() if port != HOST]


class Fuzz:
    """What is sent, and how much of it."""

    def __init__(self, array: HostileArray, seed: int) -> None:
        self.array, self.random, self.bytes = array, random.Random(seed), np.random.default_rng(seed)
        self.sent: Counter[str] = Counter()
        self.messages = 0  # with malformed packets, in this epoch
        self.limits = frame_limits(job(SHAPE).frame, SHAPE)

    # --- packets ---------------------------------------------------------------------------------

    def bad_packets(self, count: int) -> list[bytes]:
        """Packets each of which the check refuses: random bytes, and random bytes behind a good first one."""
        found: list[bytes] = []
        while len(found) < count:
            raw = self.bytes.integers(0, 256, (count, SIZE), np.uint8)
            near = self.bytes.random(count) < 0.7  # nearly right: the kind of a ray, a sample that may be one
            raw[near, 0] = self.bytes.integers(1, 7, near.sum()) | self.bytes.integers(0, 8, near.sum()) << 3
            raw[near, 3:5] = 0
            flat = raw.reshape(-1)
            found += [row.tobytes() for k, row in enumerate(raw) if first_fault(flat, k * SIZE, 1, self.limits)[0] >= 0]
        return found[:count]

    def send_packets(self, count: int) -> None:
        """About so many malformed packets, one to three in a message, as fast as credit allows."""
        links = self.array.neighbours()
        while count > 0:
            for link in links:
                if link.waiting < 64 and link.state is LinkPhase.UP:
                    for payload in self.bad_packets(32):
                        many = self.random.choice((1, 1, 1, 2, 3))
                        how = self.random.random()
                        said = many if how < 0.98 else self.random.choice((0, many + 1, 2**32 - 1))
                        link.send_data(MessageKind.PACKETS, said, payload * many)
                        self.sent["packets"] += many
                        self.messages += 1
                        count -= many
            self.drain(links)

    def drain(self, links: list[Link]) -> None:
        """Until the neighbours have taken nearly all."""
        deadline = time.monotonic() + WAIT
        while any(link.waiting > 32 for link in links):
            for link in links:
                while link.receive() is not None:  # waves wait: the driver is not listening either
                    continue
                link.push()
            if time.monotonic() > deadline:
                raise SystemExit("a neighbour takes nothing any more: a hang")

    # --- messages --------------------------------------------------------------------------------

    def send_stale(self, count: int) -> None:
        """Messages of other epochs."""
        for _ in range(count):
            link = self.random.choice(self.array.neighbours())
            epoch = (link.epoch + self.random.randrange(1, 1 << 16)) & 0xFFFF
            numbers = [self.random.randrange(1 << 32) for _ in range(3)]
            kind = self.random.choice(list(MessageKind))
            payload = self.random.randbytes(self.random.choice((0, 1, 25, 300)))
            self.sent["stale"] += link.channel.send(pack_message(int(kind), epoch, *numbers, payload))

    def send_words(self, count: int) -> None:
        """Anything on the lines; never a reset that could be obeyed."""
        assert self.array._node_processes is not None
        lines = self.array._node_processes.control_channels
        for index in list(self.array._node_processes.pids):
            line = lines._lines[index]
            for _ in range(count):
                data = (
                    self.tree(3) if self.random.random() < 0.7 else self.random.randbytes(self.random.randrange(1, 200))
                )
                try:
                    line._socket.send(data)
                except BlockingIOError:
                    break
                self.sent["words"] += 1

    def tree(self, depth: int) -> bytes:
        """Msgpack of anything, often with the names that an order has."""

        def value(deeper: int) -> Any:
            kinds = [None, True, -1, 2**63, 0.5, float("nan"), "reset", "ipc://x", b"\xff" * 9, [], {}]
            if deeper == 0 or self.random.random() < 0.3:
                return self.random.choice(kinds)
            if self.random.random() < 0.5:
                return [value(deeper - 1) for _ in range(self.random.randrange(4))]
            names = [
                "do",
                "epoch",
                "machine",
                "links",
                "port",
                "wave",
                "quota",
                "hold",
                "sums",
                "nodes",
                "refusals",
                "x",
            ]
            return {self.random.choice(names): value(deeper - 1) for _ in range(self.random.randrange(4))}

        deep = value(depth)
        if self.random.random() < 0.1:
            for _ in range(self.random.choice((20, 2000))):
                deep = [deep]
        try:
            packed: bytes = msgpack.packb(deep)
        except (ValueError, RecursionError):  # deeper than msgpack itself would write
            packed = b"\x91" * 3000 + b"\xc0"
        return packed

    def send_breaking(self, link: Link) -> None:
        """A message after which the link cannot go on."""
        choose = self.random.choice
        orders = [kind for kind in MessageKind if kind not in (MessageKind.PACKETS, MessageKind.SURFACES)]
        how = choose(("bytes", "kind", "checksum", "sequence", "credit", "again", "order", "parts", "cut"))
        self.sent[f"breaking: {how}"] += 1
        good = pack_message(*link._header(choose(orders[2:4]), 0), self.tree(3))
        if how == "bytes":
            good = self.random.randbytes(choose((0, 1, 19, 20, 21, 45, 5000)))
        elif how == "kind":
            good = bytes([choose((0, 10, 255))]) + good[1:]
        elif how == "checksum":
            good = (
                good[:SUMMED]
                + CHECKSUM_FIELD.pack(self.random.randrange(1 << 32))
                + good[SUMMED + CHECKSUM_FIELD.size :]
            )
        elif how == "sequence":
            good = pack_message(
                int(choose(orders)), link.epoch, link.messages_sent + choose((1, 77, 2**31)) & 0xFFFFFFFF, 0, 0, b""
            )
        elif how == "credit":
            good = pack_message(int(MessageKind.CREDIT), link.epoch, link.messages_sent & 0xFFFFFFFF, 2**31, 0, b"")
        elif how == "again":
            good = pack_message(
                *link._header(choose((MessageKind.HELLO, MessageKind.ACK, MessageKind.BYE_ACK)), 0), b"\x80"
            )
        elif how == "cut":
            good = good[: self.random.randrange(len(good))]
        if how == "parts":
            with_more: Any = link.channel
            for _ in range(choose((2, 40))):
                with_more.socket.send(self.random.randbytes(25), zmq.SNDMORE | zmq.NOBLOCK)
            with_more.socket.send(b"", zmq.NOBLOCK)
        else:
            link.channel.send(good)


def epoch(array: HostileArray, fuzz: Fuzz, packets: int, words: int) -> None:
    """Load, trace and disturb; then break the hostile node's links, and wait until a neighbour has said so."""
    made = job(SHAPE)
    array.driver.load(made.space, made.surfaces)

    def disturb(now: Progress) -> None:
        if now.in_flight > 0:
            fuzz.send_stale(words)
            fuzz.send_packets(packets)

    try:
        array.driver.trace(made.frame, 3000, disturb)
    except (Garbled, ProtocolError) as error:
        fuzz.sent[f"told: {type(error).__name__}"] += 1
    deadline = time.monotonic() + WAIT
    while (refused := refusals(array)) < fuzz.messages and time.monotonic() < deadline:
        continue
    fuzz.sent["told: refused messages"] += refused
    if refused != fuzz.messages:
        raise SystemExit(f"{fuzz.messages} messages with malformed packets were sent, {refused} were refused")
    fuzz.messages = 0
    fuzz.send_words(words)
    for link in array.neighbours():
        fuzz.send_breaking(link)
    while array._lost is None:
        assert array._node_processes is not None
        select.select(array._node_processes.filenos(), [], [], 0.05)
        try:
            array.check()
        except RECOVERABLE:
            break
        except Exception as error:
            raise SystemExit(f"{type(error).__name__} came from the array: {error}") from error
        if time.monotonic() > deadline:
            raise SystemExit("no neighbour noticed a broken link")


def refusals(array: HostileArray) -> int:
    """How many messages the nodes say that they refused."""
    try:
        array.driver.wave({"do": "ready"})
    except Garbled as error:
        return int(str(error).split()[0])
    return 0


def main() -> int:
    """Run; returns the exit code: 0 if no process was lost and the picture afterwards is right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=1_000_000, help="malformed packets and messages, about")
    parser.add_argument("--epochs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    faulthandler.enable()
    begun = time.monotonic()
    truth(SHAPE, SMALL)
    with HostileArray() as array:
        array.begin()
        array.wait_ready()
        pids, fuzz = array.pids, Fuzz(array, options.seed)
        for _ in range(options.epochs):
            faulthandler.dump_traceback_later(LIMIT, exit=True)
            with intruder(array, _babble(fuzz.random)):
                epoch(array, fuzz, max(1, options.messages // options.epochs), 20)
            array.reset()
            faulthandler.cancel_dump_traceback_later()
        same_nodes = array.pids == pids
        array.hostile = False
        array.reset()
        picture = RenderSession(array).render(job(SHAPE))
        same_bits = right(picture, SHAPE)
    for what, count in sorted(fuzz.sent.items()):
        print(f"{what:24}{count:10}")
    total = sum(count for what, count in fuzz.sent.items() if not what.startswith("told"))
    print(f"{total} malformed packets and messages in {options.epochs} epochs, {time.monotonic() - begun:.0f} s")
    print(
        f"processes lost: {'none' if same_nodes else 'some'}; picture afterwards: {'right' if same_bits else 'WRONG'}"
    )
    return 0 if same_nodes and same_bits else 1


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    sys.exit(main())
