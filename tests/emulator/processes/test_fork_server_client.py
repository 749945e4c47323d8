"""The fork server: nodes are launched, their ends reported, and nobody outlives the front end."""

import os
import select
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import psutil
import pytest
from support.processes import (
    TIMEOUT,
    Gate,
    gate,
    no_leftovers,
    open_descriptors,
    wait_ended,
    wait_readable,
)

from raygrid.emulator.processes.control import LONGEST_MESSAGE, ForkServerChannel
from raygrid.emulator.processes.fork_server_client import ForkServerClient
from raygrid.emulator.processes.fork_server_protocol import Warming
from raygrid.node.errors import ArrayError, LostProcess, ProtocolError
from raygrid.node.protocol.framing import LENGTH

pytestmark = pytest.mark.usefixtures("no_leftovers")
__all__ = ["gate", "no_leftovers"]  # fixtures


def start(warm: str = "warm_quickly", **options) -> ForkServerClient:
    """A fork server with the stand-in program."""
    return ForkServerClient.start(program="support.processes", warm=f"support.processes:{warm}", **options)


# --- launching -----------------------------------------------------------------------------------


def test_warming_is_reported_and_the_start_does_not_wait_for_it():
    told = []
    with start(on_warming=lambda *step: told.append(step)) as fork_server:
        assert not fork_server.warm
        assert told == []
        fork_server.wait_warm(TIMEOUT)
        assert told == [(0, 3, "kernel 0"), (1, 3, "kernel 1"), (2, 3, "kernel 2"), (3, 3, "ready")]
        assert fork_server.read_events() == []


def test_warming_comes_as_events_without_a_callback():
    with start() as fork_server:
        fork_server.wait_warm(TIMEOUT)
        wait_readable(fork_server.fileno(), "the events held back")
        assert fork_server.read_events()[-1] == Warming(3, 3, "ready")
        assert not select.select([fork_server.fileno()], [], [], 0)[0]


def test_reports_are_kept_for_a_front_end_that_does_not_listen():
    told = []
    with start("warm_at_length", on_warming=lambda *step: told.append(step[0])) as fork_server:
        wait_readable(fork_server.fileno(), "the first report")
        while fork_server.read_events() or len(told) < 3000:
            wait_readable(fork_server.fileno(), "the next report")
        assert told == list(range(3000))


def test_27_nodes_in_one_go_and_more_later(gate: Gate):
    with start() as fork_server:
        pids = fork_server.launch([gate.config(number) for number in range(27)])
        hellos = gate.wait_for(27)
        assert {hello.index: hello.pid for hello in hellos} == {(n, 0, 0): pid for n, pid in enumerate(pids)}
        assert fork_server.pids == {pid: (n, 0, 0) for n, pid in enumerate(pids)}
        assert {psutil.Process(pid).ppid() for pid in pids} == {fork_server.pid}
        later = fork_server.launch([gate.config(99)])
        assert gate.wait_for(1)[0].pid == later[0]
        assert len(fork_server.pids) == 28
    assert not any(psutil.pid_exists(pid) for pid in (*pids, *later, fork_server.pid))
    gate.wait_empty()


@pytest.mark.parametrize("warm", ["warm_quickly", "warm_untidily"])
def test_a_node_holds_no_descriptor_but_the_documented_ones(gate: Gate, warm):
    inheritable = os.memfd_create("of the front end", 0)
    with start(warm) as fork_server:
        os.close(inheritable)
        for number in range(3):  # later ones must not inherit what belongs to earlier ones
            fork_server.launch([gate.config(number)])
            hello = gate.wait_for(1)[0]
            assert set(hello.descriptors) == {0, 1, 2, hello.life, hello.line}
            assert hello.descriptors[hello.line].startswith("socket:")
            assert hello.descriptors[hello.life].startswith("pipe:")
            reading = Path(f"/proc/{hello.pid}/fdinfo/{hello.life}").read_text().split()[3]
            assert int(reading, 8) & os.O_ACCMODE == os.O_RDONLY


def test_a_node_has_default_signals_and_no_terminal(gate: Gate):
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGCHLD})
    try:
        fork_server = start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
    with fork_server:
        fork_server.launch([gate.config()])
        (hello,) = gate.wait_for(1)
        ignored, caught = int(hello.status["SigIgn"], 16), int(hello.status["SigCgt"], 16)
        assert int(hello.status["SigBlk"], 16) == 0
        assert ignored & 1 << (signal.SIGINT - 1)
        assert not (ignored | caught) & (1 << (signal.SIGTERM - 1) | 1 << (signal.SIGCHLD - 1))
        assert hello.status["Threads"] == "1"
        assert os.getsid(hello.pid) == fork_server.pid != os.getsid(0)


