"""Probes without processes: what a sample says, that it changes nothing, when it is said, and what is refused."""

from __future__ import annotations

import copy
import json
import math
import socket

import numpy as np
import pytest
from support.cli import TINY, here, one_line, warm_kernels
from support.probes import made, recorded
from support.render import EIGHT, SCENES

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.driver.samples import read_sample
from raygrid.host.probes.chrome_trace import MOST_NODES, ChromeTrace
from raygrid.host.probes.probing import Probing
from raygrid.host.probes.record import ProbeRecord, replay
from raygrid.host.probes.sums import Gauges
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import OutputError, ProtocolError
from raygrid.node.links.control_channel import ControlChannel
from raygrid.node.protocol.codec import pack_map, read_map
from raygrid.node.runtime.probe import NEVER_DUE, NodeProbe, memory, read_rate, sample
from raygrid.node.runtime.processor import Processor
from raygrid.node.tracing.work_queues import CLASSES

pytestmark = pytest.mark.usefixtures("warm_kernels", "quick_records")
assert warm_kernels


class Speaker:
    """A line that keeps what is said, as it would arrive."""

    def __init__(self) -> None:
        self.said: list[dict] = []
        self.dropped = 0

    def send(self, words) -> bool:
        self.said.append(read_map(pack_map(words), "words"))
        return True


def states(processors: list[Processor]) -> list:
    """All that a sample could change."""
    return [
        copy.deepcopy(
            (
                p.node_state.counts.tobytes(),
                (
                    p.node_state.work_queues.count.tobytes(),
                    [p.node_state.work_queues.packets(kind).tobytes() for kind in range(CLASSES)],
                ),
                p.node_state.outputs.held.tobytes(),
                p.node_state.quota,
                p.node_state.cursor.tobytes(),
                None if p.node_state.pixels is None else p.node_state.pixels.sums.tobytes(),
                [(link.messages_sent, link.bytes_sent, link.waiting, link.received) for link in p.links.values()],
                p.phase,
            )
        )
        for p in processors
    ]


@pytest.fixture(scope="module")
def busy():
    """Samples of an array in memory through a frame, of each node before each of its turns, with its queues then."""
    array = MemoryArray(EIGHT)
    array.driver.ready()
    job = make_job(load_scene(SCENES / "kinds.nff"), EIGHT, Settings(size=(64, 48)))
    taken = []

    def look(processor):
        before = states([processor])
        speaker = Speaker()
        probe = NodeProbe(speaker, clock=lambda: 12.5)
        probe.set_rate(1.0)
        probe.maybe_send(processor, 3)
        (words,) = speaker.said
        taken.append((read_sample(processor.index, words), processor.node_state.work_queues.count[:CLASSES].tolist()))
        assert states([processor]) == before, "a sample has changed something"

    for processor in array.processors:

        def work(processor=processor, work=processor.work):
            look(processor)
            return work()

        processor.work = work
    return taken, render_job(array.driver, job), array, job


def test_a_sample_changes_nothing_and_the_picture_is_the_same(busy):
    taken, picture, _, job = busy
    plain = MemoryArray(EIGHT)
    plain.driver.ready()
    untouched = render_job(plain.driver, job)
    assert np.array_equal(picture.sums, untouched.sums)
    assert picture.stats["total"] == untouched.stats["total"]
    assert picture.stats["waves"] == untouched.stats["waves"]
    assert len(taken) > 100


