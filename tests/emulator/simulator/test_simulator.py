"""The simulator: the emulator's picture and counts, closed forms of small cases, and the same trace every time."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from support.cli import here, one_line
from support.memory import memory_taken
from support.render import SCENES
from support.timed import books_of, job_of, rays_to_a_wall, simulated

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.simulator import simulator
from raygrid.emulator.simulator.flood_time import flood
from raygrid.emulator.simulator.shared_tables import ordered
from raygrid.emulator.simulator.simulator import CLOCK_BYTES, NODE_BYTES
from raygrid.emulator.topology import limits
from raygrid.emulator.topology.limits import Bound
from raygrid.host.cli.commands.simulate import in_words, summary
from raygrid.host.machine_time import plots
from raygrid.host.machine_time.cost_models import load_cost_model
from raygrid.host.machine_time.simulate_stats import make_stats
from raygrid.host.render.frame import render_job
from raygrid.node.errors import ArrayError, TooLarge
from raygrid.node.geometry.grid_walk import PORTS
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.protocol.counters import BORN, BOXES, COUNTS, HITS, SENT, TESTS, WALKS
from raygrid.node.protocol.packets import PRIMARY, RETURN
from raygrid.node.protocol.timestamps import Prices

pytestmark = pytest.mark.usefixtures("quick_records")
CASES = [
    ("kinds.nff", (1, 1, 1), "uniform", "unit", "list", 1),
    ("kinds.nff", (3, 3, 3), "uniform", "8086", "tree", 1),
    ("glass.toml", (4, 3, 1), "balanced", "t800", "list", 1),
    ("room.glb", (5, 4, 2), "uniform", "8086", "list", 1),
    ("lights.toml", (2, 2, 2), "balanced", "modern", "tree", 1),
    ("faces.nff", (4, 4, 4), "uniform", "unit", "tree", 1),
    ("tiny.nff", (3, 3, 3), "balanced", "8086-soft", "list", 4),
]


def emulated_untimed(job):
    array = MemoryArray(job.space.shape)
    array.driver.ready()
    return render_job(array.driver, job)


@pytest.mark.parametrize(("name", "shape", "split", "cost", "search", "samples"), CASES)
def test_the_emulators_picture_and_counts(name, shape, split, cost, search, samples):
    job = job_of(name, shape, (40, 32), split, samples=samples)
    done = simulated(job, cost, search)
    picture = emulated_untimed(job)
    assert np.array_equal(done.sums, picture.sums)
    stats, total = make_stats(done), picture.stats["total"]
    for kind in ("primary", "reflected", "refracted", "shadow", "return"):
        assert stats["total"]["born"][kind] == total["born"][kind], kind
    assert stats["total"]["walks"] == total["walks"]
    assert stats["total"]["hits"] == total["hits"]
    for node, record in zip(picture.stats["nodes"], stats["nodes"], strict=True):
        assert sum(node["surfaces"].values()) == record["surfaces"]
        assert node["walks"] == record["walks"]
    if search == "tree":  # each node has the very hierarchy that the emulator's has
        assert stats["total"]["boxes"] == total["boxes"]
        assert stats["total"]["tests"] == total["tests"]


def test_the_same_trace_every_time_and_another_for_other_costs():
    job = job_of("glass.toml", (3, 2, 2), (40, 30), samples=1)
    one, two = books_of(simulated(job, "8086")), books_of(simulated(job, "8086"))
    assert one.trace == two.trace
    assert one.ticks == two.ticks
    assert books_of(simulated(job, "t800")).trace != one.trace


def test_frames_of_any_size_are_models_of_one_holding():
    jobs = [job_of("kinds.nff", (3, 3, 3), size) for size in ((20, 20), (9, 7))]
    holding = simulator.hold(jobs[0].space, jobs[0].surfaces, "tree")
    for job in jobs:
        ours = holding.model(job.frame)
        whole = simulator.make_model(job.space, job.surfaces, job.frame, "tree")
        assert np.array_equal(ours.samples, whole.samples)
        assert np.array_equal(ours.borders, whole.borders)
        assert np.array_equal(ours.holding.held, whole.holding.held)
        assert np.array_equal(ours.holding.roots, whole.holding.roots)
        assert set(whole.seconds) == {"hold", "order"}


def test_a_search_that_is_none_is_refused():
    with pytest.raises(ArrayError, match="a search came as 'grid', wanted list or tree"):
        simulator.hold(*rays_to_a_wall((1, 1, 1), 1)[:2], "grid")


# --- closed forms --------------------------------------------------------------------------------

PACKET, WALK, PRIMARY_COST, HAND_ON, HIT, TEST, TRANSMIT, LATENCY = 3, 101, 41, 7, 1009, 17, 11, 5
SERVICE = PACKET + WALK + HAND_ON  # of a node that holds nothing
LAST_SERVICE = PACKET + WALK + TEST + HIT


def prices(by_processor=0, transmit=TRANSMIT, hit=HIT):
    counts = np.zeros(COUNTS, np.int64)
    counts[WALKS], counts[HITS], counts[BORN + PRIMARY] = WALK, hit, PRIMARY_COST
    counts[SENT : SENT + PORTS + 1] = HAND_ON
    return Prices(counts, PACKET, transmit, LATENCY, by_processor)


def traced(shape, pixels, of):
    """Of rays_to_a_wall, the phase."""
    model = simulator.make_model(*rays_to_a_wall(shape, pixels), "list")
    assert model.holding.held.sum() == 1
    assert model.holding.held[-1, Kind.TRIANGLE] == 1
    return simulator.trace(model, of, np.asarray(model.holding.held.sum(1) * TEST, np.int64))[0]


@pytest.mark.parametrize("by_processor", [0, 1])
@pytest.mark.parametrize("cells", [1, 2, 3, 7])
def test_one_ray_at_zero_load(cells, by_processor):
    phase = traced((cells, 1, 1), 1, prices(by_processor))
    assert phase.ticks == PRIMARY_COST + (cells - 1) * (SERVICE + TRANSMIT + LATENCY) + LAST_SERVICE
    assert phase.total[TESTS] >= 0
    assert phase.column("waited").sum() == 0
    expected = PRIMARY_COST + SERVICE + by_processor * TRANSMIT
    assert phase.nodes[0]["busy"] == (expected if cells > 1 else PRIMARY_COST + LAST_SERVICE)


def test_two_rays_meet_at_one_node():
    """The second comes while the first is served there, and waits for the rest of it."""
    phase = traced((2, 1, 1), 2, prices())
    first = PRIMARY_COST + SERVICE + TRANSMIT + LATENCY
    second = first + PRIMARY_COST + SERVICE
    assert second < first + LAST_SERVICE
    assert phase.ticks == first + 2 * LAST_SERVICE
    assert phase.nodes[1]["waited"] == first + LAST_SERVICE - second
    assert phase.nodes[0]["waited"] == 0


@pytest.mark.parametrize("rays", [2, 5, 9])
def test_a_full_link(rays):
    """A link slower than its node: packets arrive one transmission apart."""
    slow = 5000
    phase = traced((2, 1, 1), rays, prices(transmit=slow))
    assert phase.ticks == PRIMARY_COST + SERVICE + rays * slow + LATENCY + LAST_SERVICE
    assert phase.nodes[0]["sent"][1] == rays
    assert phase.nodes[1]["waited"] == 0


def test_a_processor_that_moves_bytes_is_busy_meanwhile():
    rays, slow = 4, 5000
    phase = traced((2, 1, 1), rays, prices(1, transmit=slow))
    assert phase.nodes[0]["busy"] == rays * (PRIMARY_COST + SERVICE + slow)
    assert phase.ticks == phase.nodes[0]["busy"] + LATENCY + LAST_SERVICE


# --- phases, statistics, command -----------------------------------------------------------------


def test_read_out_of_one_node_sends_a_pixel_after_the_other():
    job = job_of("tiny.nff", (1, 1, 1), (9, 7), samples=1)
    done = simulated(job, "unit", around=True)
    read = done.read_outs["middle"]
    pixels = int(done.model.borders[-1])
    # each pixel: borne in one tick, then served and handed on to the host in two
    assert read.ticks == 3 * pixels
    assert read.host == read.ticks + 2


def test_flood_visits_the_nodes_that_the_flood_of_the_emulator_does():
    job = job_of("kinds.nff", (3, 3, 3), (8, 8))
    model = load_cost_model("unit")
    flooded = flood(job.space, ordered(job.surfaces), model.prices("middle", "list"), 1)
    array = MemoryArray((3, 3, 3))
    array.driver.ready()
    array.driver.load(job.space, job.surfaces)
    assert flooded.visits == sum(processor.flood.received for processor in array.processors)
    assert flooded.ticks > 0


def test_statistics_add_up():
    job = job_of("room.glb", (3, 3, 3), (48, 36), samples=1)
    done = simulated(job, "8086", band=True, around=True)
    stats, phase = make_stats(done), done.frames["middle"]
    assert stats["ticks"] == phase.ticks == max(node["ended_tick"] for node in stats["nodes"])
    frames = [stats["band"][level]["ticks"]["frame"] for level in ("low", "middle", "high")]
    assert frames == sorted(frames)
    assert frames[0] < frames[1] < frames[2]
    assert stats["seconds"] == phase.ticks / 5_000_000
    shares = stats["shares"]
    assert shares["working"] + shares["sending"] + shares["waiting"] == pytest.approx(1.0)
    for kind, died in stats["total"]["died"].items():
        assert sum(stats["hops"].get(kind, [])) == died, kind
    hops = sum(sum(k * many for k, many in enumerate(row)) for row in stats["hops"].values())
    assert hops == stats["total"]["hops"] == sum(stats["links"]["by_port"].values())
    assert phase.levels[:, -1].tolist() == [0, 0, 0]
    assert phase.levels.min() >= 0
    assert stats["total"]["born"]["return"] == phase.total[BORN + RETURN]
    assert phase.total[BOXES] >= 0


def test_command(tmp_path):
    outputs = {name: str(tmp_path / name) for name in ("p.png", "p.npy", "s.json", "n.csv")}
    arguments = ["simulate", str(SCENES / "tiny.nff"), "--array", "3x2x1", "--size", "24x20", "--cost", "unit"]
    files = ["-o", outputs["p.png"], "-o", outputs["p.npy"], "--stats", outputs["s.json"], "--csv", outputs["n.csv"]]
    done = here(*arguments, *files, "--plots", str(tmp_path))
    assert done.code == 0, done.err
    stats = json.loads((tmp_path / "s.json").read_text())
    assert type(stats["ticks"]) is int
    assert f"{stats['ticks']:,} ticks" in done.out
    assert len((tmp_path / "n.csv").read_text().splitlines()) == 7
    for name in ("busy.png", "links.png", "time.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    sums = np.load(tmp_path / "p.npy")
    assert np.array_equal(sums, emulated_untimed(job_of("tiny.nff", (2, 2, 2), (24, 20))).sums)


def test_what_is_held_against_memory_is_what_is_taken():
    """All costs, set-up and read-out: each phase has books of its own, and not all are there at once."""
    prepare = """
