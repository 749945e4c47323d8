"""An array that stays renders scenes that move: by increments, each frame with the bits of a load of its own."""

import json
import shutil

import numpy as np
import pytest
from support.cli import one_line, warm_kernels
from support.render import SCENES
from support.service import name, on

import raygrid
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.render.animation_jobs import jobs_of
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings
from raygrid.host.scene.animation.turntable import turntable
from raygrid.host.scene.load import load_scene
from raygrid.host.service.scene_store import FrameRequest, SceneStore
from raygrid.node.errors import ArrayError

__all__ = ["name", "warm_kernels"]

MOBILE, TINY = SCENES / "mobile.toml", SCENES / "tiny.nff"
SMALL = {"size": (24, 18), "samples": 1}
OPTIONS = ("--size", "24x18", "--samples", "1")
LOADS = ("floods", "increments")


@pytest.fixture
def array(name):
    """A connection to it, when it has just been emptied; what a test leaves behind is cancelled."""
    with raygrid.connect(name) as array:
        array.reset()
        yield array
        array.cancel(None)


def afresh(scene, frame, turn=None, turn_scene=False, **settings):
    """The sums of a frame in a new array inside this process."""
    read = load_scene(scene)
    shot = read if turn is None else turntable(read, turn, turn_scene)
    (job,) = jobs_of(shot, (1, 1, 1), Settings(**(SMALL | settings)), [frame])
    array = MemoryArray((1, 1, 1))
    array.driver.ready()
    return render_job(array.driver, job).sums


def same_file(path, sums, tmp_path):
    """Whether a file is byte for byte what the sums are as a file."""
    np.save(tmp_path / "wanted.npy", sums)
    return path.read_bytes() == (tmp_path / "wanted.npy").read_bytes()


def loads(array):
    status = array.status()
    return np.array([status[what] for what in LOADS])


# ---- frames ----


def test_frames_of_a_shot_are_rendered_by_increments_and_have_their_bits(name, array, tmp_path):
    before = loads(array)
    outcome = on(name, "submit", str(MOBILE), *OPTIONS, "--frames", "11-15", "-o", "f_%02d.npy", cwd=tmp_path)
    assert outcome == (0, "".join(f"f_{frame}.npy\n" for frame in range(11, 16)), "")
    assert (loads(array) - before).tolist() == [1, 4]
    files = [tmp_path / f"f_{frame}.npy" for frame in range(11, 16)]
    for frame, file in zip(range(11, 16), files, strict=True):
        assert same_file(file, afresh(MOBILE, frame), tmp_path)
    assert len({file.read_bytes() for file in files}) == 5  # it moves


def test_frames_after_a_reset_and_of_other_settings(array, tmp_path):
    def submit(first, last, **settings):
        before = loads(array)
        array.submit(MOBILE, output=tmp_path / "f_%d.npy", frames=(first, last), **(SMALL | settings)).wait()
        return (loads(array) - before).tolist()

    assert submit(3, 4) == [1, 1]
    assert submit(4, 4, depth=2) == [0, 0]  # nothing has moved
    assert same_file(tmp_path / "f_4.npy", afresh(MOBILE, 4, depth=2), tmp_path)
    assert submit(9, 9, depth=2) == [0, 1]  # other settings share the surfaces
    assert same_file(tmp_path / "f_9.npy", afresh(MOBILE, 9, depth=2), tmp_path)
    array.reset()
    assert submit(8, 9) == [1, 1]
    assert same_file(tmp_path / "f_9.npy", afresh(MOBILE, 9), tmp_path)


def test_two_clients_in_turn_do_not_mix(name, array, tmp_path):
    """Frames of one shot, forwards, and frames of another of the same surfaces."""
    other = tmp_path / "other.toml"
    other.write_text(MOBILE.read_text().replace("rotate = [0, -200, 12]", "rotate = [0, 100, -12]"))
    wanted = [(MOBILE, (1, 3)), (MOBILE, (30, 32)), (other, (10, 12))]
    before = loads(array)
    jobs = [
        array.submit(scene, output=tmp_path / f"{k}_%d.npy", frames=frames, client=f"client {k}", **SMALL)
        for k, (scene, frames) in enumerate(wanted)
    ]
    for job in jobs:
        job.wait()
    flooded, moved = loads(array) - before
    assert flooded + moved == 9
    assert moved >= 3  # where the two of one shot follow each other
    for k, (scene, (first, last)) in enumerate(wanted):
        for frame in range(first, last + 1):
            assert same_file(tmp_path / f"{k}_{frame}.npy", afresh(scene, frame), tmp_path), (k, frame)


def test_edited_keys_are_seen_though_everything_at_rest_stays(array, tmp_path):
    scene = tmp_path / "scene.toml"
    shutil.copy(MOBILE, scene)
    submitted = {"output": tmp_path / "f_%d.npy", "frames": (20, 20), "split": "uniform", **SMALL}
    array.submit(scene, **submitted).wait()
    before = (tmp_path / "f_20.npy").read_bytes()
    scene.write_text(scene.read_text().replace("rotate = [0, -200, 12]", "rotate = [0, -100, 12]"))
    array.submit(scene, **submitted).wait()
    assert (tmp_path / "f_20.npy").read_bytes() != before
    assert same_file(tmp_path / "f_20.npy", afresh(scene, 20), tmp_path)


