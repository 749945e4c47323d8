"""Scene files of every kind that are cut, empty, wrong or not there: one clear line, exit code 1, nothing left behind.

Where, what came, what was wanted: each row of these tables has the whole line as a pattern.
"""

import struct
from pathlib import Path

import pytest
from support.cli import TINY, here, misused, one_line
from support.render import EIGHT, ONE, SCENES, rendered

from raygrid.host.scene.load import load_scene
from raygrid.node.errors import SceneError

pytestmark = pytest.mark.usefixtures("no_leftovers")

GOOD = Path(TINY).read_text()
HEAD = "v from 0 -6 2 at 0 0 0 up 0 0 1 angle 40 hither 1 resolution 32 32\nl 1 1 9\nf 1 1 1 1 0 0 0 0\n"
KEYWORDS = "b v from at up angle hither resolution l f c s p pp"
SUFFIXES = ".nff .obj .ply .stl .glb .gltf .toml"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACES = "element face {}\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
RUBBISH = bytes(range(256)) * 40
GLB = (SCENES / "room.glb").read_bytes()
TOML_SPHERE = '[[surfaces]]\nkind = "sphere"\ncentre = [0, 0, 0]\nradius = 1\n'


FILES = [  # name, contents, the line that comes after "raygrid: "
    # cut
    (
        "cut.nff",
        GOOD[: len(GOOD) // 2],
        "cut.nff, line 13: the file ends inside the polygon that begins here, after 10 numbers of 13",
    ),
    ("cut.nff", GOOD[:-9], "cut.nff, line 24: the file ends inside the sphere that begins here, after 2 numbers of 4"),
    ("cut.glb", GLB[: len(GLB) // 2], r"cut.glb: the file has \d+ bytes, but says that it has 206256: it is cut"),
    ("cut.glb", GLB[:10], "cut.glb: the file ends inside its header, after 10 bytes"),
    ("cut.gltf", '{"asset": {"ver', r"cut.gltf: the JSON cannot be read \(.+\)"),
    ("cut.ply", PLY + PLY_FACES.format(2) + "3 0 1 2\n", "cut.ply: the file ends after 4 lines of data, wanted 5"),
    (
        "cut.stl",
        bytes(80) + struct.pack("<I", 2) + bytes(50),
        "cut.stl: the file has 134 bytes, wanted 184 for its 2 facets",
    ),
    (
        "cut.stl",
        "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n",
        "cut.stl: the file ends inside facet 1, wanted .+",
    ),
    ("cut.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2", "cut.obj, line 4: .+2.+3.*"),
    ("cut.toml", "[camera]\nfrom = [0, 1", r"cut.toml: the TOML cannot be read \(.+\)"),
    # empty
    ("empty.nff", "", "empty.nff: the file is empty, wanted a viewpoint and surfaces"),
    ("empty.obj", "", "empty.obj: the file has no faces, wanted at least one"),
    ("empty.ply", "", "empty.ply: .+"),
    ("empty.stl", "", "empty.stl: the file has 0 bytes, wanted an STL file of at least 84"),
    ("empty.glb", "", "empty.glb: .+"),
    ("empty.gltf", "", "empty.gltf: .+"),
    ("empty.toml", "", "empty.toml: the file has no surfaces, wanted at least one surface"),
    # scenes without anything to see
    ("none.nff", HEAD, "none.nff: the file has no surfaces, wanted at least one of s c p pp"),
    ("none.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "none.obj: the file has no faces, wanted at least one"),
    ("none.ply", PLY + PLY_FACES.format(0), "none.ply: the file has no faces, wanted at least one"),
    ("none.stl", bytes(84), "none.stl: the file has no facets, wanted at least one"),
    ("none.gltf", '{"asset": {"version": "2.0"}}', "none.gltf: .+"),
    (
        "flat.nff",
        HEAD + "p 3 0 0 0 1 1 1 2 2 2",
        "flat.nff: the file has only 1 surface without area, wanted at least one surface",
    ),
    (
        "flat.obj",
        "v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n",
        "flat.obj: the file has only 1 surface without area, wanted .+",
    ),
    (
        "blind.nff",
        "s 0 0 0 1",
        r"blind.nff: the file has no viewpoint, wanted one \(v from at up angle hither resolution\)",
    ),
    # numbers
    ("nan.nff", HEAD + "s 0 0 nan 1", "nan.nff, line 4: came 'nan', wanted a finite number"),
    ("inf.nff", HEAD + "s 0 -inf 0 1", "inf.nff, line 4: came '-inf', wanted a finite number"),
    ("big.nff", HEAD + "s 0 0 1e40 1", "big.nff, line 4: came 1e[+]40, wanted at most 1e30"),
    ("zero.nff", HEAD + "s 0 0 0 0", "zero.nff, line 4: a sphere's radius must not be 0, came: 0 0 0 0"),
    (
        "nan.obj",
        "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n",
        "nan.obj, line 2: came '1 nan 0', wanted finite numbers of at most 1e30",
    ),
    ("nan.ply", PLY + PLY_FACES.format(1).replace("1 0 0", "1 nan 0") + "3 0 1 2\n", "nan.ply: .+"),
    ("nan.stl", bytes(84)[:80] + struct.pack("<I12fH", 1, *[float("nan")] * 12, 0), "nan.stl: .+"),
    (
        "nan.toml",
        TOML_SPHERE.replace("[0, 0, 0]", "[0, nan, 0]"),
        r"nan.toml, line 3: surfaces\[0\].centre\[1\] is nan, wanted a finite number",
    ),
    # cameras
    (
        "same.nff",
        HEAD.replace("at 0 0 0", "at 0 -6 2") + "s 0 0 0 1",
        r"same.nff, line 1: the camera looks from \(0, -6, 2\) at that same point, wanted two different points",
    ),
    (
        "up.nff",
        HEAD.replace("up 0 0 1", "up 0 6 -2") + "s 0 0 0 1",
        r"up.nff, line 1: the camera's up \(0, 6, -2\) is parallel to its view, wanted another direction",
    ),
    (
        "angle.nff",
        HEAD.replace("angle 40", "angle 180") + "s 0 0 0 1",
        "angle.nff, line 1: the camera's angle is 180 degrees, wanted more than 0 and less than 180",
    ),
    (
        "size.nff",
        HEAD.replace("32 32", "0 0") + "s 0 0 0 1",
        "size.nff, line 1: the resolution must be two whole numbers from 1 to 65535, came: 0 0",
    ),
    (
        "same.toml",
        TOML_SPHERE + "[camera]\nfrom = [1, 1, 1]\nat = [1, 1, 1]\n",
        "same.toml, line 5: camera .+two different points",
    ),
    # not what it says it is
    ("word.nff", HEAD + "s 0 0 0 1\nq 1 2 3", f"word.nff, line 5: came the unknown word 'q', wanted one of {KEYWORDS}"),
    (
        "latin.nff",
        HEAD.encode() + b"s 0 0 0 \xe91",
        rf"latin.nff, line 4: came the unknown word '\\\\xe91', wanted one of {KEYWORDS}",
    ),
    ("long.nff", HEAD + "s 0 0 0 " + "1" * 10_000_000, r"long.nff, line 4: came '1{37}\.\.\.', wanted a finite number"),
    (
        "long.nff",
        HEAD + "s 0 0 0 1 " + "z" * 10_000_000,
        r"long.nff, line 4: came the unknown word 'z{37}\.\.\.', wanted .+",
    ),
    (
        "index.obj",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
        "index.obj, line 4: came the corner '9', but the file has 3 v, 0 vt and 0 vn",
    ),
    (
        "index.ply",
        PLY + PLY_FACES.format(1) + "3 0 1 7\n",
        "index.ply: a face has the vertex 7, wanted numbers from 0 to 2",
    ),
    ("binary.nff", RUBBISH, "binary.nff, line 1: came .+ before any keyword, wanted one of .+"),
    ("binary.obj", RUBBISH, "binary.obj: .+"),
    ("binary.ply", RUBBISH, "binary.ply: this is no PLY file, wanted a header from 'ply' to 'end_header'"),
    ("binary.stl", RUBBISH, r"binary.stl: the file has 10240 bytes, wanted \d+ for its \d+ facets"),
    ("binary.glb", RUBBISH, "binary.glb: .+"),
    ("binary.gltf", RUBBISH, "binary.gltf: .+"),
    ("binary.toml", RUBBISH, r"binary.toml: the TOML cannot be read \(.+\)"),
    (
        "key.toml",
        TOML_SPHERE + "colour = 1\n",
        r"key.toml, line 5: the key surfaces\[0\].colour is unknown, wanted one of: .+",
    ),
    (
        "text.toml",
        TOML_SPHERE.replace("= 1", '= "one"'),
        r"text.toml, line 4: surfaces\[0\].radius is 'one', wanted a valid number",
    ),
    (
        "kind.toml",
        TOML_SPHERE.replace("sphere", "cube"),
        r"kind.toml, line \d: surfaces\[0\].kind is 'cube', wanted one of: .+",
    ),
    (
        "mesh.toml",
        '[[meshes]]\nfile = "gone.ply"\n',
        r"mesh.toml, line 2: meshes\[0\].file cannot be placed: .*gone.ply: there is no such file",
    ),
    ("base.toml", 'include = "gone.nff"\n', ".*gone.nff: there is no such file"),
]


@pytest.mark.parametrize(("name", "contents", "line"), FILES, ids=[f"{k}-{row[0]}" for k, row in enumerate(FILES)])
def test_scene_files(name, contents, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = tmp_path / name
    scene.write_bytes(contents if isinstance(contents, bytes) else contents.encode())
    one_line(here("render", name, "-o", "x.png", "-o", "x.npy", "--stats", "x.json"), 1, f"raygrid: {line}")
    assert list(tmp_path.iterdir()) == [scene]
    one_line(here("info", name), 1, f"raygrid: {line}")


NO_FILES = [
    ("gone.nff", "gone.nff: there is no such file"),
    ("gone/scene.obj", "gone/scene.obj: there is no such file"),
    ("folder.nff", f"folder.nff: the scene is a directory, wanted a file of one of: {SUFFIXES}"),
    (".", f".: the scene is a directory, wanted a file of one of: {SUFFIXES}"),
    ("a" * 300 + ".nff", r"a{300}.nff: the file cannot be read \(File name too long\)"),
]


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("scene.xyz", f"scene.xyz: the file has the suffix '.xyz', wanted one of: {SUFFIXES}"),
        ("scene", f"scene: the file has no suffix, wanted one of: {SUFFIXES}"),
        ("", "a scene came as '', wanted the name of a file"),
    ],
)
def test_names_that_no_scene_can_have_are_misuse(name, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for there in (False, True):
        if there and name:
            (tmp_path / name).write_text(GOOD)
        misused(here("render", name, "-o", "x.png"), "render", line)
        misused(here("info", name), "info", line)


@pytest.mark.parametrize(("name", "line"), NO_FILES, ids=[ascii(row[0][:20]) for row in NO_FILES])
def test_scenes_that_are_no_files(name, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("folder.nff").mkdir()
    one_line(here("render", name, "-o", "x.png"), 1, f"raygrid: {line}")
    one_line(here("info", name), 1, f"raygrid: {line}")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.nff"]


def test_a_scene_too_small_for_its_place(tmp_path, monkeypatch):
    """Readable, but no world box can hold it: its coordinates would be rounded away."""
    monkeypatch.chdir(tmp_path)
    Path("far.nff").write_text(HEAD + "s 1e20 0 0 1e-5")
    assert here("info", "far.nff").code == 0
    line = r"raygrid: far.nff: the surfaces span 2e-05 at \[1e\+20, 0.0, 0.0\]: too small .+, move them nearer"
    one_line(here("render", "far.nff", "-o", "x.png"), 1, line)


EXTREMES = {
    "tiny": ("0 -6e-25 0", "s 0 0 0 1e-25"),
    "huge": ("0 -6e29 0", "s 0 0 0 1e29"),
    "eye on a surface": ("0 -1 0", "s 0 0 0 1"),
    "light on a surface": ("0 -6 0", "s 1 1 8 1"),
    "light far away": ("0 -6 0", "l 1e30 0 0 s 0 0 0 1"),
    "light too bright": ("0 -6 0", "l 3 -3 3 1e30 1e30 1e30 s 0 0 0 1"),
    "too bright": ("0 -6 0", "f 1e30 1e30 1e30 1e10 1e10 1 1e10 1.5 s 0 0 0 1 s 0 0 3 1"),
    "one on the other": ("0 -6 3", "p 4 0 0 0 1 0 0 1 1 0 0 1 0 " * 50),
    "a pea on a plain": ("0 -6 3", "p 4 -1e5 -1e5 0 1e5 -1e5 0 1e5 1e5 0 -1e5 1e5 0 s 0 0 0 1e-3"),
    "a needle": ("0 -6 3", "c 0 0 0 1e-9 0 0 1000 1e-9"),
}


BEYOND = {
    "eye far away": ("0 -1e30 0", "s 0 0 0 1", "the camera's rays begin .* wanted at most 1e\\+09: .*"),
    "glass like air": (
        "0 -6 0",
        "f 1 1 1 0 1 1 1 1e-30 s 0 0 0 1",
        ".* index of refraction must be 0.001 to 1000, came: .*",
    ),
    "glass like lead": (
        "0 -6 0",
        "f 1 1 1 0 1 1 1 1e30 s 0 0 0 1",
        ".* index of refraction must be 0.001 to 1000, came: .*",
    ),
}


@pytest.mark.parametrize(("eye", "surfaces", "words"), BEYOND.values(), ids=BEYOND)
def test_what_no_arithmetic_can_carry_is_refused(eye, surfaces, words, tmp_path):
    scene = tmp_path / "strange.nff"
    scene.write_text(HEAD.replace("0 -6 2", eye) + surfaces)
    with pytest.raises(SceneError, match=words):
        rendered(load_scene(scene), ONE, size=(24, 18))


@pytest.mark.parametrize(("eye", "surfaces"), EXTREMES.values(), ids=EXTREMES)
def test_strange_scenes_are_rendered_all_the_same(eye, surfaces, tmp_path):
    scene = tmp_path / "strange.nff"
    scene.write_text(HEAD.replace("0 -6 2", eye).replace("at 0 0 0", "at 0 0 1e-40") + surfaces)
    one = rendered(load_scene(scene), ONE, size=(24, 18))
    assert (one.sums >= 0).all()
    assert (rendered(load_scene(scene), EIGHT, size=(24, 18)).sums == one.sums).all()
