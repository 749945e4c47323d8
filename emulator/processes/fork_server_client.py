"""Starts the fork server, launches nodes, hears of their ends, and leaves no process behind: the front end's side.

    with ForkServerClient.start() as fork_server:  # returns at once; read the scene while it warms
        fork_server.wait_warm(timeout=300)
        fork_server.launch(configs)  # one map a node, with its "index"
        ...  # poll fork_server.fileno(), and when it can be read, fork_server.read_events()

What nodes and fork server write to stderr comes here, not to the terminal, and becomes part of the error that tells
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
from typing import Self, assert_never

from raygrid.emulator.processes import fork_server_protocol as protocol
from raygrid.emulator.processes.control import ForkServerChannel, Message, close_all
from raygrid.emulator.processes.fork_server import LAST_WAIT, open_pidfd
from raygrid.emulator.processes.process_ended import ProcessEnded, how_ended
from raygrid.emulator.processes.stderr_log import StderrLog
from raygrid.emulator.topology.coordinates import Index
from raygrid.emulator.topology.process_stat import process_state
from raygrid.node.errors import ArrayError, LostProcess

LOOK_SECONDS = 0.25  # between two looks at whether it runs, while something is expected of it
STOPPED_SECONDS = 0.75  # after which one that is stopped is not waited for any longer
# One thread a process: a fork copies only one, and the array itself is the parallelism.
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

OnWarming = Callable[[int, int, str], object]


Event = protocol.Warming | ProcessEnded


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
        self._control_ends: dict[int, int] = {}  # of nodes that were launched, until they are taken
        self._asked: Sequence[Message] = ()  # configs of the launch under way
        self._reply: protocol.Launched | protocol.Refused | None = None
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
        directory    the socket directory, removed by the fork server if the front end dies without doing it

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
            raise ArrayError(f"the fork server cannot be started with {sys.executable!r}: {error}") from error
        finally:
            theirs.close()
            os.close(writing)
        return cls(process, ours, reading, on_warming)

    # --- while it lives --------------------------------------------------------------------------

    @property
    def alive(self) -> bool:
        """Whether the fork server was serving when last heard of."""
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
        """The end of what fork server and nodes have written to stderr."""
        return self._stderr.tail

    def fileno(self) -> int:
        """A descriptor that can be read when read_events has something to do. Raises ArrayError after `end`."""
        if self._ended:
            raise ArrayError("the fork server was ended, and has no events any more")
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
        """Whether nodes can be launched, by what has come so far. Raises ArrayError if the fork server has failed."""
        self._check_alive()
        if not self.warm:
            self._attend(0.0)
        return self.warm

    def launch(self, configs: Sequence[Message], timeout: float = 60.0) -> list[int]:
        """Fork a node for each config; returns their process ids, in the same order.

        A config is a map that msgpack can carry, with the node's coordinates under "index"; the node
        gets it with tuples for lists. Waits until the fork server is warm. Either all are forked or none:
        raises ArrayError if not, LostProcess if the fork server ends meanwhile.
        """
        for config in configs:
            index = config.get("index")
            if not (isinstance(index, (list, tuple)) and [type(axis) for axis in index] == [int] * 3):
                raise ArrayError(f'a config came with index {index!r}, wanted three whole numbers under "index"')
        self.wait_warm(timeout)
        self._check_alive()
        self._reply, self._asked = None, configs
        try:
            self._order(protocol.Launch(configs))
        except (TypeError, ValueError, OverflowError) as error:
            raise ArrayError(f"a node's config cannot be sent: {error}; wanted what msgpack can carry") from error
        reply = self._wait_reply(timeout, f"fork {len(configs)} nodes")
        if isinstance(reply, protocol.Refused):
            raise ArrayError(f"the array could not be launched: {reply.why}")
        ends = self._control.descriptors
        if len(ends) != len(reply.pids):
            many = len(ends)
            close_all(ends)
            self.kill(reply.pids)
            raise ArrayError(f"{many} lines to {len(reply.pids)} nodes came: this process has no descriptors left")
        self._control_ends.update(zip(reply.pids, ends, strict=True))
        ends.clear()
        return list(reply.pids)

    def take_control_end(self, pid: int) -> int:
        """The descriptor of the host's end of the control channel of a node that was launched; from now on the caller's."""
        return self._control_ends.pop(pid)

    def kill(self, pids: Sequence[int]) -> None:
        """Kill these nodes with SIGKILL; those that have ended already are passed over. Their ends come as events."""
        self._check_alive()
        self._order(protocol.Kill(pids))

    def _order(self, order: protocol.Order) -> None:
        self._control.send(protocol.as_message(order))

    def read_events(self) -> list[Event]:
        """What has happened since the last call, oldest first, without waiting; nothing after `end`.

        Raises LostProcess, once all events before it have been read, if the fork server ended by itself.
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

    def _wait_reply(self, timeout: float, what: str) -> protocol.Launched | protocol.Refused:
        self._wait(lambda: self._reply is not None, timeout, what)
        assert self._reply is not None
        return self._reply

    def _wait(self, done: Callable[[], bool], timeout: float | None, what: str) -> None:
        deadline = time.monotonic() + (math.inf if timeout is None else timeout)
        ran = time.monotonic()
        while not done():
            self._check_alive()
            now = time.monotonic()
            if deadline <= now:
                raise ArrayError(f"the fork server (process {self.pid}) did not {what} within {timeout:g} seconds")
            if not self.stopped:
                ran = now
            elif now - ran > STOPPED_SECONDS:
                raise LostProcess(f"the fork server (process {self.pid}) is stopped, and was to {what}")
            self._attend(min(deadline - now, LOOK_SECONDS))

    def _check_alive(self) -> None:
        if self._ended:
            raise ArrayError("the fork server was ended, wanted one that serves")
        if self._dead:
            kind, when = (LostProcess, "") if self.warm else (ArrayError, " before it was warm")
            said = self._stderr.last_lines() or "without a word"
            raise kind(f"the fork server (process {self.pid}) ended by {how_ended(self._status())}{when}: {said}")

    def _status(self) -> int:
        """How the dead fork server ended; it stays a zombie until `end`, so that its process group stays its own."""
        try:
            found = os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT)
        except ChildProcessError:  # the program ignores SIGCHLD
            return 0
        return 0 if found is None else found.si_status if found.si_code == os.CLD_EXITED else -found.si_status

    def _kill(self, number: int, group: bool = False) -> None:
        """Send the fork server a signal, or its group; nobody, if its process id may be another's by now."""
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
            self._take(message)
        if self._events:
            os.eventfd_write(self._held, 1)

    def _take(self, message: Message) -> None:
        """Take in a report."""
        match protocol.read_report(message):
            case protocol.Warm():
                self.warm = True
            case protocol.Warming() as event:
                if self._on_warming is None:
                    self._events.append(event)
                else:
                    self._on_warming(event.done, event.total, event.what)
            case protocol.NodeEnded(pid, index, status):
                self._pids.pop(pid, None)
                self._events.append(ProcessEnded(pid, index, status, self._stderr.take(index, status)))
            case protocol.Launched(pids) as reply:
                self._pids.update(zip(pids, (tuple(config["index"]) for config in self._asked), strict=True))
                self._reply = reply
            case protocol.Refused() as reply:
                self._reply = reply
            case protocol.ControlEnds():
                pass  # they wait in the channel for the end of the launch
            case unknown:
                assert_never(unknown)

    # --- its end ---------------------------------------------------------------------------------

    def end(self, timeout: float = 5.0) -> None:
        """End all nodes and the fork server: asked first, killed after `timeout` seconds, and waited for.

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
            for descriptor in (*self._control_ends.values(), self._held, self._stderr.descriptor, self._pidfd):
                if descriptor is not None:
                    os.close(descriptor)
            self._control_ends.clear()

    def _end_processes(self, timeout: float) -> None:
        self._on_warming = None
        try:
            self._order(protocol.End())
            if not self.warm:
                self._kill(signal.SIGTERM)  # it is busy compiling, and does not listen
            self._wait_gone(0.0 if self.stopped or self.deaf else timeout)
        finally:  # also after a second Ctrl-C
            self._kill(signal.SIGKILL, group=True)
            self._wait_gone(LAST_WAIT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(LAST_WAIT)
        # Without reports from the fork server, a closed stderr proves that all who could write to it are gone.
        unproved = [] if self._stderr.closed else [pid for pid in self._pids if os.path.exists(f"/proc/{pid}")]
        left = unproved if self._process.returncode is not None else [self.pid, *unproved]
        if left:
            raise ArrayError(f"processes {left} are still there {LAST_WAIT:g} seconds after SIGKILL")

    def _wait_gone(self, timeout: float) -> None:
        """Wait until the fork server is dead and all nodes are reaped, or else, all have closed stderr."""
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
    """Where the fork server is to stand: here, or at the root if the working directory is gone, without which nothing imports."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return "/"
    return None
