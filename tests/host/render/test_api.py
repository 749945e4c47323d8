"""The Python interface: launch an array, render scenes on it, from anywhere a program may want to."""

import importlib.metadata
import itertools
import logging
import math
import os
import re
import subprocess
import sys
import threading
import warnings

import numpy as np
import psutil
import pytest
import trimesh
from support.cli import TINY, here, warm_kernels
from support.render import EIGHT, SCENES, rendered

import raygrid
from raygrid.host.scene.load import load_scene

__all__ = ["warm_kernels"]

pytestmark = pytest.mark.usefixtures("no_leftovers", "warm_kernels")

KINDS = str(SCENES / "kinds.nff")
SIZE = (40, 30)


@pytest.fixture
def machine():
    """Two processors."""
    with raygrid.launch("2x1x1") as array:
        yield array


def alone(path, shape=(2, 1, 1), **settings):
    """The picture of the array inside this process."""
    return rendered(load_scene(path), shape, **settings)


# ---- what it gives ----


def test_names_are_loaded_when_used():
    for name in raygrid.__all__:
        assert getattr(raygrid, name) is not None
    with pytest.raises(AttributeError, match="module 'raygrid' has no attribute 'ray'"):
        raygrid.ray  # noqa: B018
    script = "import sys, raygrid; sys.exit(str({'numpy', 'numba', 'zmq'} & set(sys.modules) or ''))"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=60, text=True).stderr == "\n"


def test_the_package_lists_its_names_and_says_its_version():
    public = [name for name in dir(raygrid) if not name.startswith("_")]
    assert public == sorted(raygrid.__all__)
    assert {"__version__", "__doc__", "__all__"} <= set(dir(raygrid))
    assert raygrid.__version__ == importlib.metadata.version("raygrid")
    look = "import sys, raygrid; dir(raygrid), raygrid.__version__; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, timeout=60)
    assert not {"numpy", "numba", "zmq", "trimesh", "PIL", "raygrid.host"} & set(run.stdout.split())


@pytest.mark.parametrize("shape", ["2x2x2", (2, 2, 2)], ids=["text", "numbers"])
def test_a_picture_is_that_of_the_command_and_nothing_is_left(shape, tmp_path):
    with raygrid.launch(shape) as array:
        assert array.shape == EIGHT
        processes = [psutil.Process(pid) for pid in array.pids]
        assert len(processes) == 8
        picture = array.render(TINY, size=SIZE)
        picture.save(tmp_path / "by_interface.npy")
        picture.save(tmp_path / "by_interface.png")
    assert not any(process.is_running() for process in processes)
    outputs = [word for name in ("npy", "png") for word in ("-o", str(tmp_path / f"by_command.{name}"))]
    assert here("render", TINY, "--size", "40x30", *outputs).code == 0
    for name in ("npy", "png"):
        same = [(tmp_path / f"by_{way}.{name}").read_bytes() for way in ("interface", "command")]
        assert same[0] == same[1], name
    assert np.array_equal(picture.linear(), picture.sums / 2.0**24)


def test_several_scenes_in_turn(machine):
    """Each starts from nothing: another world, other surfaces, other counts."""
    for path in (TINY, KINDS, str(SCENES / "room.glb"), TINY):
        picture = machine.render(path, size=SIZE)
        expected = alone(path, size=SIZE)
        assert np.array_equal(picture.sums, expected.sums)
        for name in ("born", "died", "tests", "walks"):
            assert picture.stats["total"][name] == expected.stats["total"][name], name


def test_a_scene_can_be_loaded_once_and_rendered_often(machine):
    scene = raygrid.load_scene(KINDS)
    assert isinstance(scene, raygrid.LoadedScene)
    pictures = [machine.render(scene, size=SIZE, samples=samples) for samples in (1, 4, 1)]
    assert np.array_equal(pictures[0].sums, pictures[2].sums)
    assert [picture.samples for picture in pictures] == [1, 4, 1]


