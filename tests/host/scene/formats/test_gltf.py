"""glTF: documents made here in code, each fact of the mapping, damaged files, and the shared ones."""

import base64
import copy
import io
import json
import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from support import paths

from raygrid.host.scene.formats.gltf import node_matrix
from raygrid.host.scene.formats.gltf_materials import shading
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.protocol.frame import DIRECTIONAL, POINT

MESHES = paths.SHARED / "scenes" / "meshes"
needs_meshes = pytest.mark.skipif(not MESHES.is_dir(), reason=f"the shared meshes are not at {MESHES}")
SCENES = paths.SCENES

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
INDEX = np.array([0, 1, 2, 0, 2, 3], np.uint16)
WIDTH = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
KIND = {"f4": 5126, "u1": 5121, "u2": 5123, "u4": 5125, "i1": 5120}


def document(arrays, primitive, nodes=None, **others):
    """A glTF document with one mesh of one primitive; numbers in the primitive are rows of `arrays`."""
    data, views, accessors = b"", [], []
    for array in arrays:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        width = 1 if array.ndim == 1 else array.shape[1]
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": KIND[array.dtype.str[1:]],
                "count": len(array),
                "type": WIDTH[width],
                "normalized": array.dtype.kind != "f" and width > 1,
            }
        )
        data += array.tobytes() + bytes(-array.nbytes % 4)
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(range(len(nodes or [1])))}],
        "nodes": nodes or [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"uri": uri, "byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
        **others,
    }


def square(**others):
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, **others.pop("primitive", {})}
    return document([POINTS, INDEX, *others.pop("arrays", [])], primitive, **others)


def read(tmp_path, made, name="x.gltf"):
    path = tmp_path / name
    path.write_bytes(made if isinstance(made, bytes) else json.dumps(made).encode())
    return load_scene(path)


def glb(made):
    made = copy.deepcopy(made)
    binary = base64.b64decode(made["buffers"][0].pop("uri").partition(",")[2])
    text = json.dumps(made).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def corners(scene):
    return scene.surfaces.batches[0].data[:, :9].reshape(-1, 3, 3)


def normals_of(triangles):
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


@pytest.mark.parametrize("name", ["x.gltf", "x.glb"])
def test_a_square(tmp_path, name):
    made = square()
    scene = read(tmp_path, glb(made) if name == "x.glb" else made, name)
    assert np.array_equal(corners(scene), POINTS[INDEX].reshape(-1, 3, 3))
    assert scene.surfaces.batches[0].kind == Kind.TRIANGLE
    assert scene.materials["diffuse"].tolist() == [[0.8] * 3]
    assert scene.highlights
    assert len(scene.remarks) == 2  # camera and lights invented


def test_buffer_beside_the_file_and_nodes_without_scenes(tmp_path):
    made = square()
    (tmp_path / "with space.bin").write_bytes(base64.b64decode(made["buffers"][0]["uri"].partition(",")[2]))
    made["buffers"][0]["uri"] = "with%20space.bin"
    del made["scenes"]
    made["nodes"] = [{"mesh": 0}, {"children": [0], "translation": [5, 0, 0]}]
    assert np.allclose(corners(read(tmp_path, made))[0, 0], (5, 0, 0))


@pytest.mark.parametrize(
    ("mode", "index", "wanted"),
    [
        (5, [0, 1, 3, 2], [[0, 1, 3], [1, 2, 3]]),
        (6, [0, 1, 2, 3], [[0, 1, 2], [0, 2, 3]]),
        (4, None, [[0, 1, 2]]),
    ],
)
def test_strips_fans_and_no_indices_keep_the_front(tmp_path, mode, index, wanted):
    arrays = [POINTS[:3] if index is None else POINTS, np.array(index or [0], np.uint16)]
    primitive = {"attributes": {"POSITION": 0}, "mode": mode, **({} if index is None else {"indices": 1})}
    made = corners(read(tmp_path, document(arrays, primitive)))
    assert np.array_equal(made, POINTS[np.array(wanted)])
    assert (normals_of(made)[:, 2] > 0).all()


