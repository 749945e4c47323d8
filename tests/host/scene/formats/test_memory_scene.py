"""raygrid.Scene: what is built is what a scene file of it gives, saved and read it has the same bits, and errors are those
of scene files."""

import os
import pickle

import numpy as np
import pytest
from support.render import rendered

import raygrid
from raygrid.host.image.outputs import OutputError
from raygrid.host.scene.formats.polygon_mesh import PolygonMesh
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.scene import describe
from raygrid.host.text.misuse import OutputMisuse
from raygrid.node.errors import SceneError
from raygrid.node.geometry import Kind

RNG = np.random.default_rng(15)
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64) / 3.0
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def whole() -> raygrid.Scene:
    """Something of everything."""
    scene = raygrid.Scene(background=(0.3, 0.45, 0.7), size=(24, 18), samples=2, depth=4, highlights=True)
    scene.material("glass", diffuse=0, specular=0.08, transmission=np.float32(0.875), ior=1.5)
    scene.material(
        'a "red" one', colour=np.array([0.7, 0.1, 0.1]), keys=[{"frame": 1, "shine": 3}, {"frame": 5, "shine": 9}]
    )
    scene.group("g", pivot=(0, 1, 0), keys=[{"frame": 1, "rotate": (0, 0, 0)}, {"frame": 5, "rotate": (0, 90, 0)}])
    scene.shot(5, interpolation="smooth")
    scene.mesh(CORNERS, SIDES, colours=RNG.random((8, 3)), uv=RNG.random((8, 2)), group="g", crease=100)
    scene.mesh(CORNERS + 2, SIDES[:, :3], face_colours=RNG.integers(0, 256, (6, 4)).astype(np.uint8), normals=CORNERS)
    scene.mesh(CORNERS - 2, SIDES, material="glass")
    scene.sphere((0, 1, 3), 0.5, material="glass")
    scene.box((-3, 0, -2), (-2, 1.5, -1), material='a "red" one')
    scene.cone((2, 0, 0), 1, (2, 2, 0))
    scene.cylinder((3, 0, 0), (3, 1, 0), 0.2, group="g")
    scene.polygon([[-9, -3, -9], [-9, -3, 9], [9, -3, 9], [9, -3, -9]])
    scene.point_light((4, 5, 6), intensity=0.5, colour=(1, 0.9, 0.8), falloff=False)
    scene.directional_light(
        (-1, 2, 1), disc_degrees=3, keys=[{"frame": 1, "intensity": 1}, {"frame": 4, "intensity": 0.5}]
    )
    scene.spot_light((0, 5, 0), (0, 0, 0), outer_degrees=40)
    scene.camera((0, 2, 8), (0, 1, 0), fov=35, keys=[{"frame": 1, "eye": (0, 2, 8)}, {"frame": 5, "eye": (1, 2, 8)}])
    return scene


def test_what_is_saved_reads_as_the_same_scene(tmp_path):
    scene = whole()
    paths = scene.save(tmp_path / "a.toml")
    assert [path.removeprefix(f"{tmp_path}/") for path in paths] == ["a.toml", *(f"a_mesh_{k}.ply" for k in (1, 2, 3))]
    one, other = load_scene(scene), load_scene(tmp_path / "a.toml")
    for mine, read in zip(one.surfaces, other.surfaces, strict=True):
        assert mine.kind == read.kind
        for field in ("ids", "materials", "data", "starts"):
            np.testing.assert_array_equal(getattr(mine, field), getattr(read, field))
    assert {**describe(one), "name": ""} == {**describe(other), "name": ""}
    for frame in (1, 3, 5):
        for mine, read in zip(one.shot.at(frame), other.shot.at(frame), strict=True):
            assert mine == read if not isinstance(mine, np.ndarray) else (mine == read).all()


def test_the_pictures_are_the_same_bits(tmp_path):
    scene = whole()
    scene.save(tmp_path / "a.toml")
    one, other = (rendered(load_scene(given), (2, 1, 1), size=(24, 18)).sums for given in (scene, tmp_path / "a.toml"))
    assert one.any()
    np.testing.assert_array_equal(one, other)


