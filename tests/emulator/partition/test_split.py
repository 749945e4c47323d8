"""Where planes are put: always valid, always the same, and by a count of work that is the nodes' own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray
from support.render import SCENES
from support.surfaces import batch, random_rows

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.partition import sampling_prepass as prepass_module
from raygrid.emulator.partition import split as split_module
from raygrid.emulator.partition.cost_grid import (
    CostGrid,
    NotCompiledError,
    Weights,
    count_work,
    from_cache_only,
    improve,
)
from raygrid.emulator.partition.sampling_prepass import MOST_SURFACES, run_prepass, stand_ins
from raygrid.emulator.partition.split import split
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError
from raygrid.node.geometry.lattice import LATTICE, THINNEST_CELL, Space, make_space
from raygrid.node.geometry.surfaces import Batch, Kind, SurfaceSet, merge

WALKS = Weights(walk=1.0, box=0.0, hit=0.0, primary=0.0, hop=0.0, returned=0.0, taken_in=0.0, held=0.0)
Shape = tuple[int, int, int]
Counts = NDArray[np.float64]


def by_cell(work: CostGrid) -> NDArray[np.float64]:
    """The work of each voxel of the grid as a cell of an array, float64 (nx, ny, nz)."""
    cells = np.diff(np.diff(np.diff(work.done, axis=0), axis=1), axis=2)
    for axis in range(3):
        one, two = (other for other in range(3) if other != axis)
        upwards, downwards = (np.diff(np.diff(work.crossed[axis, way], axis=one), axis=two) for way in (0, 1))
        cells += np.delete(upwards, -1, axis=axis) + np.delete(downwards, 0, axis=axis)
    return cells


@pytest.fixture(autouse=True)
def always_worthwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pictures here are small."""
    monkeypatch.setattr(split_module, "WORTHWHILE", 0)


def job_of(name: str, shape: Shape, **settings: object) -> Job:
    return make_job(load_scene(SCENES / name), shape, Settings(**settings))  # type: ignore[arg-type]


def walks_of(job: Job) -> Counts:
    """What the nodes count, shape (nx, ny, nz)."""
    array = MemoryArray(job.space.shape)
    array.driver.ready()
    counts = np.zeros(job.space.shape)
    for node in render_job(array.driver, job).stats["nodes"]:
        counts[tuple(node["index"])] = node["walks"]
    return counts


def unevenness(counts: Counts) -> float:
    return float(counts.max() / counts.mean())


def check_planes(space: Space, shape: Shape) -> None:
    assert space.shape == shape
    for axis in range(3):
        line = space.planes[axis, : shape[axis] + 1]
        assert line[0] == 0
        assert line[-1] == LATTICE
        assert np.all(np.diff(line) >= THINNEST_CELL)


# --- the planes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (2, 2, 2), (4, 3, 1), (1, 1, 7), (5, 4, 2), (16, 16, 1), (17, 1, 1), (3000, 1, 2)]
)
@pytest.mark.parametrize("name", ["tiny.nff", "tree.nff", "lights.toml", "faces.nff", "kinds.nff"])
def test_planes_are_valid(name: str, shape: Shape) -> None:
    for kind in ("balanced", "uniform"):
        check_planes(job_of(name, shape, split=kind).space, shape)


@pytest.mark.parametrize("shape", [(2, 2, 2), (4, 4, 4), (16, 2, 1), (40, 1, 1)])
@pytest.mark.parametrize(
    "surfaces",
    [
        "s 0 0 0 1\n",  # one surface
        "p 3\n-1 -1 0\n1 -1 0\n0 1 0\n",  # a flat scene
        "s 0 0 0 100\n" + "".join(f"s 60 60 {60 + k * 1e-7} 0.0001\n" for k in range(50)),  # all in one place
        "p 3\n-1 -1 0\n1 -1 0\n0 1 0\n" + "s 0.9 -0.9 0 0.00001\n" * 200,
    ],
    ids=["one", "flat", "corner", "same"],
)
def test_planes_of_odd_scenes_are_valid(surfaces: str, shape: Shape, tmp_path: Path) -> None:
    view = "v\nfrom 0 -8 3\nat 0 0 0\nup 0 0 1\nangle 40\nhither 0.1\nresolution 64 64\nl 3 -4 5\nf 1 1 1 1 0.5 9 0 0\n"
    path = tmp_path / "odd.nff"
    path.write_text(view + surfaces)
    check_planes(make_job(load_scene(path), shape, Settings()).space, shape)


