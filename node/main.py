"""Runs the process of one node: opens links, then polls, receives and works; begins anew when a reset order says so."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any

import zmq

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST, OPPOSITE
from raygrid.node.links.control_channel import ControlChannel
from raygrid.node.links.faulty_channel import FaultPlan, FaultyChannel, send_delayed
from raygrid.node.links.link import Channel, Link, LinkPhase
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.protocol.reset import NodeConfig, read_reset
from raygrid.node.runtime.memory_stats import keep_freed_memory
from raygrid.node.runtime.native_link_table import NativeLinkTable
from raygrid.node.runtime.probe import NodeProbe, read_rate
from raygrid.node.runtime.processor import Processor

PORT_NAMES = ("-x", "+x", "-y", "+y", "-z", "+z", "host")
CHOKED_SECONDS = 0.002  # a socket without room for what a link may send is tried again after this
LONGEST_WHY = 2000  # characters of what a broken node says
CLOSING_SECONDS = 2.0  # how long a node waits for the answers to its BYE


def run(config: Mapping[str, Any], life: int, line: int) -> None:
    """Be one node until the order `end`, or until the pipe `life` closes because the launcher is gone.

    config  `node.protocol.reset.NodeConfig`, as a map
    line    descriptor of the node's end of the control channel to the host

    A reset order on the control channel ends an epoch, whatever its state: links, packets, surfaces and pixels are
    dropped, and the node begins the next one on new links, as if it had just been forked. A node whose link broke says
    so, {is: broken, why}, closes its links and waits for the reset. Anything else that goes wrong ends the process.
    """
    gc.set_threshold(50_000, 50, 50)  # a batch makes no cycles; the default would look for them every few batches
    keep_freed_memory()
    with closing(NodeProcess(life, ControlChannel(line))) as process:
        process.run(NodeConfig.of(config))


def open_links(config: NodeConfig, channels: Mapping[int, Channel]) -> dict[int, Link]:
    """The links of a node over its channels, port -> link."""
    links = {}
    for port, channel in channels.items():
        identity = {"machine": config.machine, "node": list(config.index), "port": port}
        peer = {**identity, "port": -1}  # the host
        if port != HOST:
            there = list(config.index)
            there[port >> 1] += 1 if port & 1 else -1
            peer = {"machine": config.machine, "node": there, "port": OPPOSITE[port]}
        name = f"{','.join(map(str, config.index))} port {PORT_NAMES[port]}"
        links[port] = Link(channel, name, config.epoch, identity, peer)
    return links


def processor_class(timed: bool) -> type[Processor]:
    """What a node is: one that keeps machine time if the array is `timed`."""
    if not timed:
        return Processor
    from raygrid.node.timed.timed_processor import TimedProcessor

    return TimedProcessor


class NodeProcess:
    """What a node keeps from epoch to epoch: its process, its control channel and who looks after it."""

    def __init__(self, life: int, control: ControlChannel) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context(io_threads=1)
        self._life, self._control = life, control
        self._probe = NodeProbe(control)

    def close(self) -> None:
        """Give up all sockets."""
        self._control.close()
        self._context.destroy(linger=0)

    def run(self, config: NodeConfig) -> None:
        """Live epoch after epoch."""
        next_epoch: NodeConfig | None = config
        while next_epoch is not None:
            next_epoch = self._live(next_epoch)

    def _live(self, config: NodeConfig) -> NodeConfig | None:
        """One epoch. Returns the config of the next one, None if there is none."""
        pairs: dict[int, ZmqChannel] = {}
        try:
            for link in config.links:
                pairs[link.port] = ZmqChannel(self._context, link.endpoint, link.bind)
            self._control.send({"is": "reset", "epoch": config.epoch})
            return self._serve(config, pairs)
        except ProtocolError as error:
            self._control.send({"is": "broken", "epoch": config.epoch, "why": str(error)[:LONGEST_WHY]})
        finally:
            for pair in pairs.values():
                pair.close()
        poller = zmq.Poller()
        poller.register(self._life, zmq.POLLIN)
        poller.register(self._control.fileno(), zmq.POLLIN)
        while not self._control.closed:
            if any(ready == self._life for ready, _ in poller.poll()):
                return None
            for order in self._resets(config):
                return order
        return None

    def _resets(self, config: NodeConfig) -> Iterator[NodeConfig]:
        """The configs of the resets that have come; rates of probes are set, what is no order is refused and counted."""
        while (order := self._control.receive()) is not None:
            try:
                if order.get("do") == "probe":
                    self._probe.set_rate(read_rate(order))
                    continue
                if order.get("do") != "reset":
                    raise ProtocolError(f"the message {order.get('do')!r} came to a node, wanted an order")
                yield read_reset(order, config)
            except ProtocolError:
                self._control.refused += 1

    def _with_faults(self, config: NodeConfig, pairs: Mapping[int, ZmqChannel]) -> dict[int, Channel]:
        """The channels of a node: its pairs, those to neighbours with the faults that an experiment asks for."""
        channels: dict[int, Channel] = dict(pairs)
        if config.fault is not None:
            for port in channels.keys() - {HOST}:
                key = (*config.index, port, config.epoch)
                channels[port] = FaultyChannel(channels[port], FaultPlan(*config.fault), key, self._control.send)
        return channels

    def _serve(self, config: NodeConfig, pairs: dict[int, ZmqChannel]) -> NodeConfig | None:
        channels = self._with_faults(config, pairs)
        kind = processor_class(config.timed)
        links = open_links(config, channels)
        processor = kind(
            config.index, config.shape, links, config.batch, programs=config.programs, profile=config.profile
        )
        faults = [channel for channel in channels.values() if isinstance(channel, FaultyChannel)]
        if config.timed:  # what keeps machine time takes other messages than those that compiled code knows
            return self._loop(config, processor, pairs, faults)
        others = self._life, self._control.fileno()
        native_links = NativeLinkTable(links, pairs, processor.reductions.reduction, others)
        with closing(native_links):
            processor.use_native_links(native_links)
            return self._loop(config, processor, pairs, faults)

    def _loop(
        self, config: NodeConfig, processor: Processor, pairs: dict[int, ZmqChannel], faults: list[FaultyChannel]
    ) -> NodeConfig | None:
        ports = {pair.socket: port for port, pair in pairs.items()}
        poller = zmq.Poller()
        for socket in ports:
            poller.register(socket, zmq.POLLIN)
        poller.register(self._life, zmq.POLLIN)
        poller.register(self._control.fileno(), zmq.POLLIN)
        while not processor.ended:
            patience = self._patience(processor)
            for ready, _ in poller.poll(send_delayed(faults, patience) if faults else patience):
                if ready in ports:
                    if not processor.serves_itself(ports[ready]):
                        processor.receive(ports[ready])
                    continue
                for order in self._resets(config):
                    return order
                if ready == self._life or self._control.closed:
                    return None
            processor.work(wait=not (self._probe.wanted or faults))
            if self._probe.wanted:
                self._probe.maybe_send(processor, config.epoch)
        poller.unregister(self._control.fileno())
        self._close(processor, poller, ports)
        return None

    def _patience(self, processor: Processor) -> int | None:
        """Milliseconds to wait for a message; None: until one comes."""
        if processor.busy:
            return 0
        limit = processor.wait_limit()
        if processor.choked:
            limit = CHOKED_SECONDS if limit is None else min(limit, CHOKED_SECONDS)
        limit = self._probe.patience(limit)
        return None if limit is None else int(limit * 1000) + 1

    def _close(self, processor: Processor, poller: zmq.Poller, ports: Mapping[zmq.Socket[bytes], int]) -> None:
        """Wait until every neighbour has answered BYE, but not for ever."""
        deadline = time.monotonic() + CLOSING_SECONDS
        while any(link.state != LinkPhase.CLOSED for link in processor.links.values()):
            left = deadline - time.monotonic()
            if left <= 0.0:
                return
            for ready, _ in poller.poll(int(left * 1000) + 1):
                if ready == self._life:
                    return
                processor.receive(ports[ready])
            for link in processor.links.values():
                link.push()
