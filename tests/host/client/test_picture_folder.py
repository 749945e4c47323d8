"""The folder in which pictures come back: what lies there, who may look, what goes."""

import errno
import json
import os
import stat
import tempfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from support.render import SCENES

import raygrid
from raygrid.host.client import picture_folder
from raygrid.host.client.picture_folder import PictureFolder, all_frames, runs_of
from raygrid.host.image.frames import path_of
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.scene import describe
from raygrid.node.errors import ArrayError, SceneError

TINY = str(SCENES / "tiny.nff")


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A place for temporary files with a % in its name, which is no number of a frame."""
    place = tmp_path / "50%d"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


def test_numbers_become_jobs_without_gaps():
    assert runs_of([1, 2, 4, 3, 3, 5]) == [(1, 2), (4, 4), (3, 3), (3, 3), (5, 5)]
    assert runs_of([]) == []
    assert runs_of(range(7, 9)) == [(7, 8)]
    assert all_frames(TINY, False) == [(1, 1)]
    assert all_frames(str(SCENES / "mobile.toml"), False) == [(1, 48)]


def test_a_picture_is_taken_with_its_statistics_and_its_files_go(temporary):
    with PictureFolder(TINY, several=True) as folder:
        (made,) = temporary.iterdir()
        assert stat.S_IMODE(made.stat().st_mode) == 0o700
        assert (folder.scene, folder.title) == (TINY, "tiny.nff")
        sums = np.arange(12).reshape(2, 2, 3)
        np.save(path_of(folder.output, 3), sums)
        Path(path_of(folder.stats, 3)).write_text(json.dumps({"samples": 4, "scene": "tiny.nff"}))
        picture = folder.take(3)
        assert (picture.sums.tolist(), picture.samples, picture.stats["scene"]) == (sums.tolist(), 4, "tiny.nff")
        assert repr(picture) == "<raygrid.Picture of tiny.nff, 2x2, 4 samples a pixel>"
        assert list(made.iterdir()) == []
        with pytest.raises(ArrayError, match=r"frame_0003\.npy: the picture is not as the service left it"):
            folder.take(3)
    assert list(temporary.iterdir()) == []


def test_a_folder_that_is_still_written_to_is_removed_in_the_end(temporary, monkeypatch):
    """What was cancelled may write for a moment: the error of who takes pictures is not hidden by that."""
    monkeypatch.setattr(picture_folder, "RETRY_SECONDS", 0.0)
    tried, rmdir = [], os.rmdir

    def busy(path, **options):
        tried.append(path)
        if len(tried) < 3:
            raise OSError(errno.ENOTEMPTY, "Directory not empty")
        rmdir(path, **options)

    monkeypatch.setattr(os, "rmdir", busy)
    with pytest.raises(KeyError, match="what went wrong"), PictureFolder(TINY, several=True):
        raise KeyError("what went wrong")
    assert len(tried) == 3
    assert list(temporary.iterdir()) == []


def test_scenes_of_memory_are_written_there(temporary):
    scene = raygrid.Scene(background=(0.1, 0.2, 0.3))
    scene.sphere((0, 0, 0), 1)
    with PictureFolder(scene, several=False) as folder:
        assert folder.title == "scene.toml"
        assert describe(load_scene(folder.scene)) == describe(load_scene(scene)) | {"name": "scene.toml"}
    box = trimesh.creation.box()
    for given, suffix in ((box, ".ply"), (trimesh.Scene(box), ".glb")):
        with PictureFolder(given, several=False) as folder:
            assert Path(folder.scene).suffix == suffix
            assert len(load_scene(folder.scene).surfaces) == 12
    assert list(temporary.iterdir()) == []


def test_what_cannot_be_sent_is_one_sentence_and_leaves_no_folder(temporary, monkeypatch):
    with pytest.raises(ArrayError, match=r"^tiny\.nff: a scene that was read already came, wanted its path, "):
        PictureFolder(load_scene(TINY), several=False)
    with pytest.raises(SceneError, match=r"^a scene came as None, wanted the path of a file"):
        PictureFolder(None, several=False)
    assert list(temporary.iterdir()) == []
    monkeypatch.setattr(tempfile, "tempdir", str(temporary / "gone"))
    with pytest.raises(
        ArrayError, match=r"^no folder for pictures can be made \(No such file or directory\): set TMPDIR$"
    ):
        PictureFolder(TINY, several=False)
    assert os.listdir(temporary) == []