def test_points_and_lines_are_left_out_with_a_remark(tmp_path):
    made = square()
    made["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 1})
    scene = read(tmp_path, made)
    assert len(scene.surfaces) == 2
    assert "1 primitive of points or lines left out" in scene.remarks


def test_strides_sparse_values_and_normalised_integers(tmp_path):
    spread = np.zeros((4, 5), np.float32)
    spread[:, :3] = POINTS
    made = document([spread.view(np.uint8).reshape(4, 20)[:, :4], INDEX], {"attributes": {"POSITION": 0}, "indices": 1})
    data = spread.tobytes() + INDEX.tobytes() + np.array([2], np.uint16).tobytes() + b"\0\0"
    data += np.array([9, 9, 0], np.float32).tobytes()
    made["buffers"] = [{"uri": "data:;base64," + base64.b64encode(data).decode(), "byteLength": len(data)}]
    made["bufferViews"] = [
        {"buffer": 0, "byteLength": 80, "byteStride": 20},
        {"buffer": 0, "byteOffset": 80, "byteLength": 12},
        {"buffer": 0, "byteOffset": 92, "byteLength": 2},
        {"buffer": 0, "byteOffset": 96, "byteLength": 12},
    ]
    sparse = {"count": 1, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}
    made["accessors"][0] = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse}
    assert np.array_equal(corners(read(tmp_path, made))[0], [[0, 0, 0], [1, 0, 0], [9, 9, 0]])
    small = np.array([[0, 0, 0], [127, 0, 0], [0, 127, 0]], np.int8)
    made = document([small], {"attributes": {"POSITION": 0}}, extensionsRequired=["KHR_mesh_quantization"])
    assert np.array_equal(corners(read(tmp_path, made))[0], [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_node_matrices_multiply_down_the_tree(tmp_path):
    turn = [0, 0, math.sin(math.pi / 4), math.cos(math.pi / 4)]  # a quarter about z
    nodes = [{"translation": [10, 0, 0], "scale": [2, 2, 2], "children": [1]}, {"rotation": turn, "mesh": 0}]
    made = square(nodes=nodes)
    made["scenes"] = [{"nodes": [0]}]
    assert np.allclose(corners(read(tmp_path, made))[0], [[10, 0, 0], [10, 2, 0], [8, 2, 0]])
    columns = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 4, 5, 1]
    assert node_matrix({"matrix": columns})[:3, 3].tolist() == [3, 4, 5]


def test_mirrored_nodes_keep_fronts_and_normals_outside(tmp_path):
    up = np.tile(np.array([0, 0.6, 0.8], np.float32), (4, 1))
    made = square(arrays=[up], nodes=[{"mesh": 0, "scale": [-1, 2, 1]}])
    made["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = 2
    scene = read(tmp_path, made)
    assert scene.surfaces.batches[0].kind == Kind.SMOOTH
    assert (normals_of(corners(scene))[:, 2] > 0).all()
    normal = np.array([0, 0.3, 0.8]) / np.hypot(0.3, 0.8)  # squeezed where the surface is stretched
    assert np.allclose(scene.surfaces.batches[0].data[:, 9:], np.tile(normal, 3))


def test_perspective_camera_and_its_parents_scale(tmp_path):
    turn = [math.sin(-math.pi / 4), 0, 0, math.cos(math.pi / 4)]  # looks down -y
    nodes = [
        {"mesh": 0},
        {"scale": [0.01] * 3, "children": [2]},
        {"camera": 0, "translation": [0, 300, 0], "rotation": turn},
    ]
    made = square(nodes=nodes, cameras=[{"type": "perspective", "perspective": {"yfov": 0.5, "znear": 1}}])
    made["scenes"] = [{"nodes": [0, 1]}]
    camera = read(tmp_path, made).camera
    assert np.allclose(camera.eye, (0, 3, 0))
    assert np.allclose(camera.forward, (0, -1, 0))
    assert np.allclose(camera.up, (0, 0, -1))
    assert camera.half == pytest.approx(math.tan(0.25))


def test_orthographic_camera_and_the_first_of_several(tmp_path):
    cameras = [{"type": "orthographic", "orthographic": {"xmag": 3, "ymag": 2, "znear": 0, "zfar": 9}}] * 2
    scene = read(
        tmp_path, square(nodes=[{"mesh": 0}, {"camera": 0, "translation": [0, 0, 7]}, {"camera": 1}], cameras=cameras)
    )
    assert (scene.camera.orthographic, scene.camera.half, scene.camera.eye) == (True, 2, (0, 0, 7))
    assert "the first of 2 cameras used; --camera (in Python camera=) chooses another: 1, 2" in scene.remarks


def lit(lights, nodes, camera=None):
    made = square(
        nodes=[{"mesh": 0}, *nodes],
        extensions={"KHR_lights_punctual": {"lights": lights}},
        extensionsRequired=["KHR_lights_punctual"],
    )
    if camera:
        made["nodes"].append(camera)
        made["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.5}}]
        made["scenes"] = [{"nodes": list(range(len(made["nodes"])))}]
    return made


def lamp(number, **place):
    return {"extensions": {"KHR_lights_punctual": {"light": number}}, **place}


def test_lights_of_all_kinds_share_one_exposure(tmp_path):
    lights = [
        {"type": "point", "intensity": 1600, "color": [1, 0.5, 0.25]},
        {"type": "directional", "intensity": 50},
        {"type": "spot", "intensity": 400, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.3}},
    ]
    nodes = [lamp(0, translation=[0.5, 0.5, 4]), lamp(1), lamp(2, translation=[0.5, 0.5, 2], scale=[3, 3, 3])]
    camera = {"camera": 0, "translation": [0.5, 0.5, 9]}
    scene = read(tmp_path, lit(lights, nodes, camera))  # looks at (0.5, 0.5, 0): 1600 / 16, 50, and 400 / 4 lux there
    point, sun, spot = scene.lights
    assert np.allclose(point["intensity"], (16, 8, 4))
    assert np.allclose(sun["intensity"], 0.5)
    assert np.allclose(spot["intensity"], 4)
    assert scene.lights["kind"].tolist() == [POINT, DIRECTIONAL, POINT]
    assert scene.lights["falloff"].tolist() == [1, 0, 1]
    assert np.allclose(sun["place"], (0, 0, 1))  # it shines down its -z
    assert np.allclose(spot["axis"], (0, 0, -1))
    assert np.allclose((spot["cos_inner"], spot["cos_outer"]), np.cos((0.1, 0.3)))
    assert any(remark.startswith("light intensities scaled") for remark in scene.remarks)


def test_materials():
    base = np.array((0.8, 0.6, 0.4))
    mirror = shading(base, 1, 0, 0, 1.5, {})[0]
    assert np.allclose(mirror["specular"], base)
    assert not mirror["diffuse"].any()
    rough = shading(base, 1, 1, 0, 1.5, {})[0]
    assert np.allclose(rough["diffuse"], base)
    assert not rough["specular"].any()
    assert not rough["highlight"].any()
    glass = shading(base, 0, 0, 1, 1.45, {})[0]
    assert np.allclose(glass["transmission"], base)
    assert (glass["ior"], glass["diffuse"].any(), glass["specular"].any()) == (1.45, False, False)
    plastic = shading(base, 0, 0.5, 0, 1.5, {})[0]
    assert np.allclose(plastic["diffuse"], base)
    assert np.allclose((plastic["shine"], *plastic["highlight"]), (7.5, 0.19, 0.19, 0.19))
    matte = shading(base, 0, 0.5, 0, 1.5, {"specularFactor": 0})[0]
    assert not matte["highlight"].any()


def with_material(material, **others):
    return square(primitive={"material": 0}, materials=[material], **others)


@pytest.mark.parametrize(
    ("material", "field", "wanted"),
    [
        ({}, "diffuse", 1),  # by the format's defaults a rough white metal
        ({"pbrMetallicRoughness": {"roughnessFactor": 0}}, "specular", 1),
        ({"pbrMetallicRoughness": {"metallicFactor": 0, "baseColorFactor": [0.5, 0.5, 0.5, 1]}}, "diffuse", 0.5),
        (
            {"alphaMode": "BLEND", "pbrMetallicRoughness": {"metallicFactor": 0, "baseColorFactor": [1, 1, 1, 0.25]}},
            "ior",
            1,
        ),
        (
            {
                "pbrMetallicRoughness": {"metallicFactor": 0},
                "extensions": {
                    "KHR_materials_ior": {"ior": 1.3},
                    "KHR_materials_transmission": {"transmissionFactor": 1},
                },
            },
            "ior",
            1.3,
        ),
        ({"emissiveFactor": [1, 1, 1]}, "diffuse", 1),
    ],
)
def test_materials_in_files(tmp_path, material, field, wanted):
    scene = read(tmp_path, with_material(material))
    assert np.allclose(scene.materials[field], wanted)
    assert ("material 0: its own light left out" in scene.remarks) == ("emissiveFactor" in material)


def png(texels):
    data = io.BytesIO()
    Image.fromarray(np.array(texels, np.uint8)).save(data, "PNG")
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


def textured(uv, texels, **pbr):
    made = with_material(
        {"pbrMetallicRoughness": {"metallicFactor": 0, "baseColorTexture": {"index": 0}, **pbr}},
        arrays=[np.array(uv, np.float32)],
        textures=[{"source": 0, "sampler": 0}],
        samplers=[{"wrapS": 33071}],
        images=[{"uri": png(texels)}],
    )
    made["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = 2
    return made


def test_textures_are_baked_and_multiplied_by_the_factor(tmp_path):
    texels = [[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]]
    uv = [[0.1, 0.1], [0.2, 0.3], [0.3, 0.2], [0.0, 2.0]]  # first triangle upper left; second below, by repetition
    scene = read(tmp_path, textured(uv, texels, baseColorFactor=[0.5, 0.5, 0.5, 1]))
    assert np.allclose(scene.materials["diffuse"][scene.surfaces.batches[0].materials], [[0.5, 0, 0], [0, 0, 0.5]])


def test_colours_of_vertices_are_linear(tmp_path):
    colours = np.tile(np.array([0.2140411, 1, 0, 1], np.float32), (4, 1))
    made = with_material({"pbrMetallicRoughness": {"metallicFactor": 0}}, arrays=[colours])
    made["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = 2
    assert np.allclose(read(tmp_path, made).materials["diffuse"], [[0.214, 1, 0]], atol=0.03)  # 5 bits a primary


def test_textures_of_metal_and_roughness_count_with_their_mean(tmp_path):
    made = textured(np.zeros((4, 2)), [[[255, 255, 255]]], metallicFactor=1, metallicRoughnessTexture={"index": 1})
    made["textures"].append({"source": 1})
    made["images"].append({"uri": png([[[9, 0, 255], [9, 0, 0]]])})  # roughness 0, metal half
    scene = read(tmp_path, made)
    assert np.allclose(scene.materials["specular"], 0.5)
    assert "material 0: one metal and one roughness used, the mean of their texture" in scene.remarks


def broken(change):
    made = lit([{"type": "point"}], [lamp(0)], {"camera": 0, "translation": [0, 0, 5]})
    change(made)
    return made


ERRORS = [
    (lambda m: m.update(asset={"version": "1.0"}), "the file is of glTF version '1.0', wanted 2.0"),
    (lambda m: m.pop("asset"), "the JSON has no asset"),
    (lambda m: m.update(extensionsRequired=["KHR_draco_mesh_compression"]), "requires the extension KHR_draco"),
    (lambda m: m.update(nodes=[]), "came nodes[0], but there are 0"),
    (lambda m: m.update(nodes=7), "came nodes[0]|not valid glTF"),
    (lambda m: m["nodes"][0].update(mesh=3), "came meshes[3], but there are 1"),
    (lambda m: m["nodes"][0].update(mesh="0"), "came meshes['0'], but there are 1"),
    (lambda m: m["nodes"][0].update(children=[0]), "nodes[0] is reached twice, wanted a tree"),
    (
        lambda m: m["nodes"][0].update(scale=[1e200, 1, 1]),
        "nodes[0] has a transform that is not finite, or beyond 1e30",
    ),
    (lambda m: m["nodes"][0].update(matrix=[1, 2]), "the file is not valid glTF"),
    (lambda m: m["nodes"][2].update(scale=[0, 0, 0]), "the camera looks from (0, 0, 5) at that same point"),
    (lambda m: m["nodes"][1].update(extensions={"KHR_lights_punctual": {"light": 4}}), "the file is not valid glTF"),
    (lambda m: m["extensions"]["KHR_lights_punctual"]["lights"][0].update(type="area"), "the file is not valid glTF"),
    (lambda m: m["extensions"]["KHR_lights_punctual"]["lights"][0].update(intensity=-1), "the file is not valid glTF"),
    (lambda m: m["cameras"][0]["perspective"].update(yfov=4), "the camera's angle is 229.183 degrees"),
    (lambda m: m["cameras"][0].pop("perspective"), "the file is not valid glTF (\"KeyError: 'perspective'\")"),
    (lambda m: m["accessors"][1].update(count=7), "accessors[1] needs 14 bytes of a buffer view of 12"),
    (lambda m: m["accessors"][1].update(count=5), "a primitive of triangles has 5 indices, wanted a multiple of 3"),
    (lambda m: m["accessors"][1].update(count=-1), "accessors[1].count is -1, wanted a whole number, not below 0"),
    (lambda m: m["accessors"][0].update(count=2), "a primitive has the index 3, but 2 vertices"),
    (lambda m: m["accessors"][0].update(componentType=1), "the file is not valid glTF"),
    (lambda m: m["accessors"][0].pop("bufferView") or m["accessors"][0].update(count=2**60), "wanted at most"),
    (lambda m: m["accessors"][1].update(count=0), "the file has no surfaces, wanted at least one"),
    (lambda m: m["bufferViews"][1].update(byteLength=400), "bufferViews[1] ends at byte 448 of a buffer of 60 bytes"),
    (lambda m: m["buffers"][0].update(byteLength=61), "buffers[0] has 60 bytes, wanted 61"),
    (lambda m: m["buffers"][0].update(uri="data:;base64,???"), "buffers[0].uri is no base64"),
    (lambda m: m["buffers"][0].update(uri="gone.bin"), "gone.bin: there is no such file"),
    (lambda m: m["buffers"][0].pop("uri"), "buffers[0] has no uri, and the file has no binary chunk"),
    (lambda m: m["meshes"][0]["primitives"][0].update(material=0), "came materials[0], but there are 0"),
    (lambda m: m["meshes"][0].pop("primitives"), "the file is not valid glTF (\"KeyError: 'primitives'\")"),
]


@pytest.mark.parametrize("case", range(len(ERRORS)))
def test_errors(tmp_path, case):
    change, wanted = ERRORS[case]
    with pytest.raises(SceneError) as caught:
        read(tmp_path, broken(change))
    assert str(caught.value).startswith(str(tmp_path))
    assert any(part in str(caught.value) for part in wanted.split("|"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [np.nan, np.inf, 3e38])
def test_vertices_that_are_no_coordinates(tmp_path, value):
    points = POINTS.copy()
    points[2, 1] = value
    made = document([points, INDEX], {"attributes": {"POSITION": 0}, "indices": 1})
    with pytest.raises(SceneError, match="a surface has "):
        read(tmp_path, made)


@given(st.integers(0, 5000), st.integers(0, 255))
def test_a_cut_or_damaged_glb_is_refused_or_read(tmp_path_factory, place, byte):
    made = bytearray(glb(broken(lambda m: None)))
    place %= len(made)
    path = tmp_path_factory.mktemp("glb")
    with pytest.raises(SceneError):
        read(path, bytes(made[:place]), "x.glb")
    made[place] = byte
    try:
        assert len(read(path, bytes(made), "x.glb").surfaces) > 0
    except SceneError as error:
        assert str(error).startswith(str(path))


def test_our_room():
    scene = load_scene(SCENES / "room.glb")
    assert (len(scene.surfaces), scene.surfaces.count(Kind.SMOOTH), len(scene.materials)) == (7428, 7428, 5)
    assert scene.camera.eye == pytest.approx((0.5, 2.4, 6.5))
    assert math.degrees(2 * math.atan(scene.camera.half)) == pytest.approx(40)
    floor, wall, clay, mirror, glass = scene.materials
    assert np.allclose(floor["diffuse"], (0.75, 0.75, 0.7))
    assert np.allclose(wall["diffuse"], (0.3, 0.45, 0.7))
    assert np.allclose(clay["diffuse"], (0.8, 0.35, 0.2))
    assert np.allclose(mirror["specular"], 0.95)
    assert (glass["transmission"].tolist(), glass["ior"]) == ([1, 1, 1], 1.5)
    assert np.allclose(scene.lights["place"], [[3, 5, 4], [-4, 3, 3]])
    ratio = scene.lights["intensity"][0, 0] / scene.lights["intensity"][1, 0]
    assert ratio == pytest.approx(32610.85 / 8152.71, rel=1e-4)
    assert scene.lights["falloff"].tolist() == [1, 1]


@needs_meshes
def test_duck():
    scene = load_scene(MESHES / "Duck.glb")
    assert scene.camera.eye == pytest.approx((4.00113, 4.63264, -4.31078), abs=1e-4)
    assert (scene.surfaces.count(Kind.SMOOTH), len(scene.materials) > 5) == (4212, True)
    yellow = scene.materials["diffuse"][np.bincount(next(iter(scene.surfaces)).materials).argmax()]
    assert yellow[0] > yellow[1] > 3 * yellow[2]


@needs_meshes
@pytest.mark.parametrize(("name", "triangles"), [("BoxTextured.glb", 12), ("Cameras.gltf", 2)])
def test_other_samples(name, triangles):
    scene = load_scene(MESHES / name)
    assert len(scene.surfaces) == triangles
    assert scene.surfaces.batches[0].bounds().shape == (triangles, 2, 3)
