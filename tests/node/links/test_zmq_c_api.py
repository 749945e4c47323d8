"""Links that Python alone serves, since no C functions were found or by request: the same bits, and it is said."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from support.cli import TINY, as_process, warm_kernels
from support.service import lasting

__all__ = ["warm_kernels"]
pytestmark = pytest.mark.usefixtures("fast_paths_on")
SMALL = ("--size", "24x18", "--array", "2x1x1", "-q")


@pytest.mark.usefixtures("warm_kernels")
def test_by_request_python_serves_the_links_and_stats_say_so(tmp_path):
    told = {}
    ways = {
        "compiled": {},
        "python": {"RAYGRID_NATIVE_LINKS": "0"},
        "python, by the old name": {"RAYGRID_LINKS": "python"},
    }
    for way, environment in ways.items():
        outputs = ("-o", f"{tmp_path}/{way}.npy", "--stats", f"{tmp_path}/{way}.json")
        outcome = as_process("render", TINY, *SMALL, *outputs, environment=environment)
        assert outcome.code == 0, outcome.err
        told[way] = json.loads((tmp_path / f"{way}.json").read_text())
        served_by = way.partition(",")[0]
        assert told[way]["links"]["served_by"] == served_by
        assert {node["served_by"] for node in told[way]["nodes"]} == {served_by}
    assert told["compiled"]["links"]["why"] is None
    assert told["python"]["links"]["why"] == "RAYGRID_NATIVE_LINKS=0 asks for it"
    assert told["python, by the old name"]["links"]["why"] == "RAYGRID_LINKS=python asks for it"
    pictures = [np.load(tmp_path / f"{way}.npy") for way in ways]
    assert np.array_equal(pictures[0], pictures[1])
    assert np.array_equal(pictures[0], pictures[2])


@pytest.mark.usefixtures("warm_kernels")
def test_status_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("RAYGRID_NATIVE_LINKS", "0")
    with lasting(tmp_path, "slow") as name:
        told = as_process("status", "--name", name).out
        assert "links: served by Python alone, which is slower (RAYGRID_NATIVE_LINKS=0 asks for it)\n" in told
        facts = json.loads(as_process("status", "--name", name, "--json").out)
        assert facts["links"] == {"served_by": "python", "why": "RAYGRID_NATIVE_LINKS=0 asks for it"}


@pytest.mark.parametrize(
    ("broken", "why"),
    [
        ("zmq_c_api._FROM_ZEROMQ = {'send': 'zmq_no_such_function'}", "zmq_no_such_function"),
        ("zmq_c_api._CHECKSUMS = ('XXH_no_such_function',)", "no checksum of xxhash"),
        (
            "zmq_c_api._library_of = lambda module: zmq_c_api.importlib.import_module('no_such_module')",
            "no_such_module",
        ),
    ],
)
def test_what_is_not_found_is_named(broken, why):
    code = (
        f"from raygrid.node.links import zmq_c_api\n{broken}\nprint(zmq_c_api.find_functions(), zmq_c_api.why_python())"
    )
    environment = os.environ | {"RAYGRID_NATIVE_LINKS": "1", "RAYGRID_LINKS": ""}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=environment)
    assert done.stdout.startswith("None a C function of pyzmq or xxhash cannot be found: "), done.stderr
    assert why in done.stdout