def test_meshes_in_memory_are_rendered_as_their_files_are(machine, tmp_path):
    mesh = trimesh.creation.box(extents=(1.0, 2.0, 0.5))
    mesh.visual.face_colors = np.tile(np.array([(255, 0, 0, 255), (0, 90, 255, 255)], np.uint8), (6, 1))
    mesh.export(tmp_path / "box.ply")
    of_file = machine.render(tmp_path / "box.ply", size=SIZE)
    assert np.array_equal(machine.render(mesh, size=SIZE).sums, of_file.sums)
    assert np.array_equal(machine.render(trimesh.Scene(mesh), size=SIZE).sums, of_file.sums)
    (frame,) = machine.render_frames(raygrid.load_scene(mesh), [1], size=SIZE)
    assert np.array_equal(frame.sums, of_file.sums)
    assert len(np.unique(of_file.sums.reshape(-1, 3), axis=0)) > 2


def built():
    scene = raygrid.Scene(size=SIZE)
    scene.material("mirror", diffuse=0.2, specular=0.7)
    scene.sphere((0, 1, 0), 1, material="mirror")
    ball = trimesh.creation.icosphere(2)
    scene.mesh(np.add(ball.vertices, (2, 1, 0)), ball.faces, colours=np.abs(ball.vertices))
    scene.polygon([(-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4)])
    return scene


def test_scenes_built_in_memory_are_rendered_as_their_files_are(machine, tmp_path):
    scene, view = built(), {"fit": "three-quarter", "lights": [(3, 6, 4)], "background": (0.2, 0.3, 0.5), "crease": 60}
    scene.save(tmp_path / "s.toml")
    of_file = machine.render(tmp_path / "s.toml", **view)
    assert np.array_equal(machine.render(scene, **view).sums, of_file.sums)
    (frame,) = machine.render_frames(scene, [1], **view)
    assert np.array_equal(frame.sums, of_file.sums)
    assert not np.array_equal(machine.render(scene, **view | {"crease": 0}).sums, of_file.sums)
    assert of_file.sums.shape == (SIZE[1], SIZE[0], 3)


def test_a_camera_inside_a_wall_is_told(machine):
    scene = built()
    scene.box((-9, -1, -6), (9, 9, -5))
    inside = machine.render(scene, eye=(0, 1, -5.5), at=(1, 1, -5.5), lights=[(0, 9, 9)])
    assert "the picture is all black: no light reaches what the camera sees; is it behind a wall" in inside.blank()
    with pytest.raises(raygrid.SceneError, match=r"the camera looks from \(0, 1, 0\) at that same point"):
        machine.render(scene, eye=(0, 1, 0), at=(0, 1, 0))


def test_a_caller_is_told_how_far_a_render_is(machine):
    told, watched = [], []
    picture = machine.render(TINY, size=SIZE, progress=told.append, watch=lambda phase, _: watched.append(phase))
    assert np.array_equal(picture.sums, alone(TINY, size=SIZE).sums)
    assert [now.phase for now in told] == watched
    assert (watched[0], watched[-1]) == ("load", "collect")
    parts = [now.part for now in told if now.phase == "trace"]
    assert parts == sorted(parts)
    assert 0.0 <= parts[0] <= parts[-1] <= 1.0
    told.clear()
    list(machine.render_frames(str(SCENES / "mobile.toml"), [2, 3], size=SIZE, progress=told.append))
    assert {now.frame for now in told} == {2, 3}


