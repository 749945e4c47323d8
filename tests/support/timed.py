"""Frames in machine time: by the simulator, and by timed processors in memory."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.simulator.simulator import Holding, digest_of, hold
from raygrid.emulator.simulator.work_count import CellWork, count_cell_work, price_lists
from raygrid.host.machine_time.cost_models import CostModel, load_cost_model
from raygrid.host.machine_time.simulate import Simulated, simulate_job
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.scene import Scene
from raygrid.node.geometry.grid_walk import PORTS
from raygrid.node.geometry.lattice import Space
from raygrid.node.geometry.surfaces import Kind, SurfaceSet
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.protocol.timestamps import prices_order
from support import paths
from support.frames import make_frame, orthographic
from support.render import SCENES, shared
from support.space import even_space
from support.surfaces import batch

Shape = tuple[int, int, int]
PATIENCE = 250.0  # seconds; a wave in memory comes back when all is done


class Books(NamedTuple):
    """What every node did, int64 (n,) each, sent (n, 6), and the frame's time and picture."""

    ticks: int
    busy: NDArray[np.int64]
    served: NDArray[np.int64]
    waited: NDArray[np.int64]
    most_waiting: NDArray[np.int64]
    walks: NDArray[np.int64]
    sent: NDArray[np.int64]
    trace: str
    sums: NDArray[np.int64]


@cache
def scene_of(name: str) -> Scene:
    """A bundled scene, or one of those that are not kept in this repository (spd/...)."""
    return load_scene(shared(*name.split("/")) if "/" in name else SCENES / name)


def job_of(name: str, shape: Shape, size: tuple[int, int], split: str = "uniform", **settings: Any) -> Job:
    """A small frame of a scene."""
    return make_job(scene_of(name), shape, Settings(size=size, split=split, **settings))


class Counted(NamedTuple):
    """The work of cells, and what it was counted by; a row a cost model."""

    holding: Holding
    prices: list[Any]
    walks: list[Any]
    work: CellWork


def counted(
    space: Space, surfaces: SurfaceSet, frame: Frame, search: str, costs: tuple[str, ...], samples: float = 1e9
) -> Counted:
    """What each cell does for a frame, or for as many samples of it."""
    holding = hold(space, surfaces, search)
    models = [load_cost_model(name) for name in costs]
    prices = [model.prices("middle", search) for model in models]
    walks = [model.list_ticks("middle", search, holding.held) for model in models]
    return Counted(holding, prices, walks, count_cell_work(holding, frame, price_lists(prices, walks), samples))


class Setting(NamedTuple):
    """What a simulation of something made by hand takes."""

    space: Space
    surfaces: SurfaceSet
    frame: Frame


def rays_to_a_wall(shape: Shape, pixels: int) -> Setting:
    """Parallel rays along +x from the first cell to a triangle in the last one; no light, so nothing comes of it."""
    wall = batch(Kind.TRIANGLE, [np.array([0.45, -0.4, -0.4, 0.45, 0.4, -0.4, 0.45, 0.0, 0.45])])
    size = (pixels, 1)
    camera = orthographic([-2.0, 0.0, 0.0], [1, 0, 0], 0.0005, size, up=(0, 0, 1))
    return Setting(even_space(shape), SurfaceSet((wall,)), make_frame(camera, size))


def simulated(job: Job, cost: str | CostModel, search: str | None = None, **options: Any) -> Simulated:
    """By the simulator: the middle costs, no set-up and read-out unless asked for."""
    model = load_cost_model(cost) if isinstance(cost, str) else cost
    return simulate_job(job, model, search, **{"band": False, "around": False, **options})


def books_of(done: Simulated) -> Books:
    """The books of a simulated frame."""
    phase = done.frames["middle"]
    columns = (phase.column(field) for field in ("busy", "served", "waited", "most_waiting", "walked"))
    sent = phase.nodes["sent"][:, :PORTS]
    return Books(phase.ticks, *columns, sent, phase.trace, done.sums)


def prices_of(cost: str, search: str | None = None) -> dict[str, Any]:
    """The middle prices of a model, as the order of a frame carries them."""
    model = load_cost_model(cost)
    chosen = search or model.file.search
    return prices_order(model.prices("middle", chosen), model.tests("middle") * (chosen == "list"))


def emulated_by(driver: Any, job: Job, cost: str, search: str | None = None) -> Books:
    """By a timed array that is ready: its nodes' own records."""
    picture = render_job(driver, job, prices=prices_of(cost, search))
    machines = [node["machine"] for node in picture.stats["nodes"]]
    names = ("busy_ticks", "served", "waited_ticks", "most_waiting", "walks", "sent")
    columns = (np.array([machine[name] for machine in machines], np.int64) for name in names)
    trace = digest_of(np.array([machine["trace"] for machine in machines], np.int64))
    return Books(picture.stats["ticks"], *columns, trace, picture.sums)


def emulated(job: Job, cost: str, search: str | None = None, **options: Any) -> Books:
    """By timed processors in memory."""
    array = MemoryArray(job.space.shape, timed=True, **options)
    array.driver.patience = PATIENCE
    array.driver.ready()
    link_states = emulated_by(array.driver, job, cost, search)
    array.driver.end()
    return link_states


def assert_same(one: Books, other: Books) -> None:
    """Everything equal: ticks, each node's books, the trace of all services, the picture."""
    for name, a, b in zip(Books._fields, one, other, strict=True):
        assert np.array_equal(a, b), name


def folder() -> Path:
    """Where the built-in cost models lie."""
    return paths.ROOT / "emulator" / "costs"
