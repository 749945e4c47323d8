"""Imports run host -> emulator -> node, and what is quick stays quick."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from support import paths

ROOT = paths.ROOT
MAY_IMPORT = {"node": {"node"}, "emulator": {"node", "emulator"}, "host": {"node", "emulator", "host"}}


def layers_imported(source: Path, layer: str) -> set[str]:
    """Layers that a file names in any import, within functions too; a relative one is of its own layer."""
    found = set()
    for node in ast.walk(ast.parse(source.read_text())):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                assert node.level == 1, f"{source}: imports from above its own layer"
                found.add(layer)
            elif node.module == "raygrid":
                names = [f"raygrid.{name.name}" for name in node.names]
            else:
                names = [node.module or ""]
        found |= {name.split(".")[1] for name in names if name.startswith("raygrid.")}
    return found


@pytest.mark.parametrize("layer", MAY_IMPORT)
def test_imports_run_one_way(layer):
    files = sorted((ROOT / layer).glob("*.py"))
    assert len(files) > 5
    for source in files:
        assert layers_imported(source, layer) <= MAY_IMPORT[layer], source


def test_the_check_sees_a_wrong_import(tmp_path):
    wrong = tmp_path / "wrong.py"
    wrong.write_text("def f():\n    from raygrid.host import cli\n")
    assert layers_imported(wrong, "node") == {"host"}


@pytest.mark.parametrize(
    ("program", "absent"),
    [
        ("import raygrid", {"numpy", "numba", "zmq", "trimesh", "pydantic", "raygrid.host"}),
        ("import raygrid.host.cli.main", {"numpy", "numba", "zmq", "trimesh", "pydantic", "PIL"}),
        ("import raygrid.host.cli.commands.render", {"numpy", "numba", "zmq", "trimesh", "pydantic", "PIL"}),
        ("import raygrid.emulator.processes.fork_server", {"raygrid.host", "trimesh", "pydantic", "PIL"}),
    ],
)
def test_nothing_heavy_is_imported_unasked(program, absent):
    look = f"{program}\nimport sys\nprint(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, timeout=60)
    assert not absent & set(run.stdout.split())


def test_the_fork_server_is_started_before_anything_heavy_is_imported():
    look = """
import sys
from raygrid.emulator.processes.array import Array
from raygrid.emulator.processes.fork_server_client import ForkServerClient

def start(**options):
    print("imported:", *sys.modules)
    raise SystemExit(0)

ForkServerClient.start = start
from raygrid.host.cli.main import cli
cli.main(["render", "scenes/tiny.nff", "-o", "-.png", "-q"], standalone_mode=False)
"""
    run = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, timeout=60, cwd=ROOT)
    imported = run.stdout.rpartition("imported:")[2]
    assert imported, run.stderr
    assert not {"numpy", "numba", "zmq", "PIL", "pydantic", "msgpack.fallback"} & set(imported.split())


@pytest.mark.parametrize("arguments", [["--help"], ["render", "--help"], ["info", "--help"], ["--version"]])
def test_help_comes_without_what_is_slow_to_import(arguments):
    look = f"""
import atexit, sys
from raygrid.host.cli.main import main
sys.argv = ["raygrid", *{arguments}]
atexit.register(lambda: print("\\nimported:", *sys.modules))
main()
"""
    run = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    said, _, imported = run.stdout.rpartition("imported:")
    assert "raygrid" in said
    assert not {"numba", "trimesh", "pydantic", "numpy", "zmq", "PIL"} & set(imported.split())
