"""Defines the config of a node, and the reset order by which a living node is told on its control channel to begin anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST

LAST_EPOCH = 0xFFFF  # the epoch of a message header is a u16
LONGEST_NAME = 200  # characters of an endpoint or of the machine's name


class LinkConfig(NamedTuple):
    """A link of a node: its port, the name of its socket, and whether this end makes that."""

    port: int
    endpoint: str
    bind: bool


@dataclass(frozen=True)
class NodeConfig:
    """What a node is told when it is forked.

    index     its place in the array, of this shape
    epoch     number of resets so far
    machine   name by which the links of this epoch know each other
    batch     most packets a message
    fault     (kind, rate, seed) of `node.links.faulty_channel`, if links are to be bad
    programs  whether it takes programs
    profile   whether to say where time goes
    timed     whether it keeps machine time
    """

    index: tuple[int, int, int]
    shape: tuple[int, int, int]
    epoch: int = 0
    machine: str = "memory"
    links: tuple[LinkConfig, ...] = ()
    batch: int = 1024
    fault: tuple[str, float, int] | None = None
    programs: bool = False
    profile: bool = False
    timed: bool = False

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> Self:
        """The config that the launcher gives as a map with the names above; what it does not know of is for others."""
        known = {name: told[name] for name in cls.__dataclass_fields__ if told.get(name) is not None}
        for name in ("index", "shape", "fault"):
            if name in known:
                known[name] = tuple(known[name])
        known["links"] = tuple(LinkConfig(**link) for link in told.get("links", ()))
        return cls(**known)


def read_reset(order: Mapping[str, object], config: NodeConfig) -> NodeConfig:
    """The config of the next epoch, from a reset order {do: reset, epoch, machine, links} and the config so far.

    Raises ProtocolError unless the epoch is a later one and there is one link for each port of this node.
    """
    epoch, machine, links = order.get("epoch"), order.get("machine"), order.get("links")
    if type(epoch) is not int or not config.epoch < epoch <= LAST_EPOCH:
        raise ProtocolError(f"a reset came with epoch {epoch!r}, wanted one after {config.epoch}")
    if not isinstance(machine, str) or not _is_name(machine):
        raise ProtocolError(f"a reset came with a machine of type {type(machine).__name__}, wanted a short name")
    wanted = sorted(link.port for link in config.links)
    if not isinstance(links, list) or not all(_is_link(link) for link in links):
        raise ProtocolError("a reset came with links that are none")
    if sorted(link["port"] for link in links) != wanted:
        raise ProtocolError(f"a reset came with links of other ports than {wanted}")
    found = tuple(LinkConfig(link["port"], link["endpoint"], link["bind"]) for link in links)
    return replace(config, epoch=epoch, machine=machine, links=found)


def _is_name(value: object) -> bool:
    return isinstance(value, str) and 0 < len(value) <= LONGEST_NAME


def _is_link(value: object) -> bool:
    return (
        isinstance(value, dict)
        and type(value.get("port")) is int
        and 0 <= value["port"] <= HOST
        and _is_name(value.get("endpoint"))
        and value["endpoint"].startswith("ipc://")
        and type(value.get("bind")) is bool
    )
