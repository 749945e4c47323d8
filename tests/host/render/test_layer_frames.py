"""Layers of a picture: what is first met behind the middle of each pixel, the same on all arrays, and as the oracle has it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import oracle
import pytest
from oracle import kernels
from support.oracle import oracle_scene
from support.render import SCENES
from support.timed import scene_of

import raygrid
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.image.layer_names import LAYERS
from raygrid.host.image.picture import Picture
from raygrid.host.machine_time.cost_models import load_cost_model
from raygrid.host.render.animation_jobs import jobs_of, still_job
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.render.layer_frames import with_layers
from raygrid.host.render.program_file import read_program
from raygrid.node.errors import SceneError
from raygrid.node.protocol import prices_order

SHAPES = [(1, 1, 1), (2, 1, 1), (4, 3, 1), (2, 2, 2), (3, 3, 3), (5, 4, 2)]
SIZE = (56, 40)
# every NFF primitive; a mesh with normals; parallel rays; faces that lie on planes between cells
OPEN = {"room.glb", "lights.toml", "faces.nff", "tiny.nff"}  # where some rays meet nothing
CASES = ["kinds.nff", "room.glb", "lights.toml", "faces.nff", "tiny.nff"]
# A ray is off by a step of the lattice or so, 1e-7 of the longest edge of the scene: so far are hits off that are seen
# head on. At a grazing angle they are off by more along the ray, and on small balls their normals turn.
USUALLY_OFF, FARTHEST_OFF = 1e-7, 2e-6  # of the longest edge
NORMAL_OFF = 1e-4
OF_PROCESS = {"busy_seconds", "cpu_seconds", "peak_memory", "private_memory"}


def settings_of(layers=LAYERS, **changes) -> Settings:
    return Settings(**{"size": SIZE, "samples": 1, "layers": tuple(layers)} | changes)


def array_of(shape, **options) -> MemoryArray:
    array = MemoryArray(shape, **options)
    array.driver.ready()
    return array


def traced(array: MemoryArray, job: Job, prices=None) -> Picture:
    return with_layers(array.driver, job, render_job(array.driver, job, prices=prices), prices=prices)


@cache
def reference(name, **changes) -> Picture:
    return traced(array_of((1, 1, 1)), make_job(scene_of(name), (1, 1, 1), settings_of(**changes)))


def same_layers(one: Picture, other: Picture) -> bool:
    return list(one.layers) == list(other.layers) and all(
        one.layers[layer].dtype == other.layers[layer].dtype
        and one.layers[layer].tobytes() == other.layers[layer].tobytes()
        for layer in one.layers
    )


# ---- what they are ----


def test_kinds_and_shapes_of_layers():
    layers, size = reference("kinds.nff").layers, (SIZE[1], SIZE[0])
    assert list(layers) == list(LAYERS)
    assert [layers[layer].dtype for layer in LAYERS] == [np.float32, np.float32, np.int32, np.int32]
    assert [layers[layer].shape for layer in LAYERS] == [size, (*size, 3), size, size]


@pytest.mark.parametrize("name", CASES)
def test_layers_agree_on_where_nothing_is_met(name):
    layers = reference(name).layers
    nothing = layers["surface"] < 0
    assert nothing.any() == (name in OPEN)
    assert not nothing.all()
    assert np.array_equal(np.isinf(layers["depth"]), nothing)
    assert np.array_equal(layers["material"] < 0, nothing)
    assert np.array_equal(~layers["normal"].any(axis=2), nothing)
    assert (layers["surface"][nothing] == -1).all()


@pytest.mark.parametrize("name", CASES)
def test_materials_are_those_of_the_surfaces(name):
    layers, owner = reference(name).layers, {}
    for batch in scene_of(name).surfaces:
        owner |= dict(zip(batch.ids.tolist(), batch.materials.tolist(), strict=True))
    met = layers["surface"] >= 0
    assert layers["material"][met].tolist() == [owner[surface] for surface in layers["surface"][met].tolist()]


# ---- against the oracle ----


@cache
def by_oracle(name):
    """(distances, normals, surfaces) of the rays through the middles of pixels."""
    scene = oracle_scene(scene_of(name), *SIZE)
    depth = np.full((SIZE[1], SIZE[0]), np.inf)
    normal, surface = np.zeros((SIZE[1], SIZE[0], 3)), np.full((SIZE[1], SIZE[0]), -1)
    for j, i in itertools.product(range(SIZE[1]), range(SIZE[0])):
        origin, direction = scene.camera.ray(i, j)
        d = direction / np.linalg.norm(direction)
        t, number = oracle.first_hit(scene, origin, d)
        if number >= 0:
            depth[j, i], surface[j, i] = t, number
            hit = tuple((origin + t * d).tolist())
            normal[j, i] = kernels.shading_normal(scene.surfaces, number, hit, tuple(d.tolist()))
    return depth, normal, surface


@pytest.mark.parametrize("name", CASES)
def test_layers_are_those_of_the_oracle(name):
    depth, normal, surface = by_oracle(name)
    layers = reference(name).layers
    assert np.array_equal(layers["surface"], surface)
    met = surface >= 0
    box = scene_of(name).surfaces.bounds()
    off = np.abs(layers["depth"][met] - depth[met]) / float((box[1] - box[0]).max())
    assert off.max() < FARTHEST_OFF
    assert np.median(off) < USUALLY_OFF
    assert np.abs(layers["normal"] - normal).max() < NORMAL_OFF
    np.testing.assert_allclose(np.linalg.norm(layers["normal"][met].astype(np.float64), axis=1), 1.0, atol=3e-7)


# ---- the same on all arrays ----


@pytest.mark.parametrize("name", CASES)
def test_the_same_bits_on_all_arrays(name):
    expected = reference(name)
    for shape, split in zip(SHAPES, itertools.cycle(["uniform", "balanced"])):
        array = array_of(shape, batch=7 if shape == (4, 3, 1) else 4096)
        assert same_layers(traced(array, make_job(scene_of(name), shape, settings_of(split=split))), expected), shape


def test_on_processes_and_by_name():
    with raygrid.launch("2x2x2") as array:
        picture = array.render(SCENES / "kinds.nff", size=SIZE, samples=1, layers=LAYERS)
        assert same_layers(picture, reference("kinds.nff"))
        some = array.render(SCENES / "kinds.nff", size=SIZE, samples=1, layers=["material", "depth"])
        assert list(some.layers) == ["depth", "material"]
        assert np.array_equal(some.layers["material"], picture.layers["material"])
        assert array.render(SCENES / "kinds.nff", size=SIZE, layers="normal").layers.keys() == {"normal"}
        assert array.render(SCENES / "kinds.nff", size=SIZE).layers == {}
        with pytest.raises(
            SceneError, match=r"^a layer came as 'dept', wanted some of: depth normal surface material$"
        ):
            array.render(SCENES / "kinds.nff", layers=["depth", "dept"])


# ---- what they leave as it is ----


def machine_facts(picture):
    """What statistics say but for times, and memory as the process has it."""
    stats = {key: value for key, value in picture.stats.items() if key not in ("wall_seconds", "balance", "layers")}
    return stats | {"nodes": [{key: node[key] for key in node if key not in OF_PROCESS} for node in stats["nodes"]]}


def test_picture_and_statistics_are_those_without_layers():
    shape = (2, 2, 2)
    plain = traced(array_of(shape), make_job(scene_of("kinds.nff"), shape, settings_of(())))
    picture = traced(array_of(shape), make_job(scene_of("kinds.nff"), shape, settings_of()))
    assert np.array_equal(picture.sums, plain.sums)
    assert machine_facts(picture) == machine_facts(plain)
    assert "layers" not in plain.stats
    assert set(picture.stats["wall_seconds"]) == set(plain.stats["wall_seconds"]) | {"layers"}


def machine_prices():
    cost = load_cost_model("8086")
    return prices_order(cost.prices("middle", "list"), cost.tests("middle"))


def test_ticks_are_those_without_layers_and_layers_those_without_ticks():
    shape, prices = (2, 1, 1), machine_prices()
    plain = traced(array_of(shape, timed=True), make_job(scene_of("tiny.nff"), shape, settings_of(())), prices)
    picture = traced(array_of(shape, timed=True), make_job(scene_of("tiny.nff"), shape, settings_of()), prices)
    assert picture.stats["ticks"] == plain.stats["ticks"] > 0
    assert same_layers(picture, reference("tiny.nff"))


def test_samples_and_depth_do_not_matter():
    assert same_layers(reference("tiny.nff", samples=4, depth=1), reference("tiny.nff"))


def test_nothing_is_loaded_for_layers():
    array, loads = array_of((2, 1, 1)), []
    job = replace(make_job(scene_of("tiny.nff"), (2, 1, 1), settings_of()), load_key="held")
    array.driver.load = replaced(array.driver.load, loads)
    traced(array, job)
    traced(array, job)
    assert len(loads) == 1


def replaced(function, calls):
    def called(*arguments):
        calls.append(arguments)
        return function(*arguments)

    return called


# ---- what moves, and what a program brings ----


def test_layers_of_a_frame_are_those_of_surfaces_that_stand_there():
    array, scene = array_of((2, 1, 1)), scene_of("mobile.toml")
    for job in jobs_of(scene, (2, 1, 1), settings_of(), [3, 20]):
        picture = traced(array, job)
        assert same_layers(picture, traced(array_of((1, 1, 1)), still_job(scene, (1, 1, 1), settings_of(), job.number)))
        groups = {run["group"] for run in picture.stats["layers"]["surfaces"]}
        assert groups - {None}
        assert groups <= {None, *scene.shot.names}


def test_surfaces_and_background_of_a_program(tmp_path):
    sky = tmp_path / "sky.py"
    sky.write_text(
        (SCENES / "programs" / "torus.py").read_text() + "\n\ndef background(direction):\n    return 9.0, 9.0, 9.0\n"
    )
    settings = settings_of(program=read_program(sky))
    pictures = [
        traced(array_of(shape, programs=True), make_job(scene_of("rings.toml"), shape, settings))
        for shape in [(1, 1, 1), (2, 2, 1)]
    ]
    assert same_layers(*pictures)
    assert pictures[0].sums.max() > 8 << 24
    layers = pictures[0].layers
    assert "programmed" in {run["kind"] for run in pictures[0].stats["layers"]["surfaces"]}
    assert np.isinf(layers["depth"][layers["surface"] < 0]).all()
    assert (layers["surface"] < 0).any()