def test_a_sample_says_what_the_node_has(busy):
    taken, _, array, _ = busy
    for said, queued in taken:
        assert list(said.queues.values()) == queued
        assert sum(sum(kinds.values()) for kinds in said.waiting.values()) == sum(queued)
        assert said.queues["shadows"] == sum(kinds.get("shadow", 0) for kinds in said.waiting.values())
        assert said.held == sum(queued) + sum(said.outputs.values())
        assert (said.epoch, said.number, said.time, said.dropped) == (3, 0, 12.5, 0)
    assert {said.phase for said, _ in taken} == {"idle", "load", "trace", "collect"}
    assert max(said.held for said, _ in taken) > 50
    for processor in array.processors:
        said, record = (
            read_sample(processor.index, sample(processor, 0, 0, 1.0, 0, memory(processor))),
            processor.record(),
        )
        assert (said.born, said.died, said.walks, said.hits) == tuple(
            record[name] for name in ("born", "died", "walks", "hits")
        )
        assert list(said.sent.values())[:6] == record["sent"]
        assert said.surfaces == sum(record["surfaces"].values())
        assert sum(link.messages_sent for link in said.links.values()) == record["messages"]
        assert sum(link.bytes_sent for link in said.links.values()) == record["bytes"]
        assert said.memory["pss"] > 1e6


# --- when ------------------------------------------------------------------------------------------


def test_a_node_speaks_at_its_rate_and_does_not_make_up_for_what_it_missed():
    now, speaker = 0.0, Speaker()
    (processor,) = MemoryArray((1, 1, 1)).processors
    probe = NodeProbe(speaker, clock=lambda: now)
    assert not probe.wanted
    assert probe.patience(None) is None
    assert probe.patience(0.5) == 0.5
    probe.maybe_send(processor, 0)
    assert speaker.said == []
    probe.set_rate(10.0)
    assert probe.wanted
    assert probe.patience(None) == 0.0
    for moment in (0.0, 0.05, 0.1, 0.15, 0.25, 5.0, 5.01, 5.1):
        now = moment
        probe.maybe_send(processor, 0)
    assert [words["time"] for words in speaker.said] == [0.0, 0.1, 0.25, 5.0, 5.01, 5.1]
    assert [words["number"] for words in speaker.said] == list(range(6))
    assert probe.patience(3.0) == pytest.approx(0.1, abs=0.02)
    probe.set_rate(0.0)
    assert probe.due == NEVER_DUE
    assert not probe.wanted


def test_where_nobody_reads_samples_are_dropped_and_counted():
    node, host = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    mine, theirs = ControlChannel(node.detach()), ControlChannel(host.detach())
    (processor,) = MemoryArray((1, 1, 1)).processors
    now = 0.0
    probe = NodeProbe(mine, clock=lambda: now)
    probe.set_rate(1.0)
    said = 0
    while mine.dropped < 5:
        probe.maybe_send(processor, 0)
        now += 1.0
        said += 1
        assert said < 100_000, "a line has no end"
    heard = []
    while (words := theirs.receive()) is not None:
        heard.append(read_sample((0, 0, 0), words).number)
    assert heard == list(range(said - 5))
    probe.maybe_send(processor, 0)
    words = theirs.receive()
    assert words is not None
    assert read_sample((0, 0, 0), words).dropped == 5
    mine.close()
    theirs.close()


# --- what is refused ---------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [-1, 100.1, math.inf, math.nan, "10", None, True, [1]])
def test_a_rate_that_cannot_be(rate):
    with pytest.raises(ProtocolError, match="wanted 0 to 100 samples a second"):
        read_rate({"do": "probe", "rate": rate})


SPOILT = {
    "epoch": [None, -1, 1.0, True, "0", 1 << 63],
    "number": [None, -1],
    "time": [None, 1, -1.0, math.inf, math.nan],
    "phase": [None, "sleep", 3, b"trace"],
    "counts": [None, b"", b"\0" * 8, b"\xff" * 8 * 42, "x"],
    "queues": [None, [], [1, 2], [1, 2, -3], [1, 2, 3.0], {}],
    "waiting": [None, [1] * 3, "x", [56, 1], [0, 1], [7, 1], [1, -1], [1, 1] * 57],
    "outputs": [None, [0] * 6, [0] * 8],
    "links": [None, 3, [[0, 1]], [[7, 0, 0, 0, 0]], [[-1, 0, 0, 0, 0]], [[0, 0, 0, 0, 0]] * 8],
    "surfaces": [None, -1],
    "memory": [None, {}, {"surfaces": 1}, []],
    "cpu": [None, 3, -0.5],
    "dropped": [None, -1],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in SPOILT.items() for value in values])
