"""The stated bounds: never exceeded by any order of turns, and reached by a node that is slow on purpose."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache

import numpy as np
import pytest
from support.array import (
    Order,
    haphazard,
    hurry,
    in_flight,
    launched,
    lazy,
    link_at,
    load,
    packets_alive,
    render,
    shuffled,
    trace,
    trees_alive,
    watch,
)
from support.bounds import memory_bound, packets_bound, pixel_packets_bound, surfaces_bound, trees_bound
from support.frames import make_frame, material, perspective, point_light
from support.scenes import Scene, mixed_scene, space_of
from support.space import EVEN_STEP
from support.surfaces import batch, merge

from raygrid.emulator.driver import dealing
from raygrid.emulator.driver import driver as driver_module
from raygrid.emulator.driver.admission import Progress
from raygrid.emulator.topology.bounds import branches_of, growth, growth_of
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.protocol.commands import TraceCommand
from raygrid.node.protocol.messages import WINDOW
from raygrid.node.runtime import node_state as tracer_module
from raygrid.node.runtime.surface_flood import CLOGGED

SIZE = (24, 18)


@cache
def scene(size: tuple[int, int] = SIZE) -> Scene:
    """All kinds of surfaces and materials, five lights, depth 4."""
    camera = perspective([0.15, 0.2, 1.25], [-0.1, -0.15, -1], 30, size)
    return mixed_scene(1, EVEN_STEP, 20, size=size, depth=4, camera=camera)


# --- how a tree grows ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("depth", "lights", "branches", "expected"),
    [
        (1, 0, 2, (1, 0, 1)),  # a ray, or its return
        (1, 1, 2, (1, 1, 1)),
        (1, 7, 2, (1, 7, 7)),
        (5, 0, 0, (1, 0, 1)),
        (5, 0, 2, (16, 0, 16)),
        (5, 3, 0, (1, 3, 3)),
        (5, 3, 1, (1, 15, 15)),
        (5, 3, 2, (16, 93, 93)),  # 3 (1 + 2 + 4 + 8 + 16)
        (3, 1, 2, (4, 7, 7)),
    ],
)
def test_growth(depth, lights, branches, expected):
    assert growth(depth, lights, branches) == expected


@pytest.mark.parametrize("seed", range(200))
def test_no_tree_outgrows_the_bound(seed):
    """Trees grown at random, in a random order, by the rules of the ray step."""
    rng = np.random.default_rng(seed)
    depth, lights, branches = (int(rng.integers(low, high)) for low, high in ((1, 6), (0, 5), (0, 3)))
    bound, alive = growth(depth, lights, branches), [1]  # rays by their depth, 0 for shadow rays, -1 for returns
    greedy = rng.random() < 0.5
    while alive:
        rays = [number for number, ray in enumerate(alive) if ray > 0]
        ray = alive.pop(int(rng.choice(rays)) if greedy and rays else int(rng.integers(len(alive))))
        if ray > 0 and (greedy or rng.random() < 0.7):
            alive += [0] * (lights if greedy else int(rng.integers(0, lights + 1)))
            if ray < depth:
                alive += [ray + 1] * (branches if greedy else int(rng.integers(0, branches + 1)))
        elif ray >= 0:
            alive += [-1] * int(rng.integers(0, 2))
        assert len(alive) <= bound.packets
        assert sum(ray > 0 for ray in alive) <= bound.rays
        assert sum(ray == 0 for ray in alive) <= bound.shadows


def test_branches_are_those_of_one_material():
    sorts = {"mirror": material(specular=0.1), "glass": material(transmission=(0, 0, 0.1)), "dull": material(diffuse=1)}
    both = material(specular=(0.1, 0, 0), transmission=0.5)
    camera = scene().frame.camera
    for wanted, materials in (
        (0, [sorts["dull"]]),
        (1, [sorts["mirror"], sorts["dull"]]),
        (1, [sorts["mirror"], sorts["glass"]]),
        (2, [sorts["dull"], both]),
    ):
        assert branches_of(make_frame(camera, SIZE, materials=materials)) == wanted


# --- trees and packets ---------------------------------------------------------------------------

SCHEDULES = {"shuffled": shuffled, "haphazard": haphazard, "lazy": lazy}


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize(
    ("name", "budget"), [("1x1x1", 40), ("2x2x2", 1), ("2x2x2", 12), ("2x2x2", 150), ("3x1x2", 40)]
)
def test_the_bounds_hold_at_every_moment(name, budget, schedule, monkeypatch):
    """Waves amid all activity, nodes that sleep, small messages: trees and packets are counted where they are."""
    monkeypatch.setattr(tracer_module, "BATCH_RAYS", 1)  # what is born and dies in one turn is never seen
    most = {"trees": 0, "packets": 0}

    def look() -> None:
        most["packets"] = max(most["packets"], in_flight(array))
        most["trees"] = max(most["trees"], trees_alive(array))

    array = launched(name, order=SCHEDULES[schedule](budget), batch=8)
    hurry(array, budget, share=0.9)
    seen = scene(SIZE if budget > 20 else (9, 7))
    load(array, name, seen)
    watch(array, look)
    array.driver.trace(seen.frame, budget=budget)
    nodes = len(array.processors)
    assert most["trees"] <= trees_bound(seen.frame, budget, nodes)
    assert most["packets"] <= packets_bound(seen.frame, budget, nodes)
    assert most["trees"] >= min(budget, 5)  # and it is not kept by bearing next to nothing


def most_trees(seed: int, budget: int, schedule: Callable[[int], Order] = lazy) -> int:
    """The most trees alive in a scene where each tree is one packet, so that the budget leaves nothing to spare."""
    size = (20, 15)
    seen = scene(size)
    dark = make_frame(seen.frame.camera, size, materials=[material(diffuse=1)] * 6, background=(1, 1, 1))
    assert growth_of(dark).packets == 1
    most = 0

    def look() -> None:
        nonlocal most
        most = max(most, in_flight(array))

    array = launched("2x2x2", order=schedule(seed), batch=8)
    hurry(array, seed, share=1.0)
    load(array, "2x2x2", seen)
    watch(array, look)
    array.driver.trace(dark, budget=budget)
    return most


@pytest.fixture
def slow_births(monkeypatch):
    """Homes that bear a few at a time, and so still may bear more when they answer a wave."""
    monkeypatch.setattr(tracer_module, "ADMIT_BELOW", 3)
    monkeypatch.setattr(tracer_module, "ADMIT_AT_ONCE", 2)
    monkeypatch.setattr(tracer_module, "BATCH_RAYS", 3)


@pytest.mark.usefixtures("slow_births")
@pytest.mark.parametrize("schedule", SCHEDULES)
def test_the_budget_holds_when_homes_are_slow_to_use_it(schedule):
    assert 4 < max(most_trees(seed, 10, SCHEDULES[schedule]) for seed in range(2)) <= 10


@pytest.mark.usefixtures("slow_births")
def test_counting_births_and_deaths_of_the_same_wave_would_not_do(monkeypatch):
    """The plain rule that `admission.next_quota` replaces breaks the budget, and the watching above sees it."""

    def plain(budget: int, now: Progress, before: Progress | None, allowed: int) -> int:
        return max(0, budget - now.in_flight) // max(now.homes_left, 1)

    monkeypatch.setattr(driver_module, "next_quota", plain)
    assert any(most_trees(seed, 10) > 10 for seed in range(12))


def floor_under_lights(lights: int, depth: int, **facts) -> Scene:
    """A floor in the lower half, seen from there; all lights in the upper half."""
    corners = np.array([[-0.45, -0.2, -0.45], [-0.45, -0.2, 0.45], [0.45, -0.2, 0.45], [0.45, -0.2, -0.45]])
    surfaces = merge([batch(Kind.POLYGON, [corners])])
    camera = perspective([0.0, -0.05, 0.0], [0, -1, 0], 60, SIZE)
    rng = np.random.default_rng(3)
    lamps = [point_light([*rng.uniform(-0.3, 0.3, 1), 0.3, *rng.uniform(-0.3, 0.3, 1)], 0.1) for _ in range(lights)]
    frame = make_frame(camera, SIZE, materials=[material(diffuse=0.5, **facts)], lights=lamps, depth=depth)
    return Scene(surfaces, frame, EVEN_STEP)


def only_at_first(node: int, rounds: int) -> Order:
    """One node alone gets turns for some rounds; then all do."""
    left = [rounds]

    def order(n: int) -> Iterable[int]:
        left[0] -= 1
        return [node] if left[0] >= 0 else range(n)

    return order


@pytest.mark.parametrize("budget", [200, 10_000])
@pytest.mark.parametrize("batch", [1, 64])
def test_a_slow_node_makes_the_bound_come_true(budget, batch):
    """All primaries hit at once, and every shadow ray goes to a node that is given no turn."""
    lights = 6
    floor = floor_under_lights(lights, depth=1)
    array = launched("1x2x1", batch=batch)
    load(array, "1x2x1", floor)
    most = 0

    def look() -> None:
        nonlocal most
        most = max(most, in_flight(array))

    watch(array, look)
    wave = array.driver.wave

    def slow_wave(order):
        if isinstance(order, TraceCommand) and most == 0:
            # the slow node has taken in the order of the frame, but sees nothing of what follows
            array._order, fast = only_at_first(0, 60), array._order
            watch(array, look)
            assert fast is not None
        return wave(order)

    array.driver.wave = slow_wave
    trace(array, floor, budget=budget)
    bound = packets_bound(floor.frame, budget, 2)
    assert bound == min(budget, SIZE[0] * SIZE[1]) * lights
    assert 0.99 * bound <= most <= bound
    allowed = memory_bound(floor.frame, budget, 2, batch, 0)
    waited = link_at(array, (0, 0, 0), 3).most_waiting_bytes
    if batch == 1:  # all but a window of them waited in the link, each in a message of its own
        assert 0.99 * allowed["links"] - WINDOW * 300 < waited <= allowed["links"]
    for processor in array.processors:
        assert all(used <= allowed[what] for what, used in processor.node_state.memory.items() if what != "surfaces")


def test_small_budgets_complete_and_bear_everything():
    for budget in (0, 1, 7):
        for name in ("2x2x2", "5x4x2"):
            array = launched(name)
            load(array, name, scene((9, 7)))
            last = array.driver.trace(scene((9, 7)).frame, budget=budget)
            assert last.primaries == array.driver.collect(9 * 7)[1].sum() > 40
            assert last.born == last.died


# --- memory --------------------------------------------------------------------------------------


def counts_of(node_state) -> tuple[dict[str, int], int]:
    """Surfaces held by kind, and the points of polygons."""
    held = {kind.name.lower(): sum(len(b) for b in node_state.retained if b.kind == kind) for kind in Kind}
    return held, sum(len(b.data) for b in node_state.retained if b.kind == Kind.POLYGON)


@pytest.mark.usefixtures("quick_records")
@pytest.mark.parametrize("name", ["1x1x1", "2x2x2", "5x4x2"])
@pytest.mark.parametrize("budget", [100, 262_144])
def test_the_memory_of_every_node_is_below_its_bound(name, budget):
    array = launched(name, batch=64, order=lazy(1))
    hurry(array)
    render(array, name, scene(), budget=budget)
    nodes = len(array.processors)
    for processor, record in zip(array.processors, array.driver.report(), strict=True):
        surfaces = surfaces_bound(*counts_of(processor.node_state))
        allowed = memory_bound(scene().frame, budget, nodes, 64, surfaces)
        assert record["index"] == list(processor.index)
        assert set(record["memory"]) == set(allowed)
        for what, used in record["memory"].items():
            assert 0 <= used <= allowed[what], what
        most = max(packets_bound(scene().frame, budget, nodes), pixel_packets_bound(scene().frame, nodes))
        assert record["most_waiting"] <= most


def test_the_bound_of_surfaces_is_not_much_more_than_they_need():
    array = launched("1x1x1")
    for kind in Kind:
        rows = [b for b in scene().surfaces if b.kind == kind]
        array.driver.load(space_of("1x1x1", EVEN_STEP), merge(rows))
        node_state = array.processors[0].node_state
        bound = surfaces_bound(*counts_of(node_state))
        assert 0.25 * bound < node_state.memory["surfaces"] <= bound, kind


def test_memory_of_surfaces_falls_as_the_array_grows():
    used = []
    for name in ("1x1x1", "2x2x2", "5x4x2"):
        array = launched(name)
        load(array, name, scene())
        used.append(max(processor.node_state.memory["surfaces"] for processor in array.processors))
    assert used[0] > 2 * used[1] > 2.5 * used[2]


def test_growth_of_a_frame_is_that_of_its_facts():
    assert growth_of(scene().frame) == growth(4, 5, 2)


def test_the_flood_waits_in_bounded_room(monkeypatch):
    """A node that takes nothing for long: what is under way to it, and waits before it, stays within what is stated."""
    monkeypatch.setattr(dealing, "CHUNK_BYTES", 2000)
    rng = np.random.default_rng(1)
    corners = 0.3 * rng.uniform(-1, 1, (20_000, 9))
    corners[:, 0], corners[:, 3] = -0.46, 0.45  # through all nodes, and all of them enter at the first
    many = merge([batch(Kind.TRIANGLE, corners)])
    array = launched("3x1x1")
    slow = array.processors[2]
    most = {"unread": 0, "waiting": 0, "longest": 0}

    def look() -> None:
        for processor in array.processors:
            most["unread"] = max(most["unread"], len(processor.flood.unread))
            for link in processor.links.values():
                most["waiting"] = max(most["waiting"], link.waiting)
                most["longest"] = max([most["longest"], *(len(payload) for _, _, payload in link.queued)])

    idle = [300]

    def take() -> None:
        idle[0] -= 1
        if idle[0] < 0:
            type(slow.flood).work(slow.flood)

    slow.flood.work = take
    watch(array, look)
    array.driver.load(space_of("3x1x1", EVEN_STEP), many)
    assert idle[0] < 0
    assert slow.node_state.retained
    assert most["unread"] <= WINDOW * 2  # links of the middle node; the slow one has a neighbour and the host
    assert most["waiting"] <= CLOGGED + 1
    assert most["longest"] <= 2000 + 100
    assert most["waiting"] == CLOGGED + 1  # it came to that
    assert most["unread"] >= WINDOW
    assert len(packets_alive(array)) == 0
