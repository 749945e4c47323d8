"""The front end's side of the nursery: start it, launch nodes, hear of their ends, and leave no process behind.

    with ForkServerClient.start() as nursery:  # returns at once; read the scene while it warms
        nursery.wait_warm(timeout=300)
        nursery.launch(configs)  # one map a node, with its "index"
        ...  # poll nursery.fileno(), and when it can be read, nursery.read_events()

What nodes and nursery write to stderr comes here, not to the terminal, and becomes part of the error that tells
of their end; with RAYGRID_DEBUG set it is copied to the terminal as well. Nothing here blocks longer than its
timeout, and nothing here starts a thread. For use by one thread at a time.
"""

from __future__ import annotations

import atexit
import contextlib
import math
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from raygrid.emulator.processes.control import ForkServerChannel, Message, close_all
from raygrid.emulator.processes.fork_server import LAST_WAIT, open_pidfd
from raygrid.emulator.processes.stderr_log import StderrLog
from raygrid.emulator.topology.process_stat import process_state
from raygrid.emulator.topology.socket_directory import Index
from raygrid.node.errors import ArrayError, LostProcess

LOOK_SECONDS = 0.25  # between two looks at whether it runs, while something is expected of it
STOPPED_SECONDS = 0.75  # after which one that is stopped is not waited for any longer
SIGNALS = {number.value: number.name for number in signal.Signals}
# One thread a process: a fork copies only one, and the array itself is the parallelism.
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


OnWarming = Callable[[int, int, str], Any]


class Warming(NamedTuple):
    """The nursery compiles or loads kernels: `done` of `total` are ready, `what` comes next."""

    done: int
    total: int
    what: str


@dataclass(frozen=True)
class ProcessEnded:
    """The node with coordinates `index` has ended.

    status   its exit code, or minus the number of the signal that ended it
    words    its error as it, or the library that ended it, wrote it; "" if there was none
    """

    pid: int
    index: Index
    status: int
    words: str

    @property
    def code(self) -> int | None:
        """The exit code; None if a signal ended it."""
        return self.status if self.status >= 0 else None

    @property
    def signal(self) -> str | None:
        """The name of the signal that ended it, such as "SIGKILL"; None if it exited."""
        return SIGNALS.get(-self.status, str(-self.status)) if self.status < 0 else None

    @property
    def why(self) -> str:
        """How it ended and what it said: "exit code 1: no such surface"."""
        return _how(self.status) + (f": {self.words}" if self.words else "")

    def __str__(self) -> str:
        return f"node {','.join(map(str, self.index))} (process {self.pid}) ended by {self.why}"


Event = Warming | ProcessEnded


