"""One frame of a shot in what knows of no motions: simulate, trace, jam, law and export take the picture of that frame."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from support.cli import here, one_line, warm_kernels
from support.render import EIGHT, SCENES

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.export.povray import pov_lines
from raygrid.host.machine_time.cost_models import load_cost_model
from raygrid.host.machine_time.simulate import simulate_job
from raygrid.host.render.animation_jobs import jobs_of, still_job
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.scene.animation.motions import moved_point
from raygrid.host.scene.animation.scene_frames import still
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import SceneError

pytestmark = pytest.mark.usefixtures("warm_kernels", "quick_records")
assert warm_kernels
MOBILE = str(SCENES / "mobile.toml")
SETTINGS = Settings(size=(24, 18), samples=1)
FRAME = 12


@cache
def rendered(frame: int) -> np.ndarray:
    """The sums of a frame as the array renders it, by its motions."""
    array = MemoryArray(EIGHT)
    array.driver.ready()
    (job,) = jobs_of(load_scene(MOBILE), EIGHT, SETTINGS, [frame])
    return render_job(array.driver, job).sums


@pytest.mark.parametrize("frame", [None, 1, FRAME])
@pytest.mark.parametrize("search", ["list", "tree"])
def test_a_simulated_frame_is_the_picture_that_the_array_renders(frame, search):
    job = still_job(load_scene(MOBILE), EIGHT, SETTINGS, frame)
    done = simulate_job(job, load_cost_model("unit"), search, band=False, around=False)
    assert job.number == (frame or 1)
    assert np.array_equal(done.sums, rendered(frame or 1))
    assert not np.array_equal(rendered(1), rendered(FRAME))


def test_a_traced_pixel_of_a_frame_is_that_of_its_picture():
    pixels = [(x, y) for x in range(3, 24, 6) for y in range(3, 18, 5)]
    differ = [at for at in pixels if (rendered(1)[at[1], at[0]] != rendered(FRAME)[at[1], at[0]]).any()]
    x, y = differ[0]
    for frame in (1, FRAME):
        arguments = ("--pixel", f"{x},{y}", "--size", "24x18", "--samples", "1", "--json", "--frame", str(frame))
        told = json.loads(here("trace", MOBILE, *arguments).out)
        assert (told["frame"], told["frames"]) == (frame, 48)
        assert told["sum"] == rendered(frame)[y, x].tolist()


def test_a_still_scene_of_a_frame_is_where_the_motions_take_it():
    scene = load_scene(MOBILE)
    there, pose = still(scene, FRAME), scene.shot.at(FRAME)
    assert there.shot is None
    assert there.camera == pose.camera
    assert np.array_equal(there.lights, pose.lights)
    moved = 0
    for before, after in zip(scene.surfaces, there.surfaces, strict=True):
        for k, group in enumerate(scene.shot.groups.of(before.ids).tolist()):
            first = slice(before.starts[k], before.starts[k] + 1) if before.kind.name == "POLYGON" else slice(k, k + 1)
            point = before.data[first][0, :3]
            expected = point if group < 0 else moved_point(pose.motions[group], point)
            assert after.data[first][0, :3] == pytest.approx(expected, abs=1e-6)
            moved += group >= 0
    assert moved > 3


def test_an_export_names_its_frame_and_has_its_surfaces():
    one, other = ("\n".join(pov_lines(load_scene(MOBILE), frame=frame)) for frame in (None, FRAME))
    assert one.startswith("// mobile.toml, frame 1 of 48, exported")
    assert other.startswith("// mobile.toml, frame 12 of 48, exported")
    assert one.splitlines()[1:] != other.splitlines()[1:]
    assert "\n".join(pov_lines(still(load_scene(MOBILE), FRAME))).split("\n")[1:] == other.split("\n")[1:]


@pytest.mark.parametrize(
    ("command", "more"), [("simulate", ["--no-band", "--cost", "unit", "--size", "8x6"]), ("export", ["-o", "m.pov"])]
)
def test_the_commands_say_which_frame_they_take(command, more, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, chosen = here(command, MOBILE, *more), here(command, MOBILE, *more, "--frame", "12")
    assert "note: mobile.toml: frame 1 of 48, as --frame names no other\n" in first.err
    assert "note: mobile.toml: frame 12 of 48\n" in chosen.err
    assert (first.code, chosen.code) == (0, 0)


@pytest.mark.parametrize("command", ["simulate", "trace", "jam", "export"])
def test_a_frame_that_is_none(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pixel = ["--pixel", "1,1"] if command == "trace" else []
    one_line(
        here(command, MOBILE, *pixel, "--frame", "49"), 1, r"raygrid: mobile.toml: frame 49 came, wanted frames 1 to 48"
    )
    tiny = str(SCENES / "tiny.nff")
    pattern = r"raygrid: tiny.nff: frame 2 came for a scene that does not change, wanted 1"
    one_line(here(command, tiny, *pixel, "--frame", "2"), 1, pattern)
    with pytest.raises(SceneError, match="wanted 1"):
        still_job(load_scene(tiny), EIGHT, SETTINGS, 2)
    assert np.array_equal(
        still_job(load_scene(tiny), EIGHT, SETTINGS).frame.camera,
        make_job(load_scene(tiny), EIGHT, SETTINGS).frame.camera,
    )


def test_trace_names_spot_lights():
    told = here("trace", str(SCENES / "lights.toml"), "--pixel", "60,60", "--size", "120x100", "--samples", "1")
    assert " (spot), weight" in told.out
