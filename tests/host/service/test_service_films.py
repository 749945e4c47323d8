"""Names and files of an array that stays are those of render: numbers, files that play, what is refused, what is read."""

import json
import os
import shlex
import signal

import numpy as np
import pytest
from PIL import Image
from support.cli import here, one_line, warm_kernels
from support.processes import wait_dead
from support.render import SCENES
from support.service import array, name, on, state_directory, up, watch_until

import raygrid
from raygrid.host.cli import main
from raygrid.host.cli.group_service import SUBMIT_EXAMPLES
from raygrid.host.image.frames import frames_of, parse_frames
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError, OutputError

__all__ = ["array", "name", "warm_kernels"]

MOBILE, TINY = SCENES / "mobile.toml", SCENES / "tiny.nff"
SMALL = {"size": (24, 18), "samples": 1}
OPTIONS = ("--size", "24x18", "--samples", "1")
SHOT = ("--frames", "22-24")


def by_both(name, tmp_path, scene, *options):
    """What render and submit make of the same words, each in a folder of its own."""
    outcomes = []
    for command, more in (("render", ("--array", "2x1x1", "--quiet")), ("submit", ("--name", name, "--quiet"))):
        folder = tmp_path / command
        folder.mkdir()
        os.chdir(folder)
        try:
            outcomes.append((here(command, str(scene), *OPTIONS, *options, *more), folder))
        finally:
            os.chdir(tmp_path)
    return outcomes


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    "options",
    [
        (*SHOT, "-o", "m_%03d.png", "-o", "m.gif", "-o", "m.webp"),
        (*SHOT, "-o", "m.gif"),
        ("--frames", "7", "-o", "50%%_%04d.npy"),
        ("--frames", "7", "-o", "seven.npy"),
        ("--frames", "7"),
        ("-o", "50%%.npy"),
    ],
    ids=" ".join,
)
def test_submit_and_render_make_the_same_files(name, array, tmp_path, options):
    (rendered, by_render), (submitted, by_submit) = by_both(name, tmp_path, MOBILE, *options)
    assert (rendered.code, submitted.code) == (0, 0), rendered.err + submitted.err
    assert submitted.out.split() == rendered.out.split()
    assert contents(by_submit) == contents(by_render)
    assert sorted(contents(by_submit)) == sorted(submitted.out.split())


def test_without_frames_a_number_asks_for_the_whole_shot(name, array, tmp_path):
    (rendered, _), (submitted, _) = by_both(name, tmp_path, TINY, "--turntable", "3", "-o", "t_%d.npy")
    assert submitted.out.split() == rendered.out.split() == ["t_1.npy", "t_2.npy", "t_3.npy"]
    job = on(name, "submit", str(MOBILE), *OPTIONS, "-o", str(tmp_path / "t_%02d.png"), "--detach", "--json")
    assert json.loads(job.out)["frames"] == 48


@pytest.mark.parametrize(
    ("scene", "options", "words"),
    [
        (
            TINY,
            ("--frames", "1-3", "-o", "t_%d.png"),
            "nothing moves in the scene, wanted keys in it, or --turntable N",
        ),
        (TINY, ("--frames", "1", "-o", "t.png"), "nothing moves in the scene, wanted keys in it, or --turntable N"),
        (TINY, ("-o", "t_%04d.png"), "nothing moves in the scene, wanted keys in it, or --turntable N"),
        (TINY, ("-o", "t.gif"), "nothing moves in the scene, wanted keys in it, or --turntable N"),
        (MOBILE, ("--frames", "47-49", "-o", "t_%d.png"), "frames 47-49 came, wanted frames of 1 to 48"),
        (
            MOBILE,
            ("--frames", "1-3", "-o", "t.png"),
            "several frames would go to this one file, wanted a number such as",
        ),
        (MOBILE, ("-o", "t_%d.png", "--stats", "t.json"), "statistics of several frames came, wanted a number such as"),
        (MOBILE, ("-o", "50%.png"), "the output has a % in its name that is no number, wanted one such as %04d, or %%"),
        (MOBILE, ("-o", "%d_%d.png"), "the output has 2 places for the frame's number, wanted one"),
        (MOBILE, ("--frames", "1-2", "-o", "t.mp3"), "several frames would go to this one file"),
    ],
)
def test_submit_and_render_refuse_in_the_same_words(name, array, tmp_path, scene, options, words):
    for outcome, folder in by_both(name, tmp_path, scene, *options):
        misuse = "wanted a number" in words or "2 places" in words or "one file" in words or "no number" in words
        assert (outcome.code, outcome.out) == (2 if misuse else 1, "")
        assert words in outcome.err
        assert outcome.err.count("\n") == 1
        assert list(folder.iterdir()) == []


