"""Predictions against the simulator: whole frames to the tick, others within what is stated; the command and its refusals."""

from __future__ import annotations

import json

import pytest
from support.cli import here, one_line
from support.memory import memory_taken
from support.render import SCENES
from support.timed import job_of, scene_of

import raygrid
from raygrid.emulator.simulator import work_count
from raygrid.emulator.simulator.work_count import CELL_BYTES, LIST_BYTES
from raygrid.host.machine_time import predict as module
from raygrid.host.machine_time.cost_models import LEVELS, load_cost_model
from raygrid.host.machine_time.predict import Estimate, predict
from raygrid.host.machine_time.simulate import simulate_job
from raygrid.node.errors import ArrayError, CostError, SceneError

KINDS = str(SCENES / "kinds.nff")


def simulated(name, array, size, cost, search=None):
    return simulate_job(job_of(name, array, size), load_cost_model(cost), search)


@pytest.fixture
def small_budget(monkeypatch):
    """So that a frame of tests is extrapolated."""
    for name, value in (("STEPS", 60_000), ("EVENTS", 20_000), ("LEAST_STEPS", 2_000)):
        monkeypatch.setattr(module, name, value)


@pytest.mark.parametrize(("cost", "search"), [("8086", "list"), ("t800", "tree"), ("unit", "list")])
def test_small_frames_are_simulated_as_they_are(cost, search):
    (told,) = predict(KINDS, "3x2x2", cost, search=search, size=(40, 30), split="uniform")
    done = simulated("kinds.nff", (3, 2, 2), (40, 30), cost, search)
    model = load_cost_model(cost)
    assert told.whole
    assert told.frame == Estimate(model.seconds(done.ticks), 0.0)
    assert told.read_out == Estimate(model.seconds(done.read_outs["middle"].host), 0.0)
    assert told.set_up == Estimate(model.seconds(done.floods["middle"].ticks), 0.0)
    busiest = done.frames["middle"].column("busy").max()
    assert told.busiest.seconds == pytest.approx(model.seconds(int(busiest)))
    assert told.busiest.seconds * told.share + told.latency == pytest.approx(told.frame.seconds)


@pytest.mark.usefixtures("small_budget")
@pytest.mark.parametrize("array", [(2, 2, 2), (4, 4, 4), (6, 6, 1)])
@pytest.mark.parametrize(("cost", "search"), [("8086", "list"), ("t800", "tree")])
def test_others_are_told_within_what_is_stated(array, cost, search):
    (told,) = predict(KINDS, array, cost, search=search, size=(220, 160), split="uniform")
    done = simulated("kinds.nff", array, (220, 160), cost, search)
    model = load_cost_model(cost)
    assert not told.whole
    assert told.frame.low <= model.seconds(done.ticks) <= told.frame.high
    assert 0.0 < told.frame.error < 0.5
    read_out = model.seconds(done.read_outs["middle"].host)
    assert told.read_out.seconds == pytest.approx(read_out, rel=0.05)
    for seconds, level in zip(told.band, ("low", "high"), strict=True):
        assert seconds == pytest.approx(model.seconds(done.frames[level].ticks), rel=0.2)


@pytest.mark.usefixtures("small_budget")
def test_few_rays_are_said_and_stated_wider():
    many, few = predict(KINDS, ["2x2x2", "16x16x16"], "8086", size=(100, 100), split="uniform")
    assert not many.few_rays
    assert few.few_rays
    assert few.rays == pytest.approx(many.rays, rel=0.05)
    assert few.rays_a_processor < 10.0 < many.rays_a_processor
    assert few.frame.error > many.frame.error


def test_large_scenes_are_flooded_in_part(monkeypatch):
    (whole,) = predict(KINDS, "3x3x3", "8086", size=(16, 16))
    monkeypatch.setattr(module, "FLOODED", 4)
    (part,) = predict(KINDS, "3x3x3", "8086", size=(16, 16))
    assert whole.set_up.error == 0.0
    assert part.set_up.error > 0.0
    assert part.set_up.seconds == pytest.approx(whole.set_up.seconds, rel=0.7)


@pytest.mark.usefixtures("small_budget")
def test_frames_larger_than_what_fits_are_told_from_two_pictures(monkeypatch):
    """However many samples the budget would pay for: there is memory for so many and no more."""
    monkeypatch.setattr(work_count, "MOST_ACROSS", 24)
    (told,) = predict(KINDS, "2x2x2", "unit", search="list", size=(40, 30), split="uniform")
    assert not told.whole
    model = load_cost_model("unit")
    assert told.frame.seconds == pytest.approx(
        model.seconds(simulated("kinds.nff", (2, 2, 2), (40, 30), "unit").ticks), rel=0.2
    )


