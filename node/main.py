"""The process of one node: open links, then poll, receive, work; and begin anew when the reset line says so."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import zmq

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST, OPPOSITE
from raygrid.node.links.control_channel import ControlChannel
from raygrid.node.links.faulty_channel import FaultPlan, FaultyChannel, tend
from raygrid.node.links.link import Channel, Link, LinkPhase
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.protocol.reset import read_reset
from raygrid.node.runtime.memory_stats import keep_freed_memory
from raygrid.node.runtime.native_link_table import NativeLinkTable
from raygrid.node.runtime.probe import NodeProbe, read_rate
from raygrid.node.runtime.processor import Processor

PORT_NAMES = ("-x", "+x", "-y", "+y", "-z", "+z", "host")
CHOKED_SECONDS = 0.002  # a socket without room for what a link may send is tried again after this
LONGEST_WHY = 2000  # characters of what a broken node says
CLOSING_SECONDS = 2.0  # how long a node waits for the answers to its BYE


def run(config: dict[str, Any], life: int, line: int) -> None:
    """Be one node until the order `end`, or until the pipe `life` closes because the launcher is gone.

    config  index [x, y, z], shape, epoch, machine (name of the array), batch (most packets a message), and
            links: a list of {port, endpoint, bind}; and fault, (kind, rate, seed) of `node.links.faulty_channel`, if it is wanted;
            and profile, whether to say where time goes
    line    descriptor of the node's end of the line to the host (`node.links.control_channel`)

    A reset order on the line ends an epoch, whatever its state: links, packets, surfaces and pixels are dropped, and
    the node begins the next one on new links, as if it had just been forked. A node whose link broke says so on its
    line, {is: broken, why}, closes its links and waits for the reset. Anything else that goes wrong ends the process.
    """
    gc.set_threshold(50_000, 50, 50)  # a turn makes no cycles; the default would look for them every few turns
    keep_freed_memory()
    context: zmq.Context[Any] = zmq.Context(io_threads=1)
    to_host = ControlChannel(line)
    probe = NodeProbe(to_host)
    try:
        next_epoch: dict[str, Any] | None = config
        while next_epoch is not None:
            next_epoch = _live(next_epoch, context, life, to_host, probe)
    finally:
        to_host.close()
        context.destroy(linger=0)


def _live(
    config: dict[str, Any], context: zmq.Context[Any], life: int, line: ControlChannel, probe: NodeProbe
) -> dict[str, Any] | None:
    """One epoch. Returns the config of the next one, None if there is none."""
    pairs: dict[int, ZmqChannel] = {}
    try:
        for link in config["links"]:
            pairs[link["port"]] = ZmqChannel(context, link["endpoint"], link["bind"])
        line.send({"is": "reset", "epoch": config["epoch"]})
        return _serve(config, pairs, _with_faults(config, pairs, line), life, line, probe)
    except ProtocolError as error:
        line.send({"is": "broken", "epoch": config["epoch"], "why": str(error)[:LONGEST_WHY]})
    finally:
        for pair in pairs.values():
            pair.close()
    poller = zmq.Poller()
    poller.register(life, zmq.POLLIN)
    poller.register(line.fileno(), zmq.POLLIN)
    while not line.closed:
        if any(ready == life for ready, _ in poller.poll()):
            return None
        for order in _orders(line, config, probe):
            return order
    return None


def _orders(line: ControlChannel, config: dict[str, Any], probe: NodeProbe) -> Iterator[dict[str, Any]]:
    """The configs of the resets that have come on the line; rates of probes are set, what is no order is refused and counted."""
    while (order := line.receive()) is not None:
        try:
            if order.get("do") == "probe":
                probe.set_rate(read_rate(order))
                continue
            if order.get("do") != "reset":
                raise ProtocolError(f"the words {order.get('do')!r} came on a line, wanted an order")
            yield read_reset(order, config)
        except ProtocolError:
            line.refused += 1


def open_links(config: dict[str, Any], channels: dict[int, Any]) -> dict[int, Link]:
    """The links of a node over its channels, port -> link."""
    x, y, z = config["index"]
    links = {}
    for port, channel in channels.items():
        identity = {"machine": config["machine"], "node": [x, y, z], "port": port}
        peer = {"machine": config["machine"], "node": [x, y, z], "port": -1}  # the host
        if port != HOST:
            there = [x, y, z]
            there[port >> 1] += 1 if port & 1 else -1
            peer = {"machine": config["machine"], "node": there, "port": OPPOSITE[port]}
        links[port] = Link(channel, f"{x},{y},{z} port {PORT_NAMES[port]}", config["epoch"], identity, peer)
    return links


def processor_class(config: dict[str, Any]) -> type[Processor]:
    """What a node is: one that keeps machine time if the array is `timed`."""
    if not config.get("timed", False):
        return Processor
    from raygrid.node.timed.timed_processor import TimedProcessor

    return TimedProcessor


def _with_faults(config: dict[str, Any], pairs: dict[int, ZmqChannel], line: ControlChannel) -> dict[int, Channel]:
    """The channels of a node: its pairs, those to neighbours with the faults that an experiment asks for."""
    channels: dict[int, Channel] = dict(pairs)
    if config.get("fault") is not None:
        for port in channels.keys() - {HOST}:
            key = (*config["index"], port, config["epoch"])
            channels[port] = FaultyChannel(channels[port], FaultPlan(*config["fault"]), key, line.send)
    return channels


def _serve(
    config: dict[str, Any],
    pairs: dict[int, ZmqChannel],
    channels: dict[int, Channel],
    life: int,
    line: ControlChannel,
    probe: NodeProbe,
) -> dict[str, Any] | None:
    index, shape = tuple(config["index"]), tuple(config["shape"])
    kind = processor_class(config)
    processor = kind(index, shape, open_links(config, channels), config["batch"], programs=bool(config.get("programs")))
    profiled = bool(config.get("profile"))
    if profiled:
        from raygrid.node.runtime.profile import Profile

        Profile(processor)
    faults = [channel for channel in channels.values() if isinstance(channel, FaultyChannel)]
    if kind is not Processor:  # what keeps machine time takes other messages than those that compiled code knows
        return _loop(config, processor, pairs, faults, life, line, probe)
    with closing(
        NativeLinkTable(
            processor.links, pairs, processor.reductions.reduction_state, (life, line.fileno()), timed=profiled
        )
    ) as link_table:
        processor.wire(link_table)
        return _loop(config, processor, pairs, faults, life, line, probe)


def _loop(
    config: dict[str, Any],
    processor: Processor,
    pairs: dict[int, ZmqChannel],
    faults: list[FaultyChannel],
    life: int,
    line: ControlChannel,
    probe: NodeProbe,
) -> dict[str, Any] | None:
    ports = {pair.socket: port for port, pair in pairs.items()}
    poller = zmq.Poller()
    for socket in ports:
        poller.register(socket, zmq.POLLIN)
    poller.register(life, zmq.POLLIN)
    poller.register(line.fileno(), zmq.POLLIN)
    while not processor.ended:
        patience = _patience(processor, probe)
        for ready, _ in poller.poll(tend(faults, patience) if faults else patience):
            if ready in ports:
                if not processor.serves_itself(ports[ready]):
                    processor.receive(ports[ready])
                continue
            for order in _orders(line, config, probe):
                return order
            if ready == life or line.closed:
                return None
        processor.work(wait=not (probe.wanted or faults))
        if probe.wanted:
            probe.maybe_speak(processor, config["epoch"])
    poller.unregister(line.fileno())
    _close(processor, poller, ports, life)
    return None


def _patience(processor: Processor, probe: NodeProbe) -> int | None:
    """Milliseconds to wait for a message; None: until one comes."""
    if processor.busy:
        return 0
    limit = processor.wait_limit()
    if processor.choked:
        limit = CHOKED_SECONDS if limit is None else min(limit, CHOKED_SECONDS)
    limit = probe.patience(limit)
    return None if limit is None else int(limit * 1000) + 1


def _close(processor: Processor, poller: zmq.Poller, ports: dict[Any, int], life: int) -> None:
    """Wait until every neighbour has answered BYE, but not for ever."""
    deadline = time.monotonic() + CLOSING_SECONDS
    while any(link.state != LinkPhase.CLOSED for link in processor.links.values()):
        left = deadline - time.monotonic()
        if left <= 0.0:
            return
        for ready, _ in poller.poll(int(left * 1000) + 1):
            if ready == life:
                return
            processor.receive(ports[ready])
        for link in processor.links.values():
            link.push()
