"""Law 4: the same picture, bit for bit, for every array shape, split, batch size, transport and number of runs."""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support import paths
from support.render import shared

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.host.image.picture import Picture
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.scene.load import load_scene

SCENES = paths.SCENES
SHAPES = [(1, 1, 1), (2, 1, 1), (4, 3, 1), (2, 2, 2), (3, 3, 3), (5, 4, 2)]
SPLITS = ["balanced", "uniform"]
# every NFF primitive; a mesh; refraction; many lights; faces that lie on planes between cells; 4 samples a pixel
CASES = {
    "kinds.nff": Settings(size=(56, 40)),
    "room.glb": Settings(size=(48, 36)),
    "glass.toml": Settings(size=(40, 30), samples=1),
    "lights.toml": Settings(size=(40, 30), samples=1),
    "faces.nff": Settings(size=(48, 48)),
    "tiny.nff": Settings(size=(40, 40), samples=4),
    "balls_2.nff": Settings(size=(32, 32)),
    "gears_1.nff": Settings(size=(32, 32)),
}
SHARED = ("balls_2.nff", "gears_1.nff")
BUNDLED = [name for name in CASES if name not in SHARED]


pytestmark = pytest.mark.usefixtures("quick_records")


@cache
def scene_of(name):
    return load_scene(shared("spd", name) if name in SHARED else SCENES / name)


def job_of(name, shape, split, settings=None):
    settings = settings or CASES[name]
    settings = Settings(size=settings.size, samples=settings.samples, split=split)
    return make_job(scene_of(name), shape, settings)


def in_memory(name, shape, split, batch=4096) -> Picture:
    array = MemoryArray(shape, batch)
    array.driver.ready()
    picture = render_job(array.driver, job_of(name, shape, split))
    array.driver.end()
    return picture


@cache
def reference(name) -> Picture:
    return in_memory(name, (1, 1, 1), "uniform")


def files_of(picture: Picture, directory: Path) -> tuple[bytes, bytes]:
    """The bytes of the .npy and the .png of a picture."""
    picture.save(directory / "p.npy")
    picture.save(directory / "p.png")
    return (directory / "p.npy").read_bytes(), (directory / "p.png").read_bytes()


@pytest.mark.parametrize("name", CASES)
def test_shapes_and_splits_in_memory(name, tmp_path):
    expected = files_of(reference(name), tmp_path)
    for shape, split in itertools.product(SHAPES, SPLITS):
        assert files_of(in_memory(name, shape, split), tmp_path) == expected, (shape, split)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("batch", [1, 7])
def test_small_batches_in_memory(name, batch, tmp_path):
    for shape, split in (((2, 1, 1), "uniform"), ((2, 2, 2), "balanced")):
        picture = in_memory(name, shape, split, batch)
        assert files_of(picture, tmp_path) == files_of(reference(name), tmp_path), (shape, split)


@pytest.mark.parametrize("name", CASES)
def test_the_pictures_are_not_empty(name):
    picture = reference(name)
    assert len(np.unique(picture.sums.reshape(-1, 3), axis=0)) > 50
    assert len(np.unique(picture.bytes())) > 30


@pytest.mark.usefixtures("no_leftovers")
@pytest.mark.parametrize(
    ("shape", "batch", "names", "splits", "runs"),
    [
        ((2, 2, 2), 4096, BUNDLED, SPLITS, 2),  # run again: another schedule, the same bits
        ((2, 2, 2), 1, ["kinds.nff", "tiny.nff"], ["balanced"], 1),
        ((4, 3, 1), 256, ["glass.toml", "room.glb"], SPLITS, 1),
        ((3, 3, 3), 4096, ["lights.toml", "faces.nff"], SPLITS, 1),
        ((2, 1, 1), 7, ["kinds.nff", "glass.toml"], ["uniform"], 1),
        ((5, 4, 2), 4096, ["kinds.nff", "room.glb"], ["balanced"], 1),  # the size that the paper planned to build
    ],
    ids=lambda value: "x".join(map(str, value)) if isinstance(value, tuple) else None,
)
def test_processes(shape, batch, names, splits, runs, tmp_path):
    with Array.launch(shape, batch=batch) as array:
        for name, split, _ in itertools.product(names, splits, range(runs)):
            picture = render_job(array.driver, job_of(name, shape, split))
            assert files_of(picture, tmp_path) == files_of(reference(name), tmp_path), (name, split)


@pytest.mark.slow
@pytest.mark.usefixtures("no_leftovers")
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("batch", [1, 4096])
def test_all_shapes_as_processes(shape, batch, tmp_path):
    with Array.launch(shape, batch=batch) as array:
        for name, split in itertools.product(BUNDLED, SPLITS):
            picture = render_job(array.driver, job_of(name, shape, split))
            assert files_of(picture, tmp_path) == files_of(reference(name), tmp_path), (name, split)


@pytest.mark.slow
@pytest.mark.usefixtures("no_leftovers")
@pytest.mark.parametrize("name", ["balls_3", "gears_2", "mount_5", "rings_3", "teapot_6", "tetra_6"])
def test_standard_scenes(name):
    scene, pictures = load_scene(shared("spd", f"{name}.nff")), []
    for shape in [(1, 1, 1), (2, 2, 2), (5, 4, 2)]:
        with Array.launch(shape) as array:
            pictures.append(render_job(array.driver, make_job(scene, shape, Settings(size=(256, 256)))).sums.tobytes())
    assert len(set(pictures)) == 1