def test_what_is_held_against_memory_is_what_is_taken():
    """The counts by all costs, and the clocks of one phase at a time."""
    prepare = """
from raygrid.host.machine_time.predict import predict
from support.timed import scene_of
scene = scene_of("tiny.nff")
options = {"cost": "8086", "size": (8, 8), "split": "uniform"}
predict(scene, "2x2x2", **options)  # kernels are loaded
"""
    taken, cells = memory_taken(prepare, 'predict(scene, "60x60x60", **options)'), 60**3
    counted = CELL_BYTES + len(LEVELS) * LIST_BYTES
    assert taken <= cells * counted + 16_000_000  # packets in flight, tables
    assert taken >= cells * counted * 0.5


def test_the_python_interface():
    found = raygrid.predict(scene_of("tiny.nff"), [(1, 1, 1), "2x2x2"], cost="unit", size=(12, 9))
    assert [one.array for one in found] == [(1, 1, 1), (2, 2, 2)]
    assert [one.processors for one in found] == [1, 8]
    assert all(isinstance(one, raygrid.Prediction) for one in found)
    (alone,) = raygrid.predict(scene_of("tiny.nff"), (2, 2, 2), "unit", size=(12, 9))
    assert alone.frame == found[1].frame


@pytest.mark.parametrize(
    ("arrays", "more", "error", "said"),
    [
        ([], {}, ArrayError, "no array came, wanted one or more such as 10x10x10"),
        ("2x2", {}, ArrayError, "2x2"),
        ([(2, 0, 2)], {}, ArrayError, "2x0x2"),
        (
            [10, 10, 10],
            {},
            ArrayError,
            r"arrays came as \[10, 10, 10\], wanted one or more such as 10x10x10 or \(10, 10, 10\)",
        ),
        (None, {}, ArrayError, r"arrays came as None, wanted one or more such as 10x10x10 or \(10, 10, 10\)"),
        ([(2, 2, 2.5)], {}, ArrayError, "2x2x2.5"),
        ("2x2x2", {"cost": "z80"}, CostError, "a cost model came as 'z80'"),
        ("2x2x2", {"search": "grid"}, CostError, "a search came as 'grid', wanted list or tree"),
        ("2x2x2", {"split": "fair"}, SceneError, "a split came as 'fair'"),
    ],
)
def test_what_cannot_be_is_one_sentence(arrays, more, error, said):
    with pytest.raises(error, match=said):
        predict(scene_of("tiny.nff"), arrays, **more)


def test_command_prints_a_row_for_each_array():
    done = here("predict", KINDS, "--array", "2x2x2", "--array", "8x8x8", "--cost", "unit", "--size", "24x20", "-q")
    assert done.code == 0, done.err
    lines = done.out.splitlines()
    assert lines[0].startswith("kinds.nff, 24x20 pixels, unit (list search)")
    assert [line.split()[0] for line in lines[3:5]] == ["2x2x2", "8x8x8"]
    assert "simulated as it is" in lines[3]


@pytest.mark.usefixtures("small_budget")
def test_command_says_where_few_rays_meet_a_processor():
    done = here("predict", KINDS, "--array", "16x16x16", "--cost", "unit", "--size", "100x100", "-q")
    assert "few rays: on 1 array fewer than ten meet a processor" in done.out
    assert "±" in done.out


def test_json_has_the_documented_keys():
    done = here("predict", KINDS, "--array", "2x2x2", "--cost", "unit", "--size", "24x20", "--json", "-q")
    facts = json.loads(done.out)
    assert facts["version"] == 1
    assert facts["cost"]["name"] == "unit"
    (row,) = facts["arrays"]
    assert {"array", "frame", "set_up", "read_out", "band", "busiest", "share", "latency", "few_rays"} <= set(row)
    assert set(row["frame"]) == {"seconds", "error"}


def test_bad_requests_are_one_line():
    one_line(here("predict", KINDS, "--array", "2x2"), 2, r"raygrid predict: --array: .*2x2.*")
    one_line(
        here("predict", KINDS, "--cost", "z80"), 2, r"raygrid predict: a cost model came as 'z80', wanted one of .*"
    )
    one_line(here("predict", "none.nff"), 1, r"raygrid: none.nff: .*")
