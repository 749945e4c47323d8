"""The process of one node: open links, then poll, receive, work."""

from __future__ import annotations

import gc
import time
from typing import Any

import zmq

from .link import Link, State
from .pair import Pair
from .processor import Processor
from .walk import HOST, OPPOSITE

PORT_NAMES = ("-x", "+x", "-y", "+y", "-z", "+z", "host")
CHOKED_SECONDS = 0.002  # a socket without room for what a link may send is tried again after this
CLOSING_SECONDS = 2.0  # how long a node waits for the answers to its BYE


def run(config: dict[str, Any], life: int) -> None:
    """Be one node until the order `end`, or until the pipe `life` closes because the launcher is gone.

    config  index [x, y, z], shape, epoch, machine (name of the array), batch (most packets a message),
            profile (whether to say where time goes), and links: a list of {port, endpoint, bind}
    Raises ProtocolError if a link breaks.
    """
    gc.set_threshold(50_000, 50, 50)  # a turn makes no cycles; the default would look for them every few turns
    context: zmq.Context[Any] = zmq.Context(io_threads=1)
    try:
        pairs = {link["port"]: Pair(context, link["endpoint"], link["bind"]) for link in config["links"]}
        try:
            _serve(config, pairs, life)
        finally:
            for pair in pairs.values():
                pair.close()
    finally:
        context.destroy(linger=0)


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
    from .timed_processor import TimedProcessor

    return TimedProcessor


def _serve(config: dict[str, Any], pairs: dict[int, Pair], life: int) -> None:
    index, shape = tuple(config["index"]), tuple(config["shape"])
    processor = processor_class(config)(index, shape, open_links(config, pairs), config["batch"])
    if config.get("profile"):
        from .profile import Profile

        Profile(processor)
    ports = {pair.socket: port for port, pair in pairs.items()}
    poller = zmq.Poller()
    for socket in ports:
        poller.register(socket, zmq.POLLIN)
    poller.register(life, zmq.POLLIN)
    while not processor.ended:
        for ready, _ in poller.poll(_patience(processor)):
            if ready == life:
                return
            processor.receive(ports[ready])
        if processor.gathers:
            time.sleep(processor.linger)
            for ready, _ in poller.poll(0):
                if ready == life:
                    return
                processor.receive(ports[ready])
        processor.work()
    _close(processor, poller, ports, life)


def _patience(processor: Processor) -> int | None:
    """Milliseconds to wait for a message; None: until one comes."""
    if processor.busy:
        return 0
    limit = processor.wait_limit()
    if processor.choked:
        limit = CHOKED_SECONDS if limit is None else min(limit, CHOKED_SECONDS)
    return None if limit is None else int(limit * 1000) + 1


def _close(processor: Processor, poller: zmq.Poller, ports: dict[Any, int], life: int) -> None:
    """Wait until every neighbour has answered BYE, but not for ever."""
    deadline = time.monotonic() + CLOSING_SECONDS
    while any(link.state != State.CLOSED for link in processor.links.values()):
        left = deadline - time.monotonic()
        if left <= 0.0:
            return
        for ready, _ in poller.poll(int(left * 1000) + 1):
            if ready == life:
                return
            processor.receive(ports[ready])
        for link in processor.links.values():
            link.push()