def test_a_large_config_arrives_whole(gate: Gate):
    with start() as fork_server:
        fork_server.launch([gate.config(ballast=bytes(10_000_000))])
        gate.wait_for(1)


@pytest.mark.parametrize("index", [None, [1, 2], [1, 2, "3"], 7])
def test_a_config_must_say_which_node_it_is_for(index):
    with start() as fork_server, pytest.raises(ArrayError, match=r"came with index .*, wanted three whole numbers"):
        fork_server.launch([{"index": index}])


def test_a_config_that_cannot_be_sent_is_refused(gate: Gate):
    with start() as fork_server:
        with pytest.raises(ArrayError, match=r"config cannot be sent: .*object"):
            fork_server.launch([gate.config(strange=object())])
        fork_server.launch([gate.config()])  # and does no harm
        gate.wait_for(1)


def test_a_launch_that_cannot_fork_all_forks_none(gate: Gate):
    with start(warm="warm_with_few_processes") as fork_server:
        with pytest.raises(ArrayError, match="node 3 of 5 could not be forked: Resource temporarily unavailable"):
            fork_server.launch([gate.config(number) for number in range(5)])
        assert psutil.Process(fork_server.pid).children() == []
        assert fork_server.pids == {}


# --- ends of nodes -------------------------------------------------------------------------------


def test_each_end_is_reported_with_the_node_and_the_reason(gate: Gate):
    configs = [
        gate.config(0, "return"),
        gate.config(1, "exit", code=3),
        gate.config(2, "kill", signal=int(signal.SIGKILL)),
        gate.config(3, "raise", words="no\nsuch  thing"),
        gate.config(4, "refuse", words="node 4,0,0: a packet came, wanted none"),
        gate.config(5),
    ]
    with start() as fork_server:
        pids = fork_server.launch(configs)
        ended = sorted(wait_ended(fork_server, 5), key=lambda event: event.index)
        assert [event.index[0] for event in ended] == [0, 1, 2, 3, 4]
        assert [event.pid for event in ended] == pids[:5]
        assert [event.code for event in ended] == [0, 3, None, 1, 1]
        assert [event.signal for event in ended] == [None, None, "SIGKILL", None, None]
        assert [event.why for event in ended[1:]] == [
            "exit code 3",
            "signal SIGKILL",
            "exit code 1: ValueError: no such thing",
            "exit code 1: node 4,0,0: a packet came, wanted none",
        ]
        assert str(ended[2]) == f"node 2,0,0 (process {pids[2]}) ended by signal SIGKILL"
        assert fork_server.pids == {pids[5]: (5, 0, 0)}


@pytest.mark.parametrize(
    ("status", "why"),
    [
        (127, "exit code 127: no memory for a thread's data"),
        (3, "exit code 3"),
        (-int(signal.SIGABRT), "signal SIGABRT: no memory for a thread's data"),
        (-int(signal.SIGKILL), "signal SIGKILL"),
    ],
)
def test_what_a_library_says_before_it_ends_a_node_is_passed_on(gate: Gate, monkeypatch, status, why):
    monkeypatch.delenv("RAYGRID_DEBUG", raising=False)  # or all of it goes to the terminal
    with start() as fork_server:
        fork_server.launch([gate.config(0, "say and end", said="no memory for a thread's data\n", status=status)])
        (event,) = wait_ended(fork_server, 1)
        assert event.why == why


def test_what_a_library_says_is_passed_on_once_and_for_the_node_that_it_ended(gate: Gate, monkeypatch):
    monkeypatch.delenv("RAYGRID_DEBUG", raising=False)
    with start() as fork_server:
        fork_server.launch([gate.config(0, "say and end", said="Out of memory (src/msg.cpp:1)\n", status=0)])
        wait_ended(fork_server, 1)
        for number, why in (1, "signal SIGABRT: Out of memory (src/msg.cpp:1)"), (2, "signal SIGABRT"):
            fork_server.launch([gate.config(number, "kill", signal=int(signal.SIGABRT))])
            (event,) = wait_ended(fork_server, 1)
            assert event.why == why


