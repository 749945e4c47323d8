"""Support for tests with processes: a check that nothing is left behind, a stand-in node program, waiting by name.

`no_leftovers` is a fixture; a test file that wants it says `from support.processes import no_leftovers` and
`pytestmark = pytest.mark.usefixtures("no_leftovers")`, or a conftest makes it autouse.

`run` is a node program for `ForkServerClient.start(program="support.processes")`: it announces itself at a gate and then does
what its config says. The `warm_...` functions are stand-ins for the warming.
"""

from __future__ import annotations

import ast
import gc
import multiprocessing.resource_tracker
import os
import secrets
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import psutil
import pytest

from raygrid.emulator.processes.fork_server_client import ForkServerClient
from raygrid.emulator.processes.process_ended import ProcessEnded
from raygrid.emulator.topology import socket_directory
from raygrid.node.errors import ArrayError

TESTS = Path(__file__).parents[1]
TIMEOUT = 20.0  # seconds; only a failing test takes as long
GRACE = 2.0  # seconds that a process may take to disappear after the test
MARK = "RAYGRID_TEST_MARK"  # variable that tells the processes of one test from all others, orphans too
DESCRIPTORS = ("socket:", "pipe:", "anon_inode:[pidfd]")

# --- waiting -------------------------------------------------------------------------------------


def wait_readable(source: Any, what: str, timeout: float = TIMEOUT) -> None:
    """Wait until a descriptor can be read or is at its end, or fail after `timeout` seconds."""
    poller = select.poll()
    poller.register(source, select.POLLIN)
    assert poller.poll(timeout * 1000), f"{what} did not come within {timeout} seconds"


def wait_dead(*pids: int) -> None:
    """Wait until these processes have ended."""
    for pid in pids:
        try:
            descriptor = os.pidfd_open(pid)
        except ProcessLookupError:
            continue
        try:
            wait_readable(descriptor, f"the end of process {pid}")
        finally:
            os.close(descriptor)


def wait_ended(fork_server: ForkServerClient, count: int) -> list[ProcessEnded]:
    """The next `count` nodes that end, in the order of their ends."""
    ended: list[ProcessEnded] = []
    while len(ended) < count:
        wait_readable(fork_server.fileno(), "the end of a node")
        ended += [event for event in fork_server.read_events() if isinstance(event, ProcessEnded)]
    return ended


class Hello(NamedTuple):
    """What a stand-in node says of itself at the gate."""

    index: tuple[int, ...]
    pid: int
    life: int
    line: int
    descriptors: dict[int, str]
    status: dict[str, str]


class Gate:
    """A listening socket where stand-in nodes announce themselves; each holds its connection until it is gone."""

    def __init__(self, directory: str) -> None:
        self.path = os.path.join(directory, "gate")
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(self.path)
        self._listener.listen(1000)
        self._listener.settimeout(TIMEOUT)
        self._guests: list[socket.socket] = []

    def config(self, number: int = 0, then: str = "wait", **more: Any) -> dict[str, Any]:
        """A config for the stand-in node at coordinates (number, 0, 0)."""
        return {"index": [number, 0, 0], "gate": self.path, "then": then, **more}

    def wait_for(self, count: int) -> list[Hello]:
        """The next `count` nodes that announce themselves."""
        hellos = []
        for _ in range(count):
            guest, _ = self._listener.accept()
            guest.settimeout(TIMEOUT)
            self._guests.append(guest)
            with guest.makefile("rb") as lines:
                hellos.append(Hello(*ast.literal_eval(lines.readline().decode())))
        return hellos

    def wait_empty(self) -> None:
        """Wait until all nodes that announced themselves are gone."""
        for guest in self._guests:
            assert guest.recv(1) == b"", "a stand-in node says nothing but its hello"

    def close(self) -> None:
        """Close all connections."""
        for held in (self._listener, *self._guests):
            held.close()


@pytest.fixture
def gate(no_leftovers: str) -> Iterator[Gate]:
    """A gate, and the stand-in programs made importable for the fork server."""
    made = Gate(no_leftovers)
    yield made
    made.close()


# --- stand-in node program -----------------------------------------------------------------------


def run(config: dict[str, Any], life: int, line: int) -> None:
    """Announce this node at the gate, then do what config["then"] says."""
    descriptors = {number: name for number, name in open_descriptors().items() if "/fd" not in name}
    with open("/proc/self/status") as file:
        status = dict(line.rstrip("\n").split(":\t", 1) for line in file if ":\t" in line)
    with socket.socket(socket.AF_UNIX) as door:
        door.connect(config["gate"])
        hello = (config["index"], os.getpid(), life, line, descriptors, status)
        door.sendall(f"{hello!r}\n".encode())
        THEN[config["then"]](config, life)


def _wait(config: dict[str, Any], life: int) -> None:
    select.select([life], [], [])


