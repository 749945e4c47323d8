"""The work of cells, counted without queues: what the simulator finds for the same pixels, to the tick."""

from __future__ import annotations

import pytest
from support.timed import counted, job_of, rays_to_a_wall

from raygrid.emulator.simulator import simulator
from raygrid.emulator.simulator.work_count import (
    LEAST_ACROSS,
    MOST_ACROSS,
    check_count_fits,
    few_pixels,
    price_lists,
    steps_of_a_sample,
)
from raygrid.emulator.topology import limits
from raygrid.emulator.topology.limits import Bound
from raygrid.node.errors import TooLarge
from raygrid.node.geometry.grid_walk import PORTS

COSTS = ("unit", "8086", "t800")
CASES = [
    ("kinds.nff", (3, 2, 3), "tree", 1),
    ("glass.toml", (4, 3, 1), "list", 1),
    ("lights.toml", (2, 2, 2), "tree", 1),
    ("tiny.nff", (3, 3, 3), "list", 4),
]


def counted_of(job, search, samples=1e9):
    return counted(job.space, job.surfaces, job.frame, search, COSTS, samples)


@pytest.mark.parametrize(("name", "shape", "search", "samples"), CASES)
def test_whole_frames_cost_each_cell_what_the_simulator_has_it_do(name, shape, search, samples):
    job = job_of(name, shape, (30, 23), samples=samples)
    holding, prices, walks, work = counted_of(job, search)
    assert work.share == 1.0
    for row in range(len(COSTS)):
        phase, _ = simulator.trace(holding.model(job.frame), prices[row], walks[row])
        assert work.busy[:, :, row].sum(axis=1).tolist() == phase.column("busy").tolist()
        assert work.sent.tolist() == phase.nodes["sent"][:, :PORTS].tolist()
        assert work.counts.tolist() == phase.total.tolist()
        assert work.longest[row] <= phase.ticks  # whoever meets others takes no less
    assert work.steps == phase.column("served").sum() - work.born.sum()  # rays that are born are no packets served


@pytest.mark.parametrize("cells", [1, 2, 7])
def test_a_sample_alone_takes_as_long_as_in_the_simulator(cells):
    """One ray that brings nothing home meets nobody, so the longest sample is the frame."""
    space, surfaces, frame = rays_to_a_wall((cells, 1, 1), 1)
    holding, prices, walks, work = counted(space, surfaces, frame, "list", COSTS, samples=1)
    assert work.steps == cells
    for row in range(len(COSTS)):
        phase, _ = simulator.trace(holding.model(frame), prices[row], walks[row])
        assert work.longest[row] == phase.ticks > 0


def test_fewer_pixels_have_a_share_and_about_the_same_work():
    job = job_of("kinds.nff", (2, 2, 2), (160, 120))
    *_, whole = counted_of(job, "list")
    *_, some = counted_of(job, "list", 40 * 40)
    assert some.share == 160 * 120 / (40 * 40)
    assert some.busy.sum() * some.share == pytest.approx(whole.busy.sum(), rel=0.05)


def test_few_pixels_are_the_frame_itself_if_it_has_no_more():
    frame = job_of("kinds.nff", (1, 1, 1), (30, 20)).frame
    assert few_pixels(frame, 600) is frame
    assert few_pixels(frame, 599) is not frame
    assert few_pixels(frame, 1).width == LEAST_ACROSS


@pytest.mark.parametrize("samples", [1, 4])
def test_there_is_memory_for_whatever_is_asked_for(samples):
    """A frame is given back as it is up to as many samples as memory is looked at for."""
    frame = job_of("kinds.nff", (1, 1, 1), (MOST_ACROSS, MOST_ACROSS // samples), samples=samples).frame
    assert few_pixels(frame, 3e8) is frame
    few = few_pixels(frame._replace(height=frame.height + 1), 3e8)
    assert few.width * few.height * few.samples <= MOST_ACROSS**2


def test_steps_of_a_sample_are_those_of_the_frame():
    job = job_of("kinds.nff", (4, 4, 4), (96, 96))
    holding, prices, walks, work = counted_of(job, "list")
    assert steps_of_a_sample(holding, job.frame, price_lists(prices, walks)) == pytest.approx(
        work.steps / work.samples, rel=0.1
    )


def test_arrays_that_do_not_fit_are_refused(monkeypatch):
    monkeypatch.setattr(limits, "read_memory", lambda: Bound(10**9, "the memory available"))
    with pytest.raises(TooLarge, match="a simulated 500x500x500 array"):
        check_count_fits((500, 500, 500), 3)
    check_count_fits((10, 10, 10), 3)
