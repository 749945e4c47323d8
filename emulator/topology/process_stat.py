"""Reads what the kernel says of a process in /proc/PID/stat: its state, when it began, the processor time it has used."""

from __future__ import annotations

import os
from typing import NamedTuple

TICKS = os.sysconf("SC_CLK_TCK")  # a second
STATES = {  # of a process, by the kernel's letter; none: there is no such process
    "R": "running",
    "S": "waiting",
    "D": "waiting for the kernel",
    "T": "stopped",
    "t": "stopped by a debugger",
    "Z": "dead",
    "X": "dead",
    "": "dead",
    "?": "not to be seen",
}


class ProcessStat(NamedTuple):
    """State as the kernel's letter, start in ticks since the computer began, seconds of processor time."""

    state: str
    started: int
    cpu_seconds: float


def read_stat(pid: int) -> ProcessStat | None:
    """What the kernel says of a process; None if there is none. Raises OSError if that cannot be seen, as without
    descriptors."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            # The second field is the program's name in brackets, and may itself hold blanks and brackets.
            fields = file.read().rpartition(b")")[2].split()
        return ProcessStat(fields[0].decode(), int(fields[19]), (int(fields[11]) + int(fields[12])) / TICKS)
    except (FileNotFoundError, ProcessLookupError, IndexError, ValueError):
        return None


def process_mark(pid: int) -> str | None:
    """What tells process `pid` from all others: id, start time, namespace.

    None if there is no such process, or one that has ended and whose parent has not asked how.
    """
    try:
        found = read_stat(pid)
    except OSError:
        return None
    return None if found is None or found.state in ("Z", "X") else f"{pid} {found.started} {pid_namespace()}"


def process_state(pid: int) -> str:
    """The state of a process as the kernel's letter: R, S, D, T, t or Z; "" if there is no such process, "?" if that cannot
    be seen, as without descriptors."""
    try:
        found = read_stat(pid)
    except OSError:
        return "?"
    return "" if found is None else found.state


def process_times(pid: int) -> tuple[str, float]:
    """(state as the kernel's letter, seconds of processor time); ("", 0.0) for a process that is gone or not to be seen."""
    try:
        found = read_stat(pid)
    except OSError:
        found = None
    return ("", 0.0) if found is None else (found.state, found.cpu_seconds)


def pid_namespace() -> str:
    """The namespace in which this process has its number."""
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return "unknown"
