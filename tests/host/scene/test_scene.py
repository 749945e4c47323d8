"""The builder (ids, sharing, dropping), the description, lights and exposure, loading by suffix, the scenes of ours."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support import paths

from raygrid.host.scene.builder import MOST_BENT, SceneBuilder, material
from raygrid.host.scene.cameras import perspective_camera
from raygrid.host.scene.finish import finish_scene
from raygrid.host.scene.lights import (
    directional_light,
    exposed,
    exposure_point,
    invented_lights,
    light_table,
    point_light,
    spot_light,
)
from raygrid.host.scene.load import READERS, load_scene
from raygrid.host.scene.scene import describe
from raygrid.node.errors import SceneError
from raygrid.node.geometry.lattice import SLACK
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.protocol.frame import DIRECTIONAL, MATERIAL_RECORD, POINT

SCENES = paths.SCENES
TRIANGLE = np.array([[0.0, 0, 0, 1, 0, 0, 0, 1, 0]])
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def builder_with_one_material():
    builder = SceneBuilder("x.test")
    builder.add_materials(material(diffuse=1.0))
    return builder


def test_ids_follow_order_numbers_over_kinds_and_rows_are_ascending():
    builder = builder_with_one_material()
    builder.add(Kind.SPHERE, np.array([[0.0, 0, 0, 1], [0, 0, 0, 2]]), 0, np.array([7, 1]))
    builder.add(Kind.TRIANGLE, TRIANGLE, 0, np.array([5]))
    builder.add_polygons(SQUARE, np.array([0, 4]), 0, np.array([0]))
    surfaces, _, _ = builder.finish()
    ids = {batch.kind: batch.ids.tolist() for batch in surfaces}
    assert ids == {Kind.POLYGON: [0], Kind.SPHERE: [1, 3], Kind.TRIANGLE: [2]}
    spheres = next(batch for batch in surfaces if batch.kind == Kind.SPHERE)
    assert spheres.data[:, 3].tolist() == [2.0, 1.0]


def test_running_order_numbers_follow_the_calls():
    builder = builder_with_one_material()
    builder.add(Kind.TRIANGLE, TRIANGLE, 0)
    builder.add_polygons(SQUARE, np.array([0, 4]), 0)
    builder.add(Kind.TRIANGLE, TRIANGLE + 1.0, 0)
    surfaces, _, _ = builder.finish()
    assert {batch.kind: batch.ids.tolist() for batch in surfaces} == {Kind.TRIANGLE: [0, 2], Kind.POLYGON: [1]}
    assert all(batch.data.dtype == np.float64 for batch in surfaces)


def test_equal_materials_are_shared_and_unused_ones_left_out():
    builder = SceneBuilder("x.test")
    for grey in (0.9, 0.5, 0.25, 0.5):
        builder.add_materials(material(diffuse=grey))
    builder.add(Kind.TRIANGLE, np.repeat(TRIANGLE, 3, axis=0), np.array([3, 2, 1]))
    surfaces, table, _ = builder.finish()
    assert table["diffuse"][:, 0].tolist() == [0.5, 0.25]
    assert surfaces.batches[0].materials.tolist() == [0, 1, 0]


def test_triangles_and_polygons_without_area_are_dropped_with_a_remark():
    builder = builder_with_one_material()
    flat = np.array([[0.0, 0, 0, 1, 1, 1, 2, 2, 2]])
    builder.add(Kind.TRIANGLE, np.concatenate((flat, TRIANGLE, flat)), 0)
    builder.add_polygons(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]), np.array([0, 4]), 0)
    surfaces, _, remarks = builder.finish()
    assert len(surfaces) == 1
    assert surfaces.batches[0].ids.tolist() == [0]
    assert remarks == ("2 triangles without area dropped", "1 polygon without area dropped")
    assert builder.finish()[2] == remarks  # asking twice does not remark twice


def test_a_needle_that_has_an_area_stays():
    builder = builder_with_one_material()
    builder.add(Kind.TRIANGLE, np.array([[0.0, 0, 0, 1, 0, 0, 0.5, 1e-9, 0]]), 0)
    assert len(builder.finish()[0]) == 1


def test_normals_become_unit_vectors_and_lost_ones_the_triangle_s_own():
    builder = builder_with_one_material()
    builder.add(Kind.SMOOTH, np.concatenate((TRIANGLE, [[0, 0, 4.0, 0, 0, 0, 3, 0, 4]]), axis=1), 0)
    data = builder.finish()[0].batches[0].data
    assert np.allclose(data[0, 9:], [0, 0, 1, 0, 0, 1, 0.6, 0, 0.8])


def test_polygons_are_cut_that_are_bent_against_the_scene_however_far_it_is():
    """A bend that shows in machine coordinates would be seen by one cell and not by another."""
    assert MOST_BENT == SLACK / 4
    builder = builder_with_one_material()
    bent = 0.3 * SQUARE + np.array([1000.0, 0, 0])
    bent[2, 2] += 1e-5
    builder.add_polygons(bent, np.array([0, 4]), 0)
    surfaces, _, remarks = builder.finish()
    assert surfaces.count(Kind.POLYGON) == 0
    assert surfaces.count(Kind.TRIANGLE) == 2
    assert remarks == ("1 polygon cut into triangles, being not planar",)


def test_polygons_stay_whole_whose_bend_is_nothing_against_the_scene():
    builder = builder_with_one_material()
    bent = 0.3 * SQUARE + np.array([1000.0, 0, 0])
    bent[2, 2] += 1e-5
    builder.add_polygons(bent, np.array([0, 4]), 0)
    builder.add(Kind.SPHERE, np.array([[0.0, 0.0, 0.0, 1.0]]), 0)
    surfaces, _, remarks = builder.finish()
    assert surfaces.count(Kind.POLYGON) == 1
    assert not remarks


def test_bent_polygons_are_cut_along_their_vertices():
    builder = builder_with_one_material()
    bent = SQUARE + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0.1], [0, 0, 0]])
    builder.add_polygons(np.concatenate((bent, SQUARE)), np.array([0, 4, 8]), 0)
    surfaces, _, remarks = builder.finish()
    assert (surfaces.count(Kind.TRIANGLE), surfaces.count(Kind.POLYGON)) == (2, 1)
    assert {batch.kind: batch.ids.tolist() for batch in surfaces} == {Kind.TRIANGLE: [0, 1], Kind.POLYGON: [2]}
    assert remarks == ("1 polygon cut into triangles, being not planar",)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e31])
def test_numbers_that_are_no_coordinates_are_refused(bad):
    builder = builder_with_one_material()
    with pytest.raises(SceneError, match=r"^x\.test: a surface has (a number that is not finite|the number 1e\+31)"):
        builder.add(Kind.SPHERE, np.array([[0.0, bad, 0, 1]]), 0)


def test_materials_below_0_are_refused():
    with pytest.raises(SceneError, match=r"x\.test: a material has a number that is not finite or below 0"):
        SceneBuilder("x.test").add_materials(material(specular=-0.5))


def test_no_surfaces_is_an_error_that_tells_of_dropped_ones():
    with pytest.raises(SceneError, match=r"x\.test: the file has no surfaces, wanted at least one"):
        builder_with_one_material().finish()
    builder = builder_with_one_material()
    builder.add(Kind.TRIANGLE, np.zeros((2, 9)), 0)
    with pytest.raises(SceneError, match="only 2 surfaces without area"):
        builder.finish()


def many_materials(count, baked):
    builder = SceneBuilder("x.test")
    rows = np.zeros(count, MATERIAL_RECORD)
    rows["diffuse"] = np.random.default_rng(3).random((count, 3))
    builder.add_materials(rows, baked=baked)
    builder.add(Kind.SPHERE, np.tile([0.0, 0, 0, 1], (count, 1)), np.arange(count))
    return builder, rows["diffuse"]


def test_too_many_baked_colours_are_rounded():
    builder, before = many_materials(70_000, baked=True)
    surfaces, table, remarks = builder.finish()
    assert len(table) <= 4096
    assert remarks == ("too many colours in textures: rounded to 16 levels of each primary",)
    after = table["diffuse"][surfaces.batches[0].materials]
    assert np.abs(after ** (1 / 2.2) - before ** (1 / 2.2)).max() <= 0.5 / 15 + 1e-9


def test_too_many_materials_of_another_origin_are_an_error():
    with pytest.raises(SceneError, match=r"x\.test: the file has 70000 materials, wanted at most 65536"):
        many_materials(70_000, baked=False)[0].finish()


def test_just_as_many_materials_as_fit():
    surfaces, table, remarks = many_materials(65_536, baked=False)[0].finish()
    assert len(table) == 65_536
    assert surfaces.batches[0].materials.max() == 65_535
    assert not remarks


def test_exposure_brings_the_brightest_light_to_1_and_keeps_proportions():
    lights = light_table(
        [point_light((0, 0, 2), 400.0, falloff=True), point_light((0, 5, 0), (100, 50, 0), falloff=True)]
    )
    scaled = exposed(lights, np.zeros(3), 0.01)
    assert np.allclose(scaled["intensity"], [[4, 4, 4], [1, 0.5, 0]])
    assert scaled["falloff"].tolist() == [1, 1]
    near = exposed(lights, np.array([0.0, 0, 2]), 0.1)  # a light at the very point counts as 0.1 away
    assert np.allclose(near["intensity"][0], 0.01)
    dark = light_table([point_light((0, 0, 2), 0.0, falloff=True)])
    assert exposed(dark, np.zeros(3), 0.01)["intensity"].tolist() == [[0.0, 0, 0]]


def test_exposure_point_is_on_the_axis_nearest_to_the_middle():
    camera = perspective_camera((0, 0, 5), (0, 0, 0), (0, 1, 0), 40)
    assert np.allclose(exposure_point(camera, np.array([[0.0, 0, -1], [2, 4, 3]])), [0, 0, 1])
    assert np.allclose(exposure_point(camera, np.array([[0.0, 0, 9], [2, 4, 11]])), [1, 2, 10])  # behind it


def test_light_rows():
    spot = spot_light((1, 2, 3), (0, 0, -2), 5.0, 0.1, 0.2, falloff=True)[0]
    assert (spot["kind"], spot["spot"], spot["falloff"]) == (POINT, 1, 1)
    assert np.allclose(spot["axis"], (0, 0, -1))
    assert np.allclose((spot["cos_inner"], spot["cos_outer"], spot["cos_disc"]), (np.cos(0.1), np.cos(0.2), 2))
    sun = directional_light((0, 3, 4), (1, 2, 3), 0.01, (9, 8, 7))[0]
    assert (sun["kind"], sun["spot"], sun["falloff"]) == (DIRECTIONAL, 0, 0)
    assert np.allclose(sun["place"], (0, 0.6, 0.8))
    assert np.allclose((sun["cos_disc"], *sun["disc"]), (np.cos(0.01), 9, 8, 7))
    with pytest.raises(SceneError, match="wanted one with a length"):
        directional_light((0, 0, 0), 1.0)


def test_invented_lights_come_from_behind_the_camera():
    camera = perspective_camera((3, -4, 5), (0, 0, 1), (0, 0, 1), 40)
    towards = invented_lights(camera)["place"]
    assert np.allclose(np.linalg.norm(towards, axis=1), 1)
    assert (towards @ np.array(camera.forward) < 0).all()
    assert np.sign(towards @ np.array(camera.right)).tolist() == [-1, 1]


def test_finishing_invents_what_is_missing_and_says_so():
    builder = builder_with_one_material()
    builder.add(Kind.TRIANGLE, TRIANGLE, 0)
    scene = finish_scene(builder, Path("dir/x.test"), highlights=False)
    assert (scene.name, scene.highlights, len(scene.lights)) == ("x.test", False, 2)
    assert [remark.split(":")[0] for remark in scene.remarks] == ["no camera in the file", "no light in the file"]


def test_description_is_json():
    facts = describe(load_scene(SCENES / "kinds.nff"))
    assert json.loads(json.dumps(facts)) == facts
    assert facts["surfaces"]["sphere"] == 4
    assert facts["camera"]["angle"] == pytest.approx(36)
    facts = describe(load_scene(SCENES / "lights.toml"))
    assert [light["kind"] for light in facts["lights"]].count("spot") == 2
    assert json.loads(json.dumps(facts)) == facts


@pytest.mark.parametrize("name", ["a.xyz", "a", "a.toml.bak"])
def test_unknown_suffixes_are_told_the_known_ones(name):
    with pytest.raises(SceneError, match=r"wanted one of: \.nff \.obj \.ply \.stl \.glb \.gltf \.toml$"):
        load_scene(name)


@pytest.mark.parametrize("suffix", READERS)
def test_missing_files_and_directories(suffix, tmp_path):
    with pytest.raises(SceneError, match=f"no{suffix}: there is no such file"):
        load_scene(tmp_path / f"no{suffix}")
    (tmp_path / f"dir{suffix}").mkdir()
    with pytest.raises(SceneError, match=f"dir{suffix}: the scene is a directory, wanted a file"):
        load_scene(str(tmp_path / f"dir{suffix}"))


def test_suffixes_in_capitals(tmp_path):
    path = tmp_path / "TINY.NFF"
    path.write_bytes((SCENES / "tiny.nff").read_bytes())
    assert len(load_scene(path).surfaces) == 6


@pytest.mark.parametrize(
    ("name", "surfaces", "lights"),
    [
        ("tiny.nff", 6, 2),
        ("kinds.nff", 20, 2),
        ("faces.nff", 58, 3),
        ("glass.toml", 536, 2),
        ("lights.toml", 46, 26),
        ("room.glb", 7428, 2),
        ("room.obj", 7428, 2),
        ("checker.obj", 512, 2),
        ("tree.nff", 2187, 7),
        ("rings.toml", 10, 2),
        ("marble.toml", 14, 1),
        ("mobile.toml", 21, 2),
    ],
)
def test_our_scenes(name, surfaces, lights):
    scene = load_scene(SCENES / name)
    assert (len(scene.surfaces), len(scene.lights)) == (surfaces, lights)
    ids = np.concatenate([batch.ids for batch in scene.surfaces])
    assert np.array_equal(np.sort(ids), np.arange(surfaces))
    for batch in scene.surfaces:
        assert batch.data.dtype == np.float64
        assert np.isfinite(batch.data).all()
        assert batch.materials.max() < len(scene.materials)


def test_our_scenes_are_all_tested_and_as_they_describe_themselves():
    files = {path.name for path in SCENES.iterdir() if path.suffix in READERS}
    tested = test_our_scenes.pytestmark[0].args[1]
    assert files == {case[0] for case in tested}
    kinds = load_scene(SCENES / "kinds.nff").surfaces
    assert all(kinds.count(kind) for kind in Kind)
    faces = load_scene(SCENES / "faces.nff").surfaces
    assert np.array_equal(faces.bounds(), [[-2, -2, -2], [2, 2, 2]])


def test_reading_nff_brings_in_no_large_library():
    """Start-up time: numba, trimesh, pydantic and Pillow cost 0.1 to 0.6 s each."""
    heavy = "{'numba', 'trimesh', 'pydantic', 'PIL'}"
    code = f"import sys, raygrid.host.scene.load as l; l.load_scene(sys.argv[1]); print({heavy} & set(sys.modules))"
    command = [sys.executable, "-c", code, str(SCENES / "tiny.nff")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
