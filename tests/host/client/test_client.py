"""Pictures come back from an array that stays, by the calls of one that was launched, with the same bits."""

import asyncio
import os
import signal
import threading

import numpy as np
import pytest
import trimesh
from support.cli import warm_kernels
from support.render import SCENES, rendered
from support.service import SIZE, array, end, name, sums, up

import raygrid
from raygrid.host.scene.load import load_scene

__all__ = ["array", "name", "warm_kernels"]

TINY, MOBILE, CHECKER = (str(SCENES / name) for name in ("tiny.nff", "mobile.toml", "checker.obj"))


@pytest.fixture(autouse=True)
def no_folder_is_left(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    yield
    assert list(tmp_path.iterdir()) == []


def average(renderer: raygrid.Renderer, scene) -> float:
    """Works with whatever renders."""
    return float(renderer.render(scene, size=(16, 12), progress=False).linear().mean())


def test_a_launched_and_a_connected_array_are_called_alike(array):
    assert isinstance(array, raygrid.Renderer)
    with raygrid.launch("2x1x1") as launched:
        assert isinstance(launched, raygrid.Renderer)
        assert average(launched, TINY) == average(array, TINY)
    assert repr(launched) == "<raygrid.Machine 2x1x1>"
    assert repr(array) == f"<raygrid.Service {array.name!r} 2x1x1, process {array.pid}>"


def test_a_picture_comes_back_with_its_statistics_and_is_told_of(array):
    told = []
    picture = array.render(TINY, size=SIZE, progress=told.append)
    assert np.array_equal(picture.sums, sums(TINY))
    assert (picture.samples, picture.stats["size"], picture.stats["array"]) == (1, list(SIZE), [2, 1, 1])
    assert picture.stats["total"]["born"]["pixel"] > 0
    assert [now.phase for now in told if now.phase in ("collect", "write")] == ["collect", "write"]


def test_scenes_of_memory_have_the_same_bits(array):
    scene = raygrid.Scene(background=(0.2, 0.3, 0.4), samples=2)
    scene.sphere((0, 0, 0), 1, material=scene.material("red", colour=(1, 0, 0)))
    scene.mesh(np.array([(-2.0, -1.0, -2.0), (2.0, -1.0, -2.0), (0.0, -1.0, 3.0)]), [(0, 2, 1)])
    assert np.array_equal(array.render(scene, size=SIZE).sums, rendered(load_scene(scene), (2, 1, 1), size=SIZE).sums)
    mesh = trimesh.creation.icosphere(1)
    picture = array.render(mesh, size=SIZE, fit="iso")
    assert picture.blank() is None


def test_frames_come_one_after_the_other(array):
    frames = list(array.render_frames(MOBILE, [2, 3, 7], size=SIZE))
    assert [frame.stats["frame"] for frame in frames] == [2, 3, 7]
    with raygrid.launch("2x1x1") as launched:
        own = list(launched.render_frames(MOBILE, [2, 3, 7], size=SIZE))
    assert all(np.array_equal(one.sums, other.sums) for one, other in zip(frames, own, strict=True))


def test_all_frames_of_a_scene_with_files_elsewhere_are_rendered_where_the_array_reads_them(array, tmp_path_factory):
    """What the array may read is asked of it: whoever started it has decided that."""
    folder = tmp_path_factory.mktemp("scene")
    (folder / "film.toml").write_text(f'include = "{TINY}"\n[shot]\nframes = 2\n')
    with pytest.raises(raygrid.SceneError, match="wanted one within, or raygrid up --allow-outside"):
        next(array.render_frames(folder / "film.toml", size=SIZE))

    async def frames():
        async with raygrid.aio.connect("outside") as other:
            return [frame async for frame in other.render_frames(folder / "film.toml", size=SIZE)]

    try:
        up("outside", "--allow-outside")
        with raygrid.connect("outside") as other:
            pictures = list(other.render_frames(folder / "film.toml", size=SIZE))
        pictures += asyncio.run(frames())
    finally:
        end("outside")
    assert [picture.stats["frame"] for picture in pictures] == [1, 2, 1, 2]
    wanted = rendered(load_scene(folder / "film.toml", True), (2, 1, 1), size=SIZE).sums
    assert all(np.array_equal(picture.sums, wanted) for picture in pictures)


def test_frames_that_nobody_takes_are_cancelled(array):
    frames = array.render_frames(MOBILE, size=SIZE)
    next(frames)
    frames.close()
    last = array.jobs()[-1]
    assert (last["state"], last["frames"]) == ("cancelled", 48)


def test_what_goes_wrong_is_one_sentence(array):
    with pytest.raises(raygrid.ArrayError, match=r"^job \d+ failed: .*nope\.nff: there is no such file"):
        array.render(SCENES / "nope.nff")
    with pytest.raises(raygrid.ArrayError, match=r"^depth came as 99, wanted a whole number from 1 to 31"):
        array.render(TINY, depth=99)
    with pytest.raises(TypeError, match=r"^the settings \['speed'\] came, wanted some of size, samples, "):
        array.render(TINY, speed=9)


def test_who_waits_for_a_job_that_has_ended_is_told_of_its_end(array, tmp_path):
    job = array.submit(TINY, size=SIZE, output=tmp_path / "a.npy")
    told = []
    result = job.wait(told.append)
    assert told[-1]["what"] == "end"
    again = []
    assert job.wait(again.append) == result
    assert [(event["is"], event["what"], event["job"], event["state"]) for event in again] == [
        ("event", "end", job.job, "done")
    ]
    (tmp_path / "a.npy").unlink()


def test_a_render_that_is_interrupted_before_its_job_has_a_number_cancels_it(array, monkeypatch):
    """The service is stopped, so that the answer is awaited when the interrupt comes."""
    cancel, me, over = array.cancel, threading.get_ident(), threading.Event()

    def interrupt():
        while not (array._connection._slots and array._connection._reading) and not over.wait(0.01):
            pass
        if not over.is_set():
            signal.pthread_kill(me, signal.SIGINT)

    def go_on(jobs):
        os.kill(array.pid, signal.SIGCONT)
        return cancel(jobs)

    monkeypatch.setattr(array, "cancel", go_on)
    thread = threading.Thread(target=interrupt)
    before = array.jobs()
    os.kill(array.pid, signal.SIGSTOP)
    try:
        thread.start()
        with pytest.raises(KeyboardInterrupt):
            array.render(TINY, size=(2000, 2000), samples=64)
    finally:
        over.set()
        os.kill(array.pid, signal.SIGCONT)
        thread.join(60)
    last = array.jobs()[-1]
    assert last not in before
    assert last["state"] == "cancelled"


def test_a_job_that_is_cancelled_by_another_is_an_error(array):
    caught = []

    def render():
        with pytest.raises(raygrid.ArrayError) as error:
            array.render(TINY, size=(2000, 2000), samples=64, progress=lambda _: begun.set())
        caught.append(str(error.value))

    begun = threading.Event()
    thread = threading.Thread(target=render)
    thread.start()
    assert begun.wait(60)
    array.cancel(None)
    thread.join(60)
    assert len(caught) == 1
    assert caught[0].endswith("was cancelled")
