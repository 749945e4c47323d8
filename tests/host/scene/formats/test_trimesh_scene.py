"""Scenes of trimesh in memory: what is kept is what the files keep that are written of them; what is refused, in one sentence."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from PIL import Image
from support.render import rendered
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from raygrid.host.scene.load import load_scene
from raygrid.host.scene.scene import Scene
from raygrid.host.text.misuse import SceneMisuse
from raygrid.node.errors import SceneError
from raygrid.node.geometry.surfaces import Kind

RED, GREEN = (255, 0, 0, 255), (0, 255, 0, 255)


def solid(**options):
    """An irregular tetrahedron, whose coordinates are the same in 32 bits."""
    points = [(0, 0, 0), (1, 0.25, 0), (0.5, 1, 0.125), (0.25, 0.5, 1)]
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
    return trimesh.Trimesh(np.array(points), np.array(faces), process=False, **options)


def from_file(tmp_path, given, suffix):
    path = tmp_path / f"written{suffix}"
    given.export(path)
    return load_scene(path)


def same(one, other):
    """Everything but the name."""
    assert [batch.kind for batch in one.surfaces] == [batch.kind for batch in other.surfaces]
    for mine, its in zip(one.surfaces, other.surfaces, strict=True):
        for field in ("ids", "materials", "data"):
            np.testing.assert_array_equal(getattr(mine, field), getattr(its, field))
    for field in ("materials", "lights"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
    assert (one.camera, one.background, one.highlights, one.up) == (
        other.camera, other.background, other.highlights, other.up,
    )  # fmt: skip
    assert one.remarks == other.remarks
    return True


def textured(material):
    uv = np.array([(7, 7), (57, 9), (33, 38), (14, 61)]) / 64  # the same in 32 bits, no middle between two texels
    return solid(visual=trimesh.visual.TextureVisuals(uv=uv, material=material))


def picture():
    return Image.fromarray(np.random.default_rng(3).integers(0, 256, (8, 8, 3), np.uint8))


# --- as the files have it

MESHES = {
    "plain": (solid, ".ply"),
    "plain, OBJ": (solid, ".obj"),
    "colours of vertices": (lambda: solid(vertex_colors=[RED, GREEN, (9, 80, 200, 255), (255, 255, 255, 255)]), ".ply"),
    "colours of faces": (lambda: solid(face_colors=[RED, GREEN, RED, (9, 80, 200, 255)]), ".ply"),
    "normals": (lambda: solid(vertex_normals=[(0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1)]), ".ply"),
    "MTL": (
        lambda: textured(
            SimpleMaterial(diffuse=(255, 0, 255, 255), specular=(0, 255, 0, 255), glossiness=20.0, name="m")
        ),
        ".obj",
    ),
    "texture, MTL": (lambda: textured(SimpleMaterial(image=picture(), diffuse=RED, glossiness=0.0, name="m")), ".obj"),
    "glTF": (
        lambda: textured(PBRMaterial(baseColorFactor=(51, 102, 255, 255), metallicFactor=0.25, roughnessFactor=0.5)),
        ".glb",
    ),
    "blend": (lambda: textured(PBRMaterial(baseColorFactor=(51, 102, 255, 51), alphaMode="BLEND")), ".glb"),
    "textures, glTF": (
        lambda: textured(
            PBRMaterial(
                baseColorTexture=picture(), metallicRoughnessTexture=picture(), roughnessFactor=0.5, name="gold"
            )
        ),
        ".glb",
    ),
}


@pytest.mark.parametrize("what", MESHES)
def test_a_mesh_is_what_is_read_of_the_file_written_from_it(what, tmp_path):
    make, suffix = MESHES[what]
    mesh = make()
    scene = load_scene(mesh)
    assert same(scene, from_file(tmp_path, mesh, suffix))
    assert scene.name == "trimesh.Trimesh"
    assert any("no camera in the file" in remark for remark in scene.remarks)


def test_the_picture_has_the_same_bits(tmp_path):
    mesh = solid(face_colors=[RED, GREEN, RED, (9, 80, 200, 255)])
    pictures = [
        rendered(scene, (2, 1, 1), size=(24, 18)) for scene in (load_scene(mesh), from_file(tmp_path, mesh, ".ply"))
    ]
    assert np.array_equal(pictures[0].sums, pictures[1].sums)
    assert len(np.unique(pictures[0].sums.reshape(-1, 3), axis=0)) >= 3  # two sides and what is behind


def test_coordinates_keep_their_64_bits():
    mesh = solid()
    mesh.vertices = mesh.vertices / 3.0
    (batch,) = load_scene(mesh).surfaces
    np.testing.assert_array_equal(batch.data.reshape(-1, 3, 3), np.asarray(mesh.vertices)[mesh.faces])


def test_normals_that_somebody_asked_for_make_it_smooth():
    mesh = solid()
    assert [batch.kind for batch in load_scene(mesh).surfaces] == [Kind.TRIANGLE]
    assert len(mesh.vertex_normals) == 4
    assert [batch.kind for batch in load_scene(mesh).surfaces] == [Kind.SMOOTH]


def test_a_mesh_is_left_as_it_was():
    mesh = solid(vertex_colors=[RED, GREEN, RED, GREEN])
    before = hash(mesh), hash(mesh.visual)
    load_scene(mesh)
    assert (hash(mesh), hash(mesh.visual)) == before
    assert "vertex_normals" not in mesh._cache


# --- graphs

MIRRORED = np.diag((-2.0, 0.5, 1.0, 1.0))
SHIFTED = np.array([(0, -1, 0, 4), (1, 0, 0, 0.5), (0, 0, 1, -2), (0, 0, 0, 1)], np.float64)


def graph():
    """One mesh placed twice, one of them below a node that mirrors, and one of another colour."""
    scene = trimesh.Scene()
    blue = textured(PBRMaterial(baseColorFactor=(0, 0, 255, 255), metallicFactor=0.0))
    scene.add_geometry(blue, node_name="a", geom_name="blue", transform=SHIFTED)
    scene.add_geometry(textured(PBRMaterial(baseColorFactor=RED)), node_name="b", geom_name="red", transform=MIRRORED)
    scene.graph.update("c", frame_from="b", matrix=SHIFTED, geometry="blue")
    return scene


def test_the_transforms_of_a_graph_are_applied(tmp_path):
    scene, written = load_scene(graph()), from_file(tmp_path, graph(), ".glb")
    assert len(scene.surfaces) == 12
    assert len(scene.materials) == 2
    for axis in (0, 1):
        np.testing.assert_array_equal(scene.surfaces.bounds()[axis], written.surfaces.bounds()[axis])
    pictures = [rendered(one, (2, 1, 1), size=(24, 18)).sums for one in (scene, written)]
    assert np.array_equal(*pictures)
    assert scene.name == "trimesh.Scene"


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_material_of_gltf_makes_all_meshes_flat_wherever_it_stands_in_the_graph(tmp_path, order):
    """It failed: meshes of nodes before it were smooth."""
    plain, physical = trimesh.creation.icosphere(2), trimesh.creation.icosphere(2)
    uv = np.zeros((len(physical.vertices), 2))
    physical.visual = trimesh.visual.TextureVisuals(uv=uv, material=PBRMaterial(baseColorFactor=RED))
    given = trimesh.Scene([(plain, physical)[number] for number in order])
    assert load_scene(given).surfaces.count(Kind.SMOOTH) == 0
    assert from_file(tmp_path, given, ".glb").surfaces.count(Kind.SMOOTH) == 0
    assert load_scene(trimesh.Scene(plain)).surfaces.count(Kind.SMOOTH) == 320


def test_a_graph_s_camera_is_used():
    given = graph()
    assert any("no camera" in remark for remark in load_scene(given).remarks)
    assert not given.has_camera
    given.camera = trimesh.scene.Camera(resolution=(400, 300), fov=(60.0, 45.0))
    given.camera_transform = np.array([(0, 0, 1, 9), (0, 1, 0, 2), (-1, 0, 0, 3), (0, 0, 0, 1)], np.float64)
    scene = load_scene(given)
    camera = scene.camera
    assert (camera.eye, camera.forward, camera.up) == ((9, 2, 3), (-1, 0, 0), (0, 1, 0))
    assert camera.half == pytest.approx(np.tan(np.radians(22.5)))
    assert not any("no camera" in remark for remark in scene.remarks)


def test_points_and_lines_of_a_graph_are_left_out():
    given = trimesh.Scene([solid(), trimesh.PointCloud([(0, 0, 0), (1, 1, 1)])])
    scene = load_scene(given)
    assert len(scene.surfaces) == 4
    assert "1 node of points or lines left out" in scene.remarks


# --- what is refused


def with_points(points, faces=((0, 1, 2),)):
    mesh = trimesh.Trimesh(process=False)
    mesh.vertices, mesh.faces = points, faces
    return mesh


def misplaced():
    scene = trimesh.Scene(solid())
    scene.graph.update("far", matrix=np.full((4, 4), np.nan), geometry=next(iter(scene.geometry)))
    return scene


def lost():
    scene = trimesh.Scene(solid())
    scene.graph.update("lost\x1b", frame_from="nowhere", geometry=next(iter(scene.geometry)))
    return scene


def blind():
    scene = trimesh.Scene(solid())
    scene.camera = trimesh.scene.Camera(resolution=(400, 300), fov=(60.0, 190.0))
    scene.camera_transform = np.eye(4)
    return scene


def huge():
    """A picture of which only the size is ever looked at."""
    vast = Image.new("1", (8193, 8192))
    return textured(SimpleMaterial(image=vast))


def miscoloured():
    mesh = solid(vertex_colors=[RED] * 4)
    mesh.visual._data["vertex_colors"] = np.zeros((3, 4), np.uint8)
    return mesh


REFUSED = {
    "no faces": (lambda: trimesh.Trimesh(), "trimesh.Trimesh: the mesh has no faces, wanted at least one"),
    "NaN": (
        lambda: with_points([(0, 0, np.nan), (1, 0, 0), (0, 1, 0)]),
        "trimesh.Trimesh: a surface has a number that is not finite",
    ),
    "infinite": (
        lambda: with_points([(0, 0, np.inf), (1, 0, 0), (0, 1, 0)]),
        "trimesh.Trimesh: a surface has a number that is not finite",
    ),
    "too large": (
        lambda: with_points([(0, 0, 1e31), (1, 0, 0), (0, 1, 0)]),
        "trimesh.Trimesh: a surface has the number 1e+31, wanted at most 1e30",
    ),
    "flat points": (
        lambda: with_points([(0, 0), (1, 0), (0, 1)]),
        "trimesh.Trimesh: the vertices have the shape (3, 2), wanted (n, 3)",
    ),
    "no such vertex": (
        lambda: with_points([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 7)]),
        "trimesh.Trimesh: a face has the vertex 7, wanted numbers from 0 to 2",
    ),
    "a vertex below 0": (
        lambda: with_points([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, -1)]),
        "trimesh.Trimesh: a face has the vertex -1, wanted numbers from 0 to 2",
    ),
    "no area": (
        lambda: with_points([(0, 0, 0), (1, 0, 0), (2, 0, 0)]),
        "trimesh.Trimesh: the file has only 1 surface without area, wanted at least one surface",
    ),
    "no colour for a vertex": (
        miscoloured,
        "trimesh.Trimesh: the colours of vertices have the shape (3, 4), wanted (4, 4)",
    ),
    "no number": (
        lambda: textured(SimpleMaterial(d="much")),
        "trimesh.Trimesh: the object cannot be read (\"ValueError: could not convert string to float: 'much'\")",
    ),
    "a wild material": (
        lambda: textured(SimpleMaterial(glossiness=float("nan"))),
        "trimesh.Trimesh: a material has a number that is not finite or below 0",
    ),
    "too many texels": (
        huge,
        "trimesh.Trimesh: the texture has 67,117,056 texels, wanted at most 67,108,864",
    ),
    "an empty graph": (
        lambda: trimesh.Scene(),
        "trimesh.Scene: the file has no surfaces, wanted at least one surface",
    ),
    "a wild transform": (
        misplaced,
        "trimesh.Scene, node 'far' has a transform that is not finite, or beyond 1e30",
    ),
    "a node that hangs nowhere": (lost, "trimesh.Scene: the object cannot be read ("),
    "a wide camera": (blind, "trimesh.Scene, the camera: "),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_rendered_is_refused_in_one_sentence(what):
    make, sentence = REFUSED[what]
    given = make()
    with pytest.raises(SceneError) as raised:
        load_scene(given)
    said = str(raised.value)
    assert said == sentence or (sentence.endswith(("(", ": ")) and said.startswith(sentence))
    assert said.isprintable()


@pytest.mark.parametrize(
    ("given", "came"),
    [
        (None, "None"),
        (3, "an object of int"),
        (b"x.ply", "an object of bytes"),
        (np.zeros((3, 3)), "an object of numpy.ndarray"),
        ([solid()], "an object of list"),
        (trimesh.PointCloud([(0, 0, 0)]), "an object of trimesh.points.PointCloud"),
        (trimesh.Trimesh, "an object of abc.ABCMeta"),
    ],
)
def test_what_is_no_scene_is_refused_in_one_sentence(given, came):
    with pytest.raises(SceneMisuse) as raised:
        load_scene(given)
    wanted = "wanted the path of a file, a raygrid.Scene, a trimesh.Trimesh or a trimesh.Scene"
    assert str(raised.value) == f"a scene came as {came}, {wanted}"


def test_trimesh_is_not_imported_to_ask():
    look = """
import sys, raygrid
for given in (None, 3):
    try:
        raygrid.load_scene(given)
    except raygrid.SceneError as error:
        print(error)
print('trimesh' in sys.modules)
"""
    run = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, timeout=60)
    assert run.stdout.splitlines()[-1] == "False"
    assert len(run.stdout.splitlines()) == 3


def test_a_scene_is_given_back_as_it_is():
    scene = load_scene(solid())
    assert isinstance(scene, Scene)
    assert load_scene(scene) is scene
