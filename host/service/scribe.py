"""Starts, asks and kills the scribe: the process that reads scenes, splits space, and writes pictures (`scribe_process`).

What files and programs of others make a process do cannot be foreseen: a pipe is opened for ever, a loop in compiled code
or in a library holds the interpreter, a file of a few bytes takes all memory. So none of it is done in the service. A call
is waited for with an eye on whether it is still wanted; if not, or if the scribe fails, the process is killed, and
another one takes its place.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from raygrid.emulator.processes import ONE_THREAD, SIGNALS
from raygrid.emulator.topology import process_state
from raygrid.host.files.part_files import FILE as PART
from raygrid.host.service.pickled_calls import Shared, pack, receive
from raygrid.host.service.scribe_calls import CallDone, CallFailed, ScribeCall, Unanswered
from raygrid.node.errors import RaygridError
from raygrid.node.geometry import Groups, SurfaceSet

LOOK_SECONDS = 0.05  # between two looks at whether a call is still wanted
STOPPED_SECONDS = 0.75  # a process that is stopped (SIGSTOP) for longer than this is lost, as a node is
END_SECONDS = 0.5  # for the kernel to end what was killed; what a file system holds up ends when that lets it go
SHARED = (SurfaceSet, Groups)  # an array goes on by increments only from the very same ones

T = TypeVar("T")


class ScribeError(RaygridError):
    """What a call failed with, in one line: a scene or file of whoever asked for it, or the end of the process."""


class ScribeLost(ScribeError):
    """The process ended amid a call, by whatever hand: what it did can be begun again."""


class Scribe:
    """One process, started anew whenever it had to be killed. For use by one thread.

    arguments  of `scribe_process`
    look       called often while a call is waited for; what it raises is passed on, and the call given up
    """

    def __init__(self, arguments: Sequence[str], look: Callable[[], None]) -> None:
        self._arguments, self._look = list(arguments), look
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._shared = Shared(SHARED)
        self._dying: list[subprocess.Popen[bytes]] = []

    @property
    def pid(self) -> int | None:
        """The process; None if there is none just now. May be asked by any thread."""
        process = self._process
        return None if process is None else process.pid

    def start(self) -> None:
        """Start the process unless it is there; it imports meanwhile what it needs. Raises ScribeError."""
        if self._process is not None:
            return
        self._reap()
        try:
            ours, theirs = socket.socketpair()
        except OSError as error:
            raise ScribeError(f"the process that reads scenes cannot be started ({error.strerror})") from None
        with theirs:
            program = [sys.executable, "-P", "-m", "raygrid.host.service.scribe_process"]
            try:
                self._process = subprocess.Popen(
                    [*program, str(theirs.fileno()), str(os.getpid()), *self._arguments],
                    stdin=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(),),
                    env=os.environ | ONE_THREAD,
                )
            except OSError as error:
                ours.close()
                raise ScribeError(f"the process that reads scenes cannot be started ({error.strerror})") from None
        ours.setblocking(False)
        self._socket, self._shared = ours, Shared(SHARED)

    def tell(self, call: Unanswered) -> None:
        """Let it do something that has no answer, when it comes to it. Never raises."""
        with contextlib.suppress(RaygridError, OSError):
            self.start()
            assert self._socket is not None
            self._socket.sendall(b"".join(pack(call, self._shared)))

    def ask(self, call: ScribeCall[T]) -> T:
        """Let it do something and wait for the answer.

        Raises ScribeError with what it raised, ScribeLost with how the process ended; and what `look` raises.
        """
        self.start()
        try:
            for piece in pack(call, self._shared):
                self._send(piece)
            answer: CallDone[T] | CallFailed = receive(self._shared, self._read)
        except (BrokenPipeError, ConnectionResetError, EOFError):
            raise ScribeLost(f"the process that reads scenes and writes pictures {self._how_it_ended()}") from None
        except BaseException:
            self.kill()
            raise
        if isinstance(answer, CallFailed):
            raise ScribeError(answer.why)
        return answer.value

    def _send(self, piece: memoryview) -> None:
        assert self._socket is not None
        while piece:
            self._wait(select.POLLOUT)
            with contextlib.suppress(BlockingIOError):
                piece = piece[self._socket.send(piece, socket.MSG_NOSIGNAL) :]

    def _read(self, room: memoryview) -> int:
        assert self._socket is not None
        while True:
            self._wait(select.POLLIN)
            with contextlib.suppress(BlockingIOError):
                return self._socket.recv_into(room)

    def _wait(self, event: int) -> None:
        """Until the socket is ready, with looks in between; a process that is stopped meanwhile is killed.

        Raises what `look` raises.
        """
        assert self._socket is not None
        assert self._process is not None
        stopped: float | None = None
        poller = select.poll()
        poller.register(self._socket, event)
        while True:
            self._look()
            if poller.poll(LOOK_SECONDS * 1000):
                return
            if process_state(self._process.pid) not in ("T", "t"):
                stopped = None
            elif stopped is None:
                stopped = time.monotonic()
            elif time.monotonic() - stopped >= STOPPED_SECONDS:
                self._process.kill()  # it closes its socket by that, and is told of as any that ended

    def _how_it_ended(self) -> str:
        """How the process that has closed its socket ended; it is gone afterwards."""
        assert self._process is not None
        try:
            status = self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            status = None
        self.kill()
        if status is None:
            return "has closed its door"
        return f"ended by {SIGNALS.get(-status, -status)}" if status < 0 else f"ended with exit code {status}"

    def kill(self) -> None:
        """End the process now, whatever it does, and remove the files that it had half written."""
        process, self._process = self._process, None
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if process is None:
            return
        if process.poll() is None:
            process.send_signal(signal.SIGSTOP)  # or it might begin another file after the look
            parts = half_written(process.pid)
            process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_SECONDS)
            for part in parts:
                with contextlib.suppress(OSError):
                    os.unlink(part)
        self._dying.append(process)
        self._reap()

    def _reap(self) -> None:
        self._dying = [process for process in self._dying if process.poll() is None]

    def close(self) -> None:
        """End the process. May be called twice."""
        self.kill()
        deadline = time.monotonic() + END_SECONDS
        while self._dying and (left := deadline - time.monotonic()) > 0:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._dying[0].wait(left)
            self._reap()


def half_written(pid: int) -> list[str]:
    """The files that a process has open and that are still to be renamed to what they shall be."""
    found = []
    with contextlib.suppress(OSError):
        for descriptor in os.scandir(f"/proc/{pid}/fd"):
            with contextlib.suppress(OSError):
                path = os.readlink(descriptor.path)
                if os.path.isabs(path) and Path(path).name.startswith(PART):
                    found.append(path)
    return found
