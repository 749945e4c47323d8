"""A recording of probes again: in its own time, its worst moment, and its nodes by their busy share."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from support.cli import RAYGRID, here, one_line
from support.probes import made, recorded
from support.terminal import Terminal

from raygrid.host.probes.probing import Probing
from raygrid.host.probes.replay import PAUSE_SECONDS, paced


def test_a_recording_is_played_in_its_own_time():
    now, naps = 100.0, []

    def wait(seconds):
        nonlocal now
        naps.append(seconds)
        now += seconds

    samples = [made(time=time) for time in (7.0, 7.0, 7.5, 9.0)]
    played = paced(samples, 0.5, clock=lambda: now, wait=wait)
    heard = [None if one is None else (one.time, round(now - 100.0, 6)) for one in played]
    assert [at for at in heard if at] == [(7.0, 0.0), (7.0, 0.0), (7.5, 1.0), (9.0, 4.0)]
    assert max(naps) <= PAUSE_SECONDS
    assert heard.count(None) == len(naps) >= 4.0 / PAUSE_SECONDS


def test_a_recording_that_is_late_is_not_waited_for():
    moments = iter([0.0, *[50.0] * 10])
    samples = [made(time=time) for time in (1.0, 2.0, 3.0)]
    assert list(paced(samples, 1.0, clock=lambda: next(moments), wait=lambda _: pytest.fail("it waits"))) == samples


@pytest.fixture
def jammed(tmp_path) -> str:
    """A recording whose worst moment, 30 packets in one node and 10 in the other, is in its middle."""
    path = str(tmp_path / "w.jsonl")
    with Probing((2, 1, 1), 10.0, path) as probing:
        for time, x, rays in ((1.0, 0, 3), (1.5, 1, 3), (2.0, 0, 23), (2.5, 1, 1), (3.0, 0, 0), (4.0, 1, 0)):
            probing.take(replace(made(node=(x, 0, 0), time=time), queues={"travellers": 1, "shadows": 2, "rays": rays}))
    return path


def test_the_worst_moment_is_when_most_packets_wait(jammed):
    told = here("probe", "--replay", jammed, "--worst")
    assert (told.code, told.err) == (0, "")
    assert told.out.startswith("worst moment: 40 packets wait, 1.00 s after the first sample\n2x1x1: 2 of 2 nodes")
    assert ", 40 held," in told.out
    lines = [json.loads(line) for line in here("probe", "--replay", jammed, "--worst", "--json").out.splitlines()]
    assert [(line["node"], line["time"], line["queues"]["rays"]) for line in lines] == [
        ([0, 0, 0], 2.0, 23),
        ([1, 0, 0], 1.5, 3),
    ]


def test_a_table_of_nodes_by_busy_share(tmp_path):
    path = str(tmp_path / "b.jsonl")
    with Probing((3, 1, 1), 10.0, path) as probing:
        for x, cpus in ((0, (0.0, 0.1, 0.2)), (1, (5.0, 5.9, 6.0)), (2, (0.0, 0.0, 0.0))):
            for time, cpu in zip((1.0, 2.0, 4.0), cpus, strict=True):
                probing.take(made(node=(x, 0, 0), time=time, cpu=cpu, served=int(time * 100)))
    told = here("probe", "--replay", path, "--table")
    assert [line.split() for line in told.out.splitlines()] == [
        ["node", "busy", "at", "most", "seconds", "packets", "held", "at", "most"],
        ["1,0,0", "0.33", "0.90", "3.00", "300", "10"],
        ["0,0,0", "0.07", "0.10", "3.00", "300", "10"],
        ["2,0,0", "0.00", "0.00", "3.00", "300", "10"],
    ]
    assert max(map(len, told.out.splitlines())) <= 60
    first = json.loads(here("probe", "--replay", path, "--table", "--json").out.splitlines()[0])
    assert first == {
        "is": "share", "node": [1, 0, 0], "seconds": 3.0, "busy": 0.3333, "most_busy": 0.9, "packets": 300.0, "most_held": 10,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        (["--speed", "2"], "--speed or --worst came without --replay.*"),
        (["--worst"], "--speed or --worst came without --replay.*"),
        (["--replay", "r", "--worst", "--table"], "--worst came with --table or --speed.*"),
        (["--replay", "r", "--speed", "0"], "--speed: '0' came, .*"),
    ],
)
def test_what_does_not_go_together(arguments, pattern):
    one_line(here("probe", *arguments), 2, f"raygrid probe: {pattern}")


def test_a_recording_is_drawn_in_its_time_on_a_small_terminal(tmp_path):
    recording = recorded(tmp_path / "r.jsonl")
    with Terminal([RAYGRID, "probe", "--replay", recording, "--speed", "20"], tmp_path, size=(60, 20)) as terminal:
        terminal.wait_for("reading .*r.jsonl \\.\\.\\.")
        assert terminal.wait_end() == 0
        shown = terminal.screen
    assert "reading" not in shown
    assert "2x1x1: 2 of 2 nodes, trace; busy 0.50 processors" in shown
    assert " 0|  ##" in shown
    assert "busy: .02." in shown
    assert len(shown.splitlines()) <= 20