def test_the_planes_are_the_same_every_time() -> None:
    one, two = (job_of("tree.nff", (3, 4, 2), size=(200, 100)).space.planes for _ in range(2))
    assert one.tolist() == two.tolist()


def test_a_frame_without_rays_is_split_by_surfaces() -> None:
    job = job_of("tiny.nff", (2, 3, 2))
    camera = job.frame.camera.copy()
    camera[3] = -camera[3]  # the eye looks away
    camera[4:] = 0.0
    away = split("balanced", (2, 3, 2), job.world, job.surfaces, job.frame._replace(camera=camera))
    of_surfaces = split("balanced", (2, 3, 2), job.world, job.surfaces)
    assert away.planes.tolist() == of_surfaces.planes.tolist()
    check_planes(of_surfaces, (2, 3, 2))


def test_nothing_is_estimated_where_there_is_no_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a pre-pass ran")

    monkeypatch.setattr(split_module, "_by_prepass", refuse)
    job_of("tiny.nff", (1, 1, 1))
    job_of("tiny.nff", (2, 2, 2), split="uniform")


def test_a_small_picture_is_split_by_surfaces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(split_module, "WORTHWHILE", 64 * 64 * 3 + 1)
    job = job_of("tiny.nff", (2, 2, 2), size=(64, 64))
    assert len(job.frame.lights) == 2
    of_surfaces = split("balanced", (2, 2, 2), job.world, job.surfaces)
    assert job.space.planes.tolist() == of_surfaces.planes.tolist()
    assert job_of("tiny.nff", (2, 2, 2), size=(64, 65)).space.planes.tolist() != of_surfaces.planes.tolist()


