"""Imports run one way: host -> emulator -> node, along the chain of packages in each; and what is quick stays quick."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

import pytest
from support import paths
from support.modules import (
    against_chains,
    crowded_rooms,
    cycles,
    packages_that_say_nothing,
    past_faces,
    past_fences,
    read_modules,
    relative_imports,
    stale_cycles,
    stale_faces,
    typed_pointers,
    unknown_imports,
    unused_faces,
    unused_openings,
    wrong_layers,
)

ROOT = paths.ROOT
MODULES = read_modules(ROOT)
CHAINS = {  # a package imports itself and those to its left
    layer: tuple(chain.split(" < "))
    for layer, chain in {
        "node": "faces < errors < remarks < jit < geometry < protocol < tracing < links < programs < runtime < timed < main",
        "emulator": "topology < partition < driver < processes < simulator < analysis",
        "host": "text < files < image < scene < render < machine_time < export < client < journal < probes < service"
        " < cli < facade",
    }.items()
}
OPEN = {  # modules that other layers may import as they are
    "node.errors": "all raise them",
    "node.faces": "each package makes its face by it",
    "node.remarks": "all make them",
    "node.main": "a module of the layer itself, so its own face",
    "node.geometry.spanning_tree": "preloaded by its module's name",
    "node.jit.cache": "where kernels are kept is a fact of the module, which changes while a program is compiled",
    "node.jit.fast_load": "what `raygrid doctor` asks of it nobody else needs",
    "node.jit.target": "what `raygrid doctor` asks of it nobody else needs",
    "node.links.zmq_channel": "preloaded by its module's name",
    "node.runtime.profile": "preloaded by its module's name",
    "node.tracing.step": "the module's main function has its name, which a face could not give",
    "emulator.processes.compile_clock": "a clock that is one for the process, so it is named with its module",
    "emulator.partition.cost_grid": "preloaded by its module's name",
    "emulator.partition.sampling_prepass": "preloaded by its module's name",
    "emulator.partition.split": "the module's main function has its name, which a face could not give",
}
KNOWN_CYCLES: dict[
    tuple[str, str], str
] = {}  # an import that closes one -> why it is still there; empty is what we want
KNOWN_UNTAKEN: dict[
    str, str
] = {}  # a name in a stub that no other layer takes -> why it is still there; empty is what we want
FENCES = {  # insides of libraries, which change without notice -> who may know them
    "llvmlite": ("node.jit",),
    "numba.core": ("node.jit",),
    "zmq.backend": ("node.links.zmq_c_api",),
}
MOST_MODULES = 20

RULES = {
    "relative imports": relative_imports,
    "unknown imports": unknown_imports,
    "layers": wrong_layers,
    "chains": partial(against_chains, chains=CHAINS),
    "faces": partial(past_faces, open_modules=OPEN),
    "names that no other layer takes": partial(unused_faces, without=KNOWN_UNTAKEN),
    "known names that are taken or gone": partial(stale_faces, known=KNOWN_UNTAKEN),
    "open modules that are not used": partial(unused_openings, open_modules=OPEN),
    "cycles": partial(cycles, without=KNOWN_CYCLES),
    "known cycles that are gone": partial(stale_cycles, known=KNOWN_CYCLES),
    "fences": partial(past_fences, fences=FENCES),
    "pointers without types": typed_pointers,
    "room": partial(crowded_rooms, most=MOST_MODULES),
    "what packages say": packages_that_say_nothing,
}


@pytest.mark.parametrize("rule", RULES)
def test_the_tree_keeps(rule):
    assert RULES[rule](MODULES) == []


def test_the_tree_is_read_whole():
    """So that no rule above holds for want of modules and imports."""
    assert len(MODULES) > 200
    assert {name.partition(".")[0] for name in MODULES} == {"node", "emulator", "host"}
    assert {room for chain in CHAINS.values() for room in chain} == {
        name.split(".")[1] for name in MODULES if "." in name
    }
    assert sum(len(module.imports) for module in MODULES.values()) > 1000


# --- each rule sees what is wrong ---------------------------------------------------------------------------

FACE = "from raygrid.node.faces import face\n"
PLANTED = {  # rule -> (files, what it says of them)
    "relative imports": (
        {"node/links/link.py": "def f():\n    from ..jit import kernel\n"},
        ["node.links.link:2 imports '..jit', which is relative"],
    ),
    "unknown imports": (
        {"node/jit/cache.py": "import raygrid.node.sieve\n"},
        ["node.jit.cache:1 imports node.sieve, which is not there"],
    ),
    "layers": (
        {
            "node/jit/cache.py": "def f():\n    from raygrid.emulator.topology import limits\n",
            "emulator/topology/limits.py": "",
            "emulator/driver/driver.py": "import raygrid\n",
            "host/facade/__init__.py": "",
        },
        ["emulator.driver.driver imports host.facade, a layer above its own",
         "node.jit.cache imports emulator.topology.limits, a layer above its own"],
    ),
    "chains": (
        {
            "node/jit/cache.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n"
            "    from raygrid.node.geometry.lattice import Cell\n",
            "node/geometry/lattice.py": "from raygrid.node.jit.cache import KEEPING\n",
            "node/attic/old.py": "",
        },
        ["node.attic.old is in no place of the chain of node",
         "node.jit.cache imports node.geometry.lattice, which comes after it in the chain of node"],
    ),
    "faces": (
        {
            "node/jit/__init__.pyi": "from .decorators import kernel as kernel\n",
            "node/jit/__init__.py": FACE,
            "node/jit/decorators.py": "",
            "node/errors.py": "",
            "host/text/one.py": "from raygrid.node.jit import kernel\nfrom raygrid.node.errors import RaygridError\n",
            "host/text/two.py": "from raygrid.node.jit import part\n",
            "host/text/three.py": "from raygrid.node.jit.decorators import kernel\n",
            "host/text/four.py": "from raygrid.node.jit import decorators\n",
            "host/text/five.py": "from raygrid.node import jit\na = jit.kernel, jit.lean\n",
        },
        ["host.text.five:2 takes lean from node.jit, past its face",
         "host.text.four:1 takes decorators from node.jit, past its face",
         "host.text.three:1 takes kernel from node.jit.decorators, past its face",
         "host.text.two:1 takes part from node.jit, past its face"],
    ),
    "names that no other layer takes": (
        {
            "node/jit/__init__.pyi": "from .decorators import kernel as kernel\nfrom .decorators import part as part\n"
            "from .decorators import lean as lean\nfrom . import cache as cache\n",
            "node/jit/__init__.py": FACE,
            "node/jit/decorators.py": "",
            "node/jit/cache.py": "",
            "node/links/link.py": "from raygrid.node.jit import part\n",
            "host/text/one.py": "def f():\n    from raygrid.node.jit import kernel\n",
            "host/text/two.py": "from raygrid.node import jit\na = jit.lean\n",
        },
        ["node.jit.cache is in the stub of its package, and no other layer takes it",
         "node.jit.part is in the stub of its package, and no other layer takes it"],
    ),
    "cycles": (
        {
            "node/jit/cache.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from raygrid.node.jit import lanes\n",
            "node/jit/lanes.py": "def f():\n    from raygrid.node.jit.decorators import part\n",
            "node/jit/decorators.py": "import raygrid.node.jit.cache\n",
            "node/jit/trusted_files.py": "import raygrid.node.jit.cache\n",
        },
        ["node.jit.cache node.jit.decorators node.jit.lanes import each other"],
    ),
    "fences": (
        {
            "node/jit/cache.py": "from numba.core import config\nimport llvmlite\n",
            "node/links/zmq_c_api.py": "INNER = 'zmq.backend.cython._zmq'\nimport numba.core\n",
            "node/links/link.py": "import zmq\ndef f():\n    import zmq.backend.cython\n    return zmq.backend\n",
            "node/timed/lookahead.py": "import numba\nevent = numba.core.event\nfrom numba import core, corelib\n",
            "host/cli/trace.py": "from llvmlite import ir\nx = __import__('llvmlite')\nNAMES = 'llvmlite', 'numba'\n",
        },
        ["node.links.link:3 names zmq.backend, which is for node.links.zmq_c_api",
         "node.links.link:4 names zmq.backend, which is for node.links.zmq_c_api",
         "node.links.zmq_c_api:2 names numba.core, which is for node.jit",
         "node.timed.lookahead:2 names numba.core, which is for node.jit",
         "node.timed.lookahead:3 names numba.core, which is for node.jit",
         "host.cli.trace:1 names llvmlite, which is for node.jit",
         "host.cli.trace:2 names llvmlite, which is for node.jit"],
    ),
    "pointers without types": (
        {
            "node/jit/intrinsics.py": "from llvmlite import ir\nx = ir.IntType(8).as_pointer()\nb = x.type.pointee\n"
            "builder.gep(a, [b])\nbuilder.gep(a, [b], source_etype=x)\nself._builder.load(a)\nbuilder.load(a, typ=x)\n"
            "ir.PointerType(x)\nir.PointerType()\n",
            "node/jit/cache.py": "pickle.load(file)\nx.as_pointer()\n",
        },
        ["node.jit.intrinsics:2 uses as_pointer",
         "node.jit.intrinsics:3 uses pointee",
         "node.jit.intrinsics:4 steps over what a pointer points to: gep without source_etype",
         "node.jit.intrinsics:6 reads what a pointer points to: load without typ",
         "node.jit.intrinsics:8 makes a pointer of a type"],
    ),
    "room": (
        {f"node/jit/kind_{number}.py": "" for number in range(MOST_MODULES + 1)},
        ["node.jit has 21 modules, more than 20"],
    ),
    "what packages say": (
        {"node/__init__.py": '"""One processor."""\n', "node/jit/__init__.py": FACE, "node/links/link.py": ""},
        ["node.jit has no __init__.py that says what lives there",
         "node.links has no __init__.py that says what lives there"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("rule", PLANTED)
def test_a_rule_sees_what_is_wrong(rule, tmp_path):
    files, wanted = PLANTED[rule]
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert RULES[rule](read_modules(tmp_path)) == wanted


def test_what_is_listed_and_no_longer_so_is_seen(tmp_path):
    (tmp_path / "node").mkdir()
    (tmp_path / "node" / "errors.py").write_text("from raygrid.node import remarks\n")
    (tmp_path / "node" / "remarks.py").write_text("")
    modules = read_modules(tmp_path)
    assert unused_openings(modules, ["node.errors"]) == ["node.errors is listed as open, and no other layer imports it"]
    assert stale_faces(modules, ["node.jit.part"]) == ["node.jit.part is taken, or in no stub"]
    assert stale_cycles(modules, [("node.errors", "node.remarks")]) == ["node.errors -> node.remarks closes no cycle"]


# --- what is quick stays quick --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("program", "absent"),
    [
        ("import raygrid", {"numpy", "numba", "zmq", "trimesh", "pydantic", "raygrid.host"}),
        ("import raygrid.host.cli.main", {"numpy", "numba", "zmq", "trimesh", "pydantic", "PIL"}),
        ("import raygrid.host.cli.commands.render", {"numpy", "numba", "zmq", "trimesh", "pydantic", "PIL"}),
        ("import raygrid.emulator.processes.fork_server", {"raygrid.host", "trimesh", "pydantic", "PIL"}),
        # the front end drives nodes, and traces no ray: the kernels of a node cost it a tenth of a short command
        (
            "import raygrid.host.render.frame, raygrid.host.render.session\n"
            "from raygrid.emulator.driver import Driver\n"
            "from raygrid.node.tracing import add_missed",
            {"raygrid.node.tracing.step", "raygrid.node.runtime.event_loop", "raygrid.node.runtime.node_state"},
        ),
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
