"""Notices processes that are stopped, which send nothing and do not end, and dead ones of which nobody tells."""

from __future__ import annotations

import time
from collections.abc import Iterable

from raygrid.emulator.processes.fork_server_client import ForkServerClient
from raygrid.emulator.processes.node_processes import ProcessState

LOOK_SECONDS = 0.25  # how often the states of silent processes are looked at
# for longer than this a process that is stopped (SIGSTOP), or dead without a word of it, is lost
STOPPED_SECONDS = 0.75


class ProcessWatch:
    """Remembers since when which processes do not run."""

    def __init__(self) -> None:
        self._looked = 0.0
        self._since: dict[int, float] = {}  # process id -> when it was first seen so

    def is_due(self) -> bool:
        """Whether it is time to look again; then the next time is LOOK_SECONDS later."""
        now = time.monotonic()
        if now - self._looked < LOOK_SECONDS:
            return False
        self._looked = now
        return True

    def lost(self, nodes: Iterable[ProcessState], fork_server: ForkServerClient | None) -> str | None:
        """What has not run for STOPPED_SECONDS, as a sentence; None if all runs.

        fork_server  None: it is not looked at
        """
        said = {node.pid: node.told for node in nodes if node.state in ("stopped", "dead")}
        if fork_server is not None and fork_server.stopped:
            said[fork_server.pid] = f"the fork server (process {fork_server.pid}) is stopped"
        self._since = {pid: self._since.get(pid, self._looked) for pid in said}
        for pid, since in self._since.items():
            if self._looked - since >= STOPPED_SECONDS:
                return said[pid]
        return None

    def forget(self) -> None:
        """Begin anew."""
        self._since.clear()
