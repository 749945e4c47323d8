"""The command line for tests: in this process, or as a process of its own."""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from raygrid.emulator.processes.array import WARM_SECONDS
from raygrid.emulator.processes.fork_server_client import ForkServerClient
from raygrid.host.cli.main import main
from support.render import SCENES

RAYGRID = str(Path(sys.executable).with_name("raygrid"))
TINY = str(SCENES / "tiny.nff")
TIMEOUT = 150.0  # seconds; only a failing test takes as long


class Outcome(NamedTuple):
    """What a command returned and wrote."""

    code: int
    out: str
    err: str


def here(*arguments: str) -> Outcome:
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(list(arguments))
        except SystemExit as end:
            assert isinstance(end.code, int)
            return Outcome(end.code, out.getvalue(), err.getvalue())
    raise AssertionError("main returned, wanted SystemExit")


def as_process(*arguments: str, environment: dict[str, str] | None = None, **options: Any) -> Outcome:
    """Run the installed command."""
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    done = subprocess.run(
        [RAYGRID, *arguments],
        text=True,
        timeout=TIMEOUT,
        env=os.environ | (environment or {}),
        **(streams | options),
    )
    return Outcome(done.returncode, done.stdout or "", done.stderr or "")


def one_line(outcome: Outcome, code: int, pattern: str) -> None:
    """The outcome has this code, nothing on standard output, and one line that is the pattern."""
    assert outcome.out == ""
    assert outcome.err.count("\n") == 1, outcome.err
    assert re.fullmatch(pattern, outcome.err.rstrip("\n")), outcome.err
    assert outcome.code == code


def misused(outcome: Outcome, command: str, pattern: str) -> None:
    """It is misuse of this command, told in one line that ends with where to read more."""
    one_line(outcome, 2, rf"raygrid {command}: {pattern} \(raygrid {command} --help says more\)")


@pytest.fixture(scope="module")
def warm_kernels() -> None:
    """Compile what is not in the cache yet, so that no test hears of it."""
    with ForkServerClient.start() as fork_server:
        fork_server.wait_warm(WARM_SECONDS)
