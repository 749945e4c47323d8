"""The ray tree of a pixel: it adds up to the picture, it is the oracle's tree, and its cells are a way."""

from __future__ import annotations

import json

import numpy as np
import pytest
from oracle import read_nff
from support.cli import RAYGRID, TINY, here, misused, one_line, warm_kernels
from support.oracle import oracle_scene, sample_offsets
from support.render import EIGHT, ONE, SCENES, rendered, shared
from support.terminal import Terminal
from support.tree import Branch, oracle_tree

from raygrid.emulator.analysis.provenance import Provenance, Ray
from raygrid.emulator.analysis.single_step import SingleStep
from raygrid.host.cli.trace import trace_pixel
from raygrid.host.render.job import Settings, make_job
from raygrid.host.scene.lights import NO_DISC
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError, SceneError
from raygrid.node.tracing.framebuffer import UNIT

pytestmark = pytest.mark.usefixtures("warm_kernels")
assert warm_kernels


def all_rays(root: Ray) -> list[Ray]:
    """Every ray of a tree, parents before their children."""
    found, waiting = [], [root]
    while waiting:
        ray = waiting.pop()
        found.append(ray)
        waiting += reversed(ray.children)
    return found


def job_of(path, shape=EIGHT, **settings):
    return make_job(load_scene(path), shape, Settings(**settings))


def tracing(job):
    return Provenance(job.space, job.surfaces, job.frame)


def flat(tree):
    """The maps of all rays of a sample's tree."""
    waiting, found = [tree["ray"]] if tree["ray"] else [], []
    while waiting:
        ray = waiting.pop()
        found.append(ray)
        waiting += ray["children"]
    return found


# --- it adds up ----------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [ONE, EIGHT, (4, 3, 1)], ids=str)
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("tiny.nff", {"size": (13, 11)}),
        ("glass.toml", {"size": (12, 7), "samples": 3}),
        ("lights.toml", {"size": (12, 9), "samples": 2}),  # with lights that are seen, and rays beside the world box
        ("kinds.nff", {"size": (12, 9), "highlights": True, "min_weight": 0.01, "split": "uniform"}),
    ],
)
def test_every_pixel_adds_up_to_the_picture(name, settings, shape):
    scene = load_scene(SCENES / name)
    picture = rendered(scene, shape, **settings)
    found = tracing(make_job(scene, shape, Settings(**settings)))
    born = dict.fromkeys(("primary", "reflected", "refracted", "shadow", "return"), 0)
    for y, x in np.ndindex(picture.sums.shape[:2]):
        samples = found.pixel(x, y)
        assert np.sum([sample.units for sample in samples], axis=0).tolist() == picture.sums[y, x].tolist()
        for sample in samples:
            rays = all_rays(sample.ray) if sample.ray else []
            back = [ray.came_back for ray in rays if ray.came_back]
            if rays:
                assert tuple(np.sum([[0, 0, 0]] + [b.units for b in back], axis=0)) == sample.units
            born["return"] += len(back)
            for ray in rays:
                born[ray.kind.name.lower()] += 1
    total = picture.stats["total"]["born"]
    assert born == {kind: total[kind] for kind in born}


def test_a_sample_beside_the_world_box_sees_what_is_behind_it():
    wide = load_scene(SCENES / "tiny.nff")
    job = make_job(wide, EIGHT, Settings(size=(300, 9)))
    told = trace_pixel(job, 0, 4)
    assert told["trees"][0]["ray"] is None
    assert told["sum"] == [round(value * UNIT) for value in np.float32([0.35, 0.5, 0.75])]
    assert told["sum"] == rendered(wide, EIGHT, size=(300, 9)).sums[4, 0].tolist()


# --- it is the oracle's tree -----------------------------------------------------------------------


def compare(ray, branch: Branch, scale: float, where: str):
    """A ray of the machine against one of the oracle. Weights are rounded once a generation, to 11 bits of the largest."""
    assert ray["kind"] == branch.kind, where
    assert ray.get("light") == branch.light, where
    assert ray.get("total_internal_reflection", False) == branch.inside, where
    rounding = max(branch.weight) * ray["depth"] / 2000
    np.testing.assert_allclose(ray["weight"], branch.weight, rtol=0.002, atol=rounding + 1e-6, err_msg=where)
    hit = ray["hit"]
    assert (-1 if hit is None else hit["surface"]) == branch.surface, where
    if hit is not None and ray["kind"] != "primary":
        assert hit["distance"] == pytest.approx(branch.distance, rel=1e-3, abs=1e-4 * scale), where
    children = {(child.kind, child.light, child.inside): child for child in branch.children}
    assert [(c["kind"], c.get("light"), c.get("total_internal_reflection", False)) for c in ray["children"]] == sorted(
        children, key=lambda key: (key[0] != "shadow", key[1] or 0, key[0], key[2])
    ), where
    for child in ray["children"]:
        key = (child["kind"], child.get("light"), child.get("total_internal_reflection", False))
        compare(child, children[key], scale, f"{where} > {key[0]} {child['depth']}")


