"""Forks the nodes of an array, hears of their ends, resets them, and forks anew those that a reset does not reach."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from dataclasses import dataclass

from raygrid.emulator.processes.control_channels import ControlChannels
from raygrid.emulator.processes.fork_server import LAST_WAIT
from raygrid.emulator.processes.fork_server_client import LOOK_SECONDS, ForkServerClient
from raygrid.emulator.processes.node_messages import EpochBegun, NodeMessage, read_node_message
from raygrid.emulator.processes.process_ended import ProcessEnded
from raygrid.emulator.topology.coordinates import Index, name_of
from raygrid.emulator.topology.process_stat import STATES, process_state
from raygrid.emulator.topology.wiring import Config, reset_order
from raygrid.node.errors import LostProcess

# A node looks at its control channel between two calls of a kernel. One that is in a long call (tables of a million surfaces take
# seconds) or hangs answers too late, and is killed and forked anew: that takes some 10 ms, and what it was working on
# is dropped by a reset in any case. So waiting longer would gain nothing.
RESET_SECONDS, RESET_SECONDS_A_NODE = 1.0, 0.01


@dataclass(frozen=True)
class NodeReport:
    """What a node said on its control channel."""

    index: Index
    said: NodeMessage


@dataclass(frozen=True)
class ProcessState:
    """A node, its process, and how that stands: one of `STATES`."""

    index: Index
    pid: int
    state: str

    @property
    def told(self) -> str:
        """In words: "node 1,0,0 (pid 17) is stopped"."""
        return f"node {name_of(self.index)} (pid {self.pid}) is {self.state}"


class NodeProcesses:
    """The nodes of an array as processes.

    pids    the process of each node, also of one that has ended and was not forked anew yet
    dead    nodes that are to be forked anew
    lost    those that ended by themselves, in the order in which that was told; for the caller to clear
    """

    def __init__(self, fork_server: ForkServerClient) -> None:
        self.fork_server = fork_server
        self.control_channels = ControlChannels()
        self.pids: dict[Index, int] = {}
        self.dead: set[Index] = set()
        self.lost: list[ProcessEnded] = []

    def filenos(self) -> tuple[int, int]:
        """Descriptors of which one can be read when `read_events` has something to tell."""
        return self.fork_server.fileno(), self.control_channels.fileno()

    def read_events(self) -> list[ProcessEnded | NodeReport]:
        """Which nodes have ended, and what others said, without waiting. Raises LostProcess if the fork server is gone."""
        messages = [(index, read_node_message(message)) for index, message in self.control_channels.receive()]
        events: list[ProcessEnded | NodeReport] = [
            NodeReport(index, said) for index, said in messages if said is not None
        ]
        for event in self.fork_server.read_events():
            if isinstance(event, ProcessEnded) and self.pids.get(event.index) == event.pid:
                self.dead.add(event.index)
                self.control_channels.remove(event.index)
                self.lost.append(event)
                events.append(event)
        return events

    def states(self) -> list[ProcessState]:
        """Every node with its process, as the kernel sees it now."""
        found = [(index, pid, process_state(pid)) for index, pid in self.pids.items()]
        return [ProcessState(index, pid, STATES.get(letter, letter)) for index, pid, letter in found]

    def why_silent(self) -> str:
        """Which nodes do not run, and why: "node 1,0,0 (pid 17) is stopped"; the first eight of them."""
        return "; ".join([node.told for node in self.states() if node.state not in ("running", "waiting")][:8])

    def begin(self, configs: dict[Index, Config]) -> int:
        """Bring every node to the epoch of these configs; returns how many were forked for it.

        Living nodes are told on their control channels; those that are stopped, deaf or do not answer in time are killed. Raises
        LostProcess if the fork server is gone or a process cannot be killed, ArrayError if nodes cannot be forked.
        """
        self.read_events()
        silent = self._signal(configs)
        if silent:
            self.fork_server.kill([self.pids[index] for index in silent])
            self._await(lambda: silent <= self.dead, LAST_WAIT)
            if not silent <= self.dead:
                index = min(silent - self.dead)
                self.fork_server.deaf = True  # or the kernel would have ended them, and it said so
                raise LostProcess(f"node {name_of(index)} (pid {self.pids[index]}) does not end when it is killed")
            self.lost = [event for event in self.lost if event.index not in silent]
        missing = {index: config for index, config in configs.items() if index in self.dead or index not in self.pids}
        if missing:
            pids = self.fork_server.launch(list(missing.values()))
            for index, pid in zip(missing, pids, strict=True):
                self.pids[index] = pid
                self.control_channels.add(index, self.fork_server.take_control_end(pid))
                self.dead.discard(index)
        self.pids = {index: self.pids[index] for index in configs}  # x fastest, whoever was forked last
        return len(missing)

    def close(self) -> None:
        """Close the control channels; the fork server is ended by its owner."""
        self.control_channels.close()

    def _signal(self, configs: dict[Index, Config]) -> set[Index]:
        """Tell the living nodes; returns those that did not acknowledge."""
        silent = {index for index in configs if index in self.pids and index not in self.dead}
        stopped = {state.index for state in self.states() if state.state == STATES["T"]}
        told = {index for index in silent - stopped if self.control_channels.send(index, reset_order(configs[index]))}

        def all_answered() -> bool:
            return not told & silent - self.dead

        deadline = time.monotonic() + RESET_SECONDS + RESET_SECONDS_A_NODE * len(told)
        while not all_answered() and (left := deadline - time.monotonic()) > 0:
            self._wait(left)
            for event in self.read_events():
                if isinstance(event, NodeReport) and event.said == EpochBegun(configs[event.index]["epoch"]):
                    silent.discard(event.index)
        return silent - self.dead

    def _await(self, done: Callable[[], bool], seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while not done() and not self.fork_server.stopped and (left := deadline - time.monotonic()) > 0:
            self._wait(min(left, LOOK_SECONDS))
            self.read_events()

    def _wait(self, seconds: float) -> None:
        poller = select.poll()
        for descriptor in self.filenos():
            poller.register(descriptor, select.POLLIN)
        poller.poll(seconds * 1000)
