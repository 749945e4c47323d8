"""Raygrid's pictures against the oracle's: the same scenes by a renderer that shares no code with the machine.

At least 50 dB PSNR on linear pixels (peak 1), fewer than 0.1 % of the pixels off by more than 2/255. NFF files are read
by the oracle's own reader, other scenes are converted; cameras are worked out anew in both cases.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from oracle import read_nff, render
from support.oracle import oracle_scene, sample_offsets
from support.render import EIGHT, ONE, SCENES, noticeable, psnr, rendered, shared

from raygrid.host.scene.lights import NO_DISC
from raygrid.host.scene.load import load_scene

LEAST_PSNR = 50.0
MOST_NOTICEABLE = 0.001
BORN_ALIKE = 0.01  # rays that only one of the two bears, for hits within rounding of an edge


def check(scene, truth, counts, **settings):
    """Compare the picture of one processor with the oracle's, and that of eight with it bit for bit."""
    picture = rendered(scene, ONE, **settings)
    linear, total = picture.linear(), picture.stats["total"]["born"]
    assert psnr(linear, truth) >= LEAST_PSNR
    assert noticeable(linear, truth) < MOST_NOTICEABLE
    assert total["shadow"] == pytest.approx(counts["shadow"], rel=BORN_ALIKE)
    # The oracle counts what is totally reflected as refracted.
    spawned = total["reflected"] + total["refracted"]
    assert spawned == pytest.approx(counts["reflected"] + counts["refracted"], rel=BORN_ALIKE)
    assert np.array_equal(rendered(scene, EIGHT, **settings).sums, picture.sums)


@pytest.mark.parametrize("highlights", [False, True], ids=["plain", "highlights"])
@pytest.mark.parametrize("name", ["balls_2", "gears_1", "mount_4", "rings_2", "teapot_3", "tetra_4"])
def test_standard_scenes(name, highlights):
    path = shared("spd", f"{name}.nff")
    truth, counts = render(read_nff(path, 128, 128, highlights=highlights), 128, 128)
    check(load_scene(path), truth, counts, size=(128, 128), highlights=highlights)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["balls_3", "gears_2", "mount_6", "rings_4", "teapot_12", "tetra_6"])
def test_large_standard_scenes(name):
    path = shared("spd", f"{name}.nff")
    truth, counts = render(read_nff(path, 128, 128), 128, 128)
    check(load_scene(path), truth, counts, size=(128, 128))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["balls_2", "gears_1", "mount_4", "rings_2", "teapot_3", "tetra_4"])
def test_standard_scenes_at_full_size(name):
    path = shared("spd", f"{name}.nff")
    truth, counts = render(read_nff(path, 512, 512), 512, 512)
    check(load_scene(path), truth, counts, size=(512, 512))


@pytest.mark.parametrize("shown", [None, True], ids=["as the file says", "highlights"])
@pytest.mark.parametrize(
    ("name", "size", "samples"),
    [
        ("kinds.nff", (128, 96), 1),
        ("kinds.nff", (48, 36), 5),
        ("faces.nff", (128, 128), 1),
        ("tiny.nff", (128, 128), 1),
        ("room.glb", (64, 48), 1),
        ("room.glb", (24, 18), 4),
        ("glass.toml", (96, 72), 1),
        ("glass.toml", (48, 36), 4),
        ("lights.toml", (96, 72), 1),
        ("lights.toml", (48, 36), 3),
    ],
)
def test_scenes_of_ours(name, size, samples, shown):
    scene = without_discs(load_scene(SCENES / name))
    depth = scene.depth or 5
    truth, counts = render(
        oracle_scene(scene, *size, highlights=shown, depth=depth), *size, sample_offsets(*size, samples)
    )
    check(scene, truth, counts, size=size, samples=samples, depth=depth, highlights=shown)


@pytest.mark.parametrize(
    "size", [(31, 17), (17, 31), (1, 9), (9, 1), (1, 1)], ids=lambda size: "x".join(map(str, size))
)
@pytest.mark.parametrize("name", ["kinds.nff", "glass.toml", "checker.obj"])
def test_pictures_of_odd_sizes(name, size):
    """Each of these files measures its angle of view in another way. The eye stands a little aside, or the middle of the
    picture would be the very corner of four squares of the checker."""
    scene = without_discs(load_scene(SCENES / name))
    x, y, z = scene.camera.eye
    scene = replace(scene, camera=replace(scene.camera, eye=(x + 0.01, y + 0.02, z)))
    truth, counts = render(oracle_scene(scene, *size), *size)
    check(scene, truth, counts, size=size, samples=1, depth=5)


@pytest.mark.parametrize("crease", [0, 40])
def test_meshes_without_normals_from_another_side(tmp_path, crease):
    """The oracle has the same normals, and the camera that was asked for."""
    ball = trimesh.creation.icosphere(2)
    ball.apply_scale((1.0, 1.3, 0.7))
    (tmp_path / "ball.obj").write_text(ball.export(file_type="obj", include_normals=False))
    scene = load_scene(tmp_path / "ball.obj", crease=crease, eye=(3, 2, -2.5), fov=40, lights=[(4, 5, -3, 1, 0.9, 0.8)])
    truth, counts = render(oracle_scene(scene, 64, 48), 64, 48)
    check(scene, truth, counts, size=(64, 48), samples=1, depth=5)


@pytest.mark.parametrize("depth", [1, 2, 9])
def test_other_depths(depth):
    scene = without_discs(load_scene(SCENES / "glass.toml"))
    truth, counts = render(oracle_scene(scene, 64, 48, depth=depth), 64, 48)
    check(scene, truth, counts, size=(64, 48), samples=1, depth=depth)


@pytest.mark.parametrize("least", [0.0, 0.02, 0.3])
def test_other_least_weights(least):
    scene = replace(without_discs(load_scene(SCENES / "glass.toml")), min_weight=least)
    truth, counts = render(oracle_scene(scene, 64, 48, depth=7), 64, 48)
    check(scene, truth, counts, size=(64, 48), samples=1, depth=7, min_weight=least)


def test_the_comparison_can_fail():
    """A picture of another light is found out."""
    scene = load_scene(SCENES / "kinds.nff")
    truth, counts = render(oracle_scene(scene, 64, 64), 64, 64)
    lights = scene.lights.copy()
    lights["place"][0] += 0.5
    with pytest.raises(AssertionError):
        check(replace(scene, lights=lights), truth, counts, size=(64, 64))


def without_discs(scene):
    """The oracle's lights cannot be seen: those of the machine are looked at in test_known_pictures."""
    lights = scene.lights.copy()
    lights["cos_disc"] = NO_DISC
    return replace(scene, lights=lights)
