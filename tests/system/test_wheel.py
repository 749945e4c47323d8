"""Installed from a wheel into an empty environment: all of it is there, nothing else is, and everything works. `make wheel-check`"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.docs import PAGES, files_of, marked, names_up, small, snippets
from support.modules import read_modules
from support.paths import ROOT, SCENES

LAYERS = ("node", "emulator", "host")
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
LONG = 800  # seconds for a first run, which compiles
# On a slow computer compiling takes longer than a command waits for it.
WARM = f"""
from raygrid.emulator.processes.fork_server_client import ForkServerClient
with ForkServerClient.start() as fork_server:
    fork_server.wait_warm({LONG})
"""


def test_all_packages_are_listed():
    found = {f"raygrid.{name}" for name, module in read_modules(ROOT).items() if module.is_package}
    found = found - {"raygrid.host.facade"} | {"raygrid"}
    assert set(SETTINGS["tool"]["setuptools"]["packages"]) == found


def installed_as(path: Path) -> str:
    """Where a source file lies in the wheel."""
    name = path.relative_to(ROOT).as_posix()
    return "raygrid/" + name.removeprefix("host/facade/")


def split_bounds(wanted: str) -> tuple[str, ...]:
    """A library and its bounds, however they are ordered."""
    name, *bounds = re.split(r"(?=[<>])|,", wanted.replace(" ", ""))
    return (name, *sorted(filter(None, bounds)))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built from a copy of the sources, since building writes beside them."""
    copied = tmp_path_factory.mktemp("sources")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copied)
    for layer in LAYERS:
        shutil.copytree(ROOT / layer, copied / layer, ignore=shutil.ignore_patterns("__pycache__"))
    made = tmp_path_factory.mktemp("wheel")
    call(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(made), str(copied))
    (path,) = made.glob("raygrid-*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The bin directory of an environment into which the wheel was installed, and nothing else of ours."""
    home = tmp_path_factory.mktemp("environment")
    call(sys.executable, "-m", "venv", str(home))
    call(str(home / "bin" / "python"), "-m", "pip", "install", "--quiet", str(wheel))
    return home / "bin"


@pytest.fixture(scope="module")
def complete(installed, wheel):
    """The same environment, with the libraries that pages name as extras."""
    call(str(installed / "python"), "-m", "pip", "install", "--quiet", f"{wheel}[law,prometheus,exr]")
    return installed


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory):
    """A user who has never run raygrid: nothing compiled, no state, no path to the sources."""
    home = tmp_path_factory.mktemp("user")
    mine = {"HOME": str(home), "RAYGRID_CACHE": str(home / "kernels"), "XDG_STATE_HOME": str(home / "state")}
    return {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")} | mine


def call(*words: str, **options: object) -> str:
    done = subprocess.run(words, capture_output=True, text=True, timeout=LONG + 60, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}\n{done.stderr}"
    return str(done.stdout)


@pytest.mark.slow
def test_the_wheel_has_what_the_sources_have_and_nothing_else(wheel):
    suffixes = {".py", ".pyi", ".toml", ".typed"}
    wanted = {
        installed_as(path)
        for layer in LAYERS
        for path in (ROOT / layer).rglob("*")
        if path.suffix in suffixes or path.name == "py.typed"
    }
    with zipfile.ZipFile(wheel) as packed:
        names = set(packed.namelist())
    ours = {name for name in names if ".dist-info/" not in name}
    unmarked = {"raygrid/node/py.typed", "raygrid/emulator/py.typed"}  # that of raygrid holds for all below it
    assert wanted - ours <= unmarked
    assert ours <= wanted
    assert {"raygrid/aio.py", "raygrid/host/scene/demo.toml"} <= ours
    assert {"raygrid/py.typed", "raygrid/emulator/costs/8086.toml", "raygrid/node/tracing/__init__.pyi"} <= ours
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"raygrid"}


@pytest.mark.slow
def test_the_wheel_says_what_it_is(wheel):
    project = SETTINGS["project"]
    with zipfile.ZipFile(wheel) as packed:
        (name,) = (name for name in packed.namelist() if name.endswith(".dist-info/METADATA"))
        said = message_from_bytes(packed.read(name))
    assert said.get_all("Classifier") == project["classifiers"]
    assert said["Name"] == "raygrid"
    assert said["Version"] == project["version"]
    assert said["Requires-Python"] == project["requires-python"]
    assert said["License-Expression"] == project["license"]
    assert said["Summary"] == project["description"]
    assert said["Description-Content-Type"] == "text/markdown"
    assert sorted(said.get_all("Provides-Extra")) == sorted(project["optional-dependencies"])
    assert said.get_payload().lstrip().startswith("# raygrid")
    plain = [wanted for wanted in said.get_all("Requires-Dist") if "extra ==" not in wanted]
    assert {split_bounds(wanted) for wanted in plain} == {split_bounds(wanted) for wanted in project["dependencies"]}


