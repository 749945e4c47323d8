"""The command line where the surroundings are odd: closed streams, names of any bytes, a working directory that is gone."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.cli import RAYGRID, TIMEOUT, TINY, as_process, here, one_line, warm_kernels
from support.render import SCENES

__all__ = ["warm_kernels"]

pytestmark = pytest.mark.usefixtures("warm_kernels", "no_leftovers")

ODD = os.fsdecode(b"caf\xe9")
CLOSED = ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"]


def in_shell(command: str, *words: str, cwd: object) -> subprocess.CompletedProcess[str]:
    """Run a line of the shell, in which "$@" is the words."""
    return subprocess.run(
        ["bash", "-c", command, "bash", *words], cwd=str(cwd), capture_output=True, text=True, timeout=TIMEOUT
    )


@pytest.mark.parametrize("closed", CLOSED)
def test_a_picture_is_made_with_closed_streams(closed, tmp_path):
    """It failed with "node 0,0,0 ended: OSError: Bad file descriptor", and without any word if all were closed."""
    done = in_shell(f'"$@" {closed}', RAYGRID, "render", TINY, "--size", "9x9", "-o", "x.png", cwd=tmp_path)
    said = "" if ">&- 2" in closed or closed == ">&-" else "x.png\n"
    assert (done.returncode, done.stdout, done.stderr) == (0, said, "")
    assert [path.name for path in tmp_path.iterdir()] == ["x.png"]


@pytest.mark.parametrize(
    ("words", "closed"),
    [(["trace", TINY, "--pixel", "9,9"], ">&-"), *((words, CLOSED[-1]) for words in (["--version"], ["render"]))],
    ids=str,
)
def test_words_with_closed_streams(words, closed, tmp_path):
    """`trace` was "a bug" with a closed standard output."""
    done = in_shell(f'"$@" {closed}', RAYGRID, *words, cwd=tmp_path)
    assert done.returncode == (2 if words == ["render"] else 0), done.stderr
    assert "a bug" not in done.stderr


def test_help_for_a_full_disk_is_no_bug(tmp_path):
    done = in_shell('"$@" >/dev/full', RAYGRID, "--help", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr == "raygrid: standard output cannot be written (No space left on device)\n"


def test_names_that_are_not_utf_8(tmp_path):
    """Read, written and printed as the bytes that they are, in a locale that would refuse them; export was "a bug"."""
    scene = tmp_path / f"{ODD}.nff"
    scene.write_bytes(Path(TINY).read_bytes())
    environment = {"LC_ALL": "C.UTF-8", "PYTHONIOENCODING": "utf-8:strict"}
    text = {"cwd": tmp_path, "errors": "surrogateescape", "environment": environment}
    done = as_process("export", scene.name, **text)
    assert (done.code, done.out, done.err) == (0, f"{ODD}.pov\n", "")
    assert b"// caf\\xe9.nff, exported" in (tmp_path / f"{ODD}.pov").read_bytes()
    done = as_process("info", scene.name, **text)
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("name: caf\\xe9.nff\n")
    one_line(
        as_process("render", f"{ODD}.xyz", **text), 2, r"raygrid render: caf\\xe9\.xyz: the file has the suffix .*"
    )


WITHOUT_A_PLACE = [
    (["info", "tiny.nff"], "raygrid: the working directory is gone, wanted one that is there"),
    (["render", TINY, "--size", "9x9"], "raygrid: the working directory is gone, wanted one that is there"),
    (["export", TINY], "raygrid: the working directory is gone, wanted one that is there"),
    (["law", TINY], r"raygrid: .*(the working directory is gone|cannot be made|no directory).*"),
    (["simulate", TINY, "--csv", "a.csv"], "raygrid: the working directory is gone, wanted one that is there"),
]


@pytest.mark.parametrize(
    ("words", "said"), WITHOUT_A_PLACE, ids=lambda value: value[0] if isinstance(value, list) else ""
)
def test_a_working_directory_that_is_gone(words, said, tmp_path):
    (tmp_path / "gone").mkdir()
    done = in_shell('cd gone && rmdir ../gone && "$@"', RAYGRID, *words, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(said + "\n", done.stderr), done.stderr


def test_a_program_is_tried_where_the_working_directory_is_gone(tmp_path):
    """Nodes said: "the program torus fails: FileNotFoundError"."""
    (tmp_path / "gone").mkdir()
    words = ("load", str(SCENES / "programs" / "torus.py"), "--allow-programs", "--array", "1x1x1")
    done = in_shell('cd gone && rmdir ../gone && "$@"', RAYGRID, *words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("1 nodes run torus")


@pytest.mark.parametrize("name", ["x.toml", "x.gltf"])
def test_a_number_of_five_thousand_digits(name, tmp_path):
    text = {"x.toml": "[image]\nwidth = {}\n", "x.gltf": '{{"asset": {{"version": "2.0"}}, "scene": {}}}'}[name]
    (tmp_path / name).write_text(text.format("9" * 5000))
    kind = name[2:].replace("gl", "").upper() if name == "x.toml" else "JSON"
    said = rf"raygrid: .*{name}: the {kind} cannot be read \(a number in it has too many digits\)"
    one_line(here("info", str(tmp_path / name)), 1, said)


def test_a_cost_model_with_a_number_of_five_thousand_digits(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.toml").write_text(f"hertz = {'9' * 5000}\n")
    said = r"raygrid: x\.toml: the TOML cannot be read \(a number in it has too many digits\)"
    one_line(here("simulate", TINY, "--cost", "x.toml"), 1, said)


@pytest.mark.parametrize("folder", ["/proc/x", "/proc"])
def test_a_report_of_the_law_where_none_can_be(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one_line(here("law", TINY, "-o", folder), 1, r"raygrid: /proc.*(cannot be made|no such file can be made).*")


def test_python_runs_the_package(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "raygrid", "info", "gone.nff"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "raygrid: gone.nff: there is no such file\n")
    done = subprocess.run([sys.executable, "-m", "raygrid", "--version"], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.startswith("raygrid, version ")