def test_remarks_are_told_once_and_a_black_picture_each_time(machine, caplog):
    scene = raygrid.Scene()
    scene.sphere((0, 0, 0), 1)
    scene.camera((0, 0, 5), (0, 0, 9))
    with caplog.at_level(logging.INFO, "raygrid"):
        for _ in range(2):
            machine.render(scene, size=SIZE)
    said = [(record.levelname, record.getMessage()) for record in caplog.records]
    assert said == [
        ("INFO", "raygrid.Scene: no light in the file: a key and a fill light invented"),
        *[("WARNING", "raygrid.Scene: no ray of the camera meets a surface: the picture shows the background only")]
        * 2,
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error", raygrid.RemarkWarning)
        with pytest.raises(raygrid.RemarkWarning, match="the picture shows the background only"):
            machine.render(scene, size=SIZE)


def test_an_equal_remark_on_another_scene_is_told_too(machine, caplog, tmp_path):
    """It failed: remarks were remembered without the name of their scene."""
    for name in ("a.toml", "b.toml"):
        (tmp_path / name).write_text('[[surfaces]]\nkind = "sphere"\ncentre = [0, 0, 0]\nradius = 1\n')
    with caplog.at_level(logging.INFO, "raygrid"):
        for name in ("a.toml", "b.toml", "a.toml"):
            machine.render(tmp_path / name, size=SIZE)
    lights = "no light in the file: a key and a fill light invented"
    assert [said for record in caplog.records if lights in (said := record.getMessage())] == [
        f"{name}: {lights}" for name in ("a.toml", "b.toml")
    ]


def test_what_is_no_scene_is_refused_in_one_sentence(machine):
    for given in (None, np.zeros((2, 3)), [TINY]):
        with pytest.raises(
            raygrid.SceneError, match=r"^a scene came as .*, wanted the path of a file, a raygrid\.Scene, "
        ):
            machine.render(given)
    with pytest.raises(raygrid.SceneError, match="the mesh has no faces, wanted at least one"):
        machine.render(trimesh.Trimesh())


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"size": (17, 9)},
        {"size": np.array([17, 9]), "samples": np.int64(2)},
        {"size": [33, 8], "samples": 3, "depth": 2, "min_weight": 0.05, "highlights": True, "split": "uniform"},
    ],
    ids=["as the file says", "size", "numpy", "all"],
)
def test_settings(machine, settings):
    settings = {"size": (96, 64), **settings}
    picture = machine.render(KINDS, **settings)
    assert np.array_equal(picture.sums, alone(KINDS, **settings).sums)
    assert picture.sums.shape == (settings["size"][1], settings["size"][0], 3)
    assert picture.stats["depth"] == settings.get("depth", 5)


def test_a_scene_s_own_settings_hold_unless_others_are_given(tmp_path, machine):
    scene = tmp_path / "small.toml"
    scene.write_text(
        "[image]\nwidth = 12\nheight = 7\nsamples = 3\ndepth = 2\n[[surfaces]]\nkind = 'sphere'\ncentre = [0, 0, 0]\nradius = 1\n"
    )
    picture = machine.render(scene)
    assert (picture.sums.shape, picture.samples, picture.stats["depth"]) == ((7, 12, 3), 3, 2)
    assert machine.render(scene, samples=1).samples == 1


def test_progress_is_told(machine):
    told = []
    machine.render(TINY, size=(200, 200), watch=lambda phase, progress: told.append((phase, progress)))
    assert [phase for phase, progress in told if progress is None] == ["load", "trace", "collect"]
    traced = [progress for phase, progress in told if progress is not None]
    assert all(now.primaries >= before.primaries for before, now in itertools.pairwise(traced))
    assert traced[-1].in_flight == 0


# ---- errors ----


SETTINGS = [
    ({"size": (0, 5)}, "a size came as 0x5, wanted sides of 1 to 65536 and at most 268,435,456 pixels"),
    ({"size": "40x30"}, r"a size came as '40x30', wanted two whole numbers such as \(512, 384\)"),
    ({"size": 40}, r"a size came as 40, wanted two whole numbers such as \(512, 384\)"),
    ({"size": (4.5, 3)}, r"a size came as \(4\.5, 3\), wanted two whole numbers such as \(512, 384\)"),
    ({"samples": 0}, r"0 samples a pixel came, wanted 1 to \d+ for 256x256 \(sample numbers have 32 bits\)"),
    ({"samples": 1.5}, "samples a pixel came as 1.5, wanted a whole number"),
    ({"depth": 0}, "a depth came as 0, wanted 1 to 31"),
    ({"depth": 32}, "a depth came as 32, wanted 1 to 31"),
    ({"min_weight": math.nan}, "a least weight came as nan, wanted a finite number of 0 or more"),
    ({"min_weight": -0.5}, "a least weight came as -0.5, wanted a finite number of 0 or more"),
    ({"split": "fair"}, "a split came as 'fair', wanted one of balanced, uniform"),
    ({"budget": 0}, "a budget came as 0, wanted 1 to 4294967295 packets in flight"),
]