def test_what_is_no_sample_is_refused(name, value):
    (processor,) = MemoryArray((1, 1, 1)).processors
    words = sample(processor, 0, 0, 1.0, 0, memory(processor))
    read_sample((0, 0, 0), words)
    with pytest.raises(ProtocolError, match="node 0,0,0 said a sample that is none"):
        read_sample((0, 0, 0), {**words, name: value})
    with pytest.raises(ProtocolError):
        read_sample((0, 0, 0), {key: inner for key, inner in words.items() if key != name})


# --- what is made of them ----------------------------------------------------------------------------


def test_busy_and_rate_are_worked_out_between_two_samples():
    gauges = Gauges((2, 1, 1))
    assert gauges.take(made(time=1.0, cpu=0.5)).busy == 0.0
    state = gauges.take(made(time=3.0, cpu=1.5, served=400))
    assert (state.busy, state.rate) == (0.5, 200.0)
    state = gauges.take(made(time=4.0, cpu=0.25, served=0))  # another process, another frame
    assert (state.busy, state.rate) == (0.0, 0.0)
    gauges.take(made(node=(1, 0, 0), phase="load"))
    total = gauges.totals()
    assert (total["nodes"], total["held"], total["surfaces"], total["pss"]) == (2, 20, 10, 2_000_000)
    assert gauges.by_kind("born") == {"primary": 0}
    assert [state.sample.node for state in gauges] == [(0, 0, 0), (1, 0, 0)]


def test_the_trace_file_has_bars_and_counters_of_each_node(tmp_path):
    trace = ChromeTrace((2, 1, 1))
    for time, phase, cpu in ((1.0, "load", 0.0), (1.5, "trace", 0.1), (2.0, "trace", 0.35), (2.5, "idle", 0.35)):
        trace.take(made(time=time, phase=phase, cpu=cpu))
    trace.write(tmp_path / "t.json")
    told = json.loads((tmp_path / "t.json").read_text())
    events = told["traceEvents"]
    assert {event["args"]["name"] for event in events if event["name"] == "process_name"} == {"node 0,0,0"}
    bars = [(event["name"], event["ts"], event["dur"]) for event in events if event["ph"] == "X"]
    assert bars == [("load", 0.0, 5e5), ("trace", 5e5, 1e6), ("idle", 1.5e6, 0.0)]
    shares = [(event["ts"], event["args"]) for event in events if event["name"] == "busy share"]
    assert shares == [
        (0.0, {"busy": 0.2, "wait": 0.8}),
        (5e5, {"busy": 0.5, "wait": 0.5}),
        (1e6, {"busy": 0.0, "wait": 1.0}),
    ]
    assert all(event["ph"] in "MXC" and isinstance(event["pid"], int) for event in events)
    assert [event["ts"] for event in events if "ts" in event] == sorted(e["ts"] for e in events if "ts" in e)