def compare_pixels(job, truth, pixels, offsets):
    scale = 1.0 / job.world.scale
    met = 0
    for x, y in pixels:
        told = trace_pixel(job, x, y)
        for tree in told["trees"]:
            at = offsets[y, x, tree["sample"]]
            branch = oracle_tree(truth, x + at[0], y + at[1])
            where = f"pixel {x},{y} sample {tree['sample']}"
            if tree["ray"] is None:
                assert branch.surface == -1, where
            else:
                compare(tree["ray"], branch, scale, where)
                met += len(flat(tree))
    return met


@pytest.mark.parametrize("name", ["balls_2", "gears_1", "mount_4", "rings_2", "teapot_3", "tetra_4"])
def test_the_tree_is_the_oracles_in_standard_scenes(name):
    path = shared("spd", f"{name}.nff")
    pixels = [(x, y) for x in range(7, 64, 12) for y in range(5, 64, 12)]
    job = job_of(path, (3, 2, 2), size=(64, 64))
    truth = read_nff(path, 64, 64)
    assert compare_pixels(job, truth, pixels, np.zeros((64, 64, 1, 2))) > 20


@pytest.mark.parametrize("name", ["kinds.nff", "glass.toml", "room.glb"])
def test_the_tree_is_the_oracles_in_scenes_of_ours(name):
    scene = load_scene(SCENES / name)
    size, samples = (48, 36), 2
    job = make_job(scene, EIGHT, Settings(size=size, samples=samples, highlights=True))
    if len(scene.lights):
        scene.lights["cos_disc"] = NO_DISC
    truth = oracle_scene(scene, *size, highlights=True, depth=scene.depth or 5)
    pixels = [(x, y) for x in range(3, 48, 11) for y in range(2, 36, 9)]
    assert compare_pixels(job, truth, pixels, sample_offsets(*size, samples)) > 50


# --- its cells are a way ---------------------------------------------------------------------------


def test_cells_are_a_way_from_birth_to_hit_and_home():
    job = job_of(SCENES / "kinds.nff", (4, 3, 2), size=(40, 30))
    crossed = 0
    for x, y in [(x, y) for x in range(1, 40, 6) for y in range(1, 30, 6)]:
        for sample in tracing_of(job).pixel(x, y):
            rays = all_rays(sample.ray) if sample.ray else []
            for ray in rays:
                check_way(ray.cells)
                crossed += len(ray.cells)
                if ray.met is not None:
                    assert ray.met.cell == ray.cells[-1]
                    check_inside(job, ray.met.cell, ray.met.point)
                check_inside(job, ray.cells[ray.start], ray.origin)
                if ray.came_back is not None:
                    check_way(ray.came_back.cells)
                    assert ray.came_back.cells[0] == ray.cells[-1]
                    assert ray.came_back.cells[-1] == rays[0].cells[0]
                for child in ray.children:
                    assert child.cells[0] == ray.cells[-1]
    assert crossed > 500


_tracings = {}


def tracing_of(job):
    if id(job) not in _tracings:
        _tracings[id(job)] = tracing(job)
    return _tracings[id(job)]


def check_way(cells):
    steps = np.abs(np.diff(np.array(cells), axis=0)).sum(axis=1)
    assert (steps == 1).all(), cells


def check_inside(job, cell, point):
    planes = (job.space.planes - (1 << 23)) * np.array(job.space.step)[:, None]
    for axis in range(3):
        low, high = planes[axis, cell[axis]], planes[axis, cell[axis] + 1]
        assert low - 1e-6 <= point[axis] <= high + 1e-6


def test_all_arrays_tell_the_same_but_for_cells():
    def bare(told):
        kept = ("kind", "depth", "light", "weight", "origin", "direction")
        return [
            {name: ray.get(name) for name in kept}
            | {"hit": ray["hit"] and {name: ray["hit"][name] for name in ("surface", "material", "point", "distance")}}
            | {"back": ray["returned"] and ray["returned"]["intensity"]}
            for tree in told["trees"]
            for ray in flat(tree)
        ]

    one, other = (job_of(SCENES / "glass.toml", shape, size=(48, 36), samples=2) for shape in (ONE, (3, 3, 3)))
    for x, y in [(12, 20), (24, 18), (30, 30), (40, 10)]:
        assert bare(trace_pixel(one, x, y)) == bare(trace_pixel(other, x, y))


