"""Meshes: OBJ with MTL, PLY and STL, written here or read from the shared ones; what is kept and what is refused."""

import io
import logging
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from support import paths

from raygrid.host.scene.formats.mtl import mtl_material
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.textures import Texture, Wrap, as_bytes, bake, linear, read_picture
from raygrid.node.errors import SceneError
from raygrid.node.geometry.surfaces import Kind

MESHES = paths.SHARED / "scenes" / "meshes"
needs_meshes = pytest.mark.skipif(not MESHES.is_dir(), reason=f"the shared meshes are not at {MESHES}")

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def scene_of(tmp_path, name, content, **others):
    for other, data in others.items():
        (tmp_path / other.replace("_", ".")).write_bytes(data if isinstance(data, bytes) else data.encode())
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return load_scene(path)


def corners(scene, kind=Kind.TRIANGLE):
    batch = next(batch for batch in scene.surfaces if batch.kind == kind)
    return batch.data[:, :9].reshape(-1, 3, 3)


def area(triangles):
    return (
        np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1).sum() / 2
    )


# --- OBJ


def test_obj_by_hand(tmp_path):
    scene = scene_of(
        tmp_path, "x.obj", SQUARE + "# comment\nvn 0 0 2\no name\ng group\ns 1\nf 1//1 2//1 3//1 # end\nf 1 3 4\n"
    )
    assert {batch.kind: batch.ids.tolist() for batch in scene.surfaces} == {Kind.TRIANGLE: [1], Kind.SMOOTH: [0]}
    assert corners(scene).tolist() == [[[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    smooth = next(batch for batch in scene.surfaces if batch.kind == Kind.SMOOTH)
    assert smooth.data.tolist() == [[0, 0, 0, 1, 0, 0, 1, 1, 0] + [0, 0, 1] * 3]
    assert scene.highlights
    assert scene.materials["diffuse"].tolist() == [[0.8, 0.8, 0.8]]
    assert scene.camera.up[1] > 0.8  # y is up
    assert len(scene.lights) == 2


@pytest.mark.parametrize(
    "face", ["f 1 2 3 4", "f 1/1 2/1 3/1 4/1", "f -4 -3 -2 -1", "f 1/1/ 2/1/ 3/1/ 4/1/", "f 1 2 -2 4"]
)
def test_obj_quads_in_every_notation(tmp_path, face):
    later = "\nv 9 9 9\nv 8 8 8\nv 7 7 7\nv 6 6 7\n"  # relative indices do not count from the end of the file
    scene = scene_of(tmp_path, "x.obj", SQUARE + "vt 0 0\n" + face + later)
    assert corners(scene).tolist() == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]


def test_obj_concave_faces_are_cut_without_overlap(tmp_path):
    scene = scene_of(tmp_path, "x.obj", "v 0 0 0\nv 2 1 0\nv 4 0 0\nv 2 4 0\nf 1 2 3 4\n")
    assert area(corners(scene)) == pytest.approx(6)


def test_obj_line_ends_continuations_and_colours(tmp_path):
    text = "v 0 0 0 1 0 0\r\nv 1 0 0 1 0 0\r\nv 1 1 \\\r\n0 1 0 0\r\nf 1 2 3\r\n"
    scene = scene_of(tmp_path, "x.obj", text)
    assert np.allclose(scene.materials["diffuse"], [[1, 0, 0]])


MTL = """
newmtl Red brick
Kd 0.8 0.2 0.1   # a comment
Ks 0.5
Ns 20
illum 2
newmtl Mirror
Kd 0.9 0.9 0.9
Ks 0.75 0.5 0.5
Ns 100
illum 3
newmtl Glass
kd 1 1 1
KS 0.5 0.5 0.5
Ni 1.45
d 0.25
illum 7
"""


def test_obj_materials_survive_and_keep_the_order_of_the_faces(tmp_path):
    text = (
        "mtllib x.mtl\n"
        + SQUARE
        + "usemtl Glass\nf 1 2 3\nusemtl Red brick\nf 1 3 4\nusemtl Mirror\nf 1 2 4\nf 2 3 4\n"
    )
    scene = scene_of(tmp_path, "x.obj", text, x_mtl=MTL)
    assert scene.surfaces.batches[0].ids.tolist() == [0, 1, 2, 3]
    numbers = scene.surfaces.batches[0].materials
    glass, red, mirror = scene.materials[numbers[[0, 1, 2]]]
    assert numbers[2] == numbers[3]
    assert np.allclose(red["diffuse"], (0.8, 0.2, 0.1))
    assert (red["highlight"].tolist(), red["shine"], red["specular"].any()) == ([0.5] * 3, 20, False)
    assert np.allclose(mirror["specular"], (0.75, 0.5, 0.5))
    assert np.allclose(mirror["diffuse"], (0.9 * 0.25, 0.45, 0.45))
    assert np.allclose(glass["transmission"], 0.75)
    assert (glass["ior"], glass["diffuse"].tolist()) == (1.45, [0.125] * 3)
    assert len([remark for remark in scene.remarks if not remark.startswith("no ")]) == 0


@pytest.mark.parametrize(
    ("values", "field", "wanted"),
    [
        ({b"kd": [0.5, 0.5, 0.5], b"ks": [1, 1, 1], b"ns": [9], b"illum": [1]}, "highlight", 0),
        ({b"kd": [0.5, 0.5, 0.5], b"ks": [1, 1, 1], b"illum": [2]}, "highlight", 0),
        ({b"kd": [0.5, 0.5, 0.5], b"tr": [0.25]}, "transmission", 0.25),
        ({b"kd": [0.5, 0.5, 0.5], b"tf": [0.9, 0.9, 0.9], b"illum": [6]}, "transmission", 0.9),
        ({b"kd": [0.5, 0.5, 0.5], b"tf": [1, 1, 1], b"illum": [2]}, "transmission", 0),
        ({b"d": [0.5]}, "diffuse", 0.4),
        ({}, "diffuse", 0.8),
    ],
)
def test_mtl_mapping(values, field, wanted):
    row = mtl_material({key: np.array(value, float) for key, value in values.items()})
    assert np.allclose(row[field], wanted)


def test_missing_materials_are_grey_with_a_remark(tmp_path):
    scene = scene_of(tmp_path, "x.obj", "mtllib gone.mtl\n" + SQUARE + "usemtl A\nf 1 2 3\n")
    assert "the material file gone.mtl is missing: grey used" in scene.remarks
    scene = scene_of(tmp_path, "x.obj", "mtllib x.mtl\n" + SQUARE + "usemtl A\nf 1 2 3\n", x_mtl=MTL)
    assert "grey used for unknown materials: A" in scene.remarks
    assert scene.materials["diffuse"].tolist() == [[0.8] * 3]


def test_textures_are_baked_into_triangles(tmp_path):
    texture = io.BytesIO()
    texels = np.zeros((2, 2, 3), np.uint8)
    texels[0], texels[1] = (255, 0, 0), (0, 0, 255)  # above red, below blue
    Image.fromarray(texels).save(texture, "PNG")
    mtl = "newmtl A\nKd 0.5 1 1\nmap_Kd -s 1 1 1 x.png\n"
    uv = "vt 0.1 0.1\nvt 0.9 0.1\nvt 0.5 0.2\nvt 0.1 0.9\n"  # the first three below, as OBJ's v points up
    text = "mtllib x.mtl\n" + SQUARE + uv + "usemtl A\nf 1/1 2/2 3/3\nf 1/4 2/4 3/4\n"
    scene = scene_of(tmp_path, "x.obj", text, x_mtl=mtl, x_png=texture.getvalue())
    numbers = scene.surfaces.batches[0].materials
    assert np.allclose(scene.materials["diffuse"][numbers], [[0, 0, 1], [0.5, 0, 0]])
    scene = scene_of(tmp_path, "x.obj", text, x_mtl=mtl.replace("x.png", "gone.png"))
    assert "the texture 'gone.png' is missing: plain colour used" in scene.remarks
    with pytest.raises(SceneError, match=r"x\.png: the texture cannot be read"):
        scene_of(tmp_path, "x.obj", text, x_mtl=mtl, x_png=texture.getvalue()[:40])


OBJ_ERRORS = {
    "": "the file has no faces, wanted at least one",
    SQUARE: "the file has no faces, wanted at least one",
    SQUARE + "f 1 2\n": "line 5: came a face with 2 corners, wanted at least 3",
    SQUARE + "f\n": "line 5: came a face with 0 corners",
    SQUARE + "f 1 2 5\n": "line 5: came the corner '5', but the file has 4 v, 0 vt and 0 vn",
    SQUARE + "f 1 2 0\n": "line 5: came the corner '0'",
    SQUARE + "f 1 2 -5\n": "line 5: came the corner '-5'",
    SQUARE + "f 1 2 3/1\n": "line 5: came the corner '3/1', but the file has 4 v, 0 vt",
    SQUARE + "f 1 2 x\n": "line 5: came the corner 'x'",
    SQUARE + "f 1 2 3/1/1/1\n": "line 5: came the corner '3/1/1/1'",
    SQUARE + "f 1 2 99999999999999999999999\n": "line 5: came the corner '99999999999999999999999'",
    "v 1 2\nf 1 1 1\n": "line 1: came v with 2 numbers, wanted 3",
    SQUARE + "v 1 x 2\nf 1 2 3\n": "line 5: came '1 x 2', wanted finite numbers of at most 1e30",
    SQUARE + "v 1 nan 2\nf 1 2 3\n": "line 5: came '1 nan 2', wanted finite numbers",
    SQUARE + "v 1 1e31 2\nf 1 2 3\n": "line 5: came '1 1e31 2', wanted finite numbers",
    SQUARE + "vn 1 1\nf 1//1 2//1 3//1\n": "line 5: came vn with 2 numbers, wanted 3",
    SQUARE + "f 1 1 2\n": "the file has only 1 surface without area, wanted at least one surface",
}


@pytest.mark.parametrize("text", OBJ_ERRORS, ids=range(len(OBJ_ERRORS)))
def test_obj_errors(tmp_path, text):
    with pytest.raises(SceneError) as caught:
        scene_of(tmp_path, "x.obj", text)
    assert str(caught.value).startswith(str(tmp_path / "x.obj"))
    assert OBJ_ERRORS[text] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("line", ["Kd 1 x 1", "Kd 1 1", "Ns", "Ns -1", "d nan", "Kd spectral file.rfl"])
def test_mtl_errors(tmp_path, line):
    text = "mtllib x.mtl\n" + SQUARE + "usemtl A\nf 1 2 3\n"
    if line in ("Ns", "Kd spectral file.rfl"):  # without numbers, or of a kind that nobody writes: skipped
        scene_of(tmp_path, "x.obj", text, x_mtl=f"newmtl A\n{line}\n")
        return
    with pytest.raises(SceneError, match=rf"x\.mtl: came {line.split()[0].lower()} '.*', wanted"):
        scene_of(tmp_path, "x.obj", text, x_mtl=f"newmtl A\n{line}\n")


POINTS = ["v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0", "v 1e30 2 -1e30", "vt 0 1", "vn 0 0 1", "vn 0 0 0"]
FACES = ["f 1 2 3", "f 1/1/1 2/1/1 3/1/1", "f 1//1 2//1 3//1", "f -1 -2 -3 -4", "f 3 2 1 4 5"]
OTHERS = ["usemtl A", "mtllib", "f", "v", "\\", "x y z", "\0"]
lines = st.sampled_from([*POINTS, *FACES, *OTHERS])


@given(st.lists(lines, max_size=30))
def test_any_lines_either_parse_or_are_refused(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("obj") / "x.obj"
    path.write_text("\n".join(text))
    try:
        assert len(load_scene(path).surfaces) > 0
    except SceneError as error:
        assert str(error).startswith(str(path))


# --- PLY and STL

PLY = """ply
format ascii 1.0
comment by hand
element vertex 4
property float x
property float y
property float z
{properties}element face {faces}
property list uchar int vertex_indices
end_header
{body}"""
FLAT_PLY = PLY.format(properties="", faces=2, body="0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n")
RGB = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
NXYZ = "property float nx\nproperty float ny\nproperty float nz\n"


def test_ply_flat_quads_colours_and_normals(tmp_path):
    assert corners(scene_of(tmp_path, "x.ply", FLAT_PLY)).tolist()[0] == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    body = "0 0 0 255 0 0\n1 0 0 255 0 0\n1 1 0 255 0 0\n0 1 0 255 0 0\n4 0 1 2 3\n"
    scene = scene_of(tmp_path, "x.ply", PLY.format(properties=RGB, faces=1, body=body))
    assert scene.surfaces.count(Kind.TRIANGLE) == 2
    assert np.allclose(scene.materials["diffuse"], [[1, 0, 0]])
    body = "0 0 0 0 0 1\n1 0 0 0 0 2\n1 1 0 0 3 4\n0 1 0 0 0 1\n3 0 1 2\n"
    scene = scene_of(tmp_path, "x.ply", PLY.format(properties=NXYZ, faces=1, body=body))
    smooth = next(iter(scene.surfaces))
    assert smooth.kind == Kind.SMOOTH
    assert np.allclose(smooth.data[0, 9:], [0, 0, 1, 0, 0, 1, 0, 0.6, 0.8])


def test_ply_binary(tmp_path):
    head = FLAT_PLY.replace("ascii", "binary_little_endian").partition("end_header\n")[0].encode() + b"end_header\n"
    body = struct.pack("<12f", 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0)
    body += struct.pack("<B3i", 3, 0, 1, 2) + struct.pack("<B3i", 3, 0, 2, 3)
    assert area(corners(scene_of(tmp_path, "x.ply", head + body))) == pytest.approx(1)
    for end in range(1, len(body), 7):
        with pytest.raises(SceneError, match=r"x\.ply: the PLY file cannot be read"):
            scene_of(tmp_path, "x.ply", head + body[:-end])


PLY_ERRORS = {
    b"": "this is no PLY file",
    b"hello": "this is no PLY file",
    FLAT_PLY[:60].encode(): "this is no PLY file, wanted a header from 'ply' to 'end_header'",
    FLAT_PLY.replace("face 2", "face 0").encode(): "the file has no faces",
    FLAT_PLY[:-8].encode(): "the file ends after 5 lines of data, wanted 6",
    FLAT_PLY[:-4].encode(): "the file ends inside its last face, after 1 vertices of 3",
    FLAT_PLY.replace("0 2 3", "0 2 9").encode(): "a face has the vertex 9, wanted numbers from 0 to 3",
    FLAT_PLY.replace("1 1 0", "nan 1 0").encode(): "a surface has a number that is not finite",
    FLAT_PLY.replace("1 1 0", "x 1 0").encode(): "the PLY file cannot be read",
}


@pytest.mark.parametrize("data", PLY_ERRORS, ids=range(len(PLY_ERRORS)))
def test_ply_errors(tmp_path, data):
    with pytest.raises(SceneError) as caught:
        scene_of(tmp_path, "x.ply", data)
    assert str(caught.value).startswith(str(tmp_path / "x.ply"))
    assert PLY_ERRORS[data] in str(caught.value)


FACETS = np.array([[[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[1, 0, 0], [1, 1, 0], [1, 0, 1]]], np.float32)


def binary_stl(facets):
    rows = np.zeros(len(facets), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]))
    rows["corners"] = facets
    return b"solid, though binary".ljust(80) + struct.pack("<I", len(facets)) + rows.tobytes()


def text_stl(facets):
    lines = ["solid x"]
    for facet in facets:
        vertices = [f"vertex {x} {y} {z}" for x, y, z in facet]
        lines += ["facet normal 0 0 0", "outer loop", *vertices, "endloop", "endfacet"]
    return "\n".join([*lines, "endsolid x\n"]).encode()


@pytest.mark.parametrize("write", [binary_stl, text_stl])
def test_stl_flat_and_z_up(tmp_path, write):
    scene = scene_of(tmp_path, "x.stl", write(FACETS))
    assert np.array_equal(corners(scene), FACETS)
    assert scene.camera.up[2] > 0.8


def test_files_of_stl_leave_one_handler_at_trimesh(tmp_path):
    """It failed: each added one."""
    scene_of(tmp_path, "x.stl", binary_stl(FACETS))
    before = list(logging.getLogger("trimesh").handlers)
    scene_of(tmp_path, "x.stl", binary_stl(FACETS))
    assert logging.getLogger("trimesh").handlers == before


STL_ERRORS = {
    b"": "the file has 0 bytes, wanted an STL file of at least 84",
    b"hello" * 30: "the file has 150 bytes, wanted",
    binary_stl(FACETS)[:-1]: "the file ends inside facet|the file has no facets|the file has 183 bytes",
    binary_stl(FACETS[:0]): "the file has no facets, wanted at least one",
    b"x" + binary_stl(FACETS)[1:-1]: "the file has 183 bytes, wanted 184 for its 2 facets",
    text_stl(FACETS[:0]): "the file has no facets",
    text_stl(FACETS)[:-12]: "the file ends inside facet 2, wanted all of them and 'endsolid'",
    text_stl(FACETS)[:150]: "the file ends inside facet",
    binary_stl(FACETS * np.nan): "a surface has a number that is not finite",
}


@pytest.mark.parametrize("data", STL_ERRORS, ids=range(len(STL_ERRORS)))
def test_stl_errors(tmp_path, data):
    with pytest.raises(SceneError) as caught:
        scene_of(tmp_path, "x.stl", data)
    assert str(caught.value).startswith(str(tmp_path / "x.stl"))
    assert any(part in str(caught.value) for part in STL_ERRORS[data].split("|"))


def test_several_solids_in_one_file(tmp_path):
    data = text_stl(FACETS[:1]) + text_stl(FACETS[1:])
    assert area(corners(scene_of(tmp_path, "x.stl", data))) == pytest.approx(1)


# --- textures


def test_linear_and_back():
    levels = np.arange(256, dtype=np.uint8)
    assert np.array_equal(as_bytes(linear(levels / 255), is_linear=True), levels)
    assert linear(np.array([0.5]))[0] == pytest.approx(0.21404, abs=1e-5)


def test_baking_keeps_few_colours_and_multiplies():
    colours = np.array([[255, 255, 255], [0, 0, 0], [254, 255, 249]], np.uint8)
    rows, index = bake(mtl_material({}), colours)
    assert index.tolist() == [1, 0, 1]
    assert np.allclose(rows["diffuse"], [[0, 0, 0], [0.8] * 3])
    rows, index = bake(mtl_material({}), np.random.default_rng(1).integers(0, 256, (50_000, 3)).astype(np.uint8))
    assert len(rows) <= 32_768


@pytest.mark.parametrize(
    ("wrap", "u", "wanted"),
    [(Wrap.REPEAT, 1.3, 1), (Wrap.REPEAT, -0.3, 2), (Wrap.CLAMP, 1.3, 3), (Wrap.CLAMP, -5, 0), (Wrap.MIRROR, 1.3, 2)],
)
def test_texels_outside_a_texture(wrap, u, wanted):
    texels = np.arange(4, dtype=np.uint8).reshape(1, 4, 1).repeat(3, axis=2)
    texture = Texture(texels, wrap, wrap)
    assert texture.under(np.full((1, 3, 2), (u, 0.5)))[0, 0] == wanted


def test_wild_texture_coordinates_are_texels_too():
    texture = Texture(np.full((2, 2, 3), 7, np.uint8))
    wild = np.array([[[np.nan, np.inf], [-np.inf, 1e300], [0, 0]]])
    assert texture.under(wild).tolist() == [[7, 7, 7]]


def test_a_picture_that_is_none():
    with pytest.raises(SceneError, match=r"^here: the texture cannot be read"):
        read_picture(b"GIF89a, or not", "here")


# --- the shared ones


@needs_meshes
@pytest.mark.parametrize(
    ("name", "kind", "count", "materials"),
    [
        ("spot_triangulated.obj", Kind.SMOOTH, 5856, 1),
        ("spot_quadrangulated.obj", Kind.SMOOTH, 5856, 1),
        ("room.obj", Kind.SMOOTH, 7428, 5),
    ],
)
def test_shared_meshes(name, kind, count, materials):
    scene = load_scene(MESHES / name)
    assert (scene.surfaces.count(kind), len(scene.surfaces), len(scene.materials)) == (count, count, materials)


@needs_meshes
def test_spot_is_the_same_cow_in_quads_and_triangles():
    triangles, quads = (load_scene(MESHES / f"spot_{how}.obj", crease=0) for how in ("triangulated", "quadrangulated"))
    assert area(corners(triangles)) == pytest.approx(area(corners(quads)), rel=1e-3)
    assert np.allclose(triangles.surfaces.bounds(), quads.surfaces.bounds())
    outward = [np.einsum("ni,ni->", np.cross(t[:, 0], t[:, 1]), t[:, 2]) / 6 for t in map(corners, (triangles, quads))]
    assert outward[0] == pytest.approx(outward[1], rel=1e-3)  # the volume: closed, fronts outside
    assert outward[0] > 0


@needs_meshes
def test_spot_with_its_texture(tmp_path):
    text = b"mtllib spot.mtl\nusemtl Spot\n" + (MESHES / "spot_triangulated.obj").read_bytes()
    mtl = "newmtl Spot\nKd 1 1 1\nmap_Kd spot.png\n"
    scene = scene_of(tmp_path, "x.obj", text, spot_mtl=mtl, spot_png=(MESHES / "spot_texture.png").read_bytes())
    assert 10 < len(scene.materials) < 2000
    bright = scene.materials["diffuse"][scene.surfaces.batches[0].materials].mean(axis=1)
    assert 0.3 < (bright > 0.5).mean() < 0.95  # a white cow with dark spots
