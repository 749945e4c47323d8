"""Which files a scene was read from, and whether they have changed."""

import contextlib
import os
from pathlib import Path

import pytest
from support.render import SCENES

from raygrid.host.scene.file_access import read_bytes
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.sources import recorded, recording
from raygrid.node.errors import SceneError


def read(*paths):
    with recorded() as sources:
        for path in paths:
            with contextlib.suppress(SceneError):
                read_bytes(path)
    return sources


def test_every_file_of_a_scene_is_recorded():
    with recorded() as sources:
        load_scene(SCENES / "checker.obj")
    names = {Path(name).name for name in sources.files}
    assert {"checker.obj", "checker.mtl"} <= names
    assert recording() is None


def test_included_scenes_and_meshes_are_recorded(tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "s.toml").write_text('[[meshes]]\nfile = "m.obj"\n')
    with recorded() as sources:
        load_scene(tmp_path / "s.toml")
    assert {Path(name).name for name in sources.files} == {"s.toml", "m.obj"}


@pytest.mark.parametrize("age", [0, 3600])
def test_new_contents_are_a_change_and_new_times_are_none(tmp_path, age):
    file = tmp_path / "a"
    file.write_bytes(b"one")
    os.utime(file, (file.stat().st_mtime - age,) * 2)
    sources = read(file)
    assert not sources.changed()
    os.utime(file, (1, 1))
    assert not sources.changed()
    file.write_bytes(b"two")
    assert sources.changed()
    assert sources.changed()
    file.write_bytes(b"one")
    assert not sources.changed()


def test_a_change_of_the_same_size_within_a_tick_of_the_clock_is_seen(tmp_path):
    file = tmp_path / "a"
    file.write_bytes(b"one")
    before = file.stat()
    sources = read(file)
    file.write_bytes(b"two")
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert sources.changed()


def test_files_that_come_and_go_are_changes(tmp_path):
    here, not_there = tmp_path / "here", tmp_path / "not there"
    here.write_bytes(b"x")
    sources = read(here, not_there)
    assert not sources.changed()
    not_there.write_bytes(b"x")
    assert sources.changed()
    not_there.unlink()
    assert not sources.changed()
    here.unlink()
    assert sources.changed()


def test_the_digest_is_that_of_the_contents(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "f").write_bytes(b"same")
    (tmp_path / "c").write_bytes(b"other")
    assert read(tmp_path / "a" / "f").digest() == read(tmp_path / "b" / "f").digest()
    assert read(tmp_path / "a" / "f").digest() != read(tmp_path / "c").digest()
