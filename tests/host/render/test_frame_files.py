"""The files of a frame: written whole, found again by their digest, and kept for the files that hold all frames."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.render import SCENES, rendered

from raygrid.host.image.frames import FrameNames
from raygrid.host.image.moving_pictures import Reel
from raygrid.host.render.frame_files import FrameFiles
from raygrid.host.render.job import Settings, make_job
from raygrid.host.render.prepared import PreparedFrame
from raygrid.host.scene.load import load_scene

SETTINGS = Settings(size=(16, 12))


@pytest.fixture(scope="module")
def picture():
    return rendered(load_scene(SCENES / "tiny.nff"), size=SETTINGS.size)


@pytest.fixture(scope="module")
def ready():
    return PreparedFrame(make_job(load_scene(SCENES / "tiny.nff"), (1, 1, 1), SETTINGS), "contents")


def files_of(folder, ready, *outputs, stats=None, frame=7):
    names = FrameNames.split([str(folder / name) for name in outputs], stats and str(folder / stats), True)
    reel = folder / "reel"
    reel.mkdir(exist_ok=True)
    return FrameFiles(names, frame, ready, "srgb", Reel(str(reel)))


def test_what_was_written_is_there_for_the_same_digest_alone(tmp_path, picture, ready):
    files = files_of(tmp_path, ready, "f_%02d.png", stats="%d.json")
    assert not files.are_there()
    files.write(picture)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["7.json", "f_07.png", "reel"]
    assert files.are_there()
    assert not files_of(tmp_path, replace(ready, contents="another"), "f_%02d.png").are_there()
    assert not files_of(tmp_path, ready, "f_%02d.png", frame=8).are_there()
    (tmp_path / "7.json").unlink()
    assert not files.are_there()


def test_a_frame_that_is_to_play_waits_when_it_was_written_or_found(tmp_path, picture, ready):
    files = files_of(tmp_path, ready, "f_%02d.png", "all.gif")
    files.write(picture)
    assert files.reel.has(7)
    (tmp_path / "reel" / f"{7:09d}.png").unlink()
    assert files.are_there()
    assert files.reel.has(7)
    assert not (tmp_path / "all.gif").exists()


def test_a_frame_that_only_plays_is_never_there(tmp_path, picture, ready):
    files = files_of(tmp_path, ready, "all.gif")
    files.write(picture)
    assert not files.are_there()


def test_what_a_picture_depends_on_is_in_its_digest(ready):
    job = ready.job
    others = [
        replace(ready, contents="another"),
        replace(ready, job=replace(job, settings=Settings(size=(12, 16)))),
        replace(ready, job=replace(job, settings=replace(SETTINGS, depth=2))),
    ]
    digests = {other.digest(7, "srgb") for other in [ready, *others]}
    digests |= {ready.digest(8, "srgb"), ready.digest((7, 8), "srgb"), ready.digest(7, "linear")}
    assert len(digests) == 7
    uniform = replace(ready, job=replace(job, settings=replace(SETTINGS, split="uniform")))
    assert uniform.digest(7, "srgb") == ready.digest(7, "srgb")
