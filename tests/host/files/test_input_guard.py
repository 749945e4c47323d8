"""What a command reads is never written over, by whatever way; and what is no file is refused without waiting for it."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from support import paths
from support.cli import TINY, here, one_line, warm_kernels
from support.render import SCENES

from raygrid.host.files.input_guard import Inputs, check_outputs, note, noted
from raygrid.host.image.outputs import check_path, write_whole
from raygrid.node.errors import OutputError

__all__ = ["warm_kernels"]

SMALL = ("--array", "1x1x1", "--size", "8x6", "--samples", "1", "--quiet")
MADE_OF = "the output is a file that the scene is made of, wanted another"
RECORDING = json.dumps({"is": "array", "version": 2, "array": [1, 1, 1], "rate": 1.0, "wall": 0.0, "time": 0.0}) + "\n"


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A scene of many files, here; their contents."""
    monkeypatch.chdir(tmp_path)
    Path("spot.obj").write_text(
        "mtllib spot.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    )
    Path("spot.mtl").write_text("newmtl m\nKd 1 1 1\nmap_Kd spot.png\n")
    Image.fromarray(np.full((2, 2, 3), 99, np.uint8)).save("spot.png")
    Path("base.nff").write_text(Path(TINY).read_text())
    Path("scene.toml").write_text('include = "base.nff"\n[[meshes]]\nfile = "spot.obj"\n[shot]\nframes = 3\n')
    shutil.copy(SCENES / "programs" / "marble.py", "marble.py")
    Path("price.toml").write_text((paths.ROOT / "emulator" / "costs" / "unit.toml").read_text())
    Path("probes.jsonl").write_text(RECORDING)
    os.symlink("spot.png", "link.png")
    os.link("spot.png", "hard.png")
    os.link("spot.png", "hard.pov")
    os.link("base.nff", "hard.json")
    os.mkdir("sub")
    os.symlink("..", "sub/up")
    os.link("spot.png", "f_0002.png")
    return contents()


def contents():
    return {path.name: path.read_bytes() for path in Path().iterdir() if path.is_file()}


REFUSED = [  # arguments, how the line ends
    (["render", "scene.toml", *SMALL, "-o", "spot.png"], f"spot.png: {MADE_OF}"),
    (["render", "spot.obj", *SMALL], f"spot.png: {MADE_OF}"),  # the default output
    (["render", "scene.toml", *SMALL, "-o", "link.png"], f"link.png: {MADE_OF}"),
    (["render", "scene.toml", *SMALL, "-o", "hard.png"], f"hard.png: {MADE_OF}"),
    (["render", "scene.toml", *SMALL, "-o", "sub/up/spot.png"], f"sub/up/spot.png: {MADE_OF}"),
    (["render", "scene.toml", *SMALL, "-o", "a.png", "--stats", "base.nff"], f"base.nff: {MADE_OF}"),
    (["render", "scene.toml", *SMALL, "-o", "a.png", "--stats", "spot.mtl"], f"spot.mtl: {MADE_OF}"),
    (["render", "scene.toml", *SMALL, "-o", "a.png", "--probe-record", "spot.obj"], f"spot.obj: {MADE_OF}"),
    (["render", "scene.toml", *SMALL, "-o", "a.png", "--chrome-trace", "hard.json"], f"hard.json: {MADE_OF}"),
    (
        ["render", "scene.toml", *SMALL, "-o", "a.png", "--stats", "scene.toml"],
        "the same file as the scene, wanted another",
    ),
    (["render", "scene.toml", *SMALL, "--frames", "1-3", "-o", "f_%04d.png"], f"f_0002.png: {MADE_OF}"),
    (
        ["render", "scene.toml", *SMALL, "--frames", "1-3", "-o", "%d.png", "--stats", "f_%04d.png"],
        f"f_0002.png: {MADE_OF}",
    ),
    (
        [
            "render",
            "base.nff",
            *SMALL,
            "--program",
            "marble.py",
            "--allow-programs",
            "-o",
            "a.png",
            "--stats",
            "marble.py",
        ],
        "marble.py: the output is the same file as the program, wanted another",
    ),
    (
        ["render", "base.nff", *SMALL, "--timed", "--cost", "price.toml", "-o", "a.png", "--stats", "price.toml"],
        "price.toml: the output is the same file as the cost model, wanted another",
    ),
    (["simulate", "scene.toml", *SMALL, "-o", "hard.png"], f"hard.png: {MADE_OF}"),
    (["simulate", "scene.toml", *SMALL, "--stats", "spot.mtl"], f"spot.mtl: {MADE_OF}"),
    (["simulate", "base.nff", *SMALL, "--csv", "base.nff"], "the same file as the scene, wanted another"),
    (
        ["simulate", "base.nff", *SMALL, "--cost", "price.toml", "--csv", "price.toml"],
        "as the cost model, wanted another",
    ),
    (["export", "scene.toml", "-o", "spot.obj"], f"spot.obj: {MADE_OF}"),
    (["export", "scene.toml", "-o", "hard.pov"], f"hard.pov: {MADE_OF}"),
    (["export", "base.nff", "-o", "hard.json"], "hard.json: the output is the same file as the scene, wanted another"),
    (
        ["probe", "--replay", "probes.jsonl", "--chrome-trace", "probes.jsonl"],
        "probes.jsonl: the output is the same file as the recording, wanted another",
    ),
    (
        ["probe", "--replay", "probes.jsonl", "--record", "./probes.jsonl"],
        "./probes.jsonl: the output is the same file as the recording, wanted another",
    ),
    (
        ["render", "base.nff", *SMALL, "-o", "a.png", "--probe-record", "b", "--chrome-trace", "./b"],
        "./b: the output is the same file as the output b, wanted another",
    ),
]


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
@pytest.mark.parametrize(("arguments", "line"), REFUSED, ids=[" ".join(row[0]) for row in REFUSED])
def test_no_command_writes_over_what_it_reads(scene, arguments, line):
    outcome = here(*arguments)
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.splitlines()[-1].endswith(line), outcome.err
    assert contents() == scene


def test_law_does_not_write_over_what_it_reads(scene):
    Path("law").mkdir()
    os.link("spot.png", "law/law_scene.png")
    Path("x").mkdir()
    shutil.copy("base.nff", "x/base.nff")
    for scenes, line in (
        (["scene.toml"], f"law/law_scene.png: {MADE_OF}"),
        (["base.nff", "x/base.nff"], "law/law_base.png: the output is the same file as the output law/law_base.png"),
    ):
        outcome = here("law", *scenes, "--cost", "unit", "--quiet")
        assert outcome.code == 1
        assert line in outcome.err
    assert contents() == scene


def test_a_file_that_was_looked_for_counts_though_it_was_not_there(scene):
    Path("spot.png").unlink()
    outcome = here("render", "spot.obj", *SMALL)
    assert outcome.code == 1
    assert not Path("spot.png").exists()


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_what_is_not_read_is_replaced_as_ever(scene):
    Path("a.png").write_bytes(b"old")
    assert (
        here("render", "scene.toml", *SMALL, "-o", "a.png", "--stats", "a.json", "--probe-record", "a.jsonl").code == 0
    )
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    assert Path("a.jsonl").read_text().startswith('{"is": "array"')
    assert scene.items() <= contents().items()


def test_the_last_gate_is_the_writing_itself(tmp_path):
    """Whatever was forgotten before: what is noted is not written."""
    file = tmp_path / "a"
    file.write_text("kept")
    with noted():
        note(file)
        with pytest.raises(OutputError, match=MADE_OF):
            write_whole(file, lambda out: out.write(b"gone"))
    assert file.read_text() == "kept"
    write_whole(file, lambda out: out.write(b"new"))  # nobody reads it
    assert file.read_text() == "new"


@given(st.lists(st.sampled_from(["a", "b", "c/d", "c/../a", "./b", "c/./d", "e"]), min_size=1, max_size=4), st.data())
def test_a_file_is_the_same_by_every_way_to_it(tmp_path_factory, inputs, data):
    folder = tmp_path_factory.mktemp("ways")
    (folder / "c").mkdir()
    (folder / "a").touch()
    os.link(folder / "a", folder / "hard")
    os.symlink("a", folder / "soft")
    ways = {"a": {"a", "c/../a", "hard", "soft"}, "b": {"b", "./b"}, "c/d": {"c/d", "c/./d"}, "e": {"e"}}
    output = data.draw(st.sampled_from(sorted(way for same in ways.values() for way in same)))
    wanted = any(output in same and name in same for same in ways.values() for name in inputs)
    read = Inputs()
    for name in inputs:
        read.add(folder / name, "read")
    with noted() as now:
        now.files.update(read.files)
        if wanted:
            with pytest.raises(OutputError, match="the output is read, wanted another"):
                check_outputs([folder / output])
        else:
            check_outputs([folder / output])


# ---- what is no file ----


@pytest.mark.parametrize(
    "arguments",
    [
        ("render", TINY, "-o", "pipe.png"),
        ("render", TINY, "-o", "a.png", "--stats", "pipe.png"),
        ("render", TINY, "-o", "a.png", "--probe-record", "pipe.png"),
        ("render", TINY, "-o", "a.png", "--chrome-trace", "pipe.png"),
        ("render", str(SCENES / "mobile.toml"), "--frames", "1-2", "-o", "pipe.gif"),
        ("render", str(SCENES / "mobile.toml"), "--frames", "1", "-o", "pipe.png"),
        ("simulate", TINY, "--csv", "pipe.png"),
        ("export", TINY, "-o", "pipe.png"),
    ],
    ids=" ".join,
)
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.png")
    os.mkfifo("pipe.gif")
    one_line(here(*arguments), 1, r"raygrid: pipe\.(png|gif): the output is a pipe, wanted a file")


def test_a_pipe_that_comes_meanwhile_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a")
    with pytest.raises(OutputError, match="the output is a pipe, wanted a file"):
        write_whole(tmp_path / "a", lambda out: out.write(b"x"))


def test_devices_take_what_comes(tmp_path):
    os.symlink("/dev/null", tmp_path / "null")
    check_path(tmp_path / "null")
    write_whole(tmp_path / "null", lambda out: out.write(b"x"))
    assert os.path.islink(tmp_path / "null")
