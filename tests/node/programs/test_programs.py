"""Programs: their form, their digest, the same bits on every array, and the old one stays when one is refused."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from support.cli import here, misused, warm_kernels
from support.processes import no_leftovers
from support.render import SCENES

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.host.render.animation_jobs import jobs_of
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.render.program_file import read_program
from raygrid.host.render.session import RenderSession
from raygrid.host.scene.animation.turntable import turntable
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError, ProtocolError, SceneError
from raygrid.node.geometry.rigid_motion import moved_rows
from raygrid.node.geometry.surfaces import AddedKind, Batch
from raygrid.node.programs.programs import make_program, program_order, try_functions
from raygrid.node.programs.programs import read_program as read_order

__all__ = ["no_leftovers", "warm_kernels"]
# Compiling takes long. These tests begin first (`support_order`), so the other kernels are compiled here, too, all at once.
pytestmark = [pytest.mark.timeout(900), pytest.mark.usefixtures("warm_kernels", "quick_records")]

TORUS, MARBLE = (SCENES / "programs" / name for name in ("torus.py", "marble.py"))
TINT = "def tint(point, normal, numbers):\n    return 1.0, 0.5, 0.0\n"
SKY = "def background(direction):\n    return 0.5 + 0.5 * direction[1], 0.25, abs(direction[0])\n"
SIZE = (40, 30)


def in_memory(shape=(1, 1, 1), programs=True):
    array = MemoryArray(shape, programs=programs)
    array.driver.patience = 600.0
    array.driver.ready()
    return array


def job_of(name, shape, program, **settings):
    settings = Settings(
        size=SIZE, samples=1, split="uniform", program=read_program(program) if program else None, **settings
    )
    return make_job(load_scene(SCENES / name), shape, settings)


# --- form ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (
            "def tint(point, normal):\n    return 1.0, 1.0, 1.0\n",
            r"line 1: tint\(point, normal\) came, wanted tint\(point, normal, numbers\)",
        ),
        ("def tint(point, normal, numbers=3):\n    pass\n", r"tint\(point, normal, numbers=3\) came"),
        ("@print\ndef background(direction):\n    pass\n", "without decorators"),
        ("def shade(point):\n    pass\n", "has none of the functions surface_hits, surface_normal, tint, background"),
        ("def surface_hits(origin, direction, numbers):\n    pass\n", "and surface_hits together with surface_normal"),
        ("import os\n" + TINT, "line 1: it imports os, wanted math or numpy"),
        ("from .step import step\n" + TINT, "it imports step"),
        ("def tint(:\n", "cannot be read: invalid syntax"),
        ("x" * (1 << 20) + TINT, "more than 1048576 bytes"),
        ("\0", "cannot be read"),
    ],
)
def test_programs_of_the_wrong_form(source, said):
    with pytest.raises(ProtocolError, match=f"the program x.*{said}"):
        make_program("x", source)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (
            "def tint(point, normal, numbers):\n    return 1.0, 1.0\n",
            r"tint gives \(1.0, 1.0\), wanted 3 numbers in a tuple",
        ),
        ("def tint(point, normal, numbers):\n    return 'red', 1.0, 1.0\n", "wanted 3 numbers"),
        ("def tint(point, normal, numbers):\n    return None\n", "tint gives None"),
        ("def tint(point, normal, numbers):\n    raise ValueError('no')\n", "raises in tint: ValueError: no"),
        ("x = 1 / nothing\n" + TINT, "raises in its text: NameError"),
    ],
)
def test_programs_that_do_the_wrong_thing(source, said):
    with pytest.raises(ProtocolError, match=said):
        try_functions(make_program("x", source))


def test_an_order_is_the_program_or_refused():
    program = make_program("x", TINT)
    order = program_order(program)
    assert read_order(order) == program
    assert read_order(program_order(None)) is None
    for wrong, said in (
        ({"digest": "0" * 64}, "came with the digest 0000000000000000, its text has"),
        ({"source": TINT + "\n"}, "came with the digest"),
        ({"source": 7}, "without a name, a text or a digest"),
        ({"digest": None}, "without a name, a text or a digest"),
        ({"name": "x" * 300}, "without a name"),
    ):
        with pytest.raises(ProtocolError, match=said):
            read_order(order | wrong)


def test_files_that_are_no_programs(tmp_path):
    (tmp_path / "a.py").write_bytes(b"\xff\xfe")
    for name, said in (("a.py", "no text"), ("b.py", "no such file"), ("c.txt", "suffix '.txt'")):
        with pytest.raises(SceneError, match=said):
            read_program(tmp_path / name)


# --- the torus, by itself -------------------------------------------------------------------------


def test_the_hits_of_the_torus_lie_on_it_and_none_is_missed():
    space: dict = {}
    exec(TORUS.read_text(), space)
    rng = np.random.default_rng(1)
    numbers, counts = (0.7, 0.25, 0, 0, 0, 0, 0, 0), []
    for _ in range(200):
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        o = rng.uniform(-0.6, 0.6, 3)
        o -= (o @ d) * d
        hits = np.array([t for t in space["surface_hits"](tuple(o), tuple(d), numbers) if np.isfinite(t)])
        points = o + hits[:, None] * d
        away = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.7, points[:, 2]) - 0.25
        assert np.abs(away).max(initial=0.0) < 1e-9
        along = np.linspace(-1.5, 1.5, 20001)
        p = o + along[:, None] * d
        inside = np.hypot(np.hypot(p[:, 0], p[:, 1]) - 0.7, p[:, 2]) < 0.25
        changes = np.count_nonzero(np.diff(inside))
        assert len(hits) == changes or changes - len(hits) == 2  # a ray that only grazes the tube
        counts.append(len(hits))
        for point in points:
            normal = np.array(space["surface_normal"](tuple(point), numbers))
            ring = 0.7 * np.array([point[0], point[1], 0.0]) / np.hypot(point[0], point[1])
            assert np.allclose(normal, point - ring)
    assert {0, 2, 4} <= set(counts)


def test_the_box_of_a_turned_surface_holds_its_corners():
    rng = np.random.default_rng(2)
    turn = rng.normal(size=(6, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    rows = np.concatenate(
        (turn, rng.uniform(0.1, 2, (6, 1)), rng.normal(size=(6, 3)), rng.uniform(0.1, 1, (6, 3)), np.zeros((6, 8))), 1
    )
    kind = AddedKind.PROGRAMMED
    boxes = Batch(kind, np.arange(6, dtype=np.uint32), np.zeros(6, np.uint16), rows).bounds()
    for row, box in zip(rows, boxes, strict=True):
        corners = np.array([[x, y, z, 0.0] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [*row[8:11], 1.0]
        points = moved_rows(3, corners, np.tile(row[:8], (8, 1)))[:, :3]
        assert np.allclose([points.min(0), points.max(0)], box)


# --- in arrays ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scene", "program"), [("rings.toml", TORUS), ("marble.toml", MARBLE)])
def test_every_array_gives_the_same_bits_and_the_program_shows(scene, program):
    sums = []
    for shape in ((1, 1, 1), (2, 2, 2), (3, 2, 1)):
        array = in_memory(shape)
        picture = render_job(array.driver, job_of(scene, shape, program))
        assert picture.stats["program"] == program.stem
        assert {node["program"] for node in array.driver.report()} == {read_program(program).digest}
        sums.append(picture.sums)
    assert all(np.array_equal(one, sums[0]) for one in sums)
    if scene == "rings.toml":
        assert array.processors[0].node_state.surfaces.programmed.shape[1] == 24
        assert sum(node["tests"]["programmed"] for node in array.driver.report()) > 100
    else:  # the same scene with a step that knows of no rules
        plain = render_job(array.driver, job_of(scene, (3, 2, 1), None))
        assert (plain.sums != sums[0]).any(axis=2).mean() > 0.2
        assert (plain.sums >= sums[0]).all()  # veins only darken


def test_a_program_s_surface_in_a_shot_moves_by_increments():
    scene = turntable(load_scene(SCENES / "rings.toml"), 3, True)
    settings = Settings(size=SIZE, samples=1, split="uniform", program=read_program(TORUS))
    array, alone = in_memory((2, 1, 2)), in_memory((1, 1, 1))
    jobs = zip(jobs_of(scene, (2, 1, 2), settings), jobs_of(scene, (1, 1, 1), settings), strict=True)
    for job, other in jobs:
        alone.driver.held = None
        assert np.array_equal(render_job(array.driver, job).sums, render_job(alone.driver, other).sums)


@pytest.mark.slow  # compiles one more program
def test_a_background_is_seen_by_rays_that_miss_the_world_too(tmp_path):
    (tmp_path / "sky.py").write_text(SKY)
    array = in_memory((2, 1, 1))
    job = job_of("tiny.nff", (2, 1, 1), tmp_path / "sky.py")
    camera = replace(job.scene.camera, half=4.0)  # so wide that most rays pass the world by
    job = make_job(replace(job.scene, camera=camera), (2, 1, 1), job.settings)
    picture = render_job(array.driver, job)
    i, j = 1, 1  # in a corner
    d = job.frame.camera[3] + i * job.frame.camera[4] + j * job.frame.camera[5]
    d /= np.linalg.norm(d)
    # the camera's sample lies in the middle of the pixel
    assert np.allclose(picture.linear()[j, i], [0.5 + 0.5 * d[1], 0.25, abs(d[0])], atol=1e-6)


def test_a_refused_program_leaves_the_old_one_and_the_array_serves(tmp_path):
    array = in_memory((2, 1, 1))
    job = job_of("marble.toml", (2, 1, 1), MARBLE)
    before = render_job(array.driver, job).sums
    bad = make_program(
        "bad",
        "def tint(point, normal, numbers):\n    some = [1.0, 2.0]\n    some.append(3.0)\n    return some[0], some[1], some[2]\n",
    )
    with pytest.raises(
        ArrayError, match=r"a program was refused: 2 times .* node \(0, 0, 0\): the program bad fails: .*"
    ):
        array.driver.load_program(bad)
    wrong = make_program("bad", TINT)._replace(digest="0" * 64)
    with pytest.raises(ArrayError, match=r"node \(0, 0, 0\): the program bad came with the digest 0000000000000000"):
        array.driver.load_program(wrong)
    assert {node["program"] for node in array.driver.report()} == {read_program(MARBLE).digest}
    assert np.array_equal(render_job(array.driver, job).sums, before)


def test_programs_must_be_allowed():
    array = in_memory((2, 1, 1), programs=False)
    with pytest.raises(ArrayError, match="the program x came, and this array was launched without --allow-programs"):
        array.driver.load_program(make_program("x", TINT))
    assert {node["program"] for node in array.driver.report()} == {None}
    picture = render_job(array.driver, job_of("tiny.nff", (2, 1, 1), None))
    assert picture.stats["program"] is None


def test_programmed_surfaces_without_a_program_are_refused_by_host_and_nodes():
    array = in_memory((2, 1, 1))
    with pytest.raises(SceneError, match="4 surfaces of a program came, wanted a program with surface_hits"):
        job_of("rings.toml", (2, 1, 1), None)
    job = job_of("rings.toml", (2, 1, 1), TORUS)
    with pytest.raises(ArrayError, match="programmed surfaces came, wanted a program with surface_hits before them"):
        array.driver.load(job.space, job.surfaces)
    render_job(array.driver, job_of("tiny.nff", (2, 1, 1), None))


def test_a_program_that_raises_while_it_runs_is_told_and_the_next_frame_is_served(tmp_path):
    (tmp_path / "later.py").write_text(
        "def tint(point, normal, numbers):\n    if numbers[0] > 5.0:\n        raise ValueError('too many veins')\n    return 1.0, 1.0, 1.0\n"
    )
    array = in_memory((2, 1, 1))
    with pytest.raises(ArrayError, match="the program later raises: ValueError: too many veins"):
        render_job(array.driver, job_of("marble.toml", (2, 1, 1), tmp_path / "later.py"))
    picture = render_job(array.driver, job_of("tiny.nff", (2, 1, 1), None))
    assert picture.stats["total"]["hits"] > 0


@pytest.mark.usefixtures("no_leftovers")
def test_processes_and_a_node_that_is_lost():
    """The new node gets the program before its surfaces."""
    job = job_of("marble.toml", (2, 1, 1), MARBLE)
    expected = render_job(in_memory().driver, job_of("marble.toml", (1, 1, 1), MARBLE)).sums
    with Array.launch((2, 1, 1), programs=True, patience=120.0) as array:
        assert np.array_equal(RenderSession(array).render(job).sums, expected)
        os.kill(array.pids[1], signal.SIGKILL)
        picture = RenderSession(array).render(job)
        assert np.array_equal(picture.sums, expected)
        assert len(picture.stats["faults"]) == 1


@pytest.mark.usefixtures("no_leftovers")
def test_the_command_loads_a_program():
    outcome = here("load", str(MARBLE), "--array", "2x1x1", "--allow-programs", "-q")
    assert outcome.code == 0
    assert outcome.out.startswith("2 nodes run marble (tint), digest ")


def test_without_leave_the_command_line_takes_no_program(tmp_path):
    said = r".*marble.py: a program is code that runs with your rights, wanted --allow-programs.*"
    misused(here("load", str(MARBLE)), "load", said)
    misused(here("render", str(SCENES / "marble.toml"), "--program", str(MARBLE), "-q"), "render", said)
