"""raygrid render --frames and --turntable: names, files that play, and what is refused before the work."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support_cli import here, one_line, warm_kernels
from support_render import SCENES

from raygrid.emulator.memory_array import MemoryArray
from raygrid.host.command_frames import as_ranges, has_number, named
from raygrid.host.job import Settings
from raygrid.host.load import load_scene
from raygrid.host.moving_pictures import Reel
from raygrid.host.render import render_job
from raygrid.host.shot_jobs import jobs_of
from raygrid.host.turntable import turntable
from raygrid.node.errors import OutputError

__all__ = ["warm_kernels"]

MOBILE = str(SCENES / "mobile.toml")
TINY = str(SCENES / "tiny.nff")
SMALL = ("--array", "2x1x1", "--size", "32x24", "--samples", "1", "--quiet")


def pixels(path, frame=0):
    with Image.open(path) as image:
        image.seek(frame)
        return np.asarray(image.convert("RGB"))


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_frames_of_a_shot(tmp_path):
    gif, webp = str(tmp_path / "m.gif"), str(tmp_path / "m.webp")
    outputs = ("-o", str(tmp_path / "m_%03d.png"), "-o", str(tmp_path / "m%d.npy"), "-o", gif, "-o", webp)
    stats = ("--stats", str(tmp_path / "%d.json"))
    outcome = here("render", MOBILE, "--frames", "22-24", *SMALL, *outputs, *stats)
    assert (outcome.code, outcome.err) == (0, "")
    names = [f"m_0{k}.png\nm{k}.npy".replace("\n", "\n" + str(tmp_path) + "/") for k in (22, 23, 24)]
    assert outcome.out.splitlines() == "\n".join([*(f"{tmp_path}/{name}" for name in names), gif, webp]).splitlines()
    array = MemoryArray((1, 1, 1))
    array.driver.ready()
    scene = load_scene(MOBILE)
    for job in jobs_of(scene, (1, 1, 1), Settings(size=(32, 24), samples=1), [22, 23, 24]):
        picture = render_job(array.driver, job)
        assert np.array_equal(np.load(tmp_path / f"m{job.number}.npy"), picture.sums)
        assert np.array_equal(pixels(tmp_path / f"m_0{job.number}.png"), picture.bytes())
        assert json.loads((tmp_path / f"{job.number}.json").read_text())["frame"] == job.number
        assert np.array_equal(pixels(webp, job.number - 22), picture.bytes())  # lossless
    for name in (gif, webp):
        with Image.open(name) as played:
            assert played.n_frames == 3
            assert name == webp or played.info["duration"] == 40
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith(".")) == []


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_a_turntable_has_numbered_pictures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for turn in ("--turntable", "--turntable-scene"):
        outcome = here("render", TINY, turn, "3", *SMALL)
        assert (outcome.code, outcome.err) == (0, "")
        assert outcome.out.split() == ["tiny_0001.png", "tiny_0002.png", "tiny_0003.png"]
        assert len({(tmp_path / name).read_bytes() for name in outcome.out.split()}) == 3


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_without_frames_the_first_is_rendered_and_that_is_said(tmp_path):
    loud = tuple(word for word in SMALL if word != "--quiet")
    outcome = here("render", MOBILE, *loud, "-o", str(tmp_path / "a.png"))
    assert outcome.code == 0
    assert "frame 1 of 48; --frames 1-48 renders all" in outcome.err
    assert here("render", MOBILE, *SMALL, "--frames", "1", "-o", str(tmp_path / "b.png")).code == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_wrong_frames_are_one_line(tmp_path):
    number = str(tmp_path / "%04d.png")
    one_line(
        here("render", MOBILE, "--frames", "40-60", *SMALL, "-o", number),
        1,
        r"raygrid: .*frames 40-60 came, wanted frames of 1 to 48",
    )
    one_line(
        here("render", TINY, "--frames", "1-2", *SMALL, "-o", number),
        1,
        r"raygrid: .*nothing moves in the scene, wanted keys.*",
    )
    one_line(
        here("render", MOBILE, "--turntable", "4", *SMALL, "-o", number), 1, r"raygrid: .*the scene moves by itself.*"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--frames", "3-1"), 2, r".*--frames: '3-1' came, wanted frames such as 1-48 or 7.*"),
        (("--frames", "0"), 2, r".*wanted frames such as.*"),
        (("--frames", "1-2-3"), 2, r".*wanted frames such as.*"),
        (
            ("--frames", "1-2", "-o", "x.png"),
            2,
            r"raygrid render: x.png: several frames would go to this one file, wanted a number such as %04d.*",
        ),
        (
            ("--frames", "1-2", "-o", "x_%s.png"),
            2,
            r"raygrid render: x_%s.png: the output has a % in its name that is no number.*",
        ),
        (("--frames", "1-2", "-o", "%d_%d.png"), 2, r"raygrid render: .*that is no number.*"),
        (("--frames", "1-2", "-o", "%d.txt"), 2, r"raygrid render: .*the suffix '.txt'.*"),
        (
            ("--frames", "1-2", "-o", "%d.png", "--stats", "x.json"),
            2,
            r"raygrid render: x.json: statistics of several frames.*",
        ),
        (
            ("--turntable", "2", "--turntable-scene", "2"),
            2,
            "raygrid render: --turntable and --turntable-scene came, wanted one of them .*",
        ),
        (("-o", "nowhere/x.gif"), 1, "raygrid: nowhere/x.gif: there is no directory.*"),
    ],
)
def test_what_cannot_be_is_refused_before_the_work(arguments, code, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one_line(here("render", MOBILE, *SMALL, *arguments), code, said)


def test_numbers_in_names():
    assert [has_number(name) for name in ("a.png", "a%d.png", "%04d/%.png"[:4])] == [False, True, True]
    assert named("f_%04d.png", 7) == "f_0007.png"
    assert named("f_%3d.png", 7) == "f_  7.png"


# --- films ---------------------------------------------------------------------------------------


def _fake_ffmpeg(tmp_path: Path, monkeypatch, body: str) -> None:
    """A program of that name first on the path: it gets what ffmpeg would get."""
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(f"#!{sys.executable}\nimport glob, sys\n{body}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")


def test_ffmpeg_gets_all_frames_in_order_and_the_file_appears_whole(tmp_path, monkeypatch):
    read = "frames = sorted(glob.glob(sys.argv[sys.argv.index('-i') + 1].replace('%07d', '*')))"
    _fake_ffmpeg(
        tmp_path,
        monkeypatch,
        f"{read}\nopen(sys.argv[-1], 'wb').write(b''.join(open(f, 'rb').read()[:4] for f in frames))",
    )
    with Reel(str(tmp_path / "a.mp4"), 24.0) as reel:
        for value in (0, 100, 200):
            reel.add(np.full((4, 4, 3), value, np.uint8))
        reel.write()
    assert (tmp_path / "a.mp4").read_bytes() == b"\x89PNG" * 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "bin"]


def test_an_ffmpeg_that_fails_is_one_error_with_its_words(tmp_path, monkeypatch):
    _fake_ffmpeg(tmp_path, monkeypatch, "print('no such codec', file=sys.stderr)\nsys.exit(3)")
    with Reel(str(tmp_path / "a.mp4"), 24.0) as reel:
        reel.add(np.zeros((4, 4, 3), np.uint8))
        with pytest.raises(OutputError, match=r"a.mp4: ffmpeg has failed \(no such codec\)"):
            reel.write()
    assert [path.name for path in tmp_path.iterdir()] == ["bin"]


def test_without_ffmpeg_that_is_said_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    one_line(
        here("render", MOBILE, *SMALL, "-o", str(tmp_path / "x.mp4")),
        1,
        r"raygrid: .*x.mp4: there is no ffmpeg on this computer.*",
    )


def test_frames_that_show_nothing_are_told_of():
    assert as_ranges([3]) == "frame 3"
    assert as_ranges([1, 2, 3, 7, 9, 10]) == "frames 1-3, 7, 9-10"
    scene = turntable(load_scene(SCENES / "room.glb"), 8)
    blank = {}
    array = MemoryArray((1, 1, 1))
    array.driver.ready()
    for job in jobs_of(scene, (1, 1, 1), Settings(size=(16, 12))):
        blank[job.number] = render_job(array.driver, job).blank()
    assert blank[1] is None
    assert any(said is not None and "all black" in said for said in blank.values())
