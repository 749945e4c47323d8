"""The command line: help, outputs, exit codes, and what is said where."""

import io
import json
import re
import subprocess
import sys

import click
import numpy as np
import pytest
from PIL import Image
from support import paths
from support.cli import RAYGRID, TINY, as_process, here, warm_kernels
from support.render import EIGHT, SCENES, rendered
from support.terminal import HIDE, SHOW, Terminal

from raygrid.host.cli.main import cli
from raygrid.host.scene.load import READERS, load_scene

__all__ = ["warm_kernels"]

pytestmark = pytest.mark.usefixtures("warm_kernels")

README = paths.ROOT / "README.md"
SMALL = ("--size", "64x48")
COLOUR = re.compile(r"\x1b\[[\d;]+m")

# ---- help ----


def commands():
    """Every command with the words that lead to it."""
    found = [("raygrid", cli)]
    for name, command in cli.commands.items():
        assert isinstance(command, click.Command)
        found.append((f"raygrid {name}", command))
    return found


@pytest.mark.parametrize(("words", "command"), commands(), ids=lambda value: value if isinstance(value, str) else "")
def test_every_command_has_help_with_an_example_and_is_in_the_readme(words, command):
    outcome = here(*words.split()[1:], "--help")
    assert outcome.code == 0
    assert outcome.err == ""
    assert command.help.split("\n")[0] in " ".join(outcome.out.split())
    assert re.search(rf"Examples:\n( +raygrid .*\n)* +{words} \S+", outcome.out), "wanted an example"
    assert f"{words} " in README.read_text()


@pytest.mark.parametrize(
    ("words", "command"), commands()[1:], ids=lambda value: value if isinstance(value, str) else ""
)
def test_every_option_has_help(words, command):
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"{words} {parameter.opts[0]}"


@pytest.mark.parametrize(
    "line", re.findall(r"^ +(raygrid .*)$", re.sub(r" \\\n +", " ", here("render", "--help").out), re.M)
)
def test_examples_parse(line):
    _, name, *arguments = line.split()
    cli.commands[name].make_context(name, arguments)


