"""Where a node's time goes: the parts of --profile."""

from __future__ import annotations

import numpy as np
import pytest
from support import paths
from support.cli import as_process

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.cli.profile_table import profile_table
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.runtime.profile_parts import PARTS

SCENE = paths.SCENES / "kinds.nff"


def rendered(shape, profiled):
    array = MemoryArray(shape, profile=profiled)
    array.driver.ready()
    job = make_job(load_scene(SCENE), shape, Settings(size=(96, 96)))
    return render_job(array.driver, job)


def test_the_parts_are_those_of_the_work_and_the_picture_is_the_same():
    bare, seen = rendered((2, 1, 1), profiled=False), rendered((2, 1, 1), profiled=True)
    assert np.array_equal(bare.sums, seen.sums)
    for node, plain in zip(seen.stats["nodes"], bare.stats["nodes"], strict=True):
        seconds = node["profile"]
        assert tuple(seconds) == PARTS
        assert all(spent >= 0.0 for spent in seconds.values())
        assert sum(seconds[part] for part in ("birth", "decode", "walk", "hit", "shade")) > 0.0
        assert "profile" not in plain
        for counted in ("born", "died", "tests", "walks", "boxes", "hits"):
            assert node[counted] == plain[counted], f"what is done aside shows in {counted}"


@pytest.mark.parametrize("profiled", [False, True])
def test_no_method_is_assigned_over_and_timers_are_off_unless_asked_for(profiled):
    for processor in MemoryArray((2, 1, 1), profile=profiled).processors:
        for owner in (processor, processor.node_state):
            assert not [name for name in vars(owner) if callable(getattr(type(owner), name, None))]
        assert (processor.profile is not None) == (processor.node_state.timers.clock != 0) == profiled


def test_the_table_has_a_line_a_node_and_one_for_all():
    nodes = [
        {"index": [x, 0, 0], "profile": dict.fromkeys(PARTS, 0.5) | {"hit": 2.0 * x, "wait": 3.0}} for x in range(2)
    ]
    head, first, second, total = profile_table(nodes)
    assert head.split() == ["node", "CPU", "s", *PARTS]
    assert first.split() == ["0,0,0", "3.500", *["14.3%"] * 4, "0.0%", *["14.3%"] * 3, "3.00", "s"]
    assert second.split()[:2] == ["1,0,0", "5.500"]
    assert total.split()[:2] == ["all", "9.000"]
    assert len(profile_table(nodes[:1])) == 2


def test_the_table_fits_a_terminal():
    profile = dict.fromkeys(PARTS, 12.0) | {"wait": 2.0}
    nodes = [{"index": [10, 10, 10 + x], "profile": profile} for x in range(2)]
    assert {len(line) for line in profile_table(nodes)} == {80}


@pytest.mark.usefixtures("no_leftovers")
def test_a_profile_is_one_flag_away(tmp_path):
    arguments = ["render", str(SCENE), "--array", "2x1x1", "--size", "64x64", "-q", "-o", str(tmp_path / "p.png")]
    outcome = as_process(*arguments, "--profile")
    assert outcome.code == 0, outcome
    lines = outcome.err.splitlines()
    assert lines[0].split()[0] == "node"
    assert [line.split()[0] for line in lines[1:]] == ["0,0,0", "1,0,0", "all"]
