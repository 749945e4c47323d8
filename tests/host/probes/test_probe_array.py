"""Probes of real processes: the same bits with and without, samples of every node, also after resets and losses."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.cli import TINY, as_process, here, one_line
from support.processes import no_leftovers, wait_dead
from support.render import rendered

import raygrid
from raygrid.emulator.driver.samples import NodeSample
from raygrid.emulator.processes.array import Array
from raygrid.emulator.topology.coordinates import indices
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.render.session import RenderSession
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ProtocolError

__all__ = ["no_leftovers"]
pytestmark = [pytest.mark.timeout(120)]
SHAPE = (2, 2, 1)
RUNS_DIFFER = ("messages", "bytes")  # how packets fall into messages is a matter of chance


def job(size=(64, 48), samples=2, shape=SHAPE):
    return make_job(load_scene(TINY), shape, Settings(size=size, samples=samples))


@pytest.fixture(scope="module")
def array() -> Iterator[Array]:
    with Array.launch(SHAPE, patience=60.0) as launched:
        yield launched


@pytest.mark.parametrize("shape", [(2, 2, 2), (4, 3, 1)], ids=str)
def test_the_picture_and_the_counts_are_the_same_with_and_without_probes(shape):
    frame, pictures, heard = job((96, 72), 3, shape), [], []
    with Array.launch(shape, patience=60.0) as array:
        for rate in (0.0, 100.0, 0.0):
            array.probe(rate, heard.append)
            pictures.append(render_job(array.driver, frame))
    assert {sample.node for sample in heard} == set(indices(shape))
    for picture in pictures:
        assert np.array_equal(picture.sums, pictures[0].sums)
        total, first = picture.stats["total"], pictures[0].stats["total"]
        assert {k: v for k, v in total.items() if k not in RUNS_DIFFER} == {
            k: v for k, v in first.items() if k not in RUNS_DIFFER
        }
        for node, other in zip(picture.stats["nodes"], pictures[0].stats["nodes"], strict=True):
            assert all(
                node[k] == other[k] for k in ("index", "surfaces", "born", "died", "tests", "walks", "boxes", "hits")
            )
    assert np.array_equal(pictures[0].sums, rendered(load_scene(TINY), size=(96, 72), samples=3).sums)


def test_samples_of_a_node_go_up_and_name_their_phases(array):
    heard: list[NodeSample] = []
    array.probe(100.0, heard.append)
    render_job(array.driver, job((400, 300), 4))
    array.probe(0.0, None)
    assert {sample.phase for sample in heard} >= {"trace"}
    for node in indices(SHAPE):
        mine = [sample for sample in heard if sample.node == node]
        assert len(mine) >= 3
        assert [sample.number for sample in mine] == list(range(mine[0].number, mine[0].number + len(mine)))
        assert all(one.time < other.time and one.cpu <= other.cpu for one, other in pairwise(mine))
        tracing = [sample for sample in mine if sample.phase == "trace"]
        assert all(one.walks <= other.walks for one, other in pairwise(tracing))
    assert array.refused_samples == 0


def test_a_reset_keeps_the_rate_also_for_nodes_that_are_forked_anew(array):
    heard: list[NodeSample] = []
    array.probe(100.0, heard.append)
    os.kill(array.pids[1], signal.SIGKILL)
    wait_dead(array.pids[1])
    array.reset()
    del heard[:]
    render_job(array.driver, job((400, 300), 4))
    assert {sample.node for sample in heard} == set(indices(SHAPE))
    assert {sample.epoch for sample in heard} == {array.epoch}
    array.probe(0.0, heard.append)
    array.reset()  # words on a line keep their order: after this all nodes know
    array.check()
    render_job(array.driver, job((400, 300), 4))
    assert all(sample.epoch < array.epoch for sample in heard)


def test_a_frame_that_loses_a_node_is_the_same_under_probes(array):
    heard: list[NodeSample] = []
    array.probe(100.0, heard.append)
    victim, killed = array.pids[2], []

    def watch(phase, progress) -> None:
        if phase == "trace" and progress is not None and progress.primaries and not killed:
            killed.append(os.kill(victim, signal.SIGKILL))

    picture = RenderSession(array).render(job(), watch=watch)
    array.probe(0.0, None)
    assert len(picture.stats["faults"]) == 1
    assert np.array_equal(picture.sums, rendered(load_scene(TINY), size=(64, 48), samples=2).sums)


def test_words_that_are_no_sample_are_counted(array):
    heard: list[NodeSample] = []
    array.probe(1.0, heard.append)
    array._take_sample((0, 0, 0), {"is": "sample", "epoch": -1})
    assert array.refused_samples == 1
    array.probe(0.0, None)
    assert not [sample for sample in heard if sample.epoch < 0]


def test_a_rate_that_cannot_be(array):
    with pytest.raises(ProtocolError, match="a rate of probes came as 1000, wanted 0 to 100"):
        array.probe(1000, print)


def test_a_machine_probes_while_it_renders():
    heard: list[NodeSample] = []
    with raygrid.launch(SHAPE) as machine:
        machine.probe(50.0, heard.append)
        machine.render(TINY, size=(200, 150))
    assert {sample.node for sample in heard} == set(indices(SHAPE))


# --- the command -----------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_leftovers")
def test_render_records_and_draws_what_probes_tell(tmp_path):
    files = ["--probe-record", "r.jsonl", "--chrome-trace", "t.json", "--probe-rate", "50"]
    told = as_process("render", TINY, "--size", "300x200", "-o", "a.npy", *files, cwd=tmp_path)
    assert (told.code, told.out.split()) == (0, ["a.npy"])
    assert np.array_equal(np.load(tmp_path / "a.npy"), rendered(load_scene(TINY), (2, 2, 2), size=(300, 200)).sums)
    head, *lines = map(json.loads, (tmp_path / "r.jsonl").read_text().splitlines())
    assert (head["array"], head["rate"]) == ([2, 2, 2], 50.0)
    assert {tuple(line["node"]) for line in lines} == set(indices((2, 2, 2)))
    events = json.loads((tmp_path / "t.json").read_text())["traceEvents"]
    assert {event["name"] for event in events} >= {"process_name", "packets waiting"}
    shown = here("probe", "--replay", str(tmp_path / "r.jsonl"), "--chrome-trace", str(tmp_path / "t2.json"))
    assert "8 of 8 nodes" in shown.out
    assert (tmp_path / "t2.json").read_text() == (tmp_path / "t.json").read_text()


def test_files_of_probes_that_cannot_be_written_are_refused_before_the_work(tmp_path):
    for option in ("--probe-record", "--chrome-trace"):
        bad = here("render", TINY, "-o", str(tmp_path / "a.png"), option, str(tmp_path / "no" / "x"))
        one_line(bad, 1, r"raygrid: .*/no/x: there is no directory .*")
        assert not Path(tmp_path / "a.png").exists()
