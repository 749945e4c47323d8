"""The array of real processes: neighbours only, conservation and bounds from its own counters, several frames."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support import paths
from support.bounds import memory_bound, packets_bound, pixel_packets_bound, surfaces_bound
from support.sockets import descriptors, shared_files, socket_inodes, unix_sockets

from raygrid.emulator.driver.driver import BUDGET
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.emulator.topology.coordinates import indices
from raygrid.emulator.topology.limits import NODE_BYTES
from raygrid.emulator.topology.topology import neighbour_links
from raygrid.host.image.picture import Picture
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError
from raygrid.node.geometry.lattice import make_cell
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.spanning_tree import corners
from raygrid.node.geometry.surfaces import MAX_MATERIALS, SURFACE_KINDS, Kind
from raygrid.node.protocol.frame_tables import MATERIAL_COLUMNS

SCENES = paths.SCENES
EIGHT = (2, 2, 2)
BATCH = 64


@cache
def job(shape, name: str = "kinds.nff", size: tuple[int, int] = (64, 48), samples: int = 1) -> Job:
    """A scene ready for an array."""
    return make_job(load_scene(SCENES / name), shape, Settings(size=size, samples=samples))


@cache
def in_memory(name: str = "kinds.nff", size: tuple[int, int] = (64, 48)) -> Picture:
    """The same by the array inside this process."""
    array = MemoryArray(EIGHT)
    array.driver.ready()
    return render_job(array.driver, job(EIGHT, name, size))


@pytest.fixture(scope="module")
def eight() -> Iterator[Array]:
    """Eight processors, shared by the tests of this file."""
    with Array.launch(EIGHT, batch=BATCH) as array:
        yield array


def where(array: Array) -> dict[tuple[int, int, int], int]:
    """The process of each node."""
    return dict(zip(indices(array.shape), array.pids, strict=True))


# --- neighbours only -----------------------------------------------------------------------------


def links_of(shape, index) -> tuple[set[str], set[tuple[int, int, int] | str]]:
    """Names of a node's links, and who is at their other ends: neighbours, and "host" for a corner."""
    names, others = set(), set()
    for wire in neighbour_links(shape):
        if index in (wire.lower, wire.upper):
            names.add("0-{},{},{}{}".format(*wire.lower, "xyz"[wire.axis]))
            others.add(wire.upper if index == wire.lower else wire.lower)
    if index in corners(shape).values():
        names.add("0-{},{},{}h".format(*index))
        others.add("host")
    return names, others


@pytest.mark.parametrize("shape", [EIGHT, (3, 2, 1), (1, 1, 1)])
def test_neighbours_only(shape, eight):
    """Each socket of a node belongs to one of its own links; at the other end is that neighbour, or the host."""
    if shape == EIGHT:
        render_job(eight.driver, job(EIGHT))
        check_neighbours(eight)
        return
    with Array.launch(shape) as array:
        render_job(array.driver, job(shape))
        check_neighbours(array)


def check_neighbours(array: Array) -> None:
    assert array._place is not None
    sockets = unix_sockets()
    if sockets is None:
        pytest.skip("this kernel does not tell which unix sockets belong together")
    owner = {inode: index for index, pid in where(array).items() for inode in socket_inodes(pid)}
    owner |= dict.fromkeys(socket_inodes(os.getpid()), "host")
    for index, pid in where(array).items():
        names, others = links_of(array.shape, index)
        held = socket_inodes(pid)
        (line,) = [inode for inode in held if sockets[inode].line]
        assert owner[sockets[line].peer] == "host"  # the line, of which no file bears the name
        held.remove(line)
        assert held <= set(sockets), "a socket that is no unix socket"
        paths = [Path(sockets[inode].path) for inode in held if sockets[inode].path]
        assert all(path.parent == Path(array._place.path) for path in paths)
        assert {path.name for path in paths} <= names
        connected = [inode for inode in held if not sockets[inode].listens]
        assert [owner[sockets[inode].peer] for inode in connected].count(index) == 0
        assert sorted(map(str, (owner[sockets[inode].peer] for inode in connected))) == sorted(map(str, others))
        # a link's name is that of its lower end or the host's: a connection bears it at one end
        for inode in connected:
            path = sockets[inode].path or sockets[sockets[inode].peer].path
            assert Path(path).name in names