def _raise(config: dict[str, Any], life: int) -> None:
    raise ValueError(config["words"])


def _refuse(config: dict[str, Any], life: int) -> None:
    raise ArrayError(config["words"])


def _deaf(config: dict[str, Any], life: int) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    Path(config["file"]).write_text("deaf")
    signal.pause()


def _deaf_until_life_ends(config: dict[str, Any], life: int) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    Path(config["file"]).write_text("waiting")
    select.select([life], [], [])
    Path(config["file"]).write_text("life ended")


def _babble(config: dict[str, Any], life: int) -> None:
    for _ in range(2000):
        os.write(2, b"blah " * 100 + b"\n")
    raise ValueError("nothing more to say")


def _say_and_end(config: dict[str, Any], life: int) -> None:
    os.write(2, config["said"].encode())
    if config["status"] < 0:
        os.kill(os.getpid(), -config["status"])
    os._exit(config["status"])


THEN: dict[str, Callable[[dict[str, Any], int], Any]] = {
    "wait": _wait,
    "return": lambda config, life: None,
    "raise": _raise,
    "refuse": _refuse,
    "exit": lambda config, life: os._exit(config["code"]),
    "kill": lambda config, life: os.kill(os.getpid(), config["signal"]),
    "busy": lambda config, life: signal.pause(),
    "deaf": _deaf,
    "deaf until life ends": _deaf_until_life_ends,
    "babble": _babble,
    "say and end": _say_and_end,
}


def warm_quickly(report: Callable[[int, int, str], None]) -> None:
    """Report three kernels."""
    for done in range(3):
        report(done, 3, f"kernel {done}")
    report(3, 3, "ready")


def warm_for_ever(report: Callable[[int, int, str], None]) -> None:
    """Report, and then wait for a thing that never comes."""
    report(0, 1, "stuck")
    reading, _ = os.pipe()
    select.select([reading], [], [])


def warm_untidily(report: Callable[[int, int, str], None]) -> None:
    """Leave a descriptor open, as a library might."""
    os.pipe()


def warm_at_length(report: Callable[[int, int, str], None]) -> None:
    """Report far more than a socket holds."""
    for done in range(3000):
        report(done, 3000, "x" * 1000)


def warm_badly(report: Callable[[int, int, str], None]) -> None:
    """Fail."""
    raise RuntimeError("no compiler")


def warm_with_few_processes(report: Callable[[int, int, str], None]) -> None:
    """Let the third fork of the fork server fail, as at the limit of processes."""
    fork, left = os.fork, iter((True, True))

    def fork_twice() -> int:
        if not next(left, False):
            raise BlockingIOError(11, "Resource temporarily unavailable")
        return fork()

    os.fork = fork_twice


# --- front ends ----------------------------------------------------------------------------------

# As a user would write it: no guard for __main__, and it reads nothing but its arguments.
FRONT_END = """
import os, select, signal, sys
from raygrid.emulator.processes.fork_server_client import ForkServerClient
from raygrid.emulator.topology.socket_directory import SocketDirectory
path, warm, how = sys.argv[1:]
with SocketDirectory.create((3, 1, 1)) as place:
    program = dict(program="support.processes", warm="support.processes:" + warm)
    server = ForkServerClient.start(directory=place.path, **program)
    print(place.path, server.pid, flush=True)
    if how == "ignores children":
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    if warm == "warm_for_ever":
        while not server.read_events():
            select.select([server], [], [])
        print("stuck", flush=True)
        signal.pause()
    server.launch([{"index": [n, 0, 0], "gate": path, "then": "wait"} for n in range(3)])
    if how == "has a fork":
        os.fork()
    if how in ("has a fork", "waits"):
        signal.pause()
    if how == "ends":
        server.end()
    if how == "polls":
        with server:
            while True:
                select.select([server], [], [])
                server.read_events()
"""


class FrontEnd:
    """A front end in a process of its own, in a process group of its own."""

    def __init__(self, path: str, how: str, warm: str = "warm_quickly") -> None:
        command = [sys.executable, "-c", FRONT_END, path, warm, how]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        assert self.process.stdout is not None
        self.directory, fork_server = self.process.stdout.readline().split()
        self.fork_server = int(fork_server)

    def finish(self) -> str:
        """Wait for its end; returns what it wrote to stderr."""
        return self.process.communicate(timeout=TIMEOUT)[1]


# --- nothing is left behind ----------------------------------------------------------------------


def open_descriptors() -> dict[int, str]:
    """The open descriptors of this process, number -> what it is."""
    found = {}
    for name in os.listdir("/proc/self/fd"):
        try:
            found[int(name)] = os.readlink(f"/proc/self/fd/{name}")
        except FileNotFoundError:  # that of the listing itself
            continue
    return found