def test_a_name_without_frames_to_number_is_refused_in_python(array, tmp_path):
    for output in ("a_%d.png", "a.mp4"):
        with pytest.raises(OutputError, match="one of several frames and none were named"):
            array.submit(MOBILE, output=tmp_path / output)


EXAMPLES = [
    line.strip() for text in (main.EXAMPLES, main.RENDER_EXAMPLES, SUBMIT_EXAMPLES) for line in text.splitlines()
]


@pytest.mark.parametrize("line", [line for line in EXAMPLES if "--frames" in line])
def test_the_examples_of_help_name_frames_that_there_are(line):
    words = shlex.split(line)
    scene = load_scene(SCENES.parent / words[2])
    assert len(frames_of(scene, parse_frames(words[words.index("--frames") + 1]))) > 1


# ---- files that play ----


def test_a_film_goes_on_after_a_crash(name, tmp_path):
    gif = tmp_path / "m.gif"
    with raygrid.connect(name) as array:
        job = array.submit(MOBILE, output=gif, frames=(1, 12), **SMALL)
        watch_until(array, job.job, "frame", from_frame=3)
        nodes = [node["pid"] for node in array.status()["nodes"]]
        os.kill(array.pid, signal.SIGKILL)
        wait_dead(array.pid, *nodes)
    assert not gif.exists()
    up(name)
    waiting = state_directory(name) / "films" / str(job.job)
    (waiting / "000000002.png").unlink(missing_ok=True)  # as cleaners of files do
    with raygrid.connect(name) as array:
        assert array.wait(job.job).files == (str(gif),)
    with Image.open(gif) as played:
        assert played.n_frames == 12
    assert here("render", str(MOBILE), *OPTIONS, "--frames", "1-12", "-o", str(tmp_path / "r.gif"), "-q").code == 0
    assert gif.read_bytes() == (tmp_path / "r.gif").read_bytes()


def test_frames_wait_no_longer_than_their_job(name, array, tmp_path):
    job = array.submit(MOBILE, output=[tmp_path / "c.gif"], frames=(1, 48), **SMALL)
    watch_until(array, job.job, "frame", from_frame=2)
    array.submit(MOBILE, output=tmp_path / "d.gif", frames=(1, 2), **SMALL).wait()
    job.cancel()
    for output in ("t.npy", "u.npy"):
        array.submit(TINY, output=tmp_path / output, **SMALL).wait()
    assert list((state_directory(name) / "films").iterdir()) == []
    assert {path.name for path in tmp_path.iterdir()} == {"d.gif", "t.npy", "u.npy"}


def test_resume_keeps_a_film_that_is_there_and_makes_one_of_pictures_that_are(name, array, tmp_path):
    def submit(*outputs):
        job = array.submit(MOBILE, output=[tmp_path / o for o in outputs], frames=(1, 3), resume=True, **SMALL)
        return job.wait().skipped

    assert submit("m.gif") == 0
    film, looks = (tmp_path / "m.gif").read_bytes(), (tmp_path / "m.gif").stat()
    assert submit("m.gif") == 3
    assert (tmp_path / "m.gif").stat().st_ino == looks.st_ino
    assert submit("m.gif", "%d.png") == 0
    (tmp_path / "m.gif").unlink()
    assert submit("m.gif", "%d.png") == 3
    assert (tmp_path / "m.gif").read_bytes() == film


