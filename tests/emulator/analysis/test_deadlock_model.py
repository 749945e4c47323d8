"""Deadlock on purpose: the naive machine jams in a cycle of full buffers; admission keeps the same load from it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.cli import TINY, here, one_line, warm_kernels
from support.render import EIGHT, SCENES, rendered

from raygrid.emulator.analysis.deadlock_model import NaiveMachine, surely_free
from raygrid.emulator.topology.bounds import growth_of
from raygrid.host.render.job import Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import SceneError

pytestmark = pytest.mark.usefixtures("warm_kernels")
assert warm_kernels
SIZE = (64, 64)


def job_of(name, shape=EIGHT, size=SIZE, **settings):
    return make_job(load_scene(SCENES / name), shape, Settings(size=size, **settings))


def machine(job, room, budget=None):
    return NaiveMachine(job.space, job.surfaces, job.frame, room, budget)


def picture(naive, job):
    """The sums of all homes, int64 (height, width, 3), without the samples beside the world box."""
    sums = np.zeros((job.pixels, 3), np.int64)
    for node_state in naive.tracers:
        pixels = node_state.pixels
        row = np.repeat(np.arange(len(pixels.first)), np.diff(pixels.offsets))
        column = np.arange(len(row)) - pixels.offsets[row] + pixels.first[row]
        np.add.at(sums, (pixels.first_row + row) * job.frame.width + column, pixels.sums)
    return sums.reshape(job.frame.height, job.frame.width, 3)


JAMS = [("tiny.nff", 4), ("tiny.nff", 16), ("tiny.nff", 64), ("kinds.nff", 16), ("kinds.nff", 256)]


@pytest.mark.parametrize(("name", "room"), JAMS)
def test_without_admission_it_jams_in_a_cycle(name, room):
    outcome = machine(job_of(name), room).run()
    assert outcome.jammed
    assert outcome.stuck == sum(outcome.born.values()) - sum(outcome.died.values()) > 0
    assert outcome.fullest == room
    assert len(outcome.cycle) >= 2
    assert outcome.closed is not None
    assert outcome.closed <= outcome.rounds
    nodes = [waiting.node for waiting in outcome.cycle]
    assert len(set(nodes)) == len(nodes)
    for waiting, onward in zip(outcome.cycle, [*nodes[1:], nodes[0]], strict=True):
        assert waiting.neighbour == onward
        assert sum(waiting.ahead.values()) == room, "it waits behind a full buffer"
        assert waiting.held >= 1
    still = {waiting.node: waiting.port for waiting in outcome.waiting}
    assert {(waiting.node, waiting.port) for waiting in outcome.cycle} <= still.items(), "the cycle is never left"


@pytest.mark.parametrize(("name", "room"), JAMS)
def test_with_admission_the_same_load_passes(name, room):
    job = job_of(name)
    free = surely_free(job.frame, room)
    naive = machine(job, room, max(1, free))
    outcome = naive.run()
    assert not outcome.jammed
    assert outcome.born == outcome.died
    assert (outcome.stuck, outcome.unborn, outcome.cycle, outcome.waiting) == (0, 0, [], [])
    assert outcome.most_trees <= max(1, free)
    if free:
        assert outcome.blocked == 0
        assert outcome.fullest <= free * growth_of(job.frame).packets <= room
    made = rendered(job.scene, EIGHT, size=SIZE)
    total = made.stats["total"]["born"]
    assert outcome.born == {kind: total[kind] for kind in outcome.born}
    inside = picture(naive, job).any(axis=2)
    assert np.array_equal(picture(naive, job)[inside], made.sums[inside])


def test_a_budget_beyond_what_is_promised_can_jam_again():
    outcome = machine(job_of("kinds.nff"), 16, 16).run()
    assert outcome.jammed
    assert outcome.most_trees == 16


def test_large_buffers_only_put_the_jam_off():
    kinds = [machine(job_of("kinds.nff"), room).run() for room in (16, 64, 256)]
    assert all(outcome.jammed for outcome in kinds)
    assert kinds[0].closed < kinds[1].closed < kinds[2].closed


def test_one_node_has_nobody_to_wait_for():
    outcome = machine(job_of("tiny.nff", (1, 1, 1)), 1).run()
    assert not outcome.jammed
    assert outcome.fullest == 0


def test_the_same_frame_jams_in_the_same_way():
    job = job_of("kinds.nff")
    assert machine(job, 16).run() == machine(job, 16).run()


@pytest.mark.parametrize(("room", "budget"), [(0, None), (-1, None), (1 << 21, None), (4, 0)])
def test_what_cannot_be_is_refused(room, budget):
    with pytest.raises(SceneError, match="wanted 1"):
        machine(job_of("tiny.nff"), room, budget)


# --- the command -----------------------------------------------------------------------------------


def test_the_command_prints_the_cycle_and_what_each_node_waits_for():
    told = here("jam", TINY, "--room", "64")
    assert told.code == 0
    before, after = told.out.split("with admission")
    assert "jammed: after 3,068 rounds nothing can move" in before
    assert "1,0,1 -> +y -> 1,1,1 -> -y -> 1,0,1" in before
    assert "1,0,1 waits at port +y until 1,1,1 takes one of its packets (64 primary)" in before
    assert "all is traced after" in after
    assert "it cannot jam" in after


@pytest.mark.parametrize(
    ("room", "what"), [("16", "a single tree"), ("64", "more than 1 tree"), ("256", "more than 4 trees")]
)
def test_a_budget_without_a_promise_is_told_in_trees(room, what):
    told = here("jam", str(SCENES / "kinds.nff"), "--room", room, "--budget", "5", "--size", "8x8")
    assert told.out.rstrip().endswith(
        f"nothing promises that it does not jam: the packets of {what} of rays can fill a buffer"
    )


def test_the_command_speaks_json():
    told = json.loads(here("jam", TINY, "--room", "16", "--budget", "2", "--json").out)
    assert told["without_admission"]["jammed"] is True
    assert told["with_admission"]["jammed"] is False
    assert told["with_admission"]["budget"] == 2
    cycle = told["without_admission"]["cycle"]
    assert [node["neighbour"] for node in cycle] == [node["node"] for node in [*cycle[1:], cycle[0]]]


def test_the_command_refuses_a_buffer_without_room():
    one_line(here("jam", TINY, "--room", "0"), 2, r"raygrid jam: --room: '0' came, wanted a whole number from 1 .*")
