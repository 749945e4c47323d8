"""The scene file: every table and key, placement of other files, and errors with line and key."""

import math
import shutil

import numpy as np
import pytest
from support import paths

from raygrid.host.scene.formats.toml_errors import line_of
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.polygons import area_vectors
from raygrid.host.scene.transform import moved, placement
from raygrid.node.errors import SceneError
from raygrid.node.geometry.surfaces import Batch, Kind
from raygrid.node.protocol.frame import DIRECTIONAL, POINT

BALL = '[[surfaces]]\nkind = "sphere"\ncentre = [0, 0, 0]\nradius = 1\n'
NFF = "b 0.5 0.5 0.5\nv from 0 -5 1 at 0 0 0 up 0 0 1 angle 40 hither 1 resolution 64 48\nl 1 2 3\nf 1 0 0 1 0 0 0 0\n"
NFF += "s 1 2 3 0.5\np 3 0 0 0 1 0 0 0 1 0\np 4 0 0 0 1 0 0 1 1 0 0 1 0\n"


@pytest.fixture
def read(tmp_path):
    def read(text, **files):
        for name, content in files.items():
            (tmp_path / name.replace("_", ".")).write_text(content)
        path = tmp_path / "x.toml"
        path.write_text(text)
        return load_scene(path)

    return read


def data(scene, kind):
    return next(batch for batch in scene.surfaces if batch.kind == kind).data


def test_the_least_file(read):
    scene = read(BALL)
    assert (len(scene.surfaces), scene.background, scene.highlights, scene.size) == (1, (0, 0, 0), True, None)
    assert (scene.samples, scene.depth, scene.min_weight) == (None, None, None)
    assert scene.materials["diffuse"].tolist() == [[0.8] * 3]
    assert len(scene.lights) == 2
    assert len(scene.remarks) == 2


def test_settings_camera_and_materials(read):
    scene = read(
        "background = [0.1, 0.2, 0.3]\nhighlights = false\n"
        "[image]\nwidth = 320\nheight = 200\nsamples = 4\ndepth = 7\nmin_weight = 0.01\n"
        "[camera]\nfrom = [0, -5, 0]\nat = [0, 0, 0]\nup = [0, 0, 1]\nfov = 90\n"
        "[materials.gold]\ncolor = [1, 0.5, 0]\ndiffuse = 0.5\n"
        "highlight = [0.1, 0.2, 0.3]\nshine = 9\nspecular = 0.25\n"
        "[materials.glass]\ndiffuse = 0\ntransmission = [0.9, 0.8, 0.7]\n"
        + BALL
        + 'material = "glass"\n'
        + BALL
        + 'material = "gold"\n'
    )
    assert (scene.size, scene.samples, scene.depth, scene.min_weight) == ((320, 200), 4, 7, 0.01)
    assert (scene.background, scene.highlights) == ((0.1, 0.2, 0.3), False)
    assert (scene.camera.eye, scene.camera.half) == ((0, -5, 0), pytest.approx(1))
    gold, glass = scene.materials
    assert np.allclose(gold["diffuse"], (0.5, 0.25, 0))
    assert np.allclose(gold["highlight"], (0.1, 0.2, 0.3))
    assert (gold["shine"], gold["specular"].tolist(), gold["ior"]) == (9, [0.25] * 3, 1)
    assert (glass["transmission"].tolist(), glass["ior"], glass["diffuse"].any()) == ([0.9, 0.8, 0.7], 1.5, False)


def test_orthographic_camera(read):
    camera = read(BALL + "[camera]\nfrom = [0, 0, 5]\nat = [0, 0, 0]\northographic = 6\n").camera
    assert (camera.orthographic, camera.half, camera.up) == (True, 3, (0, 1, 0))