def test_wrong_settings_are_told_and_the_array_goes_on(machine):
    for settings, line in SETTINGS:
        with pytest.raises(raygrid.RaygridError, match=rf"^{line}$"):
            machine.render(TINY, **settings)
    with pytest.raises(raygrid.SceneError, match=r"^gone\.nff: there is no such file$"):
        machine.render("gone.nff")
    with pytest.raises(raygrid.SceneError, match=r"^a scene came as 'a\\x00b\.nff', wanted the name of a file$"):
        machine.render("a\0b.nff")
    with pytest.raises(TypeError, match="sise"):
        machine.render(TINY, sise=(4, 3))
    assert np.array_equal(machine.render(TINY, size=SIZE).sums, alone(TINY, size=SIZE).sums)


@pytest.mark.parametrize("shape", ["0x2x2", "2x2", (2, 2), (1, -1, 1), "axbxc", ""])
def test_shapes_that_are_none(shape):
    with pytest.raises(ValueError, match=r"array shape .+, wanted three numbers from 1 to 65535"):
        raygrid.launch(shape)


def test_an_array_that_does_not_fit():
    with pytest.raises(
        raygrid.ArrayError, match=r"a 1000x1000x1000 array does not fit .+; largest that fits: (\d+)x\1x\1$"
    ):
        raygrid.launch((1000, 1000, 1000))


@pytest.mark.parametrize(("name", "value"), [("batch", 0), ("batch", 10**6), ("patience", 0.0), ("patience", math.nan)])
def test_options_of_launch_are_checked(name, value):
    with pytest.raises(ValueError, match=rf"a {name} came as {value}, wanted .+"):
        raygrid.launch("1x1x1", **{name: value})


def test_a_closed_array_says_so():
    array = raygrid.launch("1x1x1")
    array.close()
    array.close()
    with pytest.raises(raygrid.ArrayError, match="the array is not ready: it was not launched, or it was closed"):
        array.render(TINY, size=SIZE)


def test_an_error_in_the_block_closes_the_array():
    with pytest.raises(ZeroDivisionError), raygrid.launch("2x1x1") as array:
        processes = [psutil.Process(pid) for pid in array.pids]
        array.render(TINY, size=SIZE)
        raise ZeroDivisionError
    assert not any(process.is_running() for process in processes)


def test_an_error_in_the_watcher_ends_the_frame_and_closes_the_array():
    def watch(phase, _progress):
        if phase == "trace":
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), raygrid.launch("2x1x1") as array:
        array.render(TINY, watch=watch)


def test_a_lost_processor_is_an_error_that_names_it(machine):
    with raygrid.launch("2x1x1") as array:
        psutil.Process(array.pids[1]).kill()
        with pytest.raises(raygrid.ArrayError, match=rf"node 1,0,0 \(pid {array.pids[1]}\) ended: signal SIGKILL"):
            array.render(TINY, size=SIZE, attempts=1)
        array.reset()
        assert np.array_equal(array.render(TINY, size=SIZE).sums, machine.render(TINY, size=SIZE).sums)


# ---- where it is used from ----


def test_two_arrays_at_once(machine):
    with raygrid.launch("1x2x1") as other:
        assert not set(machine.pids) & set(other.pids)
        for path in (TINY, KINDS):
            assert np.array_equal(machine.render(path, size=SIZE).sums, other.render(path, size=SIZE).sums)