def test_the_trace_file_of_a_large_array_has_some_of_its_nodes(tmp_path):
    trace = ChromeTrace((8, 8, 8))
    for k in range(512):
        trace.take(made(node=(k % 8, k // 8 % 8, k // 64)))
    trace.write(tmp_path / "t.json")
    told = json.loads((tmp_path / "t.json").read_text())["traceEvents"]
    assert len({event["pid"] for event in told}) == MOST_NODES


def test_a_recording_comes_back_as_it_was(tmp_path, busy):
    samples = [said for said, _ in busy[0][::37]]
    path = str(tmp_path / "r.jsonl")
    with Probing(EIGHT, 2.5, path) as probing:
        for said in samples:
            probing.take(said)
    read = replay(path)
    assert (read.shape, read.rate) == (EIGHT, 2.5)
    assert list(read.samples) == samples


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (lambda lines: [], "the first line is not that of a recording"),
        (lambda lines: lines[1:], "the first line is not that of a recording"),
        (lambda lines: [lines[0].replace('"version": 2', '"version": 1')], "the first line is not that"),
        (lambda lines: [lines[0].replace("[1, 1, 1]", "[1, 0, 1]")], "the first line is not that"),
        (lambda lines: [lines[0], lines[1][:50]], "line 2: the line: Invalid JSON"),
        (lambda lines: [*lines, lines[1].replace('"surfaces":5', '"surfaces":"many"')], "line 3: surfaces: "),
    ],
)
def test_a_recording_that_is_none(tmp_path, spoil, match):
    path = tmp_path / "r.jsonl"
    record = ProbeRecord(str(path), (1, 1, 1), 10.0)
    record.take(Gauges((1, 1, 1)).take(made()))
    record.close()
    path.write_text("\n".join(spoil(path.read_text().splitlines())))
    with pytest.raises(OutputError, match=match):
        list(replay(str(path)).samples)


def test_a_recording_that_cannot_be_read_or_written(tmp_path):
    with pytest.raises(OutputError, match="cannot be read"):
        replay(str(tmp_path / "none"))
    with pytest.raises(OutputError, match="there is no directory"):
        ProbeRecord(str(tmp_path / "no" / "r"), (1, 1, 1), 10.0)
    with pytest.raises(OutputError, match="/dev/full: the file cannot be written"):
        ProbeRecord("/dev/full", (1, 1, 1), 10.0)


def test_a_disk_that_fills_up_loses_the_recording_and_no_more(tmp_path, monkeypatch):
    trace = tmp_path / "t.json"
    probing = Probing((1, 1, 1), 10.0, str(tmp_path / "r.jsonl"), str(trace))
    probing.take(made(time=1.0))
    probing.check()

    def full(state):
        raise OutputError("r.jsonl: the file cannot be written (No space left on device)")

    monkeypatch.setattr(probing._record, "take", full)
    probing.take(made(time=2.0))
    probing.take(made(time=3.0))  # goes on
    with pytest.raises(OutputError, match="No space left"):
        probing.check()
    assert probing.gauges.samples == 3
    with pytest.raises(OutputError, match="No space left"):
        probing.close()
    assert json.loads(trace.read_text())["traceEvents"]
    assert len(list(replay(str(tmp_path / "r.jsonl")).samples)) == 1


# --- the command, on a recording -----------------------------------------------------------------------


@pytest.fixture
def recording(tmp_path) -> str:
    return recorded(tmp_path / "r.jsonl")


def test_a_recording_is_shown(recording):
    told = here("probe", "--replay", recording)
    assert (told.code, told.err) == (0, "")
    assert "2x1x1: 2 of 2 nodes, trace; busy 0.50 processors" in told.out
    assert "z=0" in told.out


def test_a_recording_is_turned_into_lines_and_a_trace(recording, tmp_path):
    again, trace = str(tmp_path / "again.jsonl"), tmp_path / "t.json"
    told = here("probe", "--replay", recording, "--json", "--record", again, "--chrome-trace", str(trace))
    assert told.code == 0
    before, after = ((tmp_path / name).read_text().splitlines()[1:] for name in ("r.jsonl", "again.jsonl"))
    assert before == after == told.out.splitlines()
    assert json.loads(trace.read_text())["traceEvents"]


def test_a_recording_is_no_array(recording):
    one_line(here("probe", "--replay", recording, "--name", "x"), 2, r"raygrid probe: --replay came with .*")
    one_line(here("probe", "--replay", TINY), 1, r"raygrid: .*: the first line is not that of a recording of probes.*")
