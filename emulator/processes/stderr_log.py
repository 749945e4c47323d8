"""Keeps the end of what fork server and nodes write to the stderr they share, and what each node said before it ended."""

from __future__ import annotations

import os
import signal
import sys

from raygrid.emulator.processes.fork_server import DEBUG
from raygrid.emulator.topology.coordinates import Index, name_of

LONGEST_TAIL = 16_384  # characters of stderr that are kept
LONGEST_REASON = 300  # characters of a library's line that are passed on
OWN, NODE = "raygrid ", "raygrid node "
# Libraries say why on stderr, in a line that does not name the node, and end the process so: glibc if it finds no
# memory for a thread's data or for loading code, and libzmq (among others) through abort.
ENDED_BY_LIBRARY = (127, -int(signal.SIGABRT))


class StderrLog:
    """Reads what fork server and nodes write to stderr, from a descriptor and without waiting.

    closed   all who could write to it are gone
    tail     the end of what was written
    """

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self.descriptor = descriptor
        self.closed = False
        self.tail = ""
        self._line = ""
        self._of_node: dict[str, str] = {}
        self._of_library = ""

    def read(self) -> None:
        """Take in what has come; at most what a pipe holds, so that a babbling node cannot keep us here."""
        try:
            piece = os.read(self.descriptor, 1 << 16) if not self.closed else b""
        except BlockingIOError:
            return
        self.closed = not piece
        text = piece.decode(errors="replace")
        if os.environ.get(DEBUG) and sys.stderr is not None:
            sys.stderr.write(text)
        self.tail = (self.tail + text)[-LONGEST_TAIL:]
        *lines, self._line = (self._line + text).split("\n")
        self._line = self._line[-LONGEST_TAIL:]
        for line in lines:
            # Not only at its head: a node that crashes in the midst of a line leaves it unfinished.
            _, found, rest = line.partition(NODE)
            if found:
                node, _, words = rest.partition(": ")
                self._of_node[node] = words
            elif line.strip() and OWN not in line and not os.environ.get(DEBUG):  # then tracebacks come there as well
                self._of_library = line.strip()[:LONGEST_REASON]

    def take(self, index: Index, status: int) -> str:
        """The last line that the node wrote about itself, or else what the library that ended it wrote; "" if none.

        status   how the node ended: its exit code, or minus the number of a signal
        """
        words = self._of_node.pop(name_of(index), "")
        if status in ENDED_BY_LIBRARY:  # others may have ended since the library wrote it
            words, self._of_library = words or self._of_library, ""
        return words

    def last_lines(self) -> str:
        """The last three lines written, in one."""
        return " / ".join([line.strip() for line in self.tail.splitlines() if line.strip()][-3:])