def test_lights(read):
    scene = read(
        BALL + '[[lights]]\nkind = "point"\nposition = [1, 2, 3]\nintensity = 2\ncolour = [1, 0.5, 0]\nfalloff = true\n'
        '[[lights]]\nkind = "directional"\ntowards = [0, 0, 2]\ndisc_degrees = 0.25\n'
        '[[lights]]\nkind = "directional"\ntowards = [0, 3, 4]\ndisc_degrees = 1\ndisc_colour = [9, 8, 7]\n'
        '[[lights]]\nkind = "spot"\nposition = [0, 0, 5]\nat = [0, 0, 1]\nouter_degrees = 20\n'
        '[[lights]]\nkind = "spot"\nposition = [0, 0, 5]\nat = [0, 0, 1]\nouter_degrees = 20\ninner_degrees = 5\n'
    )
    point, sun, moon, spot, sharp = scene.lights
    assert scene.lights["kind"].tolist() == [POINT, DIRECTIONAL, DIRECTIONAL, POINT, POINT]
    assert (point["intensity"].tolist(), point["falloff"], point["cos_disc"]) == ([2, 1, 0], 1, 2)
    assert np.allclose((sun["cos_disc"], *sun["disc"], *sun["place"]), (math.cos(math.radians(0.25)), 1, 1, 1, 0, 0, 1))
    assert np.allclose((*moon["disc"], *moon["place"]), (9, 8, 7, 0, 0.6, 0.8))
    assert (spot["spot"], spot["falloff"], spot["axis"].tolist()) == (1, 0, [0, 0, -1])
    assert np.allclose((spot["cos_inner"], spot["cos_outer"]), np.cos(np.radians((16, 20))))
    assert np.isclose(sharp["cos_inner"], math.cos(math.radians(5)))
    assert not any(remark.startswith("no light") for remark in scene.remarks)


def test_every_kind_of_surface_in_the_order_of_the_file(read):
    scene = read(
        '[[surfaces]]\nkind = "box"\nlow = [0, 0, 0]\nhigh = [1, 2, 3]\n'
        + BALL.replace("radius = 1", "radius = -2").replace("centre", "center")
        + '[[surfaces]]\nkind = "cylinder"\nbase = [0, 0, 0]\ntop = [0, 0, 2]\nradius = 0.5\n'
        '[[surfaces]]\nkind = "cone"\nbase = [0, 0, 0]\nbase_radius = 0.5\napex = [0, 0, 2]\napex_radius = 1\n'
        '[[surfaces]]\nkind = "triangle"\npoints = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]\n'
        '[[surfaces]]\nkind = "triangle"\npoints = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]\n'
        "normals = [[0, 0, 1], [0, 0, 2], [0, 3, 4]]\n"
        '[[surfaces]]\nkind = "polygon"\npoints = [[0, 0, 0], [2, 1, 0], [4, 0, 0], [2, 4, 0]]\n'
        '[[surfaces]]\nkind = "cone"\nbase = [0, 0, 0]\nbase_radius = 1\napex = [0, 0, 2]\napex_radius = 1\n'
    )
    assert {batch.kind: batch.ids.tolist() for batch in scene.surfaces} == {
        Kind.POLYGON: [0, 1, 2, 3, 4, 5, 11],
        Kind.SPHERE: [6],
        Kind.CYLINDER: [7, 12],
        Kind.CONE: [8],
        Kind.TRIANGLE: [9],
        Kind.SMOOTH: [10],
    }
    assert data(scene, Kind.SPHERE).tolist() == [[0, 0, 0, -2]]
    assert data(scene, Kind.CYLINDER).tolist()[0] == [0, 0, 0, 0.5, 0, 0, 2, 0.5]
    assert data(scene, Kind.CONE).tolist() == [[0, 0, 2, 1, 0, 0, 0, 0.5]]
    assert np.allclose(data(scene, Kind.SMOOTH)[0, 9:], [0, 0, 1, 0, 0, 1, 0, 0.6, 0.8])


