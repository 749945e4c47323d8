"""Forks, reaps and reports all nodes of an array, as a small process: `python -m raygrid.emulator.processes.fork_server FD`.

Why not fork the front end: it may have threads, a ZeroMQ context, a scene and a display; a fork of all that is slow
at best. Why not spawn: a node would pay 75 MB and 1.5 s of CPU time. So this process imports the node program, warms
it (every kernel called once), and then does nothing but fork, reap and report. It is single-threaded, and Ctrl-C in
the terminal does not reach it, as it has its own session.

Orders and reports on the socket FD: `emulator.processes.fork_server_protocol`. Each node is forked with a socket pair of
its own for its control channel, so that only it and the host can speak on it.

Nobody outlives the front end: when its process or the socket is gone, the fork server ends all nodes and itself. Nobody
outlives the fork server: only it holds the write end of the `life` pipe, of which each node holds the read end and ends
when it closes; and the kernel sends each node SIGTERM if the fork server dies, for a node that is busy in a kernel.
"""

from __future__ import annotations

import argparse
import ctypes
import faulthandler
import gc
import importlib
import os
import selectors
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from fcntl import F_GETFL, F_SETFL, F_SETOWN, fcntl
from typing import NoReturn

from raygrid.emulator.processes import fork_server_protocol as protocol
from raygrid.emulator.processes.control import MOST_DESCRIPTORS, ForkServerChannel, Message, close_all
from raygrid.emulator.topology import socket_directory
from raygrid.emulator.topology.coordinates import Index, name_of
from raygrid.node.errors import RaygridError

Run = Callable[[Message, int, int], None]

LONGEST_LINE = 2000  # bytes; up to 4096 a write to a pipe is not torn
GRACE = 1.0  # seconds from SIGTERM to SIGKILL
LAST_WAIT = 5.0  # seconds for the kernel to finish what was killed
PR_SET_PDEATHSIG = 1
DEBUG = "RAYGRID_DEBUG"  # set: tracebacks of errors, and of crashes in compiled code


