"""Which numbers of surfaces are what."""

from __future__ import annotations

import shutil
import tomllib

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


def names_in(path):
    scene = load_scene(path)
    return [row["name"] for row in surface_runs(scene, every(scene))["materials"]]


def test_materials_have_the_names_of_their_files(tmp_path):
    assert names_in(SCENES / "kinds.nff") == [""] * len(load_scene(SCENES / "kinds.nff").materials)
    assert all(names_in(SCENES / "room.glb"))
    assert names_in(SCENES / "room.obj") == [name for name in names_in(SCENES / "room.obj") if name]
    assert set(names_in(SCENES / "mobile.toml")) <= set(
        tomllib.loads((SCENES / "mobile.toml").read_text())["materials"]
    )


def test_equal_materials_are_one_of_all_their_names(tmp_path):
    ball = '[[surfaces]]\nkind = "sphere"\ncentre = [{}, 0, 0]\nradius = 1\nmaterial = "{}"\n'
    text = "".join(
        f"[materials.{name}]\ncolour = [{red}, 0, 0]\n" for name, red in (("a", 1), ("b", 0.5), ("c", 1), ("d", 1))
    )
    (tmp_path / "x.toml").write_text(text + "".join(ball.format(3 * k, name) for k, name in enumerate("cba")))
    assert names_in(tmp_path / "x.toml") == ["a, c", "b"]


def test_a_scene_that_takes_another_keeps_its_names(tmp_path):
    shutil.copy(SCENES / "room.glb", tmp_path)
    (tmp_path / "x.toml").write_text('[[meshes]]\nfile = "room.glb"\n')
    assert names_in(tmp_path / "x.toml") == names_in(SCENES / "room.glb")