def test_a_box_is_closed_and_its_fronts_are_outside(read):
    scene = read('[[surfaces]]\nkind = "box"\nlow = [1, 2, 3]\nhigh = [2, 4, 6]\n')
    batch = scene.surfaces.batches[0]
    vectors = area_vectors(batch.data, batch.starts) / 2
    outward = batch.data.reshape(6, 4, 3).mean(axis=1) - (1.5, 3, 4.5)
    assert np.allclose(vectors.sum(axis=0), 0)
    assert np.allclose(np.einsum("ni,ni->", vectors, outward) / 3, 6)  # its volume
    assert (np.einsum("ni,ni->n", vectors, outward) > 0).all()


def test_meshes_are_placed_and_may_take_one_material(read):
    text = (
        '[materials.blue]\ncolour = [0, 0, 1]\n[[meshes]]\nfile = "a.nff"\nscale = 2\nrotate = [0, 0, 90]\n'
        'translate = [10, 0, 0]\n[[meshes]]\nfile = "a.nff"\nmaterial = "blue"\n' + BALL
    )
    scene = read(text, a_nff=NFF)
    assert data(scene, Kind.SPHERE).tolist()[0] == [0, 0, 0, 1]  # [[surfaces]] come first
    assert np.allclose(data(scene, Kind.SPHERE)[1:], [[6, 2, 6, 1], [1, 2, 3, 0.5]])
    assert np.allclose(data(scene, Kind.TRIANGLE)[0], [10, 0, 0, 10, 2, 0, 8, 0, 0])
    assert {batch.kind: batch.ids.tolist() for batch in scene.surfaces} == {
        Kind.SPHERE: [0, 1, 4],
        Kind.TRIANGLE: [2, 5],
        Kind.POLYGON: [3, 6],
    }
    spheres = next(batch for batch in scene.surfaces if batch.kind == Kind.SPHERE)
    assert scene.materials["diffuse"][spheres.materials].tolist() == [[0.8] * 3, [1, 0, 0], [0, 0, 1]]
    assert scene.background == (0, 0, 0)  # a mesh brings its surfaces only


def test_an_included_file_is_the_whole_scene_to_begin_with(read):
    scene = read('include = "a.nff"\n' + BALL, a_nff=NFF)
    assert (scene.size, scene.background, len(scene.lights)) == ((64, 48), (0.5, 0.5, 0.5), 1)
    assert scene.camera.eye == (0, -5, 1)
    assert data(scene, Kind.SPHERE).tolist() == [[1, 2, 3, 0.5], [0, 0, 0, 1]]
    assert scene.remarks == ()
    rest = "[camera]\nfrom = [0, 9, 0]\nat = [0, 0, 0]\nup = [0, 0, 1]\n"
    rest += '[[lights]]\nkind = "point"\nposition = [0, 0, 9]\n[image]\nwidth = 9\nheight = 8\n'
    scene = read('include = "a.nff"\nbackground = [0, 0, 0]\n' + rest)
    assert (scene.size, scene.background, len(scene.lights)) == ((9, 8), (0, 0, 0), 2)
    assert scene.camera.eye == (0, 9, 0)


