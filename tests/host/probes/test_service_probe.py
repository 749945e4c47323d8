"""Probes of an array that stays: idle and at work, for several clients, until it ends or Ctrl-C comes."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from functools import partialmethod

import numpy as np
import pytest
from support.cli import RAYGRID, TIMEOUT, TINY, here, one_line
from support.service import SIZE, end, lasting, on, sums, up
from support.terminal import HIDE, SHOW, Terminal

import raygrid
from raygrid.host.client.connection import Connection
from raygrid.host.client.service_files import find
from raygrid.host.probes import service_probe
from raygrid.host.probes.record import replay
from raygrid.host.probes.service_probe import subscribe
from raygrid.node.errors import ArrayError

NODES = {(0, 0, 0), (1, 0, 0)}  # of the array that `lasting` launches
pytestmark = pytest.mark.timeout(200)


@pytest.fixture(scope="module")
def name(tmp_path_factory) -> Iterator[str]:
    with lasting(tmp_path_factory.mktemp("state"), "probed") as launched:
        yield launched


def heard_until(feed, done) -> list:
    """Samples until a condition holds of them."""
    heard: list = []
    for sample in feed.samples:
        if sample is not None:
            heard.append(sample)
        if done(heard):
            return heard
        assert len(heard) < 20_000, "what was waited for did not come"
    raise AssertionError("the feed has ended")


def test_an_idle_array_tells_how_it_stands(name):
    with subscribe(name, 50.0) as feed:
        assert (feed.shape, feed.rate) == ((2, 1, 1), 50.0)
        heard = heard_until(feed, lambda heard: {sample.node for sample in heard} == NODES and len(heard) > 20)
    assert {sample.phase for sample in heard} <= {"idle", "load"}


def test_a_job_is_the_same_under_probes_and_they_show_its_phases(name, tmp_path):
    with subscribe(name, 100.0) as feed, raygrid.connect(name) as array:
        job = array.submit(TINY, output=tmp_path / "a.npy", size=(400, 300), samples=4)
        heard_until(feed, lambda heard: {s.node for s in heard if s.phase == "trace" and s.hits} == NODES)
        job.wait()
        heard_until(feed, lambda heard: bool(heard) and {sample.phase for sample in heard[-4:]} == {"idle"})
        small = array.submit(TINY, output=tmp_path / "b.npy", size=SIZE)
        small.wait()
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(TINY, size=(400, 300), samples=4))
    assert np.array_equal(np.load(tmp_path / "b.npy"), sums(TINY))


def test_the_fastest_client_sets_the_rate_until_it_leaves(name):
    with subscribe(name, 2.0) as slow:
        with subscribe(name, 20.0) as fast:
            assert (slow.rate, fast.rate) == (2.0, 20.0)
        for _ in range(200):  # the service notices soon that a client has left
            with subscribe(name, 1.0) as other:
                if other.rate == 2.0:
                    return
    pytest.fail("the rate of a client that has left is still in force")


def test_a_reset_does_not_end_the_samples(name):
    with subscribe(name, 50.0) as feed, raygrid.connect(name) as array:
        before = heard_until(feed, lambda heard: {sample.node for sample in heard} == NODES)[-1].epoch
        array.reset()
        heard_until(feed, lambda heard: {sample.node for sample in heard if sample.epoch > before} == NODES)


def test_a_node_that_is_forked_anew_speaks_again(name):
    with subscribe(name, 50.0) as feed, raygrid.connect(name) as array:
        heard_until(feed, lambda heard: {sample.node for sample in heard} == NODES)
        victim = array.status()["nodes"][1]["pid"]
        os.kill(victim, signal.SIGKILL)
        heard = heard_until(
            feed, lambda heard: any(s.node == (1, 0, 0) and s.number == 0 and s.epoch > heard[0].epoch for s in heard)
        )
    assert heard


@pytest.mark.parametrize("rate", [-1.0, 1000.0, "fast", None])
def test_a_rate_that_cannot_be_is_refused(name, rate):
    connection = Connection(find(name))
    with contextlib.closing(connection), pytest.raises(ArrayError, match="rate"):
        connection.ask({"do": "probe", "rate": rate})


def test_a_quiet_feed_gives_its_reader_turns_and_asks_again(name, monkeypatch):
    monkeypatch.setattr(service_probe, "QUIET_SECONDS", 0.0)
    with subscribe(name, 0.01) as feed:
        for _ in range(2000):  # samples of a client that has just left may still come
            if next(feed.samples) is None:
                break
        else:
            pytest.fail("the reader got no turn")
        assert next(feed.samples, "the end") != "the end"  # it was asked again, and goes on


def test_a_service_that_hangs_is_noticed(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(service_probe, "QUIET_SECONDS", 0.0)
    monkeypatch.setattr(
        service_probe.Connection, "__init__", partialmethod(service_probe.Connection.__init__, timeout=1.0)
    )
    pid = up("hung")["pid"]
    try:
        with subscribe("hung", 0.01) as feed:
            os.kill(pid, signal.SIGSTOP)
            with pytest.raises(ArrayError, match=r"the array 'hung' .* does not answer"):
                while True:
                    next(feed.samples)
    finally:
        os.kill(pid, signal.SIGCONT)
        end("hung")


# --- the command -----------------------------------------------------------------------------------


def test_the_command_ends_after_its_time_and_keeps_what_came(name, tmp_path):
    record, trace = str(tmp_path / "r.jsonl"), tmp_path / "t.json"
    told = on(name, "probe", "--for", "1", "--rate", "50", "--record", record, "--chrome-trace", str(trace), "--json")
    assert (told.code, told.err) == (0, "")
    lines = [json.loads(line) for line in told.out.splitlines()]
    assert {tuple(line["node"]) for line in lines} == NODES
    assert len(list(replay(record).samples)) == len(lines)
    assert json.loads(trace.read_text())["traceEvents"]


def test_ctrl_c_ends_the_command_and_the_trace_is_written(name, tmp_path):
    arguments = [RAYGRID, "probe", "--name", name, "--rate", "50", "--json", "--chrome-trace", "t.json"]
    with subprocess.Popen(arguments, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as probe:
        assert probe.stdout is not None
        assert json.loads(probe.stdout.readline())["is"] == "sample"
        probe.send_signal(signal.SIGINT)
        _, told = probe.communicate(timeout=TIMEOUT)
    assert (probe.returncode, told) == (130, "raygrid: stopped\n")
    assert json.loads((tmp_path / "t.json").read_text())["traceEvents"]


def test_a_live_table_on_a_terminal(name, tmp_path):
    with Terminal([RAYGRID, "probe", "--name", name, "--rate", "50"], tmp_path) as terminal:
        terminal.wait_for(r"2x1x1: 2 of 2 nodes, ")
        terminal.wait_for(r"1,0,0 ")
        terminal.wait_for(r"z=0")
        terminal.press("\x03")
        assert terminal.wait_end() == 130
        assert terminal.text.rfind(SHOW) > terminal.text.rfind(HIDE) >= 0


def test_an_array_that_ends_ends_the_command_with_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    up("brief")
    try:
        arguments = [RAYGRID, "probe", "--name", "brief", "--rate", "50", "--json", "--record", "r.jsonl"]
        with subprocess.Popen(
            arguments, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as probe:
            assert probe.stdout is not None
            probe.stdout.readline()
            assert on("brief", "down").code == 0
            _, told = probe.communicate(timeout=TIMEOUT)
    finally:
        end("brief")
    assert probe.returncode == 1
    # which of the two is true depends on whether its process has ended yet
    assert re.fullmatch(r"raygrid: the array 'brief' (has closed the connection|\(process \d+\) is gone)\n", told)
    assert list(replay(str(tmp_path / "r.jsonl")).samples)


def test_no_such_array(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    one_line(here("probe", "--name", "none"), 1, r"raygrid: no array named 'none' runs.*")