def test_a_kind_or_shape_that_cannot_be_is_named() -> None:
    job = job_of("tiny.nff", (1, 1, 1))
    with pytest.raises(ArrayError, match="'even'"):
        split("even", (2, 2, 2), job.world, job.surfaces)
    with pytest.raises(ArrayError, match="262145 cells, wanted at most 262144"):
        split("uniform", (LATTICE // THINNEST_CELL + 1, 1, 1), job.world, job.surfaces)


# --- the count of work -----------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(2, 2, 2), (4, 3, 1), (3, 4, 5)])
@pytest.mark.parametrize("name", ["tiny.nff", "kinds.nff", "glass.toml", "lights.toml", "faces.nff"])
@pytest.mark.parametrize("kind", ["uniform", "balanced"])
def test_walks_are_counted_as_the_nodes_count_them(name: str, shape: Shape, kind: str) -> None:
    job = job_of(name, shape, size=(40, 30), samples=1, split=kind, min_weight=0.0)
    prepass = run_prepass(job.world.step, job.surfaces, job.frame)
    np.testing.assert_array_equal(by_cell(count_work(prepass, job.space, WALKS)), walks_of(job))


def test_a_choice_of_planes_of_a_finer_grid_has_the_walks_of_its_own_grid() -> None:
    job = job_of("kinds.nff", (1, 1, 1), size=(30, 30))
    prepass = run_prepass(job.world.step, job.surfaces, job.frame)
    rng = np.random.default_rng(7)
    lines = [np.sort(rng.choice(np.arange(1000, LATTICE - 1000, 1000), 9, replace=False)) for _ in range(3)]
    fine = make_space(job.world.step, [[0, *line.tolist(), LATTICE] for line in lines])
    work = count_work(prepass, fine, WALKS)
    planes = np.array([[0, 2, 5, 10], [0, 1, 10, 0], [0, 4, 9, 10]])
    before = planes.copy()
    cost = improve(work, (3, 2, 3), planes)  # the planes move, and their cost is that of their own grid
    assert planes.tolist() != before.tolist()
    chosen = [fine.planes[axis, planes[axis, : cells + 1]].tolist() for axis, cells in enumerate((3, 2, 3))]
    cells = by_cell(count_work(prepass, make_space(job.world.step, chosen), WALKS))
    assert cost == pytest.approx(cells.max() + 0.5 * cells.mean(), rel=0.05)


def test_a_coarse_prepass_sees_what_a_fine_one_sees() -> None:
    job = job_of("glass.toml", (3, 3, 3), size=(512, 512))
    coarse, fine = (
        by_cell(count_work(run_prepass(job.world.step, job.surfaces, job.frame, n), job.space)) for n in (48, 160)
    )
    assert np.abs(coarse / coarse.sum() - fine / fine.sum()).max() < 0.01


# --- balance, by counts only -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["tiny.nff", "glass.toml", "room.glb", "lights.toml"])
def test_balance_is_better_than_uniform(name: str) -> None:
    walks = {kind: walks_of(job_of(name, (2, 2, 2), size=(96, 96), split=kind)) for kind in ("uniform", "balanced")}
    assert unevenness(walks["balanced"]) < 0.9 * unevenness(walks["uniform"])
    assert walks["balanced"].sum() < 1.3 * walks["uniform"].sum()


@pytest.mark.parametrize("shape", [(2, 2, 2), (4, 3, 1), (4, 4, 4)])
def test_the_busiest_node_of_a_tree_has_less_to_do(shape: Shape) -> None:
    """The eye is inside the world box, so all pixels are at home in one cell, whatever the planes: a share of the work
    that no planes can divide, and the busiest node has it. So work is estimated, not walks alone."""
    busiest, total = {}, {}
    for kind in ("uniform", "balanced"):
        job = job_of("tree.nff", shape, split=kind)
        cells = by_cell(count_work(run_prepass(job.world.step, job.surfaces, job.frame, 96), job.space))
        busiest[kind], total[kind] = cells.max(), cells.sum()
    assert busiest["balanced"] < busiest["uniform"]
    assert total["balanced"] < 1.3 * total["uniform"]


def sphere_of_triangles(rng: np.random.Generator, many: int) -> NDArray[np.float32]:
    z, around = rng.uniform(-1.0, 1.0, many), rng.uniform(0.0, 2.0 * np.pi, many)
    flat = np.sqrt(1.0 - z * z)
    middles = 0.3 * np.column_stack((flat * np.cos(around), flat * np.sin(around), z))
    corners = middles[:, None, :] + rng.normal(0.0, 0.003, (many, 3, 3))
    return corners.reshape(-1, 9).astype(np.float32)


def test_a_large_mesh_is_seen_by_its_stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    """The largest surfaces stay as they are, and each cell's share of the work is about that of the whole mesh."""
    job = job_of("tiny.nff", (2, 2, 2))
    floor = np.array([[-0.9, -0.9, -0.3, 0.9, -0.9, -0.3, 0.0, 0.9, -0.3]], np.float32)
    data = np.concatenate((sphere_of_triangles(np.random.default_rng(3), 3 * MOST_SURFACES), floor))
    ids, materials = np.arange(len(data), dtype=np.uint32), np.zeros(len(data), np.uint16)
    mesh = SurfaceSet((Batch(Kind.TRIANGLE, ids, materials, data),))
    chosen = stand_ins(mesh)
    assert len(chosen) <= MOST_SURFACES
    assert (chosen.batches[0].data == floor).all(axis=1).any()
    some = by_cell(count_work(run_prepass(job.world.step, mesh, job.frame), job.space, WALKS))
    monkeypatch.setattr(prepass_module, "stand_ins", merge)
    whole = by_cell(count_work(run_prepass(job.world.step, mesh, job.frame), job.space, WALKS))
    assert np.abs(some / some.sum() - whole / whole.sum()).max() < 0.03


@pytest.mark.parametrize("kind", list(Kind))
def test_stand_ins_of_every_kind(kind: Kind) -> None:
    rng = np.random.default_rng(1)
    rows = batch(kind, random_rows(kind, rng, 3000, reach=0.5, size=(0.001, 0.01)))
    chosen = stand_ins(SurfaceSet((rows,)), 2500)
    assert 2000 <= len(chosen) <= 2500
    boxes = np.concatenate([part.bounds() for part in chosen])
    assert np.isfinite(boxes).all()
    assert set(chosen.batches[0].ids) <= set(rows.ids)


# --- kernels ---------------------------------------------------------------------------------------------


def test_where_a_kernel_would_be_compiled_it_is_refused() -> None:
    @njit
    def new(x):  # type: ignore[no-untyped-def]
        return x + 1

    with from_cache_only(), pytest.raises(NotCompiledError):
        new(1)
    assert new(1) == 2  # and later it compiles
    with from_cache_only():
        assert new(2) == 3


def test_a_split_waits_for_kernels_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def fails_first(*_: object) -> None:
        calls.append("try")
        if len(calls) == 1:
            raise NotCompiledError

    monkeypatch.setattr(split_module, "_by_prepass", fails_first)
    job = job_of("tiny.nff", (1, 1, 1))
    split("balanced", (2, 2, 2), job.world, job.surfaces, job.frame, lambda: calls.append("wait"))
    assert calls == ["try", "wait", "try"]