class ForkServer:
    """Obeys the front end, forks nodes, reaps them and reports their ends.

    children   the living nodes, process id -> index
    """

    def __init__(self, control: ForkServerChannel, run: Run, front_end: int, directory: str | None) -> None:
        self.control = control
        self.children: dict[int, Index] = {}
        self._run = run
        self._directory = directory
        self._life, self._life_writer = os.pipe()
        self._wakeup, self._wakeup_writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._wakeup, selectors.EVENT_READ)
        self._selector.register(control.socket, selectors.EVENT_READ)
        # A fork of the front end that outlives it keeps the socket open, so the process itself is watched as well.
        self._front_end = open_pidfd(front_end)
        self._ending = self._orphaned = self._front_end is None and not os.path.exists(f"/proc/{front_end}")
        if self._front_end is not None:
            self._selector.register(self._front_end, selectors.EVENT_READ)

    def serve(self) -> None:
        """Obey until told to end or until the front end is gone; then end all nodes and reap them."""
        signal.set_wakeup_fd(self._wakeup_writer, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)  # only a signal with a handler wakes up
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._told_to_end)
        try:
            while not self._ending:
                self._turn(None)
        finally:
            self._end_children()
            if self._orphaned and self._directory is not None:
                socket_directory.remove(self._directory)  # the front end cannot do it any more

    def _told_to_end(self, *_: object) -> None:
        self._ending = True

    def _turn(self, timeout: float | None) -> None:
        """Wait for a command, for the end of a node or of the front end, and attend to it."""
        if not self.control.closed:
            writing = selectors.EVENT_WRITE if self.control.unsent else 0
            self._selector.modify(self.control.socket, selectors.EVENT_READ | writing)
        for key, ready in self._selector.select(timeout):
            if key.fd == self._wakeup:
                with suppress(BlockingIOError):
                    os.read(self._wakeup, 1 << 16)
            elif key.fd == self._front_end:
                self._lose_front_end(self._front_end)
            else:
                self._attend(ready)
        self._reap()

    def _attend(self, ready: int) -> None:
        if ready & selectors.EVENT_WRITE:
            self.control.flush()
        for message in self.control.receive():
            self._obey(message)
        if self.control.closed:
            self._lose_front_end(self.control.socket)

    def _lose_front_end(self, sign: int | socket.socket) -> None:
        self._selector.unregister(sign)
        self._ending = self._orphaned = True

    def _obey(self, message: Message) -> None:
        match protocol.read_order(message):
            case protocol.Launch(configs) if not self._ending:
                self._launch(configs)
            case protocol.Kill(pids):
                for pid in self.children.keys() & set(pids):  # not yet reaped, so nobody else has these ids
                    os.kill(pid, signal.SIGKILL)
            case protocol.End():
                self._ending = True
            case protocol.Launch() | None:
                self._report(protocol.Refused(f"the fork server cannot {message.get('do')!r} now"))

    def _report(self, report: protocol.Report, descriptors: Sequence[int] = ()) -> None:
        self.control.send(protocol.as_message(report), descriptors)

    # --- nodes -----------------------------------------------------------------------------------

    def _launch(self, configs: Sequence[Message]) -> None:
        """Fork a node for each config: all, or none."""
        pids: list[int] = []
        channels: list[int] = []
        try:
            for config in configs:
                ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                channels.append(ours.detach())
                with theirs:
                    pids.append(self._fork(config, theirs.fileno()))
        except OSError as error:
            close_all(channels)
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
            why = f"node {len(pids) + 1} of {len(configs)} could not be forked: {error.strerror}"
            self._report(protocol.Refused(why))
            return
        self.children.update((pid, config["index"]) for pid, config in zip(pids, configs, strict=True))
        for first in range(0, len(channels), MOST_DESCRIPTORS):
            some = channels[first : first + MOST_DESCRIPTORS]
            self._report(protocol.ControlEnds(len(some)), some)
        self._report(protocol.Launched(pids))

    def _fork(self, config: Message, channel: int) -> int:
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()  # or each child would write it again
        # A signal between the fork and the child's own dispositions must not run the fork server's handlers.
        held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD})
        try:
            fork_server = os.getpid()
            pid = os.fork()
            if pid == 0:
                self._be_node(config, channel, fork_server)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, held)
        return pid

    def _be_node(self, config: Message, channel: int, fork_server: int) -> NoReturn:
        """In the child: run the node program to its end. Never returns into the fork server's frames."""
        code = 1
        try:
            self._forget_fork_server(fork_server, channel)
            self._run(config, self._life, channel)
            code = 0
        except BaseException as error:
            say(f"raygrid node {name_of(config['index'])}", error)
        finally:
            for stream in (sys.stdout, sys.stderr):
                with suppress(Exception):
                    stream.flush()
            os._exit(code)

    def _forget_fork_server(self, fork_server: int, channel: int) -> None:
        """In the child: give up all that is the fork server's, keeping descriptors 0, 1, 2, `life` and `channel`."""
        end_with_parent(fork_server)
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        # Through their objects first: one closed later by the collector would take a node's socket with it.
        self._selector.close()
        self.control.socket.close()
        for descriptor in (self._life_writer, self._wakeup, self._wakeup_writer, self._front_end):
            if descriptor is not None:
                os.close(descriptor)
        first = 3
        for kept in sorted((self._life, channel)):
            os.closerange(first, kept)
            first = max(kept + 1, 3)
        os.closerange(first, os.sysconf("SC_OPEN_MAX"))
        signal.pthread_sigmask(signal.SIG_SETMASK, set())

    def _reap(self) -> None:
        """Report all nodes that have ended."""
        while self.children:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return
            index = self.children.pop(pid, None)
            if index is not None:
                code = os.waitstatus_to_exitcode(status)
                self._report(protocol.NodeEnded(pid, index, code))

    def _end_children(self) -> None:
        """End and reap all nodes, and give the front end a short time to read of it."""
        os.close(self._life_writer)
        for sign, bound in ((signal.SIGTERM, GRACE), (signal.SIGKILL, LAST_WAIT)):
            for pid in self.children:
                os.kill(pid, sign)
            deadline = time.monotonic() + bound
            while self.children and (left := deadline - time.monotonic()) > 0:
                self._turn(left)
        deadline = time.monotonic() + GRACE
        while self.control.unsent and not self.control.closed and (left := deadline - time.monotonic()) > 0:
            self._turn(left)


def open_pidfd(pid: int) -> int | None:
    """A descriptor that can be read when the process has ended; None where the kernel has none or it has ended."""
    try:
        return os.pidfd_open(pid)
    except OSError:
        return None


