"""Which numbers of surfaces are what."""

from __future__ import annotations

import numpy as np
from support.render import SCENES

from raygrid.host.scene.load import load_scene
from raygrid.host.scene.surface_runs import surface_runs
from raygrid.node.geometry import SURFACE_KINDS


def every(scene):
    return np.arange(-1, len(scene.surfaces))


def test_runs_say_of_each_surface_what_it_is():
    scene = load_scene(SCENES / "kinds.nff")
    facts = {}
    for run in surface_runs(scene, every(scene))["surfaces"]:
        facts |= dict.fromkeys(range(run["first"], run["last"] + 1), (run["kind"], run["material"]))
    assert sorted(facts) == list(range(len(scene.surfaces)))
    for batch in scene.surfaces:
        for number, material in zip(batch.ids.tolist(), batch.materials.tolist(), strict=True):
            assert facts[number] == (SURFACE_KINDS[batch.kind].name.lower(), material)


def test_only_what_is_seen_is_told_and_a_mesh_is_one_run():
    scene = load_scene(SCENES / "room.glb")
    told = surface_runs(scene, np.array([-1, 10, 11, 4000]))
    assert [run["material"] for run in told["surfaces"]] == [row["number"] for row in told["materials"]]
    assert [
        (run["first"] <= number <= run["last"]) for run, number in zip(told["surfaces"], (10, 4000), strict=True)
    ] == [True] * 2
    for row in told["materials"]:
        assert row["diffuse"] == scene.materials[row["number"]]["diffuse"].tolist()
    assert surface_runs(scene, np.array([-1])) == {"surfaces": [], "materials": []}


def test_groups_are_told_by_name():
    scene = load_scene(SCENES / "mobile.toml")
    found = {run["group"] for run in surface_runs(scene, every(scene))["surfaces"]}
    assert found - {None} == {scene.shot.names[number] for number in set(scene.shot.groups.numbers.tolist())}
