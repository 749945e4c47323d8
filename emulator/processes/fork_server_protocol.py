"""Declares what front end and fork server tell each other: orders one way, reports the other.

Each is a map on their socket (`emulator.processes.control`), with its name under "do" or "is" and its fields:

    order                              reports
                                       {is: warming, done, total, what}      while it warms
                                       {is: warm}                            once
    {do: launch, configs: [map, ...]}  {is: lines, number}, as often as needed, with as many descriptors;
                                       then {is: launched, pids: [...]}, or only {is: refused, why}
    {do: kill, pids: [...]}            {is: ended, ...} of each that is a node and lives
                                       {is: ended, pid, node, status}        status < 0: minus the signal
    {do: end}                          the socket closes when all nodes are reaped

The descriptors are the host's ends of the control channels to the nodes (`node.links.control_channel`), in the order of
the configs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from raygrid.emulator.processes.control import Message
from raygrid.emulator.topology.coordinates import Index
from raygrid.node.errors import ProtocolError


class Launch(NamedTuple):
    """Fork a node for each config."""

    configs: Sequence[Message]


class Kill(NamedTuple):
    """Kill these nodes; those that have ended already are passed over."""

    pids: Sequence[int]


class End(NamedTuple):
    """End all nodes, reap them, and exit."""


class Warming(NamedTuple):
    """The fork server compiles or loads kernels: `done` of `total` are ready, `what` comes next."""

    done: int
    total: int
    what: str


class Warm(NamedTuple):
    """Nodes can be launched."""


class ControlEnds(NamedTuple):
    """So many descriptors came with this report."""

    number: int


class Launched(NamedTuple):
    """All nodes of a launch are forked; their process ids in the order of the configs."""

    pids: Sequence[int]


class Refused(NamedTuple):
    """An order was not carried out."""

    why: str


class NodeEnded(NamedTuple):
    """A node has ended. status: its exit code, or minus the number of the signal that ended it."""

    pid: int
    node: Index
    status: int


Order = Launch | Kill | End
Report = Warming | Warm | ControlEnds | Launched | Refused | NodeEnded

NAMES: dict[type[Order | Report], tuple[str, str]] = {
    Launch: ("do", "launch"),
    Kill: ("do", "kill"),
    End: ("do", "end"),
    Warming: ("is", "warming"),
    Warm: ("is", "warm"),
    ControlEnds: ("is", "lines"),
    Launched: ("is", "launched"),
    Refused: ("is", "refused"),
    NodeEnded: ("is", "ended"),
}


def as_message(told: Order | Report) -> Message:
    """The map that carries an order or a report."""
    verb, name = NAMES[type(told)]
    return {verb: name, **told._asdict()}


def read_order(message: Message) -> Order | None:
    """The order that a map carries; None if it carries none."""
    match message:
        case {"do": "launch", "configs": (*configs,)}:
            return Launch(configs)
        case {"do": "kill", "pids": (*pids,)}:
            return Kill(pids)
        case {"do": "end"}:
            return End()
    return None


def read_report(message: Message) -> Report:
    """The report that a map carries. Raises ProtocolError if it carries none."""
    match message:
        case {"is": "warming", "done": int(done), "total": int(total), "what": str(what)}:
            return Warming(done, total, what)
        case {"is": "warm"}:
            return Warm()
        case {"is": "lines", "number": int(number)}:
            return ControlEnds(number)
        case {"is": "launched", "pids": (*pids,)}:
            return Launched(pids)
        case {"is": "refused", "why": str(why)}:
            return Refused(why)
        case {"is": "ended", "pid": int(pid), "node": (int(x), int(y), int(z)), "status": int(status)}:
            return NodeEnded(pid, (x, y, z), status)
    raise ProtocolError(f"the fork server reported {str(message)[:200]}, which is no report")
