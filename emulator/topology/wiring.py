"""Tells each node what it must know of one epoch: itself, its ports and their endpoints, and nothing of any other node."""

from __future__ import annotations

from typing import Any

from raygrid.emulator.topology.coordinates import Index, indices
from raygrid.emulator.topology.socket_directory import endpoint, host_endpoint
from raygrid.emulator.topology.topology import neighbour_links
from raygrid.node.geometry import HOST, corners

Config = dict[str, Any]


def node_configs(shape: Index, place: str, epoch: int, machine: str, **more: Any) -> dict[Index, Config]:
    """The config of every node (`node.main.run`), x fastest.

    place    the directory of the sockets
    machine  the name by which the links of this epoch know each other
    more     what every node is told as well
    """
    links: dict[Index, list[dict[str, Any]]] = {index: [] for index in indices(shape)}
    for wire in neighbour_links(shape):
        name = endpoint(place, epoch, wire.lower, wire.axis)
        links[wire.lower].append({"port": wire.lower_port, "endpoint": name, "bind": True})
        links[wire.upper].append({"port": wire.upper_port, "endpoint": name, "bind": False})
    for index in corners(shape).values():
        links[index].append({"port": HOST, "endpoint": host_endpoint(place, epoch, index), "bind": False})
    shared = {"shape": list(shape), "epoch": epoch, "machine": machine, **more}
    return {index: {"index": list(index), "links": links[index], **shared} for index in indices(shape)}


def reset_order(config: Config) -> Config:
    """What a living node is told on its line to go on with this config (`node.protocol.reset.read_reset`)."""
    return {"do": "reset", **{name: config[name] for name in ("epoch", "machine", "links")}}