def test_the_traceback_is_shown_on_demand(gate: Gate, monkeypatch, capfd):
    monkeypatch.setenv("RAYGRID_DEBUG", "1")
    with start() as fork_server:
        fork_server.launch([gate.config(0, "raise", words="broken")])
        (event,) = wait_ended(fork_server, 1)
    assert event.words == "ValueError: broken"
    assert "Traceback" in capfd.readouterr().err


def test_nothing_goes_to_the_terminal_without_demand(gate: Gate, monkeypatch, capfd):
    monkeypatch.delenv("RAYGRID_DEBUG", raising=False)
    with start() as fork_server:
        fork_server.launch([gate.config(0, "raise", words="broken")])
        wait_ended(fork_server, 1)
        assert fork_server.words == "raygrid node 0,0,0: ValueError: broken\n"
    assert capfd.readouterr() == ("", "")


def test_a_babbling_node_is_drained_and_its_end_attributed(gate: Gate):
    with start() as fork_server:
        fork_server.launch([gate.config(7, "babble")])
        (event,) = wait_ended(fork_server, 1)
        assert event.why == "exit code 1: ValueError: nothing more to say"
        assert len(fork_server.words) < 20_000


# --- the end of everything -----------------------------------------------------------------------


def test_ending_twice_is_ending_once(gate: Gate):
    before = open_descriptors()
    fork_server = start()
    fork_server.launch([gate.config()])
    (hello,) = gate.wait_for(1)
    fork_server.end()
    assert not psutil.pid_exists(hello.pid)
    assert not psutil.pid_exists(fork_server.pid)
    fork_server.end()
    assert not fork_server.alive
    assert fork_server.read_events() == []
    with pytest.raises(ArrayError, match="was ended"):
        fork_server.fileno()
    with pytest.raises(ArrayError, match="was ended"):
        fork_server.launch([gate.config()])
    gate.wait_empty()
    assert len(open_descriptors()) <= len(before) + 1  # the gate's connection


def test_a_node_that_ignores_sigterm_and_one_that_is_stopped_are_killed(gate: Gate, tmp_path):
    file = tmp_path / "file"
    os.mkfifo(file)
    with start() as fork_server:
        fork_server.launch([gate.config(0, "deaf", file=str(file)), gate.config(1)])
        assert file.read_text() == "deaf"
        pids = [hello.pid for hello in gate.wait_for(2)]
        os.kill(pids[1], signal.SIGSTOP)
    assert not any(psutil.pid_exists(pid) for pid in pids)


def test_ending_does_not_wait_for_the_warming():
    fork_server = start(warm="warm_for_ever")
    while not any(isinstance(event, Warming) for event in fork_server.read_events()):
        wait_readable(fork_server.fileno(), "the first report")
    fork_server.end(timeout=1e6)
    assert not psutil.pid_exists(fork_server.pid)


def test_an_exception_in_the_front_end_leaves_nothing(gate: Gate):
    fork_server = start()
    fork_server.launch([gate.config()])
    gate.wait_for(1)
    with pytest.raises(ZeroDivisionError), fork_server:
        _ = 1 / 0
    gate.wait_empty()


def test_a_fork_server_that_hangs_is_killed_with_its_nodes(gate: Gate):
    with start() as fork_server:
        fork_server.launch([gate.config(number) for number in range(3)])
        gate.wait_for(3)
        os.kill(fork_server.pid, signal.SIGSTOP)
        fork_server.end(timeout=0.05)
    gate.wait_empty()


def test_a_fork_of_the_front_end_does_not_end_its_nodes(gate: Gate):
    with start() as fork_server:
        (pid,) = fork_server.launch([gate.config()])
        gate.wait_for(1)
        fork = os.fork()
        if fork == 0:
            fork_server.end()
            os._exit(0)
        assert os.waitpid(fork, 0)[1] == 0
        assert psutil.pid_exists(pid)
        assert fork_server.launch([gate.config(1)])
        gate.wait_for(1)


def test_nodes_outlive_the_thread_that_started_the_fork_server(gate: Gate):
    started: list[ForkServerClient] = []
    thread = threading.Thread(target=lambda: started.append(start()))
    thread.start()
    thread.join()
    with started[0] as fork_server:
        fork_server.launch([gate.config()])
        gate.wait_for(1)
        assert fork_server.alive


