"""The ray step over arrays of many shapes: the same bits (law 4), nothing lost (law 5), found once (law 8)."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from support.cameras import bad_places
from support.driver import Grid, inject
from support.kernels import ray_packets
from support.scenes import EVEN_STEP, SHAPES, Rays, Scene, birth_cells, mixed_scene, space_of, trouble
from support.surfaces import F64

from raygrid.node.geometry.bvh import DEPTH
from raygrid.node.geometry.grid_walk import HOST, SELF, SELF_RAYS
from raygrid.node.geometry.lattice import HALF
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.protocol import packets
from raygrid.node.protocol.counters import BORN, BOXES, DIED, HITS, SENT, TESTS, WALKS
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import SIZE
from raygrid.node.tracing.output_queues import make_outputs
from raygrid.node.tracing.step import observed_step, step_one

STEPS = {"even": EVEN_STEP, "askew": (0.55 / HALF, 0.37 / HALF, 0.47 / HALF)}
# cells so thin that spawned rays land many cells away
ALL_STEPS = STEPS | {
    "flat": (0.55 / HALF, 0.37 / HALF, 2.1e-3 / HALF),
    "rod": (2.3e-3 / HALF, 0.9 / HALF, 2.1e-3 / HALF),
}
RAY_KINDS = [packets.PRIMARY, packets.REFLECTED, packets.REFRACTED]


def traced(scene: Scene, shape: str, schedule: int | None) -> Grid:
    """A frame of a scene on an array of this shape; schedule None: everything in order, in calls as large as may be."""
    order = None if schedule is None else np.random.default_rng(schedule)
    grid = Grid(space_of(shape, scene.step), scene.surfaces, scene.frame, order)
    grid.run()
    grid.check_conservation()
    return grid


@functools.cache
def whole_frame(step: str) -> tuple[Scene, F64, np.ndarray]:
    """(a scene with all there is, its picture on one node, the counts)."""
    scene = mixed_scene(11, STEPS[step], 24, samples=2, min_weight=0.002)
    grid = traced(scene, "1x1x1", None)
    return scene, grid.sums(), grid.counts()


# --- one step, whoever takes it ------------------------------------------------------------------------------


def one_by_one(tables, packets, ports, first, last):
    """Serve a packet by `step_one`."""
    step_one(tables, packets, first * SIZE, np.int64(ports[first]))
    return first + 1


def observed(tables, packets, ports, first, last):
    """Serve packets by an observed step, as many as it has room to note."""
    many = min(last - first, len(tables.outputs.found.items))
    return first + observed_step(tables, packets[first * SIZE :], ports[first:], 0, many)


@pytest.mark.parametrize("shape", ["1x1x1", "2x2x2"])
def test_a_step_of_one_and_an_observed_step_do_what_the_step_does(shape):
    scene = mixed_scene(12, STEPS["askew"], 10, samples=2, min_weight=0.002)
    wanted = traced(scene, shape, None)
    for serve, searches in ((one_by_one, True), (observed, False)):
        grid = Grid(space_of(shape, scene.step), scene.surfaces, scene.frame, None, serve)
        grid.outputs = make_outputs(1024, DEPTH, 1024)
        grid.run()
        grid.check_conservation()
        np.testing.assert_array_equal(grid.sums(), wanted.sums())
        for index, node in grid.nodes.items():
            counts, others = node.counts.copy(), wanted.nodes[index].counts.copy()
            if not searches:  # of shadow rays the nearest surface is looked for
                for searched in (counts, others):
                    searched[TESTS:WALKS] = searched[BOXES] = 0
            np.testing.assert_array_equal(counts, others)


# --- laws 4 and 5 on whole frames ---------------------------------------------------------------------------


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("step", STEPS)
def test_every_shape_and_schedule_gives_the_same_bits(step, shape):
    scene, picture, counts = whole_frame(step)
    for schedule in (None, 1):
        grid = traced(scene, shape, schedule)
        np.testing.assert_array_equal(grid.sums(), picture)
        # the tree of rays is the same, whatever array it grows in
        np.testing.assert_array_equal(grid.counts()[BORN:SENT], counts[BORN:SENT])
        assert grid.counts()[HITS] == counts[HITS]


def test_the_frame_has_all_there_is():
    """What the other tests compare is no empty picture."""
    scene, picture, counts = whole_frame("even")
    pixels = scene.frame.width * scene.frame.height
    assert counts[BORN + packets.PRIMARY] == picture[:, 3].sum() <= 2 * pixels
    assert all(counts[BORN + kind] > 300 for kind in (*RAY_KINDS, packets.SHADOW, packets.RETURN))
    assert (counts[TESTS : TESTS + len(Kind)] > 300).all()
    assert (picture[:, :3].max(0) > 2**24).all()


@pytest.mark.parametrize("schedule", [2, 3, 4, 5])
def test_more_schedules(schedule):
    scene, picture, _ = whole_frame("even")
    np.testing.assert_array_equal(traced(scene, "3x3x3", schedule).sums(), picture)


@pytest.mark.parametrize(
    "place", ["inside", "on a face, along it", "parallel, from inside", "inside, on a plane between cells"]
)
def test_from_any_place(place):
    """Also where returns go to one home, or start at the edge of the world."""
    scene = mixed_scene(12, STEPS["askew"], 12)
    size = (24, 18)
    cameras = bad_places(space_of("4x3x1", scene.step), size)
    scene = scene._replace(frame=scene.frame._replace(camera=cameras[place], width=size[0], height=size[1]))
    picture = traced(scene, "1x1x1", None).sums()
    assert picture[:, :3].any()
    for shape in ("4x3x1", "uneven 4x4x4", "5x4x2"):
        np.testing.assert_array_equal(traced(scene, shape, 6).sums(), picture)


@pytest.mark.parametrize("shape", ["1x1x1", "4x3x1", "3x3x3"])
def test_pixels_come_to_the_host(shape):
    scene, picture, _ = whole_frame("even")
    grid = traced(scene, shape, 7)
    np.testing.assert_array_equal(grid.delivered(), picture)
    grid.check_conservation()
    assert not grid.sums().any()
    assert grid.counts()[SENT + HOST] == sum(len(rows) for rows in grid.to_host) == grid.counts()[DIED + packets.PIXEL]


# --- law 8: rays that look for trouble ----------------------------------------------------------------------


def flown(scene: Scene, rays: Rays, shape: str, schedule: int) -> Grid:
    """Rays of the fuzz on an array of this shape, some of them born beside the cell of their origin."""
    rng = np.random.default_rng(schedule)
    grid = Grid(space_of(shape, scene.step), scene.surfaces, scene.frame, rng)
    inject(grid, ray_packets(packets.REFLECTED, rays.origins, rays.codes), birth_cells(grid.space, rays, rng))
    grid.run(births=False)
    grid.check_conservation()
    return grid


def check_no_ray_differs(seed: int, step: str, n_rays: int) -> None:
    """Each ray has a pixel of its own, so a ray that differs is named by its pixel."""
    scene, rays = trouble(seed, ALL_STEPS[step], n_rays)
    one = flown(scene, rays, SHAPES[0], seed)
    picture, counts = one.sums(), one.counts()
    assert counts[HITS] > n_rays // 4
    for shape in SHAPES[1:]:
        grid = flown(scene, rays, shape, seed + 1)
        differ = np.flatnonzero((grid.sums() != picture).any(1))
        assert len(differ) == 0, f"seed {seed}, {step} step, {shape}: rays {differ.tolist()[:20]} of {n_rays}"
        np.testing.assert_array_equal(grid.counts()[BORN:SENT], counts[BORN:SENT])


@pytest.mark.parametrize(("step", "seed"), [("even", 1), ("askew", 2), ("flat", 1), ("rod", 1)])
def test_no_ray_differs_between_shapes(step, seed):
    check_no_ray_differs(seed, step, 6_000)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 115))
@pytest.mark.parametrize("step", ALL_STEPS)
def test_no_ray_of_very_many_differs(step, seed):
    """1,800,000 rays, in 60 scenes."""
    check_no_ray_differs(seed, step, 30_000)


# --- counts -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", SHAPES)
def test_counts_add_up(shape):
    scene, _, _ = whole_frame("even")
    grid = traced(scene, shape, 8)
    counts = grid.counts()
    born, died, sent = counts[BORN:DIED], counts[DIED:SENT], counts[SENT:TESTS]
    rays = int(born[RAY_KINDS].sum())
    # what is served was born (unless it died where it was born) or handed on; returns at home are never served
    served_returns = grid.processed - rays - int(born[packets.SHADOW]) - hops_of(grid)
    assert 0 <= served_returns <= born[packets.RETURN]
    assert sent[SELF] <= born[packets.SHADOW]
    assert sent[SELF_RAYS] <= rays - born[packets.PRIMARY]
    assert counts[HITS] <= died[RAY_KINDS].sum()
    assert counts[WALKS] >= rays + born[packets.SHADOW]
    assert counts[BOXES] >= counts[TESTS : TESTS + len(Kind)].sum() // 32
    if shape == "1x1x1":
        assert counts[WALKS] == rays + born[packets.SHADOW] == grid.processed
        assert sent[:HOST].sum() == 0
        assert sent[SELF] == born[packets.SHADOW]
        assert sent[SELF_RAYS] == rays - born[packets.PRIMARY]


def hops_of(grid: Grid) -> int:
    """Packets handed on through ports, but for those that were born into a port: these are served once, not twice."""
    counts = grid.counts()
    sent = counts[SENT:TESTS]
    born_into_ports = int(counts[BORN + packets.SHADOW] - sent[SELF])
    born_into_ports += int(counts[BORN + packets.REFLECTED] + counts[BORN + packets.REFRACTED] - sent[SELF_RAYS])
    return int(sent[:HOST].sum()) - born_into_ports


def test_a_node_without_surfaces_tests_nothing():
    scene = mixed_scene(13, EVEN_STEP, 0)
    grid = traced(scene, "3x3x3", 9)
    counts = grid.counts()
    assert counts[TESTS : BOXES + 1].sum() - counts[WALKS] == 0
    assert counts[WALKS] > counts[BORN + packets.PRIMARY] == counts[BORN + packets.RETURN] > 0


def test_a_full_output_stops_the_step_before_it_overflows():
    """The number returned is the first packet not processed; nothing is written beside the room."""
    scene, picture, _ = whole_frame("even")
    grid = Grid(space_of("1x1x1", scene.step), scene.surfaces, scene.frame)
    grid.run()
    room, reserve = (grid.outputs.data.shape[1] - HEAD) // SIZE, scene.frame.n_lights + 2
    assert room - reserve < grid.fullest <= room
    assert grid.stopped > 0
    assert not grid.outputs.data[:, :HEAD].any()
    np.testing.assert_array_equal(grid.sums(), picture)
