"""Kernels from the cache on disk: loaded without numba's compiler, by numba alone where it is another, compiled after."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from support.small_kernels import BOTH, WANTED, SmallKernels

from raygrid.host.render.import_block import hidden
from raygrid.node.jit.fast_load import can_load_alone

pytestmark = pytest.mark.usefixtures("fast_paths_on")

AN_ERROR = """
def told(values):
    try:
        small.doubled(values)
    except ValueError as error:
        return str(error)
"""


@pytest.fixture
def run(tmp_path):
    """Runs calls of the small kernels in a new process, all with the same cache."""
    small = SmallKernels(tmp_path)
    return lambda *arguments, **variables: small.run(*arguments, **variables)[0]


@pytest.fixture
def run_again(tmp_path):
    """The same, where the small kernels have run before."""
    small = SmallKernels(tmp_path)
    small.keep_compiled()
    return lambda *arguments, **variables: small.run(*arguments, **variables)[0]


def test_this_numba_is_one_of_which_kernels_are_loaded_alone():
    assert can_load_alone()


def test_a_kernel_on_disk_is_loaded_without_the_compiler(run):
    first = run()
    assert first["result"] == WANTED
    assert first["compiled"] == ["double", "doubled", "total"]
    assert first["ready"] > 0
    assert run() == {"result": WANTED, "ready": 0, "compiled": []}


def test_what_a_loaded_kernel_raises_is_told(run):
    wanted = ["a value below 0"]
    assert run("told(-values)", AN_ERROR)["result"] == wanted
    assert run("told(-values)", AN_ERROR) == {"result": wanted, "ready": 0, "compiled": []}


def test_kernels_are_compiled_after_others_were_loaded_and_call_them(run_again):
    again = run_again(f"{BOTH}, small.later(values), small.third(values)")
    assert again["result"] == [*WANTED, 27.0, 3.0]
    assert again["compiled"] == ["later", "third"]
    assert run_again("small.later(values)") == {"result": [27.0], "ready": 0, "compiled": []}


def test_other_types_are_compiled_and_the_first_are_still_there(run_again):
    again = run_again("small.total(values), small.total(values.astype(np.float32)), small.total(values)")
    assert again["result"] == [12.0, 12.0, 12.0]
    assert "total" in again["compiled"]


def test_a_name_without_address_makes_the_compiler_ready(run_again):
    before = "from raygrid.node.jit import fast_load\nfast_load.binding.address_of_symbol = lambda name: None"
    again = run_again(before=before)
    assert (again["result"], again["compiled"]) == (WANTED, [])
    assert again["ready"] > 0


@pytest.mark.parametrize(
    "before",
    [
        # Another load_overload, which does something that is not known here.
        "from numba.core import caching\n"
        "load = caching.Cache.load_overload\n"
        "caching.Cache.load_overload = lambda self, sig, target_context: load(self, sig, target_context)",
        "from numba.core import compiler\n"
        "make = compiler.CompileResult._rebuild\n"
        "compiler.CompileResult._rebuild = classmethod(lambda cls, *all: make(*all))",
    ],
    ids=["another load_overload", "another _rebuild"],
)
def test_of_another_numba_kernels_are_cached_by_numba_alone(run_again, before):
    # what is kept for the one is nothing to the other
    first, second = run_again(before=before), run_again(before=before)
    assert first["result"] == second["result"] == WANTED
    assert first["compiled"]
    assert not second["compiled"]
    assert second["ready"] > 0
    assert run_again() == {"result": WANTED, "ready": 0, "compiled": []}


def test_runtime_statistics_are_left_to_numba(run):
    assert run(NUMBA_NRT_STATS="1")["result"] == WANTED
    assert run(NUMBA_NRT_STATS="1")["ready"] > 0


def test_by_request_numba_loads_the_same_files_by_its_own_means(run):
    first = run(RAYGRID_FAST_LOAD="0")
    assert first["result"] == WANTED
    assert first["compiled"] == ["double", "doubled", "total"]
    assert run() == {"result": WANTED, "ready": 0, "compiled": []}
    again = run(RAYGRID_FAST_LOAD="0")
    assert (again["result"], again["compiled"]) == (WANTED, [])
    assert again["ready"] > 0


def test_without_a_directory_of_ours_numba_chooses_one(run):
    nowhere = f"{os.devnull}/kernels"
    assert run(RAYGRID_CACHE=nowhere)["compiled"]
    assert run(RAYGRID_CACHE=nowhere) == {"result": WANTED, "ready": 0, "compiled": []}


def test_where_nothing_can_be_kept_everything_is_compiled_anew(run):
    before = "import os\nmkdir = os.mkdir\ndef refuse(*_, **__): raise OSError(30, 'Read-only file system')\nos.mkdir = refuse"
    for _ in range(2):
        again = run(f"{BOTH}, small.total.stats.cache_path", before)
        assert again["result"] == [*WANTED, os.devnull]
        assert again["compiled"] == ["double", "doubled", "total"]


def test_bounds_are_checked_if_asked_for(run):
    before = """
def told(values):
    try:
        return small.third(values)
    except IndexError as error:
        return "out of bounds"
"""
    calls = "told(values), told(values[:2])"
    for _ in range(2):
        assert run(calls, before, NUMBA_BOUNDSCHECK="1")["result"] == [3.0, "out of bounds"]


def test_without_a_compiler_kernels_are_python(run):
    assert run(NUMBA_DISABLE_JIT="1") == {"result": WANTED, "ready": 0, "compiled": []}


def test_the_kernels_of_the_nodes_are_loaded_without_the_compiler():
    """The fork server's own warm-up, twice, as only the first one may compile."""
    look = """
import sys
from numba.core.base import BaseContext
refresh = BaseContext.refresh
BaseContext.refresh = lambda self: (print("made ready"), refresh(self))[1]
from raygrid.emulator.processes.warm import warm
warm(print)
"""
    command = [sys.executable, "-c", look]
    subprocess.run(command, capture_output=True, check=True, timeout=280)
    again = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert again.stdout.splitlines()[0].endswith("loading kernels")
    assert again.stdout.splitlines()[-1].endswith("ready")
    assert len(again.stdout.splitlines()) == 2


# --- modules that are not imported for a while --------------------------------------------------------------------


def test_a_hidden_module_cannot_be_imported_and_afterwards_can():
    sys.modules.pop("colorsys", None)
    with hidden("colorsys"), pytest.raises(ImportError):
        __import__("colorsys")
    assert __import__("colorsys").rgb_to_hsv(1, 1, 1) == (0.0, 0.0, 1)


def test_what_is_imported_already_stays():
    with hidden("json"):
        assert __import__("json") is json
    assert sys.modules["json"] is json