def end_with_parent(parent: int, number: int = signal.SIGTERM) -> None:
    """Ask the kernel for a signal when the parent ends, and end now if it has ended already."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(number), 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


def say(who: str, error: BaseException) -> None:
    """Write an error to stderr as one line "who: what", behind its traceback if RAYGRID_DEBUG is set."""
    if os.environ.get(DEBUG):
        traceback.print_exception(error)
    told = str(error) if isinstance(error, RaygridError) else f"{type(error).__name__}: {error}"
    line = f"{who}: {' '.join(told.split())}".encode(errors="backslashreplace")
    with suppress(OSError):
        os.write(2, line[:LONGEST_LINE] + b"\n")


def end_if_orphaned(control: socket.socket, directory: str | None) -> None:
    """Clean up and end at once, also in the midst of compiling, when the other end of the socket closes."""

    def look(*_: object) -> None:
        try:
            gone = not control.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            gone = False
        except OSError:
            gone = True
        if gone:
            if directory is not None:
                socket_directory.remove(directory)
            os._exit(1)

    signal.signal(signal.SIGIO, look)
    fcntl(control, F_SETOWN, os.getpid())
    fcntl(control, F_SETFL, fcntl(control, F_GETFL) | os.O_ASYNC)
    look()


def warm_up(control: ForkServerChannel, program: str, warm: str, directory: str | None = None) -> Run:
    """Import the node program and warm it, with a report a step; returns its `run`."""
    end_if_orphaned(control.socket, directory)
    gc.disable()  # of what is imported and loaded nearly all stays, and looking it through takes a sixth of the time
    # numba would import it, if it is installed, for its linear algebra; kernels and programs have none.
    sys.modules.setdefault("scipy", None)  # type: ignore[arg-type]
    run: Run = importlib.import_module(program).run
    module, _, function = warm.partition(":")

    def report(done: int, total: int, what: str) -> None:
        if done:
            gc.enable()  # but compiling leaves much behind
        control.send(protocol.as_message(protocol.Warming(done, total, what)))

    getattr(importlib.import_module(module), function)(report)
    fcntl(control.socket, F_SETFL, fcntl(control.socket, F_GETFL) & ~os.O_ASYNC)
    signal.signal(signal.SIGIO, signal.SIG_IGN)
    tasks = len(os.listdir("/proc/self/task"))
    if tasks > 1:
        say("raygrid fork server", RaygridError(f"warming left {tasks} threads, wanted 1: forks may hang"))
    if gc.isenabled():
        gc.collect()
    gc.freeze()  # or the first collection in each node would write to, and so copy, all that is shared
    gc.enable()
    control.send(protocol.as_message(protocol.Warm()))
    return run


def build_parser() -> argparse.ArgumentParser:
    """The arguments that `ForkServerClient.start` passes."""
    parser = argparse.ArgumentParser(prog="python -m raygrid.emulator.processes.fork_server", description=__doc__)
    parser.add_argument("fd", type=int, metavar="FD", help="socket to the front end")
    parser.add_argument("--front-end", type=int, default=os.getppid(), metavar="PID", help="process to outlive never")
    parser.add_argument("--program", default="raygrid.node.main", metavar="MODULE", help="its run(config, life)")
    parser.add_argument("--warm", default="raygrid.emulator.processes.warm:warm", metavar="MODULE:FUNCTION")
    parser.add_argument("--directory", metavar="DIR", help="socket directory to remove if the front end dies")
    return parser


def main(argv: list[str] | None = None) -> NoReturn:
    """Warm, serve, and end."""
    arguments = build_parser().parse_args(argv)
    # A front end may have blocked or ignored signals, and both are inherited through exec.
    signal.pthread_sigmask(signal.SIG_SETMASK, set())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if os.environ.get(DEBUG):
        faulthandler.enable()
    os.set_inheritable(arguments.fd, False)
    control = ForkServerChannel(socket.socket(fileno=arguments.fd))
    try:
        run = warm_up(control, arguments.program, arguments.warm, arguments.directory)
        ForkServer(control, run, arguments.front_end, arguments.directory).serve()
    except Exception as error:
        say("raygrid fork server", error)
        os._exit(1)
    os._exit(0)  # without tearing down numba, which takes a tenth of a second


if __name__ == "__main__":
    main()
