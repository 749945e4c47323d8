"""Timed processors keep the same ticks as the simulator, exactly, and the same picture as always."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from support.array import backwards, haphazard, lazy, shuffled
from support.timed import assert_same, books_of, emulated, emulated_by, job_of, simulated

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.host.render.frame import render_job

pytestmark = pytest.mark.usefixtures("quick_records")

SCENES = ["kinds.nff", "glass.toml", "tiny.nff", "lights.toml"]
SHAPES = [(1, 1, 1), (3, 1, 1), (4, 3, 1), (2, 2, 2), (3, 3, 3)]
SPLITS = ["uniform", "balanced"]
COSTS = ["unit", "8086"]


def same_ticks(name, shape, split, cost, search=None, size=(8, 6), **options):
    job = job_of(name, shape, size, split, samples=1)
    assert_same(emulated(job, cost, search, **options), books_of(simulated(job, cost, search)))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("cost", COSTS)
def test_small_arrays(name, cost):
    for shape, split in (((1, 1, 1), "uniform"), ((3, 1, 1), "balanced"), ((2, 2, 2), "uniform")):
        same_ticks(name, shape, split, cost)


@pytest.mark.parametrize(("cost", "search"), [("t800", "list"), ("8086", "tree"), ("modern", "tree"), ("unit", "tree")])
def test_who_moves_the_bytes_and_how_hits_are_found(cost, search):
    same_ticks("kinds.nff", (2, 2, 1), "uniform", cost, search)


@pytest.mark.parametrize("order", [backwards, shuffled(1), haphazard(2), lazy(3)], ids=["back", "mix", "any", "lazy"])
def test_the_schedule_does_not_matter(order):
    same_ticks("glass.toml", (2, 2, 1), "balanced", "8086", size=(8, 6), order=order)


@pytest.mark.parametrize("batch", [1, 3])
def test_the_batch_does_not_matter(batch):
    same_ticks("kinds.nff", (3, 1, 1), "uniform", "unit", size=(8, 6), batch=batch)


def test_frame_after_frame_and_untimed_ones_between():
    array = MemoryArray((2, 1, 1), timed=True)
    array.driver.patience = 100.0
    array.driver.ready()
    for name, cost in (("kinds.nff", "unit"), ("tiny.nff", "8086"), ("kinds.nff", "8086")):
        job = job_of(name, (2, 1, 1), (8, 6), samples=1)
        expected = books_of(simulated(job, cost))
        assert_same(emulated_by(array.driver, job, cost), expected)
        assert np.array_equal(render_job(array.driver, job).sums, expected.sums)
    array.driver.end()


@pytest.mark.usefixtures("no_leftovers")
def test_real_processes_with_and_without_probes():
    with Array.launch((2, 2, 1), timed=True, patience=100.0) as array:
        samples = []
        for rate in (0.0, 50.0):
            array.probe(rate, samples.append)
            for name, cost in (("kinds.nff", "unit"), ("glass.toml", "8086")):
                job = job_of(name, (2, 2, 1), (12, 9), "balanced", samples=1)
                assert_same(emulated_by(array.driver, job, cost), books_of(simulated(job, cost)))
            assert bool(samples) == (rate > 0.0)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("name", "cost"), list(itertools.product(SCENES, COSTS)))
def test_all(name, cost):
    for shape, split in itertools.product(SHAPES, SPLITS):
        same_ticks(name, shape, split, cost, size=(8, 6) if shape == (3, 3, 3) else (10, 8))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.usefixtures("no_leftovers")
@pytest.mark.parametrize("shape", [(4, 3, 1), (2, 2, 2), (3, 3, 3)])
def test_all_as_processes(shape):
    with Array.launch(shape, timed=True, patience=200.0) as array:
        for name, cost in itertools.product(SCENES, COSTS):
            job = job_of(name, shape, (8, 6), samples=1)
            assert_same(emulated_by(array.driver, job, cost), books_of(simulated(job, cost)))
