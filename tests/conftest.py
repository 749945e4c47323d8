"""What all tests share: time limits, steady random cases, and the check that nothing is left behind."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import tempfile
from collections.abc import Iterator

import pytest
from hypothesis import settings
from support.cases import steady
from support.order import place_of
from support.processes import MARK, Leftovers, no_leftovers

from raygrid.node.jit.switches import SWITCHES

__all__ = ["no_leftovers"]  # for the single tests of files that start processes

TIMEOUT, SLOW_TIMEOUT = 300, 900  # seconds; a first run compiles
if os.environ.get("NUMBA_DISABLE_JIT") == "1":
    TIMEOUT = SLOW_TIMEOUT  # without a compiler tests of many cases take minutes on a busy computer

settings.register_profile("steady", steady(100))
settings.load_profile("steady")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the files of `support_order` begin first; give every test a time limit that fits it, unless it names its own."""
    items.sort(key=lambda item: place_of(item.path.stem))
    for item in items:
        if item.get_closest_marker("timeout") is None:
            slow = item.get_closest_marker("slow") is not None
            item.add_marker(pytest.mark.timeout(SLOW_TIMEOUT if slow else TIMEOUT))


@pytest.fixture(autouse=True, scope="module")
def nothing_left() -> Iterator[None]:
    """Fail a file of tests that leaves processes, socket directories, sockets or pipes behind.

    Once a file, because looking costs 0.2 s; files that start processes use `no_leftovers` for each test as well.
    """
    mark, before = secrets.token_hex(8), os.environ.get(MARK)
    os.environ[MARK] = mark
    leftovers, base = Leftovers(mark, "/tmp"), os.environ.get("XDG_RUNTIME_DIR")
    yield
    left = leftovers.find()
    if os.environ.get("XDG_RUNTIME_DIR") != base:
        left.append(f"XDG_RUNTIME_DIR as {os.environ.get('XDG_RUNTIME_DIR')}, it was {base}")
    os.environ.pop(MARK) if before is None else os.environ.update({MARK: before})
    if left:
        pytest.fail("the tests of this file left behind:\n" + "\n".join(f"  {line}" for line in left), pytrace=False)


def pytest_configure(config: pytest.Config) -> None:
    """A shell lets what it starts in the background ignore Ctrl-C, and children inherit that: tests of it would hang.

    A worker of pytest-xdist gets a session and a place for sockets of its own, so that what its tests leave behind is told
    from what the other workers are using.
    """
    if hasattr(config, "workerinput"):
        os.setsid()
        runtime = tempfile.mkdtemp(prefix="rgtest-", dir="/tmp")
        os.environ["XDG_RUNTIME_DIR"] = runtime
        config.add_cleanup(lambda: shutil.rmtree(runtime, ignore_errors=True))
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def quick_records(monkeypatch: pytest.MonkeyPatch) -> None:
    """Records of nodes in memory without this process' own memory, which takes the kernel longer than a small picture."""
    monkeypatch.setattr("raygrid.node.runtime.report.private_memory", lambda: 0)


@pytest.fixture
def fast_paths_on(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """For tests of fast paths: none is turned off, also where the tests run with one of them off (`make test-switches`)."""
    from raygrid.node.links import zmq_c_api

    for switch in SWITCHES:
        monkeypatch.setenv(switch.variable, "1")
    monkeypatch.delenv(zmq_c_api.OLD_SWITCH, raising=False)
    forget = zmq_c_api._look_for_functions.cache_clear
    forget()
    yield
    forget()
