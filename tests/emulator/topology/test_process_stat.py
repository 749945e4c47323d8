"""What the kernel says of processes: those that are there, those that are gone, and what cannot be seen."""

import builtins
import os
import subprocess
import time

from raygrid.emulator.topology.process_stat import process_mark, process_state, process_times, read_stat


def test_a_name_with_blanks_and_brackets_does_not_confuse_the_start_time(tmp_path):
    strange = tmp_path / "a) b ("
    strange.symlink_to("/bin/cat")
    with subprocess.Popen([str(strange)], stdin=subprocess.PIPE) as process:
        pid, started, _ = process_mark(process.pid).split()
        assert int(pid) == process.pid
        assert int(started) >= int(process_mark(os.getpid()).split()[1])


def test_a_process_has_a_state_and_the_time_that_it_has_used():
    spent = time.process_time()
    state, seconds = process_times(os.getpid())
    assert state == process_state(os.getpid()) == "R"
    assert seconds > spent - 0.1  # the kernel counts in hundredths


def test_a_process_that_is_gone_has_neither_state_nor_mark():
    with subprocess.Popen(["true"], stdin=subprocess.DEVNULL) as process:
        pid = process.pid
    assert (read_stat(pid), process_mark(pid), process_state(pid), process_times(pid)) == (None, None, "", ("", 0.0))


def test_one_that_has_ended_and_was_not_reaped_has_no_mark():
    with subprocess.Popen(["true"], stdin=subprocess.DEVNULL) as process:
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert process_state(process.pid) == "Z"
        assert process_mark(process.pid) is None


def test_what_cannot_be_seen_is_not_taken_for_dead(monkeypatch):
    def refused(*_arguments, **_options):
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(builtins, "open", refused)
    assert process_state(os.getpid()) == "?"
    assert process_times(os.getpid()) == ("", 0.0)