@pytest.mark.slow
def test_nothing_but_raygrid_lies_at_the_top(installed, surroundings, tmp_path):
    look = "from importlib.metadata import files; print(*sorted({str(file).partition('/')[0] for file in files('raygrid')}))"
    top = call(str(installed / "python"), "-c", look, env=surroundings, cwd=tmp_path).split()
    version = SETTINGS["project"]["version"]
    assert top == ["..", "raygrid", f"raygrid-{version}.dist-info"]  # .. is bin/raygrid
    where = Path(
        call(str(installed / "python"), "-c", "import raygrid; print(raygrid.__file__)", env=surroundings).strip()
    )
    assert where.is_relative_to(installed.parent)
    assert not {"node", "emulator", "host", "tests"} & {path.name for path in where.parents[1].iterdir()}


@pytest.mark.slow
@pytest.mark.timeout(4 * LONG)
@pytest.mark.usefixtures("no_leftovers")
def test_everything_works_from_there(installed, surroundings, tmp_path):
    scene = tmp_path / "tiny.nff"
    shutil.copy(SCENES / "tiny.nff", scene)

    def raygrid(*words: str) -> str:
        return call(str(installed / "raygrid"), *words, env=surroundings, cwd=tmp_path)

    few = ["--size", "24x16", "--samples", "1"]
    call(str(installed / "python"), "-c", WARM, env=surroundings, cwd=tmp_path)
    raygrid("render", "tiny.nff", "--array", "2x1x1", *few, "-o", "render.png", "-q")
    raygrid("demo", "--array", "2x1x1", *few, "-q")
    assert Image.open(tmp_path / "demo.png").size == (24, 16)
    told = raygrid("simulate", "tiny.nff", "--array", "2x1x1", "--cost", "8086", *few)
    assert "ticks" in told or "seconds" in told
    raygrid("up", "--array", "2x1x1", "--name", "wheel")
    try:
        raygrid("submit", "tiny.nff", "--name", "wheel", *few, "-o", "submit.png")
    finally:
        raygrid("down", "--name", "wheel")
    rendered, submitted = (np.asarray(Image.open(tmp_path / name)) for name in ("render.png", "submit.png"))
    assert np.array_equal(rendered, submitted)  # not the files: those of a service carry marks for --resume


def as_a_reader(page: Path, folder: Path) -> Path:
    """A folder with what a page takes for granted: the scenes, a folder for pictures, the files that it lets its reader write."""
    folder.mkdir()
    (folder / "scenes").symlink_to(SCENES)
    (folder / "out").mkdir()
    for name, text in files_of(page).items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(4 * LONG)
@pytest.mark.usefixtures("no_leftovers")
def test_marked_lines_run_from_there(complete, surroundings, tmp_path):
    """Every line of README, docs and tutorials that is marked, as a reader would type it who has only the wheel and the scenes."""
    raygrid = str(complete / "raygrid")
    call(str(complete / "python"), "-c", WARM, env=surroundings, cwd=tmp_path)
    ran = 0
    for page in PAGES:
        for number, lines in enumerate(marked(page)):
            folder = as_a_reader(page, tmp_path / f"{page.stem}-{number}")
            try:
                for line in lines:
                    if not any(word.endswith(".mp4") for word in line.words) or shutil.which("ffmpeg") is not None:
                        call(raygrid, *small(line.words), env=surroundings, cwd=folder)
                        ran += 1
            finally:
                for name in names_up(lines):
                    subprocess.run([raygrid, "down", "--cancel", "--name", name], env=surroundings, timeout=LONG)
    assert ran > 70


@pytest.mark.slow
@pytest.mark.timeout(4 * LONG)
@pytest.mark.usefixtures("no_leftovers")
def test_snippets_and_notebooks_run_from_there(complete, surroundings, tmp_path):
    """Every Python block, and the cells of every notebook, one after the other, as a program."""
    python, raygrid = str(complete / "python"), str(complete / "raygrid")
    call(python, "-c", WARM, env=surroundings, cwd=tmp_path)
    programs = [(page, snippet) for page in PAGES for snippet, _ in snippets(page)]
    programs += [(path, cells_of(path)) for path in NOTEBOOKS]
    call(raygrid, "up", "--array", "2x1x1", "--name", "film", env=surroundings, cwd=tmp_path)
    try:
        for number, (page, program) in enumerate(programs):
            folder = as_a_reader(page, tmp_path / str(number)) if page.suffix == ".md" else tmp_path
            call(python, "-c", program, env=surroundings, cwd=folder)
    finally:
        call(raygrid, "down", "--cancel", "--name", "film", env=surroundings, cwd=tmp_path)
    assert len(programs) > 15


def cells_of(notebook: Path) -> str:
    """The code of a notebook as one program."""
    cells = json.loads(notebook.read_text())["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
