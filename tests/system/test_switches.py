"""Fast paths that are turned off by a variable: the same bits from real processes, all of which inherit it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.cli import as_process, warm_kernels
from support.render import SCENES

from raygrid.node.jit.switches import NATIVE_LINKS, SWITCHES

__all__ = ["warm_kernels"]
pytestmark = pytest.mark.usefixtures("fast_paths_on")
SMALL = (str(SCENES / "kinds.nff"), "--size", "48x36", "--array", "2x2x2", "-q")


def case(switch):
    """One without which every kernel is compiled anew takes minutes."""
    return pytest.param(switch, marks=pytest.mark.slow) if switch.changes_code else switch


@pytest.fixture(scope="module")
def usual(tmp_path_factory, warm_kernels):
    return rendered(tmp_path_factory.mktemp("usual"), {switch.variable: "" for switch in SWITCHES})


def rendered(folder, environment):
    """(exact sums of a small picture, its statistics), of processes with these variables."""
    outcome = as_process(
        "render", *SMALL, "-o", f"{folder}/x.npy", "--stats", f"{folder}/x.json", environment=environment
    )
    assert (outcome.code, outcome.err) == (0, "")
    return np.load(folder / "x.npy"), json.loads((folder / "x.json").read_text())


@pytest.mark.usefixtures("no_leftovers")
@pytest.mark.parametrize("switch", [case(one) for one in SWITCHES], ids=lambda switch: switch.variable)
def test_the_picture_is_the_same_with_each_off(switch, usual, tmp_path):
    sums, stats = rendered(tmp_path, {switch.variable: "0"})
    assert np.array_equal(sums, usual[0])
    for node, other in zip(stats["nodes"], usual[1]["nodes"], strict=True):
        for counted in ("born", "died", "tests", "walks", "boxes", "hits"):
            assert node[counted] == other[counted]
    served = "python" if switch is NATIVE_LINKS else usual[1]["links"]["served_by"]
    assert {node["served_by"] for node in stats["nodes"]} == {served}


@pytest.mark.parametrize("switch", SWITCHES, ids=lambda switch: switch.variable)
def test_doctor_says_that_each_is_off_and_why(switch):
    assert "asks for it" not in as_process("doctor", "--json", environment={switch.variable: ""}).out
    outcome = as_process("doctor", "--json", environment={switch.variable: "0"})
    facts = json.loads(outcome.out)
    off = {name: path["why"] for name, path in facts["fast_paths"].items() if not path["on"]}
    assert f"{switch.variable}=0 asks for it" in off.values()
    assert any(f"unset {switch.variable}" in sentence for sentence in facts["advice"])
