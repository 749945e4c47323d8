"""raygrid render --frames and --turntable: names, files that play, and what is refused before the work."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin
from support.cli import here, one_line, warm_kernels
from support.paths import ROOT
from support.render import SCENES

from raygrid.emulator.driver.admission import Progress
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.cli.commands.frames import as_ranges
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.image.ffmpeg import SHIPS, find_ffmpeg
from raygrid.host.image.moving_pictures import Reel, waiting
from raygrid.host.image.resume_check import KEYWORD
from raygrid.host.render.animation_jobs import jobs_of
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings
from raygrid.host.scene.animation.turntable import turntable
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import OutputError
from raygrid.node.protocol.packets import PRIMARY

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
    assert np.array_equal(pixels(tmp_path / "a.png"), pixels(tmp_path / "b.png"))


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
        (("--frames", "1-2", "-o", "%d_%d.png"), 2, r"raygrid render: .*2 places for the frame's number.*"),
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
        (("-o", "%d.png", "--profile"), 2, r".*--profile, .* came with several frames, wanted a single one.*"),
        (("--stats", "%d.json", "--timed"), 2, r".*--timed came with --frames.*"),
        (("-o", "nowhere/x.gif"), 1, "raygrid: nowhere/x.gif: there is no directory.*"),
    ],
)
def test_what_cannot_be_is_refused_before_the_work(arguments, code, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one_line(here("render", MOBILE, *SMALL, *arguments), code, said)


# --- going on --------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_resume_renders_only_what_is_missing_or_edited(tmp_path):
    gif, plain = str(tmp_path / "m.gif"), tuple(word for word in SMALL if word != "--quiet")
    shot = ("render", MOBILE, "--frames", "22-25", "-o", str(tmp_path / "m_%03d.png"), "-o", gif)
    assert here(*shot, *SMALL).code == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / "m_023.png").unlink()
    with Image.open(tmp_path / "m_024.png") as image:
        kept, edited = PngImagePlugin.PngInfo(), image.copy()
    kept.add_text(KEYWORD, image.info[KEYWORD])
    edited.putpixel((0, 0), (1, 2, 3))
    edited.save(tmp_path / "m_024.png", pnginfo=kept)
    (tmp_path / "m.gif").unlink()
    outcome = here(*shot, *plain, "--resume")
    assert outcome.code == 0
    assert outcome.out.split() == [str(tmp_path / "m_023.png"), str(tmp_path / "m_024.png"), gif]
    assert "2 of 4 frames were there already" in outcome.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert here(*shot, *SMALL, "--resume", "--transfer", "linear").out.count("m_0") == 4


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_what_has_no_digest_of_its_own_is_rendered_again(tmp_path):
    shot = ("render", MOBILE, "--frames", "1-2", "-o", str(tmp_path / "%d.npy"), *SMALL)
    assert here(*shot).code == 0
    assert here(*shot, "--resume").out.count(".npy") == 2


def test_resume_is_for_shots():
    one_line(here("render", TINY, "--resume"), 2, "raygrid render: --resume came without frames, wanted --frames.*")


class Bar:
    """What a bar of rich would be told."""

    def __init__(self):
        self.total, self.completed, self.details = None, [], []

    def add_task(self, what, total, detail):
        self.total = total
        return 0

    def update(self, task, completed=None, detail=None, description=None):
        self.completed += [] if completed is None else [completed]
        self.details += [] if detail is None else [detail]

    def remove_task(self, task):
        pass

    def refresh(self):
        pass


def test_the_progress_of_a_shot_is_that_of_all_its_frames():
    reporter = ProgressReporter(quiet=True)
    reporter._bar, reporter._task = Bar(), 0
    reporter.shot(4)
    assert reporter._bar.total == 4
    reporter.expect(100)
    born = tuple(50 * (kind == PRIMARY) for kind in range(8))
    for done in range(4):
        reporter.frame(11 + done, done, skipped=1 if done else 0)
        reporter.watch("trace", None)
        reporter.watch("trace", Progress(born, born, 0) if done else None)
    assert reporter._bar.total == 4
    shown = reporter._bar.completed
    assert shown == sorted(shown)
    assert shown[-1] == 3.5
    assert reporter._bar.details[-1].startswith("3 of 4 done, ")


# --- films ---------------------------------------------------------------------------------------


@pytest.fixture
def ffmpeg():
    """The real one."""
    program = find_ffmpeg()
    if program is None:
        pytest.skip("there is no ffmpeg here: apt-get install ffmpeg, or pip install 'raygrid[mp4]'")
    return program


def noise(count, size=(64, 48)):
    """Frames that no codec makes small."""
    random = np.random.default_rng(5)
    return [random.integers(0, 256, (size[1], size[0], 3), np.uint8) for _ in range(count)]


def play(path, pictures, fps=24.0):
    with waiting() as reel:
        for number, picture in enumerate(pictures, 3):
            reel.add(number, picture)
        reel.play(str(path), range(3, 3 + len(pictures)), fps)


def decoded(ffmpeg, path):
    """The frames of a film, as ffmpeg decodes them."""
    command = [ffmpeg, "-nostdin", "-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    return subprocess.run(command, capture_output=True, check=True, timeout=60).stdout


def test_a_film_has_all_frames_in_order(tmp_path, ffmpeg):
    pictures = [np.full((48, 64, 3), value, np.uint8) for value in (0, 80, 160, 240)]
    play(tmp_path / "a.mp4", pictures)
    frames = np.frombuffer(decoded(ffmpeg, tmp_path / "a.mp4"), np.uint8).reshape(4, 48, 64, 3)
    assert np.abs(frames.mean(axis=(1, 2, 3)) - [0, 80, 160, 240]).max() < 3
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_odd_sides_are_padded_and_that_is_said(tmp_path, ffmpeg):
    film = str(tmp_path / "50%%.mp4")
    loud = ("--array", "2x1x1", "--size", "33x25", "--samples", "1")
    outcome = here("render", MOBILE, "--frames", "1-2", *loud, "-o", film)
    assert (outcome.code, outcome.out) == (0, str(tmp_path / "50%.mp4") + "\n")
    assert "black is added at the right or below: 33x25 becomes 34x26" in outcome.err
    assert len(decoded(ffmpeg, tmp_path / "50%.mp4")) == 2 * 34 * 26 * 3


@pytest.mark.parametrize("room", [0, 1_000, 20_000])
def test_a_film_on_a_full_disk_is_an_error_and_no_file(tmp_path, monkeypatch, ffmpeg, room):
    """The real ffmpeg under a limit of the size of files that fails a write as a full disk does: it ends with 0."""
    limited = f"resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))"
    ignored = "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)"
    body = f"import os, resource, signal\n{ignored}\n{limited}\nos.execv({ffmpeg!r}, sys.argv)"
    out = tmp_path / "out"
    out.mkdir()
    _fake_ffmpeg(tmp_path, monkeypatch, body)
    with pytest.raises(OutputError, match=r"a.mp4: ffmpeg has failed \(.*File too large"):
        play(out / "a.mp4", noise(4, (128, 96)))
    assert list(out.iterdir()) == []


def test_a_film_on_a_disk_without_room(tmp_path, ffmpeg):
    """A real one of 64 kB, where this computer lets us have it."""
    disk = tmp_path / "disk"
    disk.mkdir()
    own = ["unshare", "--map-root-user", "--mount", "sh", "-ec"]
    mounted = f"mount -t tmpfs -o size=64k none {disk}; "
    if shutil.which("unshare") is None or subprocess.run([*own, mounted], capture_output=True).returncode != 0:
        pytest.skip("no file system can be mounted here")
    film = f"{disk}/a.mp4"
    here_too = [str(Path(__file__).parent), str(ROOT / "tests")]
    code = f"import sys; sys.path[:0] = {here_too!r}; import test_frames as t; t.play({film!r}, t.noise(8, (200, 100)))"
    command = f"{mounted} {sys.executable} -c '{code.replace(chr(39), chr(34))}' || true; ls -A {disk}"
    done = subprocess.run([*own, command], capture_output=True, text=True, timeout=120)
    assert re.search(r"OutputError: .*a.mp4: .*(No space left on device|ffmpeg has failed)", done.stderr), done.stderr
    assert done.stdout == ""


def test_a_film_that_lacks_frames_is_none(tmp_path, monkeypatch, ffmpeg):
    """An ffmpeg that says nothing and writes half."""
    half = "2 if sys.argv[i - 1] == '-frames:v' else a"
    body = f"import os\nos.execv({ffmpeg!r}, [str({half}) for i, a in enumerate(sys.argv)])"
    _fake_ffmpeg(tmp_path, monkeypatch, body)
    with pytest.raises(OutputError, match=r"a.mp4: the film that ffmpeg wrote has 2 frames, wanted 4"):
        play(tmp_path / "a.mp4", noise(4))
    assert [path.name for path in tmp_path.iterdir()] == ["bin"]


def _fake_ffmpeg(tmp_path: Path, monkeypatch, body: str) -> None:
    """A program of that name first on the path: it gets what ffmpeg would get."""
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(f"#!{sys.executable}\nimport sys\n{body}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")


def test_an_ffmpeg_that_fails_is_one_error_with_its_words(tmp_path, monkeypatch):
    _fake_ffmpeg(tmp_path, monkeypatch, "print('no such codec', file=sys.stderr)\nsys.exit(3)")
    with pytest.raises(OutputError, match=r"a.mp4: ffmpeg has failed \(no such codec\)"):
        play(tmp_path / "a.mp4", noise(1))
    assert [path.name for path in tmp_path.iterdir()] == ["bin"]


def test_a_film_is_given_up_at_once(tmp_path, monkeypatch):
    """An ffmpeg that never ends; the fixture of the file sees whether it is left."""
    _fake_ffmpeg(tmp_path, monkeypatch, "import signal\nsignal.pause()")

    class GivenUp(Exception):
        pass

    def look():
        raise GivenUp

    frames = tmp_path / "frames"
    frames.mkdir()
    reel = Reel(str(frames), look)
    reel.add(1, noise(1)[0])
    for name in ("a.mp4", "a.gif", "a.webp"):
        with pytest.raises(GivenUp):
            reel.play(str(tmp_path / name), [1], 24.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bin", "frames"]


def test_without_ffmpeg_that_is_said_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, SHIPS, None)
    one_line(
        here("render", MOBILE, *SMALL, "-o", str(tmp_path / "x.mp4")),
        1,
        r"raygrid: .*x.mp4: there is no ffmpeg on this computer, wanted it for .mp4 "
        r"\(or the extra: pip install 'raygrid\[mp4\]'\), or .gif or .webp instead",
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


def test_frames_wait_where_a_percent_sign_is_in_the_path(tmp_path, monkeypatch, ffmpeg):
    odd = tmp_path / "50%d off"
    odd.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(odd))
    play(tmp_path / "a.mp4", noise(2))
    assert list(odd.iterdir()) == []