# --- a fork server that fails ------------------------------------------------------------------------


def test_a_program_that_is_not_there():
    said = r"exit code 1 before it was warm: raygrid fork server: ModuleNotFoundError: No"
    with ForkServerClient.start(program="no_such_program") as fork_server, pytest.raises(ArrayError, match=said):
        fork_server.wait_warm(TIMEOUT)


def test_files_where_the_user_stands_are_not_imported(monkeypatch, tmp_path):
    (tmp_path / "msgpack.py").write_text("raise SystemExit(9)")
    monkeypatch.chdir(tmp_path)
    with start() as fork_server:
        fork_server.wait_warm(TIMEOUT)


def test_warming_that_fails_is_told():
    with start(warm="warm_badly") as fork_server:
        with pytest.raises(ArrayError, match="RuntimeError: no compiler"):
            fork_server.launch([])
        assert not fork_server.alive


def test_warming_that_takes_too_long_is_told():
    said = r"did not become warm within 0\.05 seconds"
    with start(warm="warm_for_ever") as fork_server, pytest.raises(ArrayError, match=said):
        fork_server.wait_warm(0.05)


def test_a_front_end_that_died_before_the_fork_server_was_warm(pair):
    left, control = pair  # somebody still holds the other end
    dead = subprocess.Popen(["true"])
    dead.wait()
    number = str(control.socket.fileno())
    command = [sys.executable, "-m", "raygrid.emulator.processes.fork_server", number, "--front-end", str(dead.pid)]
    stand_in = ["--program", "support.processes", "--warm", "support.processes:warm_quickly"]
    subprocess.run(command + stand_in, pass_fds=[int(number)], timeout=TIMEOUT, check=True)
    assert ForkServerChannel(left).receive()[-1] == {"is": "warm"}


def test_a_python_that_cannot_be_run(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with pytest.raises(ArrayError, match="cannot be started with '/no/such/python'"):
        start()


def test_a_killed_fork_server_is_reported_and_takes_its_nodes_along(gate: Gate):
    with start() as fork_server:
        fork_server.launch([gate.config(number, "wait" if number % 2 else "busy") for number in range(8)])
        gate.wait_for(8)
        fork_server.read_events()
        os.kill(fork_server.pid, signal.SIGKILL)
        gate.wait_empty()
        wait_readable(fork_server.fileno(), "the end of the fork server")
        with pytest.raises(LostProcess, match=r"ended by signal SIGKILL: without a word"):
            fork_server.read_events()
        assert not fork_server.alive
        with pytest.raises(LostProcess):
            fork_server.launch([gate.config()])


def test_the_life_pipe_alone_ends_a_node(gate: Gate, tmp_path):
    file = tmp_path / "file"
    os.mkfifo(file)
    with start() as fork_server:
        fork_server.launch([gate.config(n) for n in range(3)])
        fork_server.launch([gate.config(9, "deaf until life ends", file=str(file))])
        assert file.read_text() == "waiting"
        gate.wait_for(4)
        os.kill(fork_server.pid, signal.SIGKILL)
        assert file.read_text() == "life ended"
        gate.wait_empty()


# --- messages ------------------------------------------------------------------------------------


@pytest.fixture
def pair():
    left, right = socket.socketpair()
    with left, right:
        yield left, ForkServerChannel(right)


def test_messages_survive_any_cutting(pair):
    left, control = pair
    sender, copy = socket.socketpair()
    with sender, copy:
        ForkServerChannel(sender).send({"index": [1, 2, 3]})
        whole = copy.recv(1000)
    received = []
    for byte in whole * 2:
        left.send(bytes([byte]))
        received += control.receive()
    assert received == [{"index": (1, 2, 3)}] * 2
    assert not control.closed


def test_the_end_comes_after_the_last_message(pair):
    left, control = pair
    ForkServerChannel(left).send({"is": "warm"})
    left.close()
    assert control.receive() == [{"is": "warm"}]
    assert control.closed
    control.send({"do": "end"})  # to nobody, and no error
    assert control.unsent == 0


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (LENGTH.pack(LONGEST_MESSAGE + 1), "wanted at most"),
        (LENGTH.pack(1) + b"\x01", "came as int, wanted a map"),
    ],
)
def test_what_is_no_message_is_refused(pair, raw, said):
    left, control = pair
    left.send(raw)
    with pytest.raises(ProtocolError, match=said):
        control.receive()