def test_pictures_of_render_are_known_to_submit(name, array, tmp_path):
    names = ("-o", str(tmp_path / "%d.png"))
    assert here("render", str(MOBILE), "--array", "1x1x1", *OPTIONS, *SHOT, *names, "--quiet").code == 0
    job = array.submit(MOBILE, output=tmp_path / "%d.png", frames=(22, 24), resume=True, **SMALL)
    assert job.wait().skipped == 3


# ---- what is read ----


def textured(folder):
    """A triangle with a texture; the files of the scene."""
    (folder / "spot.obj").write_text(
        "mtllib spot.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    )
    (folder / "spot.mtl").write_text("newmtl m\nKd 1 1 1\nmap_Kd spot.png\n")
    Image.fromarray(np.full((2, 2, 3), 99, np.uint8)).save(folder / "spot.png")
    return contents(folder)


def test_a_job_does_not_write_over_what_its_scene_reads(name, array, tmp_path):
    before = textured(tmp_path)
    os.link(tmp_path / "spot.png", tmp_path / "hard.png")
    os.symlink("spot.mtl", tmp_path / "link.npy")
    for output in ("spot.png", "hard.png", "link.npy"):
        outcome = on(name, "submit", "spot.obj", *OPTIONS, "-q", "-o", output, cwd=tmp_path)
        one_line(
            outcome, 1, r"raygrid: job \d+ failed: .*the output is a file that the scene is made of, wanted another"
        )
    outcome = on(name, "submit", "spot.obj", *OPTIONS, "-o", "a.png", "-q", "--stats", "spot.mtl", cwd=tmp_path)
    one_line(outcome, 1, r"raygrid: job \d+ failed: .*spot.mtl: the output is a file that the scene is made of, .*")
    with pytest.raises(ArrayError, match="the same file as the scene"):
        array.submit(tmp_path / "spot.obj", output=tmp_path / "a.png", stats=tmp_path / "spot.obj", **SMALL).wait()
    assert {key: value for key, value in contents(tmp_path).items() if key in before} == before
    array.submit(tmp_path / "spot.obj", output=tmp_path / "a.npy", **SMALL).wait()


def test_no_output_is_the_journal(name, array, tmp_path):
    journal = state_directory(name) / "journal.sqlite"
    words = r".*the output is a file of the array 'test' that stays, wanted another"
    one_line(here("render", str(TINY), "-o", str(tmp_path / "a.png"), "--stats", str(journal)), 1, words)
    os.link(journal, tmp_path / "j.json")
    with pytest.raises(ArrayError, match=words):
        array.submit(TINY, output=tmp_path / "a.png", stats=tmp_path / "j.json", **SMALL).wait()
    (tmp_path / "j.json").unlink()
    with raygrid.connect(name) as other:
        assert other.jobs(1)[-1]["state"] == "failed"


def test_a_job_with_two_names_for_one_file_is_refused(array, tmp_path):
    os.symlink("a.npy", tmp_path / "b.npy")
    with pytest.raises(ArrayError, match=r"b\.npy: the output is the same file as the output .*a\.npy, wanted another"):
        array.submit(TINY, output=[tmp_path / "a.npy", tmp_path / "b.npy"], **SMALL).wait()
    with pytest.raises(ArrayError, match="the same file as the output"):  # a11.npy, of frames 11 and 1
        array.submit(MOBILE, output=[tmp_path / "a%d.npy", tmp_path / "a1%d.npy"], frames=(1, 11), **SMALL).wait()
    assert [path.name for path in tmp_path.iterdir()] == ["b.npy"]


def test_a_pipe_as_an_output_holds_nobody_up(name, array, tmp_path):
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(ArrayError, match="the output is a pipe, wanted a file"):
        array.submit(TINY, output=tmp_path / "a.png", **SMALL).wait()