def test_a_node_holds_no_file_and_shares_no_memory(eight):
    render_job(eight.driver, job(EIGHT))
    for pid in eight.pids:
        others = {what for number, what in descriptors(pid).items() if number > 2 and not what.startswith("socket:")}
        assert {what.split(":")[0] for what in others} <= {"pipe", "anon_inode"}
        assert sum(what.startswith("pipe:") for what in others) == 1  # tells it that its parent is gone
        assert shared_files(pid) == []
        assert "/scenes/" not in Path(f"/proc/{pid}/maps").read_text()


def test_the_socket_directory_is_ours_alone(eight):
    place = Path(eight._place.path)
    assert place.stat().st_mode & 0o777 == 0o700
    names = {name for index in indices(EIGHT) for name in links_of(EIGHT, index)[0]}
    assert {entry.name for entry in place.iterdir()} - {"pid"} == names


# --- surfaces ------------------------------------------------------------------------------------


def touching(made: Job, index) -> dict[str, int]:
    """How many surfaces of each kind touch a cell."""
    cell = make_cell(made.space, index)
    low, high = np.array(cell.low_at), np.array(cell.high_at)
    counts = dict.fromkeys((kind.name.lower() for kind in SURFACE_KINDS), 0)
    for batch in made.surfaces:
        counts[batch.kind.name.lower()] += int(meets(batch, low, high).sum())
    return counts


@pytest.mark.parametrize("name", ["kinds.nff", "room.glb", "lights.toml"])
def test_a_node_holds_the_surfaces_that_touch_its_cell_and_no_other(eight, name):
    made = job(EIGHT, name, (16, 12))
    nodes = render_job(eight.driver, made).stats["nodes"]
    for node in nodes:
        assert node["surfaces"] == touching(made, tuple(node["index"]))
    assert sum(sum(node["surfaces"].values()) for node in nodes) < 8 * len(made.surfaces)
    array = MemoryArray(EIGHT)
    array.driver.load(made.space, made.surfaces)
    for processor, node in zip(array.processors, nodes, strict=True):
        assert processor.node_state.memory["surfaces"] == node["memory"]["surfaces"]


# --- the same bits, conservation, bounds ---------------------------------------------------------


@pytest.mark.parametrize("name", ["kinds.nff", "glass.toml", "lights.toml", "room.glb"])
def test_the_same_bits_and_counts_as_in_memory(eight, name):
    expected, found = in_memory(name), render_job(eight.driver, job(EIGHT, name))
    assert np.array_equal(found.sums, expected.sums)
    for what in ("born", "died", "hops", "walks", "hits"):
        assert found.stats["total"][what] == expected.stats["total"][what], what
    for one, other in zip(found.stats["nodes"], expected.stats["nodes"], strict=True):
        assert (one["index"], one["born"], one["died"], one["sent"]) == (
            other["index"],
            other["born"],
            other["died"],
            other["sent"],
        )


def polygon_points(made: Job) -> int:
    """Vertices of all polygons of a scene."""
    return sum(len(batch.data) for batch in made.surfaces if batch.kind == Kind.POLYGON)


