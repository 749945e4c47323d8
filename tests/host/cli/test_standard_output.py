"""Results on standard output (-), options for files that come twice, and folders that are made."""

import io
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.cli import RAYGRID, TINY, as_process, here, one_line, warm_kernels
from support.render import SCENES, rendered
from support.terminal import Terminal

from raygrid.host.scene.load import load_scene

__all__ = ["warm_kernels"]

pytestmark = pytest.mark.usefixtures("no_leftovers", "warm_kernels")

SMALL = ("--array", "1x1x1", "--size", "8x6", "--samples", "1", "--quiet")


def test_a_picture_goes_down_a_pipe(tmp_path):
    done = subprocess.run(
        [RAYGRID, "render", TINY, *SMALL, "-o", "-", "-o", "a.npy"], capture_output=True, cwd=tmp_path, timeout=150
    )
    assert (done.returncode, done.stderr) == (0, b"")
    picture = rendered(load_scene(TINY), size=(8, 6), samples=1)
    with Image.open(io.BytesIO(done.stdout)) as image:
        assert image.format == "PNG"
        assert np.array_equal(np.asarray(image), picture.bytes())
    assert [path.name for path in tmp_path.iterdir()] == ["a.npy"]


def test_statistics_go_down_a_pipe_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = here("render", TINY, *SMALL, "-o", "a.png", "--stats", "-")
    assert (outcome.code, outcome.err) == (0, "")
    assert json.loads(outcome.out)["size"] == [8, 6]
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_simulate_tells_what_came_out_as_json(tmp_path):
    outcome = here(
        "simulate", TINY, *SMALL, "--cost", "unit", "--no-band", "--json", "--stats", str(tmp_path / "a.json")
    )
    assert outcome.code == 0
    told, written = json.loads(outcome.out), json.loads((tmp_path / "a.json").read_text())
    assert told["ticks"] == written["ticks"] > 0
    assert set(told) == set(written)


def test_simulate_writes_its_statistics_to_a_pipe_and_its_summary_beside(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = here("simulate", TINY, *SMALL, "--cost", "unit", "--no-band", "--stats", "-")
    assert outcome.code == 0
    assert json.loads(outcome.out)["size"] == [8, 6]
    assert "machine: 1x1x1 processors" in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_export_writes_to_a_pipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = here("export", TINY, "-o", "-")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("// tiny.nff, exported by raygrid")
    assert outcome.out == here_file(tmp_path)


def here_file(folder):
    """What export writes to a file."""
    assert here("export", TINY, "-o", str(folder / "a.pov")).code == 0
    return (folder / "a.pov").read_text()


def test_a_picture_is_not_shown_to_a_terminal(tmp_path):
    with Terminal([RAYGRID, "render", TINY, *SMALL, "-o", "-"], tmp_path) as terminal:
        terminal.wait_for("standard output is a terminal, wanted a pipe or a file for a picture")
        assert terminal.wait_end() == 1


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["render", TINY, "-o", "-", "--stats", "-"], "-: standard output came twice, wanted it once"),
        (["render", TINY, "-o", "-", "-o", "-"], "-: standard output came twice, wanted it once"),
        (["render", TINY, "--probe-record", "-"], "-: the output is standard output, wanted the name of a file"),
        (
            ["render", str(SCENES / "mobile.toml"), "--frames", "1", "-o", "-"],
            "-: the output is standard output, wanted .*",
        ),
        (
            ["render", str(SCENES / "mobile.toml"), "--frames", "1-2", "-o", "-"],
            "-: several frames would go to this one .*",
        ),
        (["submit", TINY, "-o", "-"], "-: the output is standard output, wanted a file, since the service writes it"),
        (["submit", TINY, "--stats", "-"], "-: the output is standard output, wanted the name of a file"),
    ],
    ids=lambda value: " ".join(value[1:]) if isinstance(value, list) else "",
)
def test_what_standard_output_is_not_for(arguments, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one_line(here(*arguments), 2, f"raygrid {arguments[0]}: {line}.*")


def test_a_reader_that_goes_away_is_no_error(tmp_path):
    read, write = os.pipe()
    os.close(read)
    with open(write, "wb") as out:
        assert as_process("render", TINY, *SMALL, "-o", "-", stdout=out, cwd=tmp_path) == (0, "", "")


def test_standard_output_that_is_full_is_one_line(tmp_path):
    with open("/dev/full", "w") as full:
        outcome = as_process("render", TINY, *SMALL, "--stats", "-", "-o", "a.png", stdout=full, cwd=tmp_path)
    one_line(outcome, 1, r"raygrid: standard output cannot be written \(No space left on device\)")


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (("render", TINY), "--stats"),
        (("render", TINY), "--probe-record"),
        (("render", TINY), "--chrome-trace"),
        (("simulate", TINY), "--csv"),
        (("simulate", TINY), "--plots"),
        (("submit", TINY), "--stats"),
        (("export", TINY), "--output"),
        (("law", TINY), "--output"),
        (("probe",), "--record"),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0],
)
def test_of_two_files_for_one_option_none_is_lost(command, option, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = here(*command, option, "a", option, "b")
    one_line(outcome, 2, rf"raygrid {command[0]}: {option}: came more than once, wanted it once .*")
    assert list(tmp_path.iterdir()) == []


# ---- folders ----


@pytest.mark.parametrize("spoilt", ["s 1 2\n", None])
def test_a_law_that_fails_leaves_no_folder(tmp_path, monkeypatch, spoilt):
    monkeypatch.chdir(tmp_path)
    scene = "none.nff" if spoilt is None else "bad.nff"
    if spoilt is not None:
        Path(scene).write_text(spoilt)
    assert here("law", scene, "-o", "report", "--quiet").code == 1
    assert not Path("report").exists()
    Path("there").mkdir()
    assert here("law", scene, "-o", "there", "--quiet").code == 1
    assert Path("there").is_dir()


def test_the_folder_of_plots_is_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plain = ("simulate", TINY, *SMALL, "--cost", "unit", "--no-band", "--plots")
    assert here(*plain, "plots").code == 0
    assert sorted(path.name for path in Path("plots").iterdir()) == ["busy.png", "links.png", "time.png"]
    one_line(here(*plain, "a/b"), 1, r"raygrid: a/b: there is no directory a, wanted one that is there")
    Path("file").touch()
    one_line(here(*plain, "file"), 1, r"raygrid: file: the output is a file, wanted a folder")
