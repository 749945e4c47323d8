"""Declares what a node knows of a wave: the command and its handler, the replies of its children, and its own reply."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from raygrid.node.errors import ProtocolError
from raygrid.node.protocol.commands import CommandMap
from raygrid.node.runtime.reduction import SUMS, Long

if TYPE_CHECKING:  # the driver reads replies, and needs nothing of a node's state
    from raygrid.node.runtime.report import NodeRecord

MOST_SHOWN = 3  # reasons of refusals in a reply


@dataclass
class Wave:
    """The wave that is under way in a node.

    command   its name, as it came
    number    as it came
    deadline  moment at which a busy node replies, 0: at once
    replies   of children, as they came
    """

    command: object
    number: object
    deadline: float
    replies: list[CommandMap] = field(default_factory=list)


class Handler(NamedTuple):
    """What obeys a command.

    run    raises ProtocolError
    needs  what must have come before: "space", "frame" or ""
    phase  that it begins, for the probes: load, trace, collect or idle; "": none
    """

    run: Callable[[CommandMap], None]
    needs: str = ""
    phase: str = ""


@dataclass
class WaveReply:
    """The reply of a node, or of all below it in the tree.

    sums      int64 (SUMS,)
    nodes     records of nodes, if they are asked for
    refusals  reasons, MOST_SHOWN at most
    """

    sums: Long
    nodes: list[NodeRecord] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)

    def as_map(self, wave: object) -> dict[str, object]:
        """Pack it for the way. wave: the number of the wave, as it came."""
        sums = self.sums.astype("<i8").tobytes()
        return {"sums": sums, "nodes": self.nodes, "refusals": self.refusals, "wave": wave}

    def add(self, other: CommandMap) -> None:
        """Add the reply of a child, as it came. Raises ProtocolError if it is none."""
        nodes, refusals = other.get("nodes"), other.get("refusals")
        if not isinstance(nodes, list) or not isinstance(refusals, list):
            raise ProtocolError("a reply came without its lists")
        self.sums = self.sums + read_sums(other)
        self.nodes = self.nodes + nodes
        self.refusals = (self.refusals + refusals)[:MOST_SHOWN]


def read_sums(reply: CommandMap) -> Long:
    """The sums of a reply, int64 (SUMS,). Raises ProtocolError if it has none."""
    sums = reply.get("sums")
    if not isinstance(sums, bytes) or len(sums) != 8 * SUMS:
        raise ProtocolError("a reply came without its sums")
    return np.frombuffer(sums, "<i8").astype(np.int64)


def do_nothing(_: CommandMap) -> None:
    """Of commands that only want a reply."""