ERRORS = {
    "": "the file has no surfaces, wanted at least one surface",
    "a = = 1": "the TOML cannot be read (Invalid value (at line 1, column 5))",
    BALL + "raduis = 1": "line 5: the key surfaces[0].raduis is unknown, wanted one of: kind, material, group, centre",
    "size = 3\n" + BALL: "line 1: the key size is unknown, wanted one of: include, background",
    BALL + "[camera]\nfrm = [0, 0, 0]": "line 6: the key camera.frm is unknown, wanted one of: from, at",
    BALL + "[camera]\nat = [0, 0, 0]": "line 5: camera.from is missing",
    BALL + "[camera]\nfrom = [0, 0]\nat = [0, 0, 0]": "line 6: camera.from[2] is missing",
    BALL + "[camera]\nfrom = [0, 0, '1']\nat = [0, 0, 0]": "line 6: camera.from[2] is '1', wanted a valid number",
    BALL + "[camera]\nfrom = [1, 0, 0]\nat = [1, 0, 0]": "line 5: camera shows nothing: the camera looks from",
    BALL + "[camera]\nfrom = [1, 0, 0]\nat = [0, 0, 0]\nfov = 180": "line 8: camera.fov is 180, wanted less than 180",
    BALL + "[camera]\nfrom = [1, 0, 0]\nat = [0, 0, 0]\nfov = 1\northographic = 1": "wanted either fov",
    BALL.replace("sphere", "spher"): "line 1: surfaces[0].kind is 'spher', wanted one of: sphere, cylinder",
    BALL.replace("kind", "sort"): "line 1: surfaces[0].kind is None, wanted one of",
    BALL + BALL.replace("radius = 1", "radius = 0"): "line 8: surfaces[1].radius is 0, wanted another number",
    BALL.replace("= 1", "= nan"): "line 4: surfaces[0].radius is nan, wanted a finite number",
    BALL.replace("= 1", "= true"): "line 4: surfaces[0].radius is True, wanted a valid number",
    BALL.replace("= 1", "= 1e31"): "line 4: surfaces[0].radius is 1e+31, wanted less than or equal to 1e30",
    BALL + 'material = "gold"': "line 5: surfaces[0].material is 'gold', wanted one of: none, as",
    BALL + 'material = "gold"\n[materials.a]\n[materials.b]': "surfaces[0].material is 'gold', wanted one of: a, b",
    BALL + "[materials.a]\ncolour = [1, 1, -1]": "line 6: materials.a.colour[2] is -1, wanted greater than",
    BALL + "[materials.a]\nspecular = 'x'": "line 6: materials.a.specular is 'x', wanted a list",
    BALL + "[materials.a]\nior = 0": "line 6: materials.a.ior is 0, wanted greater than or equal to 0.001",
    BALL + "[image]\nwidth = 0\nheight = 1": "line 6: image.width is 0, wanted greater than or equal to 1",
    BALL + "[image]\nwidth = 10": "line 5: image is {'width': 10}, wanted both width and height, or neither",
    BALL + "[image]\ndepth = 32": "line 6: image.depth is 32, wanted less than or equal to 31",
    BALL + "[[lights]]\nkind = 'directional'\ntowards = [0, 0, 0]": "line 7: lights[0].towards is [0, 0, 0], wanted",
    BALL + "[[lights]]\nkind = 'spot'\nposition = [0, 0, 0]\nat = [0, 0, 0]": "wanted two different points as",
    BALL + "[[meshes]]\nfile = 'gone.obj'": "line 6: meshes[0].file cannot be placed:",
    BALL + "[[meshes]]\nfile = 'x.toml'": "line 6: meshes[0].file is 'x.toml', wanted a file that is no",
    BALL + "[[meshes]]\nfile = 'a.nff'\nscale = [1, 2, 1]": "cones can be scaled only by the same",
    BALL + "[[meshes]]\nfile = 'a.nff'\nscale = 0": "line 7: meshes[0].scale[0] is 0, wanted another number",
    "include = 'a.obj'": "line 1: include is 'a.obj', wanted an .nff file; meshes go under [[meshes]]",
    "include = 'gone.nff'": "gone.nff: there is no such file",
    "[[surfaces]]\nkind = 'cone'\nbase = [0, 0, 0]\nbase_radius = 1\napex = [0, 0, 0]": "surfaces[0] has both ends at",
    "[[surfaces]]\nkind = 'cone'\nbase = [0, 0, 0]\nbase_radius = 0\napex = [0, 0, 1]": "has the radii 0.0 and 0.0",
    "[[surfaces]]\nkind = 'box'\nlow = [0, 0, 0]\nhigh = [1, 0, 1]": "wanted a box whose low is below its high",
    "[[surfaces]]\nkind = 'polygon'\npoints = [[0, 0, 0], [1, 1, 1]]": "line 3: surfaces[0].points is",
    "surfaces = 3": "line 1: surfaces is 3, wanted a list",
}