def test_what_is_built_is_what_is_rendered():
    scene = load_scene(whole())
    counts = {kind: scene.surfaces.count(kind) for kind in Kind}
    assert (counts[Kind.SPHERE], counts[Kind.CONE], counts[Kind.CYLINDER], counts[Kind.POLYGON]) == (1, 1, 1, 7)
    assert (counts[Kind.SMOOTH], counts[Kind.TRIANGLE]) == (12 + 6, 12)
    assert (scene.size, scene.samples, scene.depth, scene.background) == ((24, 18), 2, 4, (0.3, 0.45, 0.7))
    assert scene.shot.frames == 5
    assert scene.name == "raygrid.Scene"


def test_arrays_are_copied_and_may_be_of_any_number_type():
    points = CORNERS.astype(np.float32)
    scene = raygrid.Scene()
    scene.mesh(points, SIDES.astype(np.uint16))
    before = load_scene(scene).surfaces.bounds()
    points += 9
    np.testing.assert_array_equal(load_scene(scene).surfaces.bounds(), before)


def test_uv_and_all_digits_are_in_the_file(tmp_path):
    from plyfile import PlyData

    scene, uv = raygrid.Scene(), RNG.random((8, 2))
    scene.mesh(CORNERS * np.pi, SIDES, uv=uv)
    _, path = scene.save(tmp_path / "a.toml")
    vertex = PlyData.read(path)["vertex"]
    np.testing.assert_array_equal(np.stack((vertex["s"], vertex["t"]), axis=1), uv)
    np.testing.assert_array_equal(vertex["x"], CORNERS[:, 0] * np.pi)


def test_a_mesh_of_faces_of_all_sizes_is_written_as_it_is(tmp_path):
    corners, starts = np.array([0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5]), np.array([0, 4, 8, 11])
    colours = RNG.integers(0, 256, (3, 3)).astype(np.uint8)
    with open(tmp_path / "m.ply", "wb") as file:
        PolygonMesh(CORNERS, corners, starts, of_faces=colours).write_ply(file)
    scene = load_scene(tmp_path / "m.ply")
    assert len(scene.surfaces) == 5
    assert len(scene.materials) == 3


def test_the_class_is_known_by_its_public_name():
    scene = whole()
    assert repr(scene) == "<raygrid.Scene of 3 lights, 5 surfaces, 3 meshes, 2 materials, 1 group>"
    assert f"{raygrid.Scene.__module__}.{raygrid.Scene.__qualname__}" == "raygrid.Scene"
    few = raygrid.Scene()
    few.mesh(CORNERS, SIDES)
    assert repr(few) == "<raygrid.Scene of 1 mesh>"
    again = pickle.loads(pickle.dumps(scene))
    assert describe(load_scene(again)) == describe(load_scene(scene))


M = "raygrid.Scene: meshes[0]"
FAULTS = [
    (lambda s: s.sphere((0, 0), 1), "raygrid.Scene: surfaces[0].centre[2] is missing"),
    (lambda s: s.sphere((0, 0, float("nan")), 1), "raygrid.Scene: surfaces[0].centre[2] is nan, wanted a finite number"),
    (lambda s: s.sphere((0, 0, 0), 0), "raygrid.Scene: surfaces[0].radius is 0, wanted another number than 0"),
    (lambda s: s.material("a", ior=-1), "raygrid.Scene: materials.a.ior is -1, wanted greater than or equal to 0.001"),
    (lambda s: [s.material("a"), s.material("a")], "raygrid.Scene: materials.a came twice, wanted it once"),
    (lambda s: s.material(""), "raygrid.Scene: a name of materials is '', wanted text"),
    (lambda s: s.group("g", keys=[{"frame": 0}]), "raygrid.Scene: groups.g.keys[0].frame is 0, wanted greater than"),
    (lambda s: s.camera((0, 0, 0), (0, 0, 0)), "raygrid.Scene: camera shows nothing: the camera looks from (0, 0, 0)"),
    (lambda s: s.camera((0, 0, 1), (0, 0, 0), fov=180), "raygrid.Scene: camera.fov is 180, wanted less than 180"),
    (lambda s: s.directional_light((0, 0, 0)), "raygrid.Scene: lights[0].towards is [0, 0, 0], wanted a direction"),
    (lambda s: s.mesh(CORNERS[:, :2], SIDES), f"{M}.vertices have the shape (8, 2), wanted numbers of the shape (n, 3)"),
    (lambda s: s.mesh("x", SIDES), f"{M}.vertices came with the dtype <U1, wanted numbers"),
    (lambda s: s.mesh([[1, 2, 3], [1]], SIDES), f"{M}.vertices came with rows of different lengths"),
    (lambda s: s.mesh(np.full((8, 3), np.inf), SIDES), f"{M}.vertices[0] is [inf, inf, inf], wanted finite numbers"),
    (lambda s: s.mesh(CORNERS, SIDES / 1.0), f"{M}.faces came with the dtype float64, wanted whole numbers"),
    (lambda s: s.mesh(CORNERS, SIDES + 1), f"{M}.faces[1] is [5, 7, 8, 6], wanted numbers from 0 to 7"),
    (lambda s: s.mesh(CORNERS, SIDES[:, :2]), f"{M}.faces have the shape (6, 2), wanted whole numbers"),
    (lambda s: s.mesh(CORNERS, SIDES[:0]), f"{M}.faces have the shape (0, 4), wanted"),
    (lambda s: s.mesh(CORNERS, SIDES, normals=CORNERS[1:]), f"{M}.normals have the shape (7, 3), wanted numbers of the shape (8"),
    (lambda s: s.mesh(CORNERS, SIDES, uv=CORNERS), f"{M}.uv have the shape (8, 3), wanted numbers of the shape (8, 2)"),
    (lambda s: s.mesh(CORNERS, SIDES, colours=SIDES), f"{M}.colours have the shape (6, 4), wanted uint8, or floats from 0 to 1"),
    (lambda s: s.mesh(CORNERS, SIDES, colours=CORNERS), f"{M}.colours[0] is [-0.3"),
    (lambda s: s.mesh(CORNERS, SIDES, face_colours=SIDES), f"{M}.face_colours came with the dtype int64, wanted uint8"),
    (lambda s: s.mesh(CORNERS, SIDES, crease=200), f"{M}.crease is 200, wanted less than or equal to 180"),
    (lambda s: s.mesh(CORNERS, SIDES, colours=abs(CORNERS), material="a"), f"{M} has colours and the material 'a'"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "words"), FAULTS, ids=[words[:70] for _, words in FAULTS])