# --- what cannot be --------------------------------------------------------------------------------


@pytest.mark.parametrize(("x", "y"), [(-1, 0), (13, 0), (0, 11), (1 << 40, 0)])
def test_a_pixel_outside_the_picture(x, y):
    with pytest.raises(SceneError, match=f"a pixel came as {x},{y}, wanted 0,0 to 12,10"):
        trace_pixel(job_of(TINY, ONE, size=(13, 11)), x, y)


def test_a_sample_that_is_not():
    with pytest.raises(SceneError, match="a sample came as 3, wanted 0 to 2"):
        trace_pixel(job_of(TINY, ONE, size=(13, 11), samples=3), 0, 0, 3)


def test_a_tree_without_end_is_refused():
    job = job_of(SCENES / "glass.toml", ONE, size=(48, 36))
    found = Provenance(job.space, job.surfaces, job.frame, most_rays=5)
    with pytest.raises(SceneError, match="makes more than 5 rays"):
        for y in range(36):
            found.pixel(24, y)


def test_an_array_too_large_for_memory_is_refused_before_the_work():
    one_line(
        here("trace", TINY, "--pixel", "0,0", "--array", "200x200x200", "--split", "uniform"),
        1,
        r"raygrid: an array of 200x200x200 in one process needs 6400\.0 GB of memory, and .* leaves .* GB",
    )


def test_a_step_that_contradicts_itself_is_an_error(monkeypatch):
    job = job_of(TINY, ONE, size=(13, 11))
    serve = SingleStep.serve

    def blind(steps, *arguments):
        served = serve(steps, *arguments)
        return served._replace(met=served.met._replace(item=-1))

    monkeypatch.setattr(SingleStep, "serve", blind)
    with pytest.raises(ArrayError, match="ended otherwise than its surfaces say"):
        tracing(job).pixel(6, 5)


# --- the command -----------------------------------------------------------------------------------


def test_the_command_prints_a_plain_tree():
    told = here("trace", TINY, "--pixel", "128,128")
    assert told.code == 0
    first, second, third, *rest = told.out.splitlines()
    assert first.startswith("pixel 128,128 of 256x256, 1 sample, array 2x2x2: linear ")
    assert second.startswith("sample 0: ")
    assert third.startswith("  primary ray, depth 1, weight 1 1 1; cells ")
    assert "hit sphere 1 (material 1) at " in third
    assert [line.split(",")[0] for line in rest][:3] == [
        "    shadow ray to light 0 (point)",
        "    shadow ray to light 1 (point)",
        "    reflected ray",
    ]
    assert "\x1b" not in told.out


def test_the_command_speaks_json_and_agrees_with_render(tmp_path):
    sums = tmp_path / "sums.npy"
    options = ("--size", "64x48", "--samples", "3", "--array", "2x1x1")
    assert here("render", str(SCENES / "glass.toml"), *options, "-o", str(sums)).code == 0
    told = json.loads(here("trace", str(SCENES / "glass.toml"), *options, "--pixel", "30,24", "--json").out)
    assert told["sum"] == np.load(sums)[24, 30].tolist()
    only = here("trace", str(SCENES / "glass.toml"), *options, "--pixel", "30,24", "--sample", "1", "--json")
    assert json.loads(only.out)["trees"] == told["trees"][1:2]


def test_the_command_draws_a_tree_on_a_terminal(tmp_path):
    with Terminal([RAYGRID, "trace", TINY, "--pixel", "128,128"], tmp_path) as terminal:
        assert terminal.wait_end() == 0
        assert "└── primary ray" in terminal.screen
        assert "├── shadow ray to light 0" in terminal.screen


@pytest.mark.parametrize("pixel", ["12", "1,2,3", "a,b", "-1,4", "1.5,2", ""])
def test_a_pixel_that_is_none_is_a_usage_error(pixel):
    one_line(here("trace", TINY, f"--pixel={pixel}"), 2, r"raygrid trace: --pixel: .* came, wanted column and row.*")


def test_a_pixel_outside_is_one_line():
    misused(here("trace", TINY, "--pixel", "256,0"), "trace", "a pixel came as 256,0, wanted 0,0 to 255,255")