class ForkServerClient:
    """The process that all nodes are forked from. Use as a context manager; leaves no process.

    pid     its process id, which is also its session and process group
    warm    whether nodes can be launched
    deaf    whether it does not do what it is told; for the caller to say
    """

    def __init__(
        self, process: subprocess.Popen[bytes], control: socket.socket, stderr: int, on_warming: OnWarming | None
    ) -> None:
        self.pid = process.pid
        self.warm = self.deaf = False
        self._process = process
        self._control = ForkServerChannel(control)
        self._stderr = StderrLog(stderr)
        self._pidfd = open_pidfd(process.pid)
        self._on_warming = on_warming
        self._pids: dict[int, Index] = {}
        self._events: list[Event] = []
        self._lines: dict[int, int] = {}
        self._asked: Sequence[Message] = ()  # configs of the launch under way
        self._reply: Message | None = None
        self._dead = self._ended = False
        self._owner = os.getpid()
        # Readable when there is something to read anywhere, or events that came with the answer to a launch.
        self._held = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._epoll = select.epoll()
        for descriptor in self._sources() | {self._held}:
            self._epoll.register(descriptor, select.EPOLLIN)
        atexit.register(self.end)

    @classmethod
    def start(
        cls,
        *,
        program: str = "raygrid.node.main",
        warm: str = "raygrid.emulator.processes.warm:warm",
        on_warming: OnWarming | None = None,
        directory: str | None = None,
    ) -> ForkServerClient:
        """Start the process and return at once; it imports and warms `program` meanwhile.

        program      module with run(config: dict, life: int), the whole life of a node
        warm         module:function, called once with report(done, total, what)
        on_warming   called as on_warming(done, total, what), by wait_warm, launch and read_events;
                     without it Warming events come from read_events
        directory    the socket directory, removed by the nursery if the front end dies without doing it

        Raises ArrayError if no process can be started.
        """
        ours, theirs = socket.socketpair()
        reading, writing = os.pipe2(os.O_CLOEXEC)
        arguments = [str(theirs.fileno()), "--front-end", str(os.getpid()), "--program", program, "--warm", warm]
        arguments += ["--directory", directory] if directory is not None else []
        try:
            # -P: a random.py where the user happens to stand is not what the node program imports.
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "raygrid.emulator.processes.fork_server", *arguments],
                stderr=writing,
                close_fds=True,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
                env=os.environ | ONE_THREAD,
                cwd=_standing(),
                stdin=subprocess.DEVNULL,
            )
        except OSError as error:
            ours.close()
            os.close(reading)
            raise ArrayError(f"the nursery cannot be started with {sys.executable!r}: {error}") from error
        finally:
            theirs.close()
            os.close(writing)
        return cls(process, ours, reading, on_warming)

    # --- while it lives --------------------------------------------------------------------------

    @property
    def alive(self) -> bool:
        """Whether the nursery was serving when last heard of."""
        return not (self._dead or self._ended)

    @property
    def stopped(self) -> bool:
        """Whether the process is stopped (SIGSTOP) at this moment: it forks nothing, and tells of nobody's end."""
        return not self._ended and process_state(self.pid) == "T"

    @property
    def serving(self) -> bool:
        """Whether it can be asked to fork and kill nodes."""
        return self.alive and not self.deaf and not self.stopped

    @property
    def pids(self) -> dict[int, Index]:
        """The nodes that live, process id -> coordinates, as of the last event read."""
        return dict(self._pids)

    @property
    def words(self) -> str:
        """The end of what nursery and nodes have written to stderr."""
        return self._stderr.tail

    def fileno(self) -> int:
        """A descriptor that can be read when read_events has something to do. Raises ArrayError after `end`."""
        if self._ended:
            raise ArrayError("the nursery was ended, and has no events any more")
        return self._epoll.fileno()

    def wait_warm(self, timeout: float | None = None, on_wait: Callable[[], None] | None = None) -> None:
        """Wait until nodes can be launched. Raises ArrayError if it fails, or takes more than `timeout` seconds, and
        what `on_wait` raises, which is called four times a second or more."""

        def warm() -> bool:
            if on_wait is not None:
                on_wait()
            return self.warm

        self._wait(warm, timeout, "become warm")

    def is_warm(self) -> bool:
        """Whether nodes can be launched, by what has come so far. Raises ArrayError if the nursery has failed."""
        self._check_alive()
        if not self.warm:
            self._attend(0.0)
        return self.warm

    def launch(self, configs: Sequence[Message], timeout: float = 60.0) -> list[int]:
        """Fork a node for each config; returns their process ids, in the same order.

        A config is a map that msgpack can carry, with the node's coordinates under "index"; the node
        gets it with tuples for lists. Waits until the nursery is warm. Either all are forked or none:
        raises ArrayError if not, LostProcess if the nursery ends meanwhile.
        """
        for config in configs:
            index = config.get("index")
            if not (isinstance(index, (list, tuple)) and [type(axis) for axis in index] == [int] * 3):
                raise ArrayError(f'a config came with index {index!r}, wanted three whole numbers under "index"')
        self.wait_warm(timeout)
        self._check_alive()
        self._reply, self._asked = None, configs
        try:
            self._control.send({"do": "launch", "configs": list(configs)})
        except (TypeError, ValueError, OverflowError) as error:
            raise ArrayError(f"a node's config cannot be sent: {error}; wanted what msgpack can carry") from error
        self._wait(lambda: self._reply is not None, timeout, f"fork {len(configs)} nodes")
        reply: Message = self._reply or {}
        if "pids" not in reply:
            raise ArrayError(f"the array could not be launched: {reply['why']}")
        pids, lines = list(reply["pids"]), self._control.descriptors
        if len(lines) != len(pids):
            close_all(lines)
            self.kill(pids)
            raise ArrayError(f"{len(lines)} lines to {len(pids)} nodes came: this process has no descriptors left")
        self._lines.update(zip(pids, lines, strict=True))
        lines.clear()
        return pids

    def take_line(self, pid: int) -> int:
        """The descriptor of the host's end of the line to a node that was launched; from now on the caller's."""
        return self._lines.pop(pid)

    def kill(self, pids: Sequence[int]) -> None:
        """Kill these nodes with SIGKILL; those that have ended already are passed over. Their ends come as events."""
        self._check_alive()
        self._control.send({"do": "kill", "pids": list(pids)})

    def read_events(self) -> list[Event]:
        """What has happened since the last call, oldest first, without waiting; nothing after `end`.

        Raises LostProcess, once all events before it have been read, if the nursery ended by itself.
        """
        if self._ended:
            return []
        self._attend(0.0)
        events, self._events = self._events, []
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._held)
        if not events:
            self._check_alive()
        return events

    def _wait(self, done: Callable[[], bool], timeout: float | None, what: str) -> None:
        deadline = time.monotonic() + (math.inf if timeout is None else timeout)
        ran = time.monotonic()
        while not done():
            self._check_alive()
            now = time.monotonic()
            if deadline <= now:
                raise ArrayError(f"the nursery (process {self.pid}) did not {what} within {timeout:g} seconds")
            if not self.stopped:
                ran = now
            elif now - ran > STOPPED_SECONDS:
                raise LostProcess(f"the nursery (process {self.pid}) is stopped, and was to {what}")
            self._attend(min(deadline - now, LOOK_SECONDS))

    def _check_alive(self) -> None:
        if self._ended:
            raise ArrayError("the nursery was ended, wanted one that serves")
        if self._dead:
            kind, when = (LostProcess, "") if self.warm else (ArrayError, " before it was warm")
            said = self._stderr.last_lines() or "without a word"
            raise kind(f"the nursery (process {self.pid}) ended by {_how(self._status())}{when}: {said}")

    def _status(self) -> int:
        """How the dead nursery ended; it stays a zombie until `end`, so that its process group stays its own."""
        try:
            found = os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT)
        except ChildProcessError:  # the program ignores SIGCHLD
            return 0
        return 0 if found is None else found.si_status if found.si_code == os.CLD_EXITED else -found.si_status

    def _kill(self, number: int, group: bool = False) -> None:
        """Send the nursery a signal, or its group; nobody, if its process id may be another's by now."""
        with contextlib.suppress(ChildProcessError, ProcessLookupError):
            os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG)
            (os.killpg if group else os.kill)(self.pid, number)

    def _sources(self) -> set[int]:
        """The descriptors that may still bring something."""
        sources = set() if self._dead else {self._control.socket.fileno(), self._pidfd}
        sources |= set() if self._stderr.closed else {self._stderr.descriptor}
        return {source for source in sources if source is not None}

    def _attend(self, timeout: float) -> None:
        """Wait for anything, at most `timeout` seconds, and take in all that has come."""
        poller = select.poll()
        for source in self._sources():
            writing = source == self._control.socket.fileno() and self._control.unsent
            poller.register(source, select.POLLIN | (select.POLLOUT if writing else 0))
        ready = dict(poller.poll(None if timeout == math.inf else timeout * 1000))
        if not ready or self._dead:
            self._stderr.read()
            return
        self._control.flush()
        messages = self._control.receive()
        self._stderr.read()  # after the reports: a node's words were there before its end was known
        self._dead = self._control.closed or self._pidfd in ready
        for message in messages:
            self._hear(message)
        if self._events:
            os.eventfd_write(self._held, 1)

    def _hear(self, message: Message) -> None:
        """Take in a report."""
        kind = message["is"]
        if kind == "warm":
            self.warm = True
        elif kind == "warming":
            event = Warming(message["done"], message["total"], message["what"])
            if self._on_warming is None:
                self._events.append(event)
            else:
                self._on_warming(*event)
        elif kind == "ended":
            index: Index = message["index"]
            self._pids.pop(message["pid"], None)
            status: int = message["status"]
            self._events.append(ProcessEnded(message["pid"], index, status, self._stderr.take(index, status)))
        elif kind != "lines":  # launched, or refused
            indices = (tuple(config["index"]) for config in self._asked)
            self._pids.update(zip(message.get("pids", ()), indices, strict=False))
            self._reply = message

    # --- its end ---------------------------------------------------------------------------------

    def end(self, timeout: float = 5.0) -> None:
        """End all nodes and the nursery: asked first, killed after `timeout` seconds, and waited for.

        May be called twice, and at any time; in a fork of the front end it only closes descriptors.
        Raises ArrayError if a process is still there afterwards.
        """
        if self._ended:
            return
        try:
            if os.getpid() == self._owner:
                self._end_processes(timeout)
        finally:
            self._ended = True
            self._pids.clear()
            atexit.unregister(self.end)
            self._epoll.close()
            self._control.close()
            for line in self._lines.values():
                os.close(line)
            self._lines.clear()
            for descriptor in (self._held, self._stderr.descriptor, self._pidfd):
                if descriptor is not None:
                    os.close(descriptor)

    def _end_processes(self, timeout: float) -> None:
        self._on_warming = None
        try:
            self._control.send({"do": "end"})
            if not self.warm:
                self._kill(signal.SIGTERM)  # it is busy compiling, and does not listen
            self._wait_gone(0.0 if self.stopped or self.deaf else timeout)
        finally:  # also after a second Ctrl-C
            self._kill(signal.SIGKILL, group=True)
            self._wait_gone(LAST_WAIT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(LAST_WAIT)
        # Without reports from the nursery, a closed stderr proves that all who could write to it are gone.
        unproved = [] if self._stderr.closed else [pid for pid in self._pids if os.path.exists(f"/proc/{pid}")]
        left = unproved if self._process.returncode is not None else [self.pid, *unproved]
        if left:
            raise ArrayError(f"processes {left} are still there {LAST_WAIT:g} seconds after SIGKILL")

    def _wait_gone(self, timeout: float) -> None:
        """Wait until the nursery is dead and all nodes are reaped, or else, all have closed stderr."""
        deadline = time.monotonic() + timeout
        while not (self._dead and (not self._pids or self._stderr.closed)):
            left = deadline - time.monotonic()
            if left <= 0:
                return
            self._attend(left)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()


def _standing() -> str | None:
    """Where the nursery is to stand: here, or at the root if the working directory is gone, without which nothing imports."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return "/"
    return None


def _how(status: int) -> str:
    return f"exit code {status}" if status >= 0 else f"signal {SIGNALS.get(-status, -status)}"
