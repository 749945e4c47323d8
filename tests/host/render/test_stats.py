"""The statistics: every key is documented, and what they say agrees with itself."""

import json
import re

import numpy as np
import pytest
from support import paths
from support.cli import here, warm_kernels
from support.render import SCENES, rendered

from raygrid.host.scene.load import load_scene
from raygrid.node.geometry.surfaces import SURFACE_KINDS
from raygrid.node.protocol.packets import PacketKind

__all__ = ["warm_kernels"]

pytestmark = pytest.mark.usefixtures("no_leftovers", "warm_kernels")

DOCUMENT = paths.ROOT / "docs" / "stats.md"
SURFACES = {kind.name.lower() for kind in SURFACE_KINDS}
PACKETS = {kind.name.lower() for kind in PacketKind}


@pytest.fixture(scope="module")
def stats(tmp_path_factory, warm_kernels):
    """Those of a run of the command."""
    folder = tmp_path_factory.mktemp("stats")
    arguments = ("--size", "80x60", "--array", "2x2x1", "-o", str(folder / "x.npy"), "--stats", str(folder / "x.json"))
    outcome = here("render", str(SCENES / "kinds.nff"), *arguments)
    assert outcome.code == 0, outcome.err
    return json.loads((folder / "x.json").read_text())


def keys(value, name=""):
    """Dotted names of all leaves; a map by kind of packet or surface is one leaf, a list of maps as its maps."""
    if isinstance(value, dict) and set(value) not in (SURFACES, PACKETS):
        return {key for k, part in value.items() for key in keys(part, f"{name}.{k}".removeprefix("."))}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return {key for part in value for key in keys(part, name)}
    return {name}


def test_every_key_is_documented_and_every_documented_key_is_there(stats):
    documented = re.findall(r"^\| `([\w.]+)` \|", DOCUMENT.read_text(), re.M)
    assert sorted(documented) == sorted(set(documented))
    assert keys(stats) == set(documented)
    text = DOCUMENT.read_text()
    for kind in SURFACES | PACKETS:
        assert f"`{kind}`" in text, kind


def test_a_line_for_each_key_and_each_node(tmp_path, stats):
    path = tmp_path / "y.json"
    assert (
        here(
            "render", str(SCENES / "tiny.nff"), "--size", "8x8", "-o", str(tmp_path / "y.npy"), "--stats", str(path)
        ).code
        == 0
    )
    lines = path.read_text().splitlines()
    assert len(lines) == 2 + len(stats) - 1 + 8 + 2


def test_totals_are_the_sums_over_the_nodes(stats):
    total, nodes = stats["total"], stats["nodes"]
    for name in ("born", "died", "tests"):
        for kind, count in total[name].items():
            assert count == sum(node[name][kind] for node in nodes), (name, kind)
    for name in ("walks", "boxes", "hits", "messages", "bytes"):
        assert total[name] == sum(node[name] for node in nodes), name
    assert total["hops"] == sum(sum(node["sent"]) for node in nodes)


def test_a_complete_frame_is_conserved_and_leaves_nothing_waiting(stats):
    total = stats["total"]
    assert total["born"] == total["died"]
    assert total["born"]["primary"] <= 80 * 60
    assert total["hits"] <= sum(total["born"][kind] for kind in ("primary", "reflected", "refracted"))
    assert all(node["waiting"] == 0 for node in stats["nodes"])
    assert stats["most_in_flight"] <= sum(total["born"].values())


def test_the_frame_is_as_asked(stats):
    assert stats["array"] == [2, 2, 1]
    assert stats["size"] == [80, 60]
    assert stats["unit"] == 2**24
    assert [len(line) for line in stats["planes"]] == [3, 3, 2]
    assert all(line[0] == 0 and line[-1] == 2**24 for line in stats["planes"])
    assert [node["index"] for node in stats["nodes"]] == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert len({node["pid"] for node in stats["nodes"]}) == 4


def test_times_and_memory_are_plausible(stats):
    seconds = stats["wall_seconds"]
    assert all(value > 0.0 for value in seconds.values())
    assert sum(seconds.values()) - seconds["whole"] <= seconds["whole"]
    assert stats["balance"] >= 1.0
    for node in stats["nodes"]:
        assert 0.0 <= node["busy_seconds"] <= node["cpu_seconds"]
        assert 0 < node["private_memory"] <= node["peak_memory"]
        assert sum(node["memory"].values()) > 0


def test_counts_do_not_depend_on_the_run(stats):
    """Nor on whether nodes are processes. (Messages and bytes do.)"""
    picture = rendered(load_scene(SCENES / "kinds.nff"), (2, 2, 1), size=(80, 60))
    for name in ("born", "died", "tests", "walks", "hits", "hops"):
        assert picture.stats["total"][name] == stats["total"][name], name


def test_statistics_are_plain(stats):
    """No numpy numbers are left in the map of the Python interface."""
    picture = rendered(load_scene(SCENES / "tiny.nff"), size=(16, 16))
    assert json.loads(json.dumps(picture.stats)) == picture.stats
    assert not any(isinstance(value, np.generic) for value in picture.stats.values())