@pytest.mark.parametrize("text", ERRORS, ids=range(len(ERRORS)))
def test_errors(read, text, tmp_path):
    (tmp_path / "a.nff").write_text(NFF)
    with pytest.raises(SceneError) as caught:
        read(text)
    assert str(caught.value).startswith(str(tmp_path))
    assert ERRORS[text] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text(tmp_path):
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(SceneError, match=r"x\.toml: the TOML cannot be read"):
        load_scene(tmp_path / "x.toml")


def test_lines_are_found_by_key():
    text = "a = 1\n\n[b]\nc = 2\n[[d]]\ne = 1\n[[d]]\n  e = 1 # [[d]]\n[f.g]\nh = [\n  1,\n]\n"
    places = {
        ("a",): 1,
        ("b",): 3,
        ("b", "c"): 4,
        ("d", 0, "e"): 6,
        ("d", 1): 7,
        ("d", 1, "e"): 8,
        ("f", "g", "h", 0): 10,
    }
    for key, line in places.items():
        assert line_of(text, key) == line
    assert line_of(text, ("d", 1, "missing")) == 7
    assert line_of(text, ("nowhere",)) is None


def one(kind, row):
    return Batch(kind, np.zeros(1, np.uint32), np.zeros(1, np.uint16), np.array([row], float))


def test_placement_scales_then_turns_about_x_y_z():
    assert np.allclose(placement(2.0, (0, 0, 0)), 2 * np.eye(3))
    assert np.allclose(placement((2, 3, 4), (90, 0, 0)) @ (1, 1, 1), (2, -4, 3))
    assert np.allclose(placement(1.0, (90, 0, 90)) @ (0, 1, 0), (0, 0, 1))  # about x first
    assert np.allclose(placement(1.0, (0, 90, 0)) @ (0, 0, 1), (1, 0, 0))


def test_moving_keeps_fronts_when_it_mirrors():
    mirror = placement((-1, 1, 1), 0.0)
    triangle = moved(one(Kind.TRIANGLE, [0, 0, 0, 1, 0, 0, 0, 1, 0]), mirror, (5, 0, 0))
    assert triangle.tolist() == [[5, 0, 0, 5, 1, 0, 4, 0, 0]]
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]])
    starts = np.array([0, 4, 7])
    polygons = Batch(Kind.POLYGON, np.arange(2, dtype=np.uint32), np.zeros(2, np.uint16), square, starts)
    after = moved(polygons, mirror, (0, 0, 0))
    assert np.allclose(area_vectors(after, starts), area_vectors(square, starts))
    smooth = moved(one(Kind.SMOOTH, [0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 0, 1, 0, 0, 1, 0, 1, 1]), mirror, (0, 0, 0))
    assert smooth.reshape(6, 3)[3:].tolist() == [[-1, 0, 1], [0, 1, 1], [0, 0, 1]]


def test_moving_round_surfaces():
    matrix = placement(2.0, (0, 0, 90))
    assert np.allclose(moved(one(Kind.SPHERE, [1, 0, 0, -3]), matrix, (0, 0, 1)), [[0, 2, 1, -6]])
    cone = moved(one(Kind.CONE, [1, 0, 0, 3, 0, 1, 0, 1]), matrix, (0, 0, 1))
    assert np.allclose(cone, [[0, 2, 1, 6, -2, 0, 1, 2]])


def test_the_example_in_the_docs(read, tmp_path):
    docs = (paths.ROOT / "docs" / "scenes.md").read_text()
    example = docs.partition("```toml\n")[2].partition("```")[0]
    for name in ("checker.obj", "checker.mtl"):
        shutil.copy(paths.SCENES / name, tmp_path)
    scene = read(example)
    assert len(scene.surfaces) > 4
    assert scene.remarks == ()