@pytest.mark.parametrize(
    "arguments", [[], ["--help"], ["render", "--help"], ["info", "--help"], ["--version"]], ids=" ".join
)
def test_help_needs_no_heavy_libraries(arguments):
    script = (
        "import sys\nfrom raygrid.host.cli.main import main\n"
        f"try:\n    main({arguments!r})\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'zmq', 'PIL', 'rich', 'pydantic', 'trimesh'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_without_arguments_the_help_is_shown_and_the_code_is_that_of_misuse():
    outcome = here()
    assert (outcome.code, outcome.out) == (2, "")
    assert "Commands:" in outcome.err


def test_version():
    assert re.fullmatch(r"raygrid, version \d+\.\d+\.\d+\n", here("--version").out)


# ---- outputs ----


@pytest.mark.usefixtures("no_leftovers")
def test_render_writes_what_it_was_asked_for(tmp_path):
    """Several outputs, the exact sums among them, and the statistics; the same as by an array inside this process."""
    names = ["a.png", "deep/b.npy", "c.jpg", "d.PNG", "e.ppm"]
    (tmp_path / "deep").mkdir()
    outputs = [word for name in names for word in ("-o", name)]
    outcome = as_process("render", TINY, *SMALL, *outputs, "--stats", "stats.json", cwd=tmp_path)
    assert (outcome.code, outcome.err) == (0, "")  # quiet without a terminal
    assert outcome.out.split() == names
    picture = rendered(load_scene(TINY), EIGHT, size=(64, 48))
    sums = np.load(tmp_path / "deep" / "b.npy", allow_pickle=False)
    assert sums.dtype == np.int64
    assert sums.shape == (48, 64, 3)
    assert np.array_equal(sums, picture.sums)
    for name in ("a.png", "d.PNG", "e.ppm"):
        assert np.array_equal(image(tmp_path / name), picture.bytes("srgb")), name
    assert image(tmp_path / "c.jpg").shape == (48, 64, 3)
    assert (tmp_path / "deep" / "b.npy").read_bytes() == _as_numpy_saves(picture.sums)
    born = json.loads((tmp_path / "stats.json").read_text())["total"]["born"]
    assert born == picture.stats["total"]["born"]
    found = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert found == {*names, "stats.json"}


def image(path):
    """The bytes of a picture file."""
    with Image.open(path) as opened:
        return np.array(opened)


def _as_numpy_saves(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


@pytest.mark.usefixtures("no_leftovers")
def test_the_default_output_is_the_scene_s_name_here_and_settings_reach_the_frame(tmp_path):
    options = ["--array", "3x1x1", "--samples", "2", "--depth", "2", "--min-weight", "0.1", "--highlights"]
    machine = ["--split", "uniform", "--batch", "7", "--budget", "100", "--patience", "90", "-q"]
    outcome = as_process("render", TINY, *SMALL, *options, *machine, "--transfer", "linear", cwd=tmp_path)
    assert outcome == (0, "tiny.png\n", "")
    settings = {"samples": 2, "depth": 2, "min_weight": 0.1, "highlights": True, "split": "uniform"}
    picture = rendered(load_scene(TINY), (3, 1, 1), size=(64, 48), **settings)
    assert np.array_equal(image(tmp_path / "tiny.png"), picture.bytes("linear"))


@pytest.mark.usefixtures("no_leftovers")
def test_an_output_replaces_a_file_and_follows_a_link(tmp_path):
    (tmp_path / "old.png").write_text("old")
    (tmp_path / "real").mkdir()
    (tmp_path / "link.npy").symlink_to(tmp_path / "real" / "sums.npy")
    assert here("render", TINY, *SMALL, "-o", str(tmp_path / "old.png"), "-o", str(tmp_path / "link.npy")).code == 0
    assert image(tmp_path / "old.png").shape == (48, 64, 3)
    assert (tmp_path / "link.npy").is_symlink()
    assert np.load(tmp_path / "real" / "sums.npy").shape == (48, 64, 3)


# ---- info ----


def test_info_says_what_is_in_a_scene():
    text = here("info", str(SCENES / "kinds.nff")).out
    for line in ("name: kinds.nff", "  sphere: ", "  cone: ", "  polygon: ", "lights:", "camera:", "background: "):
        assert re.search(rf"^{line}", text, re.M), line
    facts = json.loads(here("info", "--json", str(SCENES / "kinds.nff")).out)
    assert facts["surfaces_total"] == sum(facts["surfaces"].values())
    assert facts["name"] == "kinds.nff"


@pytest.mark.parametrize("scene", sorted(path.name for path in SCENES.iterdir() if path.suffix in READERS))
def test_info_works_for_every_scene_of_ours(scene):
    outcome = here("info", str(SCENES / scene))
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith(f"name: {scene}\n")


def test_output_into_a_closed_pipe_is_no_error_message():
    done = subprocess.run(
        ["bash", "-c", f"'{RAYGRID}' info --json '{SCENES}/kinds.nff' | true; exit ${{PIPESTATUS[0]}}"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stderr == ""
    assert done.returncode in (0, 1)  # 0 if all was written before the reader ended


# ---- on a terminal ----


@pytest.mark.usefixtures("no_leftovers")
def test_a_terminal_sees_progress_and_is_left_clean(tmp_path):
    with Terminal(
        [RAYGRID, "render", TINY, "--size", "512x512", "--samples", "4", "-o", "x.png"], tmp_path
    ) as terminal:
        terminal.wait_for(r"reading .*tiny\.nff")
        terminal.wait_for(r"launching 8 processors")
        terminal.wait_for(r"loading surfaces")
        terminal.wait_for(r"tracing .*\d+\.\d\d M packets/s, \d+ s left")
        terminal.wait_for(r"collecting pixels")
        assert terminal.wait_end() == 0
        assert terminal.text.rindex(SHOW) > terminal.text.rindex(HIDE)
        assert re.fullmatch(
            r"[\d,]+ primary, [\d,]+ reflected, [\d,]+ refracted, [\d,]+ shadow rays; [\d,]+ hops\n"
            r"traced in \d+\.\d\d s of wall time \(\d+\.\d\d million rays/s\), \d+\.\d\d s in all\nx\.png",
            terminal.screen,
        ), terminal.screen
        assert COLOUR.search(terminal.text)


@pytest.mark.usefixtures("no_leftovers")
def test_no_color_is_honoured(tmp_path):
    arguments = [RAYGRID, "render", TINY, "--size", "300x300", "-o", "x.png"]
    with Terminal(arguments, tmp_path, {"NO_COLOR": "1"}) as terminal:
        assert terminal.wait_end() == 0
        assert "tracing" in terminal.text
        codes = [code for sequence in COLOUR.findall(terminal.text) for code in re.findall(r"\d+", sequence)]
        assert not [code for code in codes if code.startswith(("3", "4", "9", "10"))], "colours"


@pytest.mark.usefixtures("no_leftovers")
def test_a_dumb_terminal_gets_no_control_sequences(tmp_path):
    arguments = [RAYGRID, "render", TINY, *SMALL, "-o", "x.png"]
    with Terminal(arguments, tmp_path, {"TERM": "dumb"}) as terminal:
        assert terminal.wait_end() == 0
        assert "\x1b" not in terminal.text
        assert "primary" in terminal.text


@pytest.mark.usefixtures("no_leftovers")
def test_quiet_is_quiet_on_a_terminal_too(tmp_path):
    with Terminal([RAYGRID, "render", TINY, *SMALL, "-q", "-o", "x.png"], tmp_path) as terminal:
        assert terminal.wait_end() == 0
        assert terminal.text == "x.png\r\n"


# ---- notes ----


@pytest.mark.usefixtures("no_leftovers")
def test_notes_on_the_scene_are_told_without_a_terminal_too_but_not_to_the_quiet(tmp_path):
    """A mesh without camera and lights: both are invented, and said."""
    arguments = ("render", str(SCENES / "checker.obj"), *SMALL, "-o", str(tmp_path / "x.png"))
    outcome = here(*arguments)
    assert outcome.code == 0
    assert re.search(r"^note: no camera in the file: .+\nnote: no light in the file: .+$", outcome.err, re.M)
    assert here(*arguments, "--quiet").err == ""


@pytest.mark.usefixtures("no_leftovers")
def test_a_camera_that_looks_away_gives_the_background_and_a_note(tmp_path):
    scene = tmp_path / "away.nff"
    scene.write_text(
        "b 0.25 0.5 1 v from 0 -9 0 at 0 -10 0 up 0 0 1 angle 40 hither 1 resolution 20 10 l 1 1 9 s 0 0 0 1"
    )
    output = tmp_path / "x.png"
    outcome = here("render", str(scene), "--transfer", "linear", "-o", str(output))
    assert outcome.code == 0
    assert "note: no ray of the camera meets a surface: the picture shows the background only\n" in outcome.err
    assert (image(output) == (64, 128, 255)).all()