@pytest.mark.parametrize("budget", [1, 500, BUDGET])
@pytest.mark.parametrize("name", ["kinds.nff", "lights.toml"])
def test_conservation_and_the_bounds(eight, name, budget):
    """From the counters of real runs, with more samples than the smaller budgets allow at once."""
    made = job(EIGHT, name, (24, 18) if budget == 1 else (120, 90))
    stats = render_job(eight.driver, made, budget).stats
    assert stats["total"]["born"] == stats["total"]["died"]
    assert 0 < stats["most_in_flight"] <= packets_bound(made.frame, budget, 8)
    most = max(packets_bound(made.frame, budget, 8), pixel_packets_bound(made.frame, 8))
    for node in stats["nodes"]:
        assert node["waiting"] == 0
        assert node["most_waiting"] <= most
        surfaces = surfaces_bound(node["surfaces"], polygon_points(made))
        allowed = memory_bound(made.frame, budget, 8, BATCH, surfaces)
        assert set(node["memory"]) == set(allowed)
        for what, used in node["memory"].items():
            assert used <= allowed[what], what
        assert node["private_memory"] <= NODE_BYTES + sum(allowed.values())


def test_the_budget_is_used_and_not_much_exceeded(eight):
    """The bound in packets is for the worst case; what is in flight in an ordinary picture is about the budget."""
    made = job(EIGHT, "lights.toml", (160, 120))
    at_ease = render_job(eight.driver, made).stats["most_in_flight"]
    tight = render_job(eight.driver, made, 2000).stats["most_in_flight"]
    assert tight < at_ease
    assert tight > 500


def test_several_frames_scenes_and_runs_on_one_array(eight):
    for _ in range(2):
        for name in ("kinds.nff", "glass.toml"):
            for _ in range(2):
                assert np.array_equal(render_job(eight.driver, job(EIGHT, name)).sums, in_memory(name).sums)


def test_a_frame_with_as_many_materials_as_there_can_be(eight):
    """Its order has megabytes, and runs over every link of the tree of waves."""
    made = job(EIGHT)
    eight.driver.load(made.space, made.surfaces)
    materials = np.zeros((MAX_MATERIALS, MATERIAL_COLUMNS))
    materials[: len(made.frame.materials)] = made.frame.materials
    eight.driver.trace(made.frame._replace(materials=materials))
    sums, _ = eight.driver.collect(made.pixels)
    eight.driver.trace(made.frame)
    assert np.array_equal(sums, eight.driver.collect(made.pixels)[0])
    assert sums.any()


# --- failures that an array survives -------------------------------------------------------------


def test_a_refused_order_is_reported_and_the_array_goes_on(eight):
    with pytest.raises(ArrayError, match=r"8 times a node refused what came: node .*an order came as 'dance'"):
        eight.driver.wave({"do": "dance"})
    assert np.array_equal(render_job(eight.driver, job(EIGHT)).sums, in_memory().sums)


def test_a_frame_with_too_few_materials_is_refused_and_the_array_goes_on(eight):
    made = job(EIGHT)
    eight.driver.load(made.space, made.surfaces)
    with pytest.raises(ArrayError, match="a frame came with 1 materials, a surface here has number"):
        eight.driver.trace(made.frame._replace(materials=made.frame.materials[:1]))
    assert np.array_equal(render_job(eight.driver, made).sums, in_memory().sums)


@pytest.mark.parametrize("phase", ["load", "trace", "collect"])
def test_a_frame_that_was_broken_off_leaves_nothing_in_the_next(eight, phase):
    long = job(EIGHT, "lights.toml", (300, 200))

    def stop(now, progress) -> None:
        if now == phase and (phase != "trace" or (progress is not None and progress.in_flight > 1000)):
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            render_job(eight.driver, long, watch=stop)
        assert np.array_equal(render_job(eight.driver, job(EIGHT)).sums, in_memory().sums)


# --- shapes --------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_leftovers")
@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (2, 1, 1), (3, 1, 1), (1, 4, 2), pytest.param((5, 4, 2), marks=pytest.mark.slow)]
)
def test_arrays_of_other_shapes(shape):
    with Array.launch(shape) as array:
        picture = render_job(array.driver, job(shape))
        nodes = picture.stats["nodes"]
        assert [tuple(node["index"]) for node in nodes] == list(indices(shape))
        assert [node["pid"] for node in nodes] == array.pids
        assert np.array_equal(picture.sums, in_memory().sums)
        assert [node["surfaces"] for node in nodes] == [touching(job(shape), index) for index in indices(shape)]
