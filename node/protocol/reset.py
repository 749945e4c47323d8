"""The reset order: what a living node is told on its line to begin a new epoch with."""

from __future__ import annotations

from typing import Any

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST

LAST_EPOCH = 0xFFFF  # the epoch of a message header is a u16
LONGEST_NAME = 200  # characters of an endpoint or of the machine's name


def read_reset(order: dict[str, Any], config: dict[str, Any]) -> dict[str, Any]:
    """The config of the next epoch, from a reset order {do: reset, epoch, machine, links} and the config so far.

    Raises ProtocolError unless the epoch is a later one and there is one link for each port of this node.
    """
    epoch, machine, links = order.get("epoch"), order.get("machine"), order.get("links")
    if type(epoch) is not int or not config["epoch"] < epoch <= LAST_EPOCH:
        raise ProtocolError(f"a reset came with epoch {epoch!r}, wanted one after {config['epoch']}")
    if not _is_name(machine):
        raise ProtocolError(f"a reset came with a machine of type {type(machine).__name__}, wanted a short name")
    wanted = sorted(link["port"] for link in config["links"])
    if not isinstance(links, list) or not all(_is_link(link) for link in links):
        raise ProtocolError("a reset came with links that are none")
    if sorted(link["port"] for link in links) != wanted:
        raise ProtocolError(f"a reset came with links of other ports than {wanted}")
    return {**config, "epoch": epoch, "machine": machine, "links": links}


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and 0 < len(value) <= LONGEST_NAME


def _is_link(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and type(value.get("port")) is int
        and 0 <= value["port"] <= HOST
        and _is_name(value.get("endpoint"))
        and value["endpoint"].startswith("ipc://")
        and type(value.get("bind")) is bool
    )
