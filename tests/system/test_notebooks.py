"""The notebooks of docs/notebooks run from top to bottom, and are kept without what they printed."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from support.cli import warm_kernels
from support.paths import ROOT

__all__ = ["warm_kernels"]

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
HAS_JUPYTER = all(importlib.util.find_spec(name) is not None for name in ("nbclient", "nbformat", "ipykernel"))
needs_jupyter = pytest.mark.skipif(not HAS_JUPYTER, reason="nbclient and ipykernel are not installed: the extra docs")
CELL_SECONDS = 250  # only a failing test takes as long


# in a process of its own, since what speaks to kernels keeps sockets until its process ends
EXECUTE = """
import sys
import nbclient, nbformat
given, made, folder, seconds = sys.argv[1:]
client = nbclient.NotebookClient(nbformat.read(given, as_version=4), timeout=int(seconds), resources={"metadata": {"path": folder}})
nbformat.write(client.execute(), made)
"""


class Ran(NamedTuple):
    """How a notebook went: whether to its end, what was said of it, and what its cells put out."""

    whole: bool
    said: str
    outputs: list[dict[str, Any]]


@pytest.fixture
def run(tmp_path):
    """Runs a notebook in an empty folder."""
    own = {name: str(tmp_path / name.lower()) for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR")}
    folder, made = tmp_path / "here", tmp_path / "made.ipynb"
    folder.mkdir()

    def run_notebook(path: Path) -> Ran:
        words = [sys.executable, "-c", EXECUTE, str(path), str(made), str(folder), str(CELL_SECONDS)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=2 * CELL_SECONDS, env=os.environ | own)
        cells = json.loads(made.read_text())["cells"] if made.exists() else []
        return Ran(done.returncode == 0, done.stderr, [out for cell in cells for out in cell.get("outputs", ())])

    return run_notebook


@pytest.fixture
def notebook_of(tmp_path):
    """Writes a notebook of one cell."""

    def write(code: str) -> Path:
        cell = {"id": "a", "cell_type": "code", "source": code, "metadata": {}, "outputs": [], "execution_count": None}
        kept = json.loads(NOTEBOOKS[0].read_text()) | {"cells": [cell]}
        path = tmp_path / "one.ipynb"
        path.write_text(json.dumps(kept))
        return path

    return write


def test_there_are_three():
    assert len(NOTEBOOKS) >= 3


@needs_jupyter
@pytest.mark.timeout(600)
@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, run):
    ran = run(path)
    assert ran.whole, ran.said
    assert ran.outputs
    assert not [out for out in ran.outputs if out["output_type"] == "error" or out.get("name") == "stderr"]


@needs_jupyter
def test_a_picture_is_shown(run, notebook_of):
    """So that what the notebooks say of a last value is so."""
    ran = run(notebook_of("import numpy as np\nimport raygrid\nraygrid.Picture(np.zeros((4, 4, 3), np.int64), 1, {})"))
    assert [sorted(out["data"]) for out in ran.outputs] == [["image/png", "text/plain"]], ran.said


@needs_jupyter
def test_a_cell_that_fails_is_seen(run, notebook_of):
    ran = run(notebook_of("assert 1 == 2, 'not so'"))
    assert not ran.whole
    assert "AssertionError" in ran.said
    assert "not so" in ran.said


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_outputs(path: Path):
    kept = json.loads(path.read_text())
    assert kept["nbformat"] == 4
    assert set(kept["metadata"]) == {"kernelspec", "language_info"}
    for cell in kept["cells"]:
        assert cell["id"].startswith(path.stem)
        assert cell["metadata"] == {}
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None
    assert kept["cells"][0]["source"][0].startswith("# ")