def test_what_an_array_must_hold_is_told_apart_by_where_groups_are(tmp_path):
    """Two scenes with the same surfaces at rest in the same world and cells, of which only a key differs."""
    still = '[[surfaces]]\nkind = "box"\nlow = [-9, -9, -9]\nhigh = [9, 9, 9]\n'
    text = "[camera]\nfrom = [0, 0, 20]\nat = [0, 0, 0]\n[shot]\nframes = 3\n[groups.g]\n[[groups.g.keys]]\nframe = 1\ntranslate = [{}, 0, 0]\n"
    ball = '[[surfaces]]\nkind = "sphere"\ncentre = [0, 0, 0]\nradius = 1\ngroup = "g"\n'
    path, store, loaded = tmp_path / "s.toml", SceneStore((2, 1, 1)), []
    for shift in (1, 2, 1):
        path.write_text(text.format(shift) + still + ball)
        loaded.append(store.frame(FrameRequest(str(path), Settings(split="uniform")), 2).job.load_key)
    assert loaded[0] == loaded[2] != loaded[1]


def test_resume_skips_frames_of_a_shot(name, array, tmp_path):
    def submit(frames, *more):
        command = ("submit", str(MOBILE), *OPTIONS, "--frames", frames, "-o", "f_%d.npy", "--resume", "--json", *more)
        outcome = on(name, *command, cwd=tmp_path)
        assert outcome.code == 0, outcome.err
        events = [json.loads(line) for line in outcome.out.splitlines()]
        return [(event["frame"], event["skipped"]) for event in events if event["what"] == "frame"]

    assert submit("5-6") == [(5, False), (6, False)]
    before = [(tmp_path / f"f_{frame}.npy").stat().st_mtime_ns for frame in (5, 6)]
    assert submit("4-7") == [(4, False), (5, True), (6, True), (7, False)]
    assert [(tmp_path / f"f_{frame}.npy").stat().st_mtime_ns for frame in (5, 6)] == before
    shutil.copy(tmp_path / "f_5.npy", tmp_path / "f_6.npy")  # another frame's
    assert submit("6-7") == [(6, False), (7, True)]
    for frame in (4, 6, 7):
        assert same_file(tmp_path / f"f_{frame}.npy", afresh(MOBILE, frame), tmp_path)
    assert submit("7", "--depth", "1") == [(7, False)]


def test_frames_that_the_shot_has_not_are_one_error_before_any_is_rendered(name, array, tmp_path):
    for frames, said in (("47-49", "frames 47-49"), ("49", "frame 49")):
        outcome = on(name, "submit", str(MOBILE), *OPTIONS, "--frames", frames, "-o", "f_%d.npy", cwd=tmp_path)
        first = frames.split("-")[0]
        pattern = rf"raygrid: job \d+ failed: frame {first}: mobile.toml: {said} came, wanted frames of 1 to 48"
        one_line(outcome, 1, pattern)
    assert list(tmp_path.iterdir()) == []
    array.submit(MOBILE, output=tmp_path / "f_%d.npy", frames=(48, 48), **SMALL).wait()  # it goes on


def test_a_shot_without_frames_is_its_first(name, array, tmp_path):
    outcome = on(name, "submit", str(MOBILE), *OPTIONS, "-o", "f.npy", cwd=tmp_path)
    assert (outcome.code, outcome.out) == (0, "f.npy\n")
    assert "frame 1 of 48; --frames 1-48 renders all" in outcome.err
    assert same_file(tmp_path / "f.npy", afresh(MOBILE, 1), tmp_path)


# ---- turntables ----


def test_turntables(name, array, tmp_path):
    before = loads(array)
    outcome = on(name, "submit", str(TINY), *OPTIONS, "--turntable-scene", "3", "-o", "s_%d.npy", cwd=tmp_path)
    assert outcome == (0, "s_1.npy\ns_2.npy\ns_3.npy\n", "")
    assert (loads(array) - before).tolist() == [1, 2]
    array.submit(TINY, output=tmp_path / "c_%d.npy", turntable=4, frames=(2, 3), **SMALL).wait()
    assert (loads(array) - before).tolist() == [2, 2]  # then nothing moves but the camera
    array.submit(TINY, output=tmp_path / "still.npy", **SMALL).wait()
    for frame in (1, 2, 3):
        assert same_file(tmp_path / f"s_{frame}.npy", afresh(TINY, frame, 3, True), tmp_path)
    for frame in (2, 3):
        assert same_file(tmp_path / f"c_{frame}.npy", afresh(TINY, frame, 4), tmp_path)
    assert same_file(tmp_path / "still.npy", afresh(TINY, 1), tmp_path)
    again = array.submit(TINY, output=tmp_path / "c_%d.npy", turntable=5, frames=(2, 2), resume=True, **SMALL).wait()
    assert again.skipped == 0  # another turn
    with pytest.raises(ArrayError, match="wanted frames of 1 to 4"):
        array.submit(TINY, output=tmp_path / "c_%d.npy", turntable=4, frames=(4, 5), **SMALL).wait()
    with pytest.raises(ArrayError, match="moves by itself"):
        array.submit(MOBILE, output=tmp_path / "c_%d.npy", turntable=2, **SMALL).wait()