def test_use_from_threads(machine):
    """One array launched and used in a thread of its own, another handed to a thread."""
    sums = {}

    def own():
        with raygrid.launch("1x1x2") as array:
            sums["own"] = array.render(TINY, size=SIZE).sums

    def handed():
        sums["handed"] = machine.render(TINY, size=SIZE).sums

    threads = [threading.Thread(target=work) for work in (own, handed)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert np.array_equal(sums["own"], sums["handed"])


SCRIPT = f"""
import raygrid
with raygrid.launch("2x1x1") as array:
    array.render({TINY!r}, size=(40, 30)).save("x.npy")
print("done")
"""
CARELESS = f"""
import raygrid
array = raygrid.launch("2x1x1")
array.render({TINY!r}, size=(40, 30)).save("x.npy")
print("done")
"""


@pytest.mark.parametrize("script", [SCRIPT, CARELESS], ids=["with", "never closed"])
@pytest.mark.parametrize("way", ["file", "-c", "stdin"])
def test_a_script_needs_no_guard(way, script, tmp_path):
    """No `if __name__ == "__main__"`: nodes are not made by importing the program again."""
    (tmp_path / "script.py").write_text(script)
    arguments = {"file": ["script.py"], "-c": ["-c", script], "stdin": ["-"]}[way]
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=tmp_path,
        input=script if way == "stdin" else None,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.stdout, done.stderr, done.returncode) == ("done\n", "", 0)
    assert np.array_equal(np.load(tmp_path / "x.npy"), alone(TINY, size=SIZE).sums)


def test_modules_of_the_user_do_not_get_in_the_way(tmp_path):
    """A random.py or numba.py where the user happens to stand is not what the nodes import."""
    for name in ("random", "msgpack", "node", "host"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong module')")
    script = f"import os\nos.chdir({os.fspath(tmp_path)!r}){SCRIPT}"
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, timeout=120)
    assert (done.stdout, done.stderr, done.returncode) == ("done\n", "", 0)


def test_the_example_of_the_documentation_works(tmp_path, monkeypatch):
    """As in the package's own words, but for a smaller picture."""
    monkeypatch.chdir(SCENES.parent)
    example = re.search(r"\n    import raygrid\n(.*?)\n\n", raygrid.__doc__ + "\n\n", re.S)
    assert example is not None
    lines = [line[4:] for line in ("    import raygrid\n" + example[1]).splitlines()]
    code = "\n".join(lines).replace("(640, 480)", "(64, 48)").replace('"room.png"', repr(str(tmp_path / "room.png")))
    names = {}
    exec(code, names)
    assert names["radiance"].shape == (48, 64, 3)
    assert (tmp_path / "room.png").exists()


# ---- threads ----


def test_a_second_thread_is_refused_in_one_sentence_and_the_first_one_s_picture_is_right(machine):
    refused, traced = [], threading.Event()

    def other():
        assert traced.wait(60.0)
        for use in (lambda: machine.render(TINY, size=SIZE), machine.reset, lambda: machine.probe(1.0, print)):
            with pytest.raises(
                raygrid.ArrayError, match=r"^the array is in use by another thread, wanted one at a time: "
            ):
                use()
        refused.append(True)

    thread = threading.Thread(target=other)
    thread.start()

    def watch(phase, progress):
        if phase == "trace" and not traced.is_set():
            traced.set()
            thread.join(60.0)

    picture = machine.render(KINDS, size=SIZE, watch=watch)
    assert refused
    assert np.array_equal(picture.sums, alone(KINDS, size=SIZE).sums)
    assert np.array_equal(machine.render(KINDS, size=SIZE).sums, picture.sums)


def test_threads_may_use_it_one_after_the_other(machine):
    pictures = []
    for _ in range(3):
        thread = threading.Thread(target=lambda: pictures.append(machine.render(KINDS, size=SIZE)))
        thread.start()
        thread.join(60.0)
    assert [np.array_equal(picture.sums, alone(KINDS, size=SIZE).sums) for picture in pictures] == [True] * 3


def test_an_array_that_another_thread_closes_gives_up_its_frame_and_leaves_nothing():
    machine, traced, told = raygrid.launch("2x1x1"), threading.Event(), []

    def other():
        with pytest.raises(raygrid.ArrayError, match=r"^the array was closed by another thread while it was in use$"):
            machine.render(KINDS, size=(3000, 3000), samples=64, watch=lambda *_: traced.set())
        told.append(True)

    thread = threading.Thread(target=other)
    thread.start()
    assert traced.wait(60.0)
    machine.close()
    thread.join(60.0)
    assert told
    machine.close()
