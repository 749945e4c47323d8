"""`raygrid doctor` as it is typed, and what it says of computers on which something is wrong."""

from __future__ import annotations

import json
import os
import resource
import sys
import tempfile

import pytest
from support.cli import as_process, here

from raygrid.emulator.topology import Bound, read_resources
from raygrid.host.cli import doctor_facts
from raygrid.host.cli.commands import doctor
from raygrid.node.links import zmq_c_api

pytestmark = pytest.mark.usefixtures("fast_paths_on")


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    """A computer with room, whatever this one has left just now."""
    plenty = Bound(1 << 40, "no limit")
    monkeypatch.setattr(doctor_facts, "read_resources", lambda: type(read_resources())(*[plenty] * 4))


def said(outcome) -> str:
    """What was printed, as one line."""
    return " ".join(outcome.out.split())


def test_as_it_is_typed(tmp_path):
    new = tmp_path / "new"
    done = as_process("doctor", environment={"RAYGRID_CACHE": str(new), "COLUMNS": "80"})
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("raygrid ")
    assert done.out.endswith("a small array can run here\n")
    assert not [line for line in done.out.splitlines() if len(line) > 80 and " " in line[14:]]
    for word in ("numpy", "libzmq", "native links", "not there yet", "open files a process", "sockets in", "extras"):
        assert word in done.out
    assert not new.exists()


def test_as_json(monkeypatch):
    done = here("doctor", "--json")
    facts = json.loads(done.out)
    assert (done.code, done.err, facts["problems"]) == (0, "", [])
    assert set(facts) == set(doctor.DoctorFacts.__annotations__)
    assert facts["versions"]["Python"] == ".".join(map(str, sys.version_info[:3]))
    assert facts["largest_array"] == min(one["largest"] for one in facts["limits"].values())


def test_too_few_descriptors_as_it_is_typed():
    limits = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))}
    done = as_process("doctor", **limits)
    assert (done.code, done.err) == (1, "")
    assert "PROBLEM: a 2x2x2 array does not fit this computer: its 8 processors need 140 descriptors" in said(done)
    assert "a small array can run" not in done.out


def test_a_problem_in_json_has_code_1_too(monkeypatch):
    monkeypatch.setattr(doctor_facts, "read_limits", lambda: ({}, ["too little: more helps"]))
    done = here("doctor", "--json")
    assert (done.code, json.loads(done.out)["problems"]) == (1, ["too little: more helps"])


def test_links_by_python_are_slower_and_no_problem(monkeypatch):
    monkeypatch.setattr(zmq_c_api, "_look_for_functions", lambda: (None, "RAYGRID_NATIVE_LINKS=0 asks for it"))
    done = here("doctor")
    assert done.code == 0
    assert "native links: off, RAYGRID_NATIVE_LINKS=0 asks for it" in said(done)
    assert "advice: native links: off, which is slower: unset RAYGRID_NATIVE_LINKS a small" in said(done)
    monkeypatch.setattr(zmq_c_api, "_look_for_functions", lambda: (None, "a C function cannot be found"))
    assert "advice: links are served by Python, which is slower: install pyzmq and xxhash" in said(here("doctor"))


def test_a_library_that_is_broken(monkeypatch):
    monkeypatch.setitem(sys.modules, "msgpack", None)
    done = here("doctor")
    assert done.code == 1
    assert "PROBLEM: msgpack cannot be imported (ModuleNotFoundError: " in said(done)
    assert "pip install --force-reinstall msgpack" in said(done)
    assert "native links" not in done.out


def test_a_library_that_was_not_tried(monkeypatch):
    monkeypatch.setattr(doctor_facts, "read_misfits", lambda: {"numpy": ">=9"})
    done = here("doctor")
    assert done.code == 0
    version = json.loads(here("doctor", "--json").out)["versions"]["numpy"]
    assert f"advice: numpy: {version}, with which this raygrid was not tried: pip install 'numpy>=9'" in said(done)


def test_a_library_that_is_missing(monkeypatch):
    monkeypatch.setattr(doctor_facts, "NEEDED", ("numpy", "no-such"))
    done = here("doctor")
    assert done.code == 1
    assert "no-such MISSING" in said(done)
    assert "PROBLEM: no-such is not installed: pip install no-such" in said(done)


def test_no_compiler(monkeypatch):
    from raygrid.node.jit import fast_load

    monkeypatch.setattr(fast_load.config, "DISABLE_JIT", 1)
    done = here("doctor")
    assert done.code == 1
    assert "PROBLEM: kernels are interpreted, which is far slower (NUMBA_DISABLE_JIT asks for it): unset it" in said(
        done
    )


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        (
            {"directory": None, "why": "/a: not a directory"},
            "compiled kernels cannot be kept, and each run compiles them anew",
        ),
        ({"writable": False}, "kernels that the cache lacks cannot be kept, and each run compiles them anew"),
        ({"why": "/a: writable by all"}, "kernels are not kept in the usual place"),
    ],
    ids=["nowhere", "to read only", "elsewhere"],
)
def test_a_cache_that_is_not_as_it_should_be_is_no_problem(monkeypatch, change, advice):
    found = doctor_facts.read_cache() | change
    monkeypatch.setattr(doctor_facts, "read_cache", lambda: found)
    done = here("doctor")
    assert done.code == 0
    assert f"advice: {advice}" in said(done)
    assert "set RAYGRID_CACHE to a directory that is yours alone" in said(done)
    assert found["why"] in said(done)


def test_no_place_for_sockets(monkeypatch):
    places = {"sockets": {"/long": "too long"}, "temporary": "/tmp", "ffmpeg": None}
    monkeypatch.setattr(doctor_facts, "read_places", lambda: places)
    done = here("doctor")
    assert done.code == 1
    assert "PROBLEM: no directory for sockets (/long (too long)): set XDG_RUNTIME_DIR" in said(done)
    assert "ffmpeg: not found, so no .mp4" in said(done)


def test_no_temporary_directory(monkeypatch):
    def none() -> str:
        raise FileNotFoundError

    monkeypatch.setattr(tempfile, "gettempdir", none)
    done = here("doctor")
    assert done.code == 0
    assert "advice: no temporary directory can be written" in said(done)
    assert "temporary no directory can be written" in said(done)


def test_an_extra_that_is_not_installed(monkeypatch):
    monkeypatch.setattr(doctor_facts, "EXTRAS", {"law": ("numpy", "no-such"), "plots": ("numpy",)})
    assert "extras law (pip install no-such), plots installed" in said(here("doctor"))


def test_what_names_hold_is_shown_safely(monkeypatch):
    monkeypatch.setenv("RAYGRID_SAID", "a\x1b[31mb")
    assert "RAYGRID_SAID=a\\x1b[31mb" in here("doctor").out
    assert os.environ["RAYGRID_SAID"] == json.loads(here("doctor", "--json").out)["environment"]["RAYGRID_SAID"]