def test_a_call_that_cannot_be_is_one_sentence_and_changes_nothing(call, words):
    scene = raygrid.Scene()
    with pytest.raises(SceneError) as refused:
        call(scene)
    assert words in str(refused.value)
    scene.sphere((0, 0, 0), 1)
    assert len(load_scene(scene).surfaces) == 1


def test_what_is_wrong_as_a_whole_is_said_when_it_is_read(tmp_path):
    for names, words in (
        ({"material": "no"}, "surfaces[0].material is 'no', wanted one of: none, as the file has no [materials]"),
        ({"group": "no"}, "surfaces[0].group is 'no', wanted one of: none, as the file has no [groups]"),
    ):
        scene = raygrid.Scene()
        scene.sphere((0, 0, 0), 1, **names)
        with pytest.raises(SceneError) as refused:
            load_scene(scene)
        assert str(refused.value) == f"raygrid.Scene: {words}"
        with pytest.raises(SceneError):
            scene.save(tmp_path / "a.toml")
    with pytest.raises(SceneError, match="no surfaces"):
        load_scene(raygrid.Scene())
    assert list(tmp_path.iterdir()) == []


def test_it_is_saved_as_a_scene_file_only(tmp_path):
    with pytest.raises(OutputError, match=r"a.glb: the file has the suffix '.glb', wanted .toml"):
        whole().save(tmp_path / "a.glb")
    with pytest.raises(SceneError, match=r"image.height is 0, wanted greater than or equal to 1"):
        raygrid.Scene(size=(3, 0))


def test_a_name_that_a_scene_file_cannot_hold_is_refused_before_anything_is_written(tmp_path):
    """It failed: a UnicodeEncodeError came, and meshes were there already."""
    scene = raygrid.Scene()
    scene.sphere((0, 0, 0), 1)
    name = os.fsdecode(b"T\xfcr.toml")
    assert scene.save(tmp_path / name) == (str(tmp_path / name),)
    (tmp_path / name).unlink()
    scene.mesh(CORNERS, SIDES)
    with pytest.raises(OutputMisuse, match="the name is no UTF-8, wanted one that a scene file can refer to"):
        scene.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_views_are_for_scenes_in_memory_too():
    scene = load_scene(whole(), fit="top", lights=[(0, 9, 0)], crease=0)
    assert np.allclose(scene.camera.forward, (0, -1, 0))
    assert len(scene.lights) == 1
    assert scene.surfaces.count(Kind.SMOOTH) == 6  # those with normals of their own