class Leftovers:
    """Finds what has appeared since it was made: processes, socket directories, sockets, pipes.

    Processes are found as descendants; by a mark in their environment, which orphans and processes in other
    sessions keep; and in our session when their parent is not (forked twice, never executed).
    """

    def __init__(self, mark: str, runtime: str, grace: float = GRACE) -> None:
        self._grace = grace
        self._mark = f"{MARK}={mark}".encode()
        self._runtime = runtime
        self._began = time.time()
        self._session = os.getsid(0)
        self._me = psutil.Process()
        self._processes = set(self._me.children(recursive=True))
        self._directories = set(self._socket_directories())
        self._descriptors = set(self._watched_descriptors().items())

    def find(self) -> list[str]:
        """A line for each thing left behind. Ends the processes and removes the directories."""
        if self._watched_descriptors().items() - self._descriptors:
            gc.collect()  # what only waits for the collector is not left behind
        _, processes = psutil.wait_procs(self.processes(), timeout=self._grace)
        lines = [self._describe(process) for process in processes]
        for process in processes:
            process.kill()
        psutil.wait_procs(processes, timeout=self._grace)
        for directory in self._socket_directories():
            if directory not in self._directories and self._is_ours(directory):
                lines.append(f"directory {directory} of {_signed(directory)} with {sorted(os.listdir(directory))}")
                shutil.rmtree(directory, ignore_errors=True)
        new = self._watched_descriptors().items() - self._descriptors
        return lines + [f"descriptor {number} {what}" for number, what in sorted(new)]

    def processes(self) -> list[psutil.Process]:
        """The processes that have come from this one and are still there, zombies too."""
        found = set(self._me.children(recursive=True))
        for process in psutil.process_iter():
            if process.pid != self._me.pid and (self._is_marked(process) or self._has_strayed(process)):
                found.add(process)
        tracker = multiprocessing.resource_tracker._resource_tracker._pid  # lives as long as the test run
        return [process for process in found - self._processes if process.pid != tracker]

    def _is_marked(self, process: psutil.Process) -> bool:
        try:
            return self._mark in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0")
        except OSError:
            return False

    def _has_strayed(self, process: psutil.Process) -> bool:
        try:
            if os.getsid(process.pid) != self._session or process.pid == self._session:
                return False
            return process.create_time() >= self._began and os.getsid(process.ppid()) != self._session
        except (psutil.Error, OSError):
            return False

    def _describe(self, process: psutil.Process) -> str:
        try:
            group, session = os.getpgid(process.pid), os.getsid(process.pid)
            told = f"{process.status()}, parent {process.ppid()}, group {group}, session {session}"
            return f"process {process.pid} ({told}): {' '.join(process.cmdline())[:200]}"
        except (psutil.Error, OSError) as error:
            return f"process {process.pid} ({error})"

    def _socket_directories(self) -> list[str]:
        bases = {self._runtime, *socket_directory.bases()}
        return [str(path) for base in bases for path in Path(base).glob(f"{socket_directory.PREFIX}*")]

    def _is_ours(self, directory: str) -> bool:
        """Not if it belongs to another living front end, such as that of a test run beside this one.

        One that is not signed may be just being made there: that takes a moment, within which it is signed.
        """
        deadline = time.monotonic() + self._grace
        while os.path.isdir(directory):
            try:
                pid = int(Path(directory, socket_directory.PID_FILE).read_text().split()[0])
            except (OSError, ValueError, IndexError):
                if time.monotonic() > deadline:
                    return True
                os.sched_yield()
                continue
            return pid == os.getpid() or not psutil.pid_exists(pid)
        return False

    def _watched_descriptors(self) -> dict[int, str]:
        tracker = multiprocessing.resource_tracker._resource_tracker._fd
        found = open_descriptors().items()
        return {number: what for number, what in found if what.startswith(DESCRIPTORS) and number != tracker}


def _signed(directory: str) -> str:
    """What a socket directory says of whose it is."""
    try:
        return Path(directory, socket_directory.PID_FILE).read_text().strip()
    except OSError:
        return "nobody"


@pytest.fixture
def no_leftovers(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Fail a test that leaves processes, socket directories, sockets or pipes behind.

    The test gets a short private directory as XDG_RUNTIME_DIR, which is also the fixture's value, and this
    directory of tests as PYTHONPATH, so that processes started by it find the stand-in programs.
    """
    runtime = tempfile.mkdtemp(prefix="rgtest-", dir="/tmp")
    mark = secrets.token_hex(8)
    # Not in a context of its own: what the test sets is to be undone before this is, or these names would outlive it.
    monkeypatch.setenv(MARK, mark)
    monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
    monkeypatch.setenv("PYTHONPATH", str(TESTS))
    leftovers = Leftovers(mark, runtime)
    try:
        yield runtime
    finally:
        left = leftovers.find()
        shutil.rmtree(runtime, ignore_errors=True)
    if left:
        pytest.fail("the test left behind:\n" + "\n".join(f"  {line}" for line in left), pytrace=False)
