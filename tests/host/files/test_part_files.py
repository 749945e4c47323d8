"""Files that are written aside, and the sweeping of those that dead processes left."""

import os
import stat
import subprocess
import sys

import pytest

from raygrid.host.files import part_files
from raygrid.host.files.part_files import DIRECTORY, DIRECTORY_NAME, FILE, FILE_NAME, PartFolder, replacing, sweep
from raygrid.host.image.outputs import write_whole

KILLED = """
import os, signal, sys, tempfile
from raygrid.host.files.part_files import PartFolder, replacing
tempfile.tempdir = sys.argv[1]
reel = PartFolder()
open(os.path.join(reel.path, "0.png"), "w").close()
beside = os.path.join(sys.argv[1], "film")
with replacing(beside) as (path, file), replacing(beside, ".mp4") as (film, _):
    print(reel.path, path, film, flush=True)
    {}
"""


@pytest.fixture(autouse=True)
def afresh(tmp_path, monkeypatch):
    """As a new process, with the temporary directory here."""
    monkeypatch.setattr(part_files, "_swept", {})
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def test_without_a_temporary_directory_there_is_nothing_to_sweep(monkeypatch):
    def none() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr("tempfile.gettempdir", none)
    part_files.sweep_folders()


def other(folder, end):
    """Another process that has begun to write; how it goes on."""
    command = [sys.executable, "-c", KILLED.format(end), str(folder)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def test_what_a_killed_process_left_is_swept_by_the_next(tmp_path):
    with other(tmp_path, "os.kill(os.getpid(), signal.SIGKILL)") as process:
        assert process.stdout is not None
        left = process.stdout.readline().split()
        process.wait(60)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(os.path.basename(path) for path in left)
    write_whole(tmp_path / "a.json", lambda file: file.write(b"x"))
    assert not os.path.exists(left[1])
    assert not os.path.exists(left[2])
    reel = PartFolder()
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == [os.path.basename(reel.path)]
    reel.remove()
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_what_is_in_use_stays(tmp_path):
    with other(tmp_path, "sys.stdin.readline()") as process:
        assert process.stdout is not None
        assert process.stdin is not None
        used = process.stdout.readline().split()
        write_whole(tmp_path / "a.json", lambda file: file.write(b"x"))
        PartFolder().remove()
        assert all(os.path.exists(path) for path in used)
        process.stdin.write("\n")
        process.stdin.close()
        assert process.wait(60) == 0
    assert not os.path.exists(used[1])  # removed by its owner


def test_only_our_own_kinds_and_names_are_swept(tmp_path):
    keep = [".raygrid-part-notes", ".raygrid-part-0123456789ab.txt", "frames-of-raygrid-holiday", "a.png"]
    for name in keep:
        (tmp_path / name).touch()
    (tmp_path / (FILE + "0" * 12)).mkdir()  # no file
    os.symlink("a.png", tmp_path / (FILE + "1" * 12))
    (tmp_path / (DIRECTORY + "2" * 12)).touch()  # no directory
    before = sorted(path.name for path in tmp_path.iterdir())
    assert sweep(str(tmp_path), FILE_NAME, stat.S_ISREG) == []
    assert sweep(str(tmp_path), DIRECTORY_NAME, stat.S_ISDIR) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_one_that_was_swept_before_it_was_locked_is_made_anew(tmp_path, monkeypatch):
    made = []

    def swept_at_once(path, mode, make=part_files._make_file):
        descriptor = make(path, mode)
        made.append(path)
        if len(made) < 3:
            os.unlink(path)
        return descriptor

    monkeypatch.setattr(part_files, "_make_file", swept_at_once)
    with replacing(str(tmp_path / "a")) as (path, file):
        file.write(b"x")
        assert path == made[-1]
        assert os.path.exists(path)
    assert len(made) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_fails_leaves_the_file_that_was_there(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), replacing(str(tmp_path / "a")) as (_, file):
        file.write(b"new")
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"


def test_a_file_has_the_rights_that_any_new_one_has(tmp_path):
    old = os.umask(0o027)
    try:
        write_whole(tmp_path / "a", lambda file: file.write(b"x"))
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640
