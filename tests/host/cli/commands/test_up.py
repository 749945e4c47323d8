"""Ctrl-C at every moment of a launch leaves nothing; what the launched array does then: tests/host/service."""

from __future__ import annotations

import os
import signal
import subprocess
import threading

import pytest
from support.processes import no_leftovers

from raygrid.emulator.topology import socket_directory
from raygrid.host.cli.commands import up
from raygrid.host.cli.commands.up import UpRequest, run_up
from raygrid.node.errors import ArrayError

assert no_leftovers


@pytest.fixture
def launch(tmp_path, monkeypatch, no_leftovers):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return UpRequest((2, 1, 1), "stopped", 4096, 30.0, False, False, False, True)


def test_control_c_while_the_service_is_being_forked_leaves_none(launch, monkeypatch):
    started = []

    class Interrupted(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            started.append(self)
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(up.subprocess, "Popen", Interrupted)
    ended = threading.Event()
    other = threading.Thread(target=ended.wait)  # as that of the progress bar: the kernel may choose it for the signal
    other.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            run_up(launch)
    finally:
        ended.set()
        other.join()
    (process,) = started
    assert process.returncode is not None  # waited for
    for base in socket_directory.bases()[:1]:
        assert not [entry for entry in os.listdir(base) if entry.startswith(socket_directory.PREFIX)]


def test_a_service_that_cannot_be_started_is_one_sentence(launch, monkeypatch):
    monkeypatch.setattr(up.sys, "executable", "/nowhere/python")
    with pytest.raises(ArrayError, match=r"the service cannot be started with '/nowhere/python': .*No such file"):
        run_up(launch)
