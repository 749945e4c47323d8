"""Declares what front end and fork server tell each other: orders one way, reports the other.

Each is a map on their socket (`emulator.processes.control`), with its name under "do" or "is" and its fields:

    order                              reports
                                       {is: warming, done, total, what}      while it warms
                                       {is: warm}                            once
    {do: launch, configs: [map, ...]}  {is: lines, count}, as often as needed, with as many descriptors;
                                       then {is: launched, pids: [...]}, or only {is: refused, why}
    {do: kill, pids: [...]}            {is: ended, ...} of each that is a node and lives
                                       {is: ended, pid, index, status}       status < 0: minus the signal
    {do: end}                          the socket closes when all nodes are reaped

The descriptors are the host's ends of the control channels to the nodes (`node.links.control_channel`), in the order of
the configs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from raygrid.emulator.processes.control import Message
from raygrid.emulator.topology.coordinates import Index
from raygrid.node.errors import ProtocolError


@dataclass(frozen=True)
class Launch:
    """Fork a node for each config."""

    configs: Sequence[Message]


@dataclass(frozen=True)
class Kill:
    """Kill these nodes; those that have ended already are passed over."""

    pids: Sequence[int]


@dataclass(frozen=True)
class End:
    """End all nodes, reap them, and exit."""


@dataclass(frozen=True)
class Warming:
    """The fork server compiles or loads kernels: `done` of `total` are ready, `what` comes next."""

    done: int
    total: int
    what: str


@dataclass(frozen=True)
class Warm:
    """Nodes can be launched."""


@dataclass(frozen=True)
class ControlEnds:
    """So many descriptors came with this report."""

    count: int


@dataclass(frozen=True)
class Launched:
    """All nodes of a launch are forked; their process ids in the order of the configs."""

    pids: Sequence[int]


@dataclass(frozen=True)
class Refused:
    """An order was not carried out."""

    why: str


@dataclass(frozen=True)
class NodeEnded:
    """A node has ended. status: its exit code, or minus the number of the signal that ended it."""

    pid: int
    index: Index
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
    return {verb: name, **vars(told)}


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
        case {"is": "lines", "count": int(count)}:
            return ControlEnds(count)
        case {"is": "launched", "pids": (*pids,)}:
            return Launched(pids)
        case {"is": "refused", "why": str(why)}:
            return Refused(why)
        case {"is": "ended", "pid": int(pid), "index": (int(x), int(y), int(z)), "status": int(status)}:
            return NodeEnded(pid, (x, y, z), status)
    raise ProtocolError(f"the fork server reported {str(message)[:200]}, which is no report")
