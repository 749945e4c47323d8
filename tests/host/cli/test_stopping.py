"""Ctrl-C and other ends at any moment: no process, socket directory or half-written file stays, the terminal is clean."""

import os
import signal
import subprocess

import pytest
from support.cli import RAYGRID, TINY, warm_kernels
from support.terminal import HIDE, SHOW, Terminal

__all__ = ["warm_kernels"]

pytestmark = pytest.mark.usefixtures("warm_kernels", "no_leftovers")

# A floor that fills the picture and is not lit: hardly any work for many pixels.
FLOOR = (
    "v from 0 0 5 at 0 0 0 up 0 1 0 angle 40 hither 1 resolution 9 9 f 1 1 1 1 0 0 0 0 p 4 -9 -9 0 9 -9 0 9 9 0 -9 9 0"
)
LONG = ["render", TINY, "--size", "3000x3000", "--samples", "16", "-o", "x.png", "-o", "x.npy", "--stats", "x.json"]
MANY_PIXELS = ["render", "floor.nff", "--size", "3000x2000", "-o", "x.png", "-o", "x.npy", "--stats", "x.json"]


def check_stopped(terminal, folder, code=130):
    """As it should be after Ctrl-C: one line, the cursor shown, the folder without files but the scene."""
    assert terminal.wait_end() == code, terminal.screen
    assert terminal.screen.endswith("raygrid: stopped"), terminal.screen
    assert "Traceback" not in terminal.text
    assert terminal.text.count(HIDE) == terminal.text.count(SHOW)
    assert {path.name for path in folder.iterdir()} <= {"floor.nff"}


@pytest.mark.parametrize(
    ("moment", "arguments"),
    [
        ("reading", LONG),
        ("launching", LONG),
        ("loading surfaces", LONG),
        (r"tracing .*packets/s", LONG),
        ("collecting pixels", MANY_PIXELS),
        (r"writing x\.png", MANY_PIXELS),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_control_c_ends_everything(moment, arguments, tmp_path):
    (tmp_path / "floor.nff").write_text(FLOOR)
    with Terminal([RAYGRID, *arguments], tmp_path) as terminal:
        terminal.wait_for(moment)
        terminal.press("\x03")
        check_stopped(terminal, tmp_path)


def test_control_c_while_kernels_are_compiled(tmp_path):
    """In the first run on a computer, which says so."""
    with Terminal([RAYGRID, *LONG], tmp_path, {"RAYGRID_CACHE": str(tmp_path / "cache")}) as terminal:
        terminal.wait_for(r"compiling the kernels of nodes \(kind 1 of 4\), once on this computer")
        terminal.wait_for(r"compiling \w+ .*\d+ of \d+")
        terminal.press("\x03")
        assert terminal.wait_end() == 130
        assert "raygrid: stopped" in terminal.screen
        assert {path.name for path in tmp_path.iterdir()} <= {"cache"}


def test_impatient_control_c(tmp_path):
    """A second one, while the first is being obeyed, changes nothing of what is left: nothing."""
    with Terminal([RAYGRID, *LONG], tmp_path) as terminal:
        terminal.wait_for(r"tracing .*packets/s")
        for _ in range(3):
            terminal.press("\x03")
        assert terminal.wait_end() in (130, -signal.SIGINT)
        assert {path.name for path in tmp_path.iterdir()} == set()


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGHUP])
def test_signals_that_ask_for_an_end(sign, tmp_path):
    with Terminal([RAYGRID, *LONG], tmp_path) as terminal:
        terminal.wait_for(r"tracing .*packets/s")
        os.kill(terminal.process.pid, sign)
        assert terminal.wait_end() == 128 + sign
        assert terminal.screen.endswith(f"raygrid: ended by {sign.name}")
        assert list(tmp_path.iterdir()) == []


def test_a_killed_front_end_leaves_no_process_and_no_socket_directory(tmp_path, no_leftovers):
    with Terminal([RAYGRID, *LONG], tmp_path) as terminal:
        terminal.wait_for(r"tracing .*packets/s")
        os.kill(terminal.process.pid, signal.SIGKILL)
        terminal.wait_end()  # the terminal closes when the last process that holds it is gone
        assert list(tmp_path.iterdir()) == []


def test_a_killed_processor_is_an_error_of_one_line_if_there_is_no_other_attempt(tmp_path):
    with Terminal([RAYGRID, *LONG, "--attempts", "1"], tmp_path) as terminal:
        node = _kill_a_node(terminal)
        assert terminal.wait_end() == 1
        assert f"(pid {node}) ended: signal SIGKILL" in " ".join(terminal.screen.split("\n"))
        assert terminal.screen.startswith("raygrid: node 1,1,0")
        assert list(tmp_path.iterdir()) == []


def test_a_killed_processor_is_told_and_the_frame_begins_anew(tmp_path):
    with Terminal([RAYGRID, *LONG], tmp_path) as terminal:
        node = _kill_a_node(terminal)
        terminal.wait_for(rf"note: node 1,1,0 \(pid {node}\) ended: signal SIGKILL; the array was reset in ")
        terminal.wait_for(r"tracing .*packets/s")
        terminal.press("\x03")
        assert terminal.wait_end() == 130
        assert list(tmp_path.iterdir()) == []


def _kill_a_node(terminal):
    terminal.wait_for(r"tracing .*packets/s")
    fork_server = int(_children(terminal.process.pid)[0])
    node = int(_children(fork_server)[3])
    os.kill(node, signal.SIGKILL)
    return node


def _children(pid):
    return subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=True).stdout.split()