from support.timed import job_of, simulated
simulated(job_of("tiny.nff", (2, 2, 2), (8, 8)), "8086", band=True, around=True)  # kernels are loaded
job = job_of("tiny.nff", (60, 60, 60), (8, 8))
"""
    taken, nodes = memory_taken(prepare, 'simulated(job, "8086", band=True, around=True)'), 60**3
    assert taken <= nodes * (NODE_BYTES + 2 * CLOCK_BYTES) + 16_000_000  # packets in flight, tables
    assert taken >= nodes * 2 * CLOCK_BYTES * 0.5


def test_an_array_beyond_memory_is_refused_before_anything_is_worked_out(monkeypatch):
    def never(*_):
        raise AssertionError("it has begun")

    job = job_of("tiny.nff", (30, 30, 30), (8, 8))
    left = 20**3 * (NODE_BYTES + 2 * CLOCK_BYTES) + 8_000_000
    monkeypatch.setattr(limits, "read_memory", lambda: Bound(left, "the memory available"))
    monkeypatch.setattr(simulator, "shared_geometry", never)
    for options in ({"band": True}, {"around": True}):
        with pytest.raises(
            TooLarge, match=r"a simulated 30x30x30 array .* leaves \d+ MB; largest that fits: 2\dx2\dx2\d"
        ):
            simulated(job, "8086", **options)


@pytest.mark.parametrize("shape", [(4, 3, 2), (12, 1, 1), (1, 1, 1), (2, 2, 12)])
def test_heat_maps_have_axes_with_the_numbers_of_processors(shape):
    figure = plots._layers(np.arange(float(np.prod(shape))), shape, "title", "scale")
    drawn = [axis for axis in figure.axes if axis.get_title()]
    assert [axis.get_title() for axis in drawn] == [f"z = {z}" for z in range(shape[2])]
    assert drawn[0].get_ylabel() == "y"
    assert drawn[-1].get_xlabel() == "x"
    for axis in drawn:
        for ticks, ends, side in ((axis.get_xticks(), axis.get_xlim(), 0), (axis.get_yticks(), axis.get_ylim(), 1)):
            seen = [tick for tick in ticks if ends[0] <= tick <= ends[1]]
            assert seen
            assert all(tick == int(tick) and 0 <= tick < shape[side] for tick in seen)
    width, height = figure.get_size_inches()
    assert max(width / height, height / width) < 8.0


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.0, "0 s"),
        (0.01234, "0.0123 s"),
        (59.4, "59.4 s"),
        (59.9, "1 min"),
        (60, "1 min"),
        (125.3, "2 min 5 s"),
        (3599.7, "1 h"),
        (15_830, "4 h 24 min"),
        (86_390, "1 d"),
        (86400 * 12 + 3 * 3600 + 1799, "12 d 3 h"),
        (1e9, "11,574 d 2 h"),
    ],
)
def test_times_in_words(seconds, words):
    assert in_words(seconds) == words


def test_the_summary_names_the_busiest_node_and_link():
    done = simulated(job_of("kinds.nff", (3, 3, 2), (24, 20)), "8086", band=True, around=True)
    stats = make_stats(done)
    busy = {tuple(node[axis] for axis in "xyz"): node["busy_ticks"] for node in stats["nodes"]}
    x, y, z = stats["busiest"]["node"]
    assert busy[x, y, z] == max(busy.values()) == stats["busiest"]["ticks"]
    assert stats["busiest"]["share"] == stats["busiest"]["ticks"] / stats["ticks"]
    link = stats["links"]["busiest"]
    (sender,) = (node for node in stats["nodes"] if [node[axis] for axis in "xyz"] == link["node"])
    assert sender[f"sent{link['port']}"] == link["packets"] > 0
    text = "\n".join(summary(done, stats))
    assert (
        f"busiest processor: {x},{y},{z}, at work {stats['busiest']['share']:.1%} of the frame; busiest link: " in text
    )
    ends = re.search(r"busiest link: (\d),(\d),(\d) to (\d),(\d),(\d) \(([-+])([xyz])\)", text)
    steps = [int(ends[4 + axis]) - int(ends[1 + axis]) for axis in range(3)]
    assert steps == [(1 if ends[7] == "+" else -1) if axis == ends[8] else 0 for axis in "xyz"]
    assert "e+" not in text
    seconds = stats["seconds"]
    assert f"{seconds:.4g} machine seconds ({in_words(seconds)}); low to high costs: " in text


def test_a_single_node_has_no_busiest_link():
    done = simulated(job_of("tiny.nff", (1, 1, 1), (8, 8)), "unit")
    assert "busiest processor: 0,0,0, " in (text := "\n".join(summary(done, make_stats(done))))
    assert "no packet went from one to another" in text


@pytest.mark.parametrize(
    ("arguments", "code", "pattern"),
    [
        (
            ["--cost", "8088"],
            2,
            r"raygrid simulate: a cost model came as '8088', wanted one of 8086, .* or a \.toml file .*",
        ),
        (
            ["--array", "3000x3000x3000"],
            1,
            r"raygrid: a simulated 3000x3000x3000 array does not fit this computer: its 27000000000 processors and 64 samples need .* TB of memory, and .* leaves .*; largest that fits: (\d+)x\1x\1",
        ),
        (
            ["--plots", "/nowhere/at/all"],
            1,
            r"raygrid: /nowhere/at/all: there is no directory /nowhere/at, wanted one that is there",
        ),
        (["--search", "hash"], 2, r"raygrid simulate: .*"),
    ],
)
def test_bad_input_is_one_clear_line(arguments, code, pattern):
    one_line(here("simulate", str(SCENES / "tiny.nff"), "--size", "8x8", *arguments), code, pattern)
