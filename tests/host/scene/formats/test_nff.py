"""The NFF reader: golden cases by hand, every error, round trips, any text at all, and the facts of the SPD scenes."""

import time
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import paths

from raygrid.host.scene.formats.nff import load_nff, parse_nff
from raygrid.node.errors import SceneError
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.protocol.frame import POINT

SPD = paths.SHARED / "scenes" / "spd"
needs_spd = pytest.mark.skipif(not SPD.is_dir(), reason=f"the shared SPD scenes are not at {SPD}")

VIEW = "v\nfrom 0 -5 1\nat 0 0 0\nup 0 0 1\nangle 40\nhither 1\nresolution 64 48\n"
BALL = "s 0 0 0 1\n"


def parsed(text):
    return parse_nff(Path("x.nff"), text if isinstance(text, bytes) else text.encode())


def only_batch(scene, kind):
    return next(batch for batch in scene.surfaces if batch.kind == kind)


def test_a_whole_file_by_hand():
    scene = parsed(
        "# a comment\nb 0.1 0.2 0.3 # and one more\nv from 1 2 3 at 0 0 0 up 0 0 1\n\tangle 45 hither .01\n"
        "resolution 320 200 l 4 3 2\nl 1 2 3 1 0.5 0\nf 1 0.5 0.25 0.8 0.2 30 0 0\ns 0 0 0 2\nf 1 1 1 0.1 0 0 0.9 1.5\n"
        "c 0 0 0 1\n0 0 2 0.5\ns 1 1 1 -0.25 c 0 0 0 1 0 0 3 1\n"
        "p 3 0 0 0 1 0 0 0 1 0\np 4 0 0 0 1 0 0 1 1 0 0 1 0\npp 3 0 0 0 0 0 2 1 0 0 0 0 1 0 1 0 0 3 4"
    )
    assert (scene.name, scene.size, scene.highlights) == ("x.nff", (320, 200), False)
    assert scene.background == (0.1, 0.2, 0.3)
    assert scene.camera.eye == (1, 2, 3)
    assert scene.remarks == ()
    assert {b.kind: b.ids.tolist() for b in scene.surfaces} == {
        Kind.SPHERE: [0, 2],
        Kind.CONE: [1],
        Kind.CYLINDER: [3],
        Kind.TRIANGLE: [4],
        Kind.POLYGON: [5],
        Kind.SMOOTH: [6],
    }
    assert only_batch(scene, Kind.SPHERE).data.tolist() == [[0, 0, 0, 2], [1, 1, 1, -0.25]]
    assert only_batch(scene, Kind.SPHERE).materials.tolist() == [0, 1]
    assert only_batch(scene, Kind.CONE).data.tolist() == [[0, 0, 0, 1, 0, 0, 2, 0.5]]
    assert only_batch(scene, Kind.CYLINDER).data.tolist() == [[0, 0, 0, 1, 0, 0, 3, 1]]
    assert only_batch(scene, Kind.TRIANGLE).data.tolist() == [[0, 0, 0, 1, 0, 0, 0, 1, 0]]
    assert only_batch(scene, Kind.POLYGON).data.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert only_batch(scene, Kind.POLYGON).starts.tolist() == [0, 4]
    smooth = only_batch(scene, Kind.SMOOTH).data
    assert np.allclose(smooth, [[0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0.6, 0.8]])


def test_materials_follow_the_reference_shading():
    scene = parsed(VIEW + "f 1 0.5 0.25 0.8 0.2 30 0 0\n" + BALL + "f 1 1 1 0.1 0 100000 0.9 1.5\n" + BALL)
    opaque, glass = scene.materials
    assert np.allclose(opaque["diffuse"], (0.8, 0.4, 0.2))
    assert opaque["specular"].tolist() == opaque["highlight"].tolist() == [0.2] * 3
    assert (opaque["shine"], opaque["ior"], opaque["transmission"].any()) == (30, 1, False)
    assert glass["transmission"].tolist() == [0.9] * 3
    assert (glass["ior"], glass["specular"].any()) == (1.5, False)


def test_equal_fills_are_one_material():
    text = "".join(f"f 1 0 {k % 3} 1 0 0 0 {k % 2}\n{BALL}" for k in range(30))
    scene = parsed(VIEW + text)
    assert len(scene.materials) == 3  # an index of refraction that is never used keeps nothing apart
    assert scene.surfaces.batches[0].materials.tolist() == [0, 1, 2] * 10


def test_lights_share_the_intensity():
    scene = parsed(VIEW + "l 1 2 3\nl 4 5 6\nl 7 8 9 1 0.5 0\nl 0 0 1\n" + BALL)
    assert scene.lights["kind"].tolist() == [POINT] * 4
    assert scene.lights["place"].tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9], [0, 0, 1]]
    assert scene.lights["intensity"].tolist() == [[0.5] * 3, [0.5] * 3, [0.5, 0.25, 0], [0.5] * 3]
    assert not scene.lights["falloff"].any()
    assert not scene.lights["spot"].any()


def test_without_lights_background_or_fill():
    scene = parsed(VIEW + BALL)
    assert (len(scene.lights), scene.background) == (0, (0, 0, 0))
    assert scene.materials["diffuse"].tolist() == [[1, 1, 1]]
    assert [remark.split(":")[0] for remark in scene.remarks] == [
        "no fill before the first surface",
        "no light in the file",
    ]


def test_what_follows_a_late_fill_has_its_material():
    scene = parsed(VIEW + BALL + "f 1 0 0 1 0 0 0 0\n" + BALL)
    assert scene.surfaces.batches[0].materials.tolist() == [0, 1]
    assert scene.materials["diffuse"].tolist() == [[1, 1, 1], [1, 0, 0]]


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", " "),
        lambda text: text.replace(" ", "\n"),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace(" ", "\t \f"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", " # s 1 2 3 # 4\n").replace("1 # s", "1# s"),
        lambda text: text.replace("from 0 -5 1\nat 0 0 0\n", "at 0 0 0\nfrom 0 -5 1\n"),
        lambda text: text.replace("5", "0.05E+2").replace("40", "+4.e1"),
    ],
)
def test_formatting_makes_no_difference(change):
    text = VIEW + "l 5 5 5\nf 1 1 1 1 0 0 0 0\np 4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n" + BALL
    plain, odd = parsed(text), parsed(change(text))
    assert odd.camera == plain.camera
    assert np.array_equal(odd.lights, plain.lights)
    assert np.array_equal(odd.materials, plain.materials)
    for a, b in zip(odd.surfaces, plain.surfaces, strict=True):
        assert np.array_equal(a.data, b.data)


def test_cones_begin_with_their_wider_end():
    scene = parsed(VIEW + "c 0 0 0 0.5 0 0 2 1\nc 0 0 0 -2 0 0 1 -2\nc 0 0 0 -1 0 0 1 -2\nc 0 0 0 0 0 0 1 1\n")
    assert only_batch(scene, Kind.CONE).data.tolist() == [
        [0, 0, 2, 1, 0, 0, 0, 0.5],
        [0, 0, 1, -2, 0, 0, 0, -1],
        [0, 0, 1, 1, 0, 0, 0, 0],
    ]
    assert only_batch(scene, Kind.CYLINDER).ids.tolist() == [1]


def test_patches_of_more_than_three_vertices_become_triangles():
    flat = "0 0 0 0 0 1 2 0 0 0 0 1 2 2 0 0 0 1 0 2 0 0 0 1"
    dented = "0 0 0 0 0 1 2 1 0 1 0 1 4 0 0 0 0 1 2 4 0 0 0 1"
    scene = parsed(VIEW + BALL + f"pp 4 {flat}\n" + BALL + f"pp 4 {dented}\n" + BALL)
    smooth = only_batch(scene, Kind.SMOOTH)
    assert smooth.ids.tolist() == [1, 2, 4, 5]
    assert only_batch(scene, Kind.SPHERE).ids.tolist() == [0, 3, 6]
    corners = smooth.data[:, :9].reshape(-1, 3, 3)
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    assert (areas > 0).all()
    assert (areas[:2].sum(), areas[2:].sum()) == (4, 6)
    at_dent = (corners == (2, 1, 0)).all(axis=2)
    assert at_dent.sum() == 2  # both triangles of the dented patch meet at the dent, with its normal
    assert np.allclose(smooth.data[:, 9:].reshape(-1, 3, 3)[at_dent], np.array((1, 0, 1)) / np.sqrt(2))


def test_bent_and_flat_polygons_are_remarked():
    scene = parsed(VIEW + "p 4 0 0 0 1 0 0 1 1 0.5 0 1 0\np 3 0 0 0 1 1 1 2 2 2\np 4 0 0 0 1 0 0 1 1 0 0 1 0\nl 1 1 1")
    assert (scene.surfaces.count(Kind.TRIANGLE), scene.surfaces.count(Kind.POLYGON)) == (2, 1)
    assert "1 polygon cut into triangles, being not planar" in scene.remarks
    assert "1 triangle without area dropped" in scene.remarks


ERRORS = {
    "": "x.nff: the file is empty, wanted a viewpoint and surfaces",
    "# nothing\n": "x.nff: the file is empty",
    "\n\n3 4": "x.nff, line 3: came '3' before any keyword, wanted one of b v from",
    VIEW: "x.nff: the file has no surfaces, wanted at least one of s c p pp",
    BALL: "x.nff: the file has no viewpoint, wanted one",
    VIEW + BALL + "sphere 1 2 3": "x.nff, line 9: came the unknown word 'sphere', wanted one of b v from",
    VIEW + BALL + "\ns 0 0 1..5 1": "x.nff, line 10: came '1..5', wanted a number",
    VIEW + "s 0 0\n0x1 1": "x.nff, line 9: came '0x1', wanted a number",
    VIEW + "s 0 0 0 1_0": "x.nff, line 8: came '1_0', wanted a number",
    VIEW + "s 0 nan 0 1": "x.nff, line 8: came 'nan', wanted a finite number",
    VIEW + "s 0 -inf 0 1": "x.nff, line 8: came '-inf', wanted a finite number",
    VIEW + "s 0 1e999 0 1": "x.nff, line 8: came '1e999', wanted a finite number",
    VIEW + "s 0 1e31 0 1": "x.nff, line 8: came 1e+31, wanted at most 1e30",
    VIEW + "s 0 0 0": "x.nff, line 8: the file ends inside the sphere that begins here, after 3 numbers of 4",
    VIEW + "p 4 0 0 0 1": "x.nff, line 8: the file ends inside the polygon that begins here, after 5 numbers of 13",
    VIEW + "pp": "x.nff, line 8: the file ends inside the polygon with normals",
    VIEW + "s 0 0 0\n" + BALL: "x.nff, line 8: the sphere has 3 numbers, wanted 4",
    VIEW + "s 0 0 0 1 2\n" + BALL: "x.nff, line 8: the sphere has 5 numbers, wanted 4",
    VIEW + "c 0 0 0 1 0 0 1\n" + BALL: "x.nff, line 8: the cone or cylinder has 7 numbers, wanted 8",
    VIEW + "l 1 2\n" + BALL: "x.nff, line 8: the light has 2 numbers, wanted 3 or 6",
    VIEW + "l 1 2 3 4\n" + BALL: "x.nff, line 8: the light has 4 numbers, wanted 3 or 6",
    VIEW + "f 1 1 1 1 0 0 0\n" + BALL: "x.nff, line 8: the fill has 7 numbers, wanted 8",
    VIEW + "p 3 0 0 0 1 1 1 0 1\n" + BALL: "x.nff, line 8: the polygon has 9 numbers, wanted 10",
    VIEW + "p 2 0 0 0 1 1 1\n" + BALL: "x.nff, line 8: a polygon must have at least 3 vertices, came: 2 0 0 0 1 1 1",
    VIEW + "pp 0\n" + BALL: "x.nff, line 8: a polygon must have at least 3 vertices, came: 0",
    VIEW + "p 3.5 0 0 0\n" + BALL: "x.nff, line 8: a polygon's number of vertices must be whole, came: 3.5 0 0 0",
    VIEW + "p 1e15 0 0 0\n" + BALL: "x.nff, line 8: a polygon's number of vertices must be below 2^31",
    VIEW + BALL + "s 1 1 1 0": "x.nff, line 9: a sphere's radius must not be 0, came: 1 1 1 0",
    VIEW + "c 0 0 1 1 0 0 1 2": "x.nff, line 8: a cone's base and apex must be two points",
    VIEW + "c 0 0 1 0 0 0 2 0": "x.nff, line 8: a cone's radii must not both be 0",
    VIEW + "c 0 0 1 1 0 0 2 -1": "x.nff, line 8: a cone's radii must have one sign",
    VIEW + "f 1 1 -1 1 0 0 0 0\n" + BALL: "x.nff, line 8: a fill's colours, weights and shine must not be below 0",
    VIEW
    + "f 1 1 1 1 0 0 0.5 0\n"
    + BALL: "x.nff, line 8: a transparent fill's index of refraction must be 0.001 to 1000",
    VIEW + "l 1 1 1 1 -1 1\n" + BALL: "x.nff, line 8: a light's colour must not be below 0",
    VIEW + "b 1 -1 1\n" + BALL: "x.nff, line 8: the background's colour must not be below 0",
    VIEW + "b 1 1 1 b 1 1 1\n" + BALL: "x.nff, line 8: came a second background, wanted one",
    VIEW + VIEW + BALL: "x.nff, line 8: came a second viewpoint, wanted one",
    VIEW.replace("hither 1\n", "") + BALL: "x.nff, line 1: the viewpoint has no 'hither', wanted all of from at up",
    VIEW.replace("v\n", "") + BALL: "x.nff, line 1: came 'from' outside a viewpoint",
    VIEW + BALL + "angle 30": "x.nff, line 9: came 'angle' outside a viewpoint",
    VIEW.replace("angle 40", "at 40 0 0") + BALL: "x.nff, line 1: the viewpoint has no 'angle'",
    VIEW.replace("64 48", "64 0") + BALL: "x.nff, line 7: the resolution must be two whole numbers from 1 to 65535",
    VIEW.replace("64 48", "64 4.5") + BALL: "x.nff, line 7: the resolution must be two whole numbers from 1 to 65535",
    VIEW.replace("40", "180") + BALL: "x.nff, line 1: the camera's angle is 180 degrees",
    VIEW.replace("0 -5 1", "0 0 0") + BALL: "x.nff, line 1: the camera looks from (0, 0, 0) at that same point",
    VIEW.replace("up 0 0 1", "up 0 -5 1") + BALL: "x.nff, line 1: the camera's up (0, -5, 1) is parallel to its view",
    VIEW + "p 3 0 0 0 1 1 1 2 2 2\n": "x.nff: the file has only 1 surface without area",
}


@pytest.mark.parametrize("text", ERRORS, ids=range(len(ERRORS)))
def test_errors_name_file_line_what_came_and_what_was_wanted(text):
    with pytest.raises(SceneError) as caught:
        parsed(text)
    assert str(caught.value).startswith(ERRORS[text])
    assert "\n" not in str(caught.value)


def test_the_first_error_of_the_file_is_told():
    with pytest.raises(SceneError, match="line 9: a sphere's radius"):
        parsed(VIEW + BALL + "s 0 0 0 0\nc 0 0 0 1 0 0 0 1\np 2 0 0 0 1 1 1\ns 1 1\n")


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_lines_are_counted_with_every_line_ending_and_over_comments(ending):
    text = (VIEW + "# s s s\n\n" + BALL + "what\n").replace("\n", ending)
    with pytest.raises(SceneError, match=r"^x\.nff, line 11: came the unknown word 'what'"):
        parsed(text)


KEYWORDS = ["b", "v", "from", "at", "up", "angle", "hither", "resolution", "l", "f", "c", "s", "p", "pp"]
NUMBERS = ["0", "1", "-1", "3", "4", "0.5", "2.5", "1e30", "-1e30", "1e-300"]
OTHERS = ["#", "\n", "x", "nan", "inf", "1_0", "1e400", "\0", "é"]
words = st.sampled_from([*KEYWORDS, *NUMBERS, *OTHERS])


@given(st.binary(max_size=200))
def test_any_bytes_either_parse_or_are_refused(data):
    try_to_parse(VIEW.encode() + data)
    try_to_parse(data)


@settings(max_examples=300)
@given(st.lists(words, max_size=60))
def test_any_words_either_parse_or_are_refused(text):
    try_to_parse(VIEW.encode() + " ".join(text).encode())


numbers = st.sampled_from(["0", "1", "-1", "0.5", "1e30", "-1e30", "1e-300", "1e-9", "7"])
entities = st.one_of(
    st.lists(numbers, min_size=4, max_size=4).map(lambda n: ["s", *n]),
    st.lists(numbers, min_size=8, max_size=8).map(lambda n: ["c", *n]),
    st.lists(numbers, min_size=8, max_size=8).map(lambda n: ["f", *n]),
    st.integers(3, 6).flatmap(
        lambda k: st.lists(numbers, min_size=3 * k, max_size=3 * k).map(lambda n: ["p", str(len(n) // 3), *n])
    ),
    st.integers(3, 6).flatmap(
        lambda k: st.lists(numbers, min_size=6 * k, max_size=6 * k).map(lambda n: ["pp", str(len(n) // 6), *n])
    ),
)


@settings(max_examples=300)
@given(st.lists(entities, min_size=1, max_size=5))
def test_any_entities_either_parse_or_are_refused(text):
    try_to_parse(VIEW.encode() + " ".join(chain.from_iterable(text)).encode())


def try_to_parse(data):
    try:
        scene = parsed(data)
    except SceneError as error:
        assert str(error).startswith("x.nff")
        return
    assert len(scene.surfaces) > 0
    for batch in scene.surfaces:
        assert np.isfinite(batch.data).all()


coordinates = st.floats(-1e6, 1e6).map(lambda x: float(f"{x:.9g}"))
radii = st.floats(1e-3, 1e3)
points = st.tuples(coordinates, coordinates, coordinates)
spheres = st.tuples(st.just("s"), points, radii)
cones = st.tuples(st.just("c"), points, radii, points, radii).filter(lambda c: c[1] != c[3])
triangles = st.tuples(st.just("p"), points, points, points)


def written(entity):
    keyword, *parts = entity
    numbers = [n for part in parts for n in (part if isinstance(part, tuple) else (part,))]
    count = [len(parts)] if keyword == "p" else []
    return " ".join([keyword, *map(repr, [*count, *numbers])])


@given(st.lists(st.one_of(spheres, cones, triangles), min_size=1, max_size=8))
def test_round_trip(made):
    scene = try_to_read(VIEW + "\n".join(map(written, made)))
    if scene is None:
        return  # nothing but triangles without area
    read = {int(i): row.tolist() for batch in scene.surfaces for i, row in zip(batch.ids, batch.data, strict=True)}
    kept = iter(sorted(read))
    for keyword, *parts in made:
        flat = [n for part in parts for n in (part if isinstance(part, tuple) else (part,))]
        if keyword == "p" and flat not in read.values():
            continue  # dropped for having no area
        if keyword == "c" and abs(flat[7]) > abs(flat[3]):
            flat = flat[4:] + flat[:4]
        assert read[next(kept)] == flat
    assert next(kept, None) is None


def try_to_read(text):
    try:
        return parsed(text)
    except SceneError as error:
        assert "without area" in str(error)
        return None


def mountain(steps):
    """Fractal-like triangles as the SPD program mount writes them: 2 * steps^2 of them."""
    grid = np.linspace(-1, 1, steps + 1)
    height = 0.2 * np.sin(7 * grid)[:, None] * np.cos(5 * grid)
    lines = []
    for j in range(steps):
        for i in range(steps):
            a, b, c, d = (
                f"{grid[x]:.6g} {grid[y]:.6g} {height[y, x]:.6g}"
                for x, y in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
            )
            lines.append(f"p 3\n{a}\n{b}\n{c}\np 3\n{c}\n{d}\n{a}")
    return (VIEW + "l 1 1 1\nf 0.5 0.45 0.35 1 0 100000 0 0\n" + "\n".join(lines) + "\n").encode()


def test_130_thousand_polygons_take_about_a_second():
    text = mountain(256)
    begun = time.process_time()
    scene = parsed(text)
    taken = time.process_time() - begun
    assert scene.surfaces.count(Kind.TRIANGLE) == 2 * 256**2
    assert taken < 5, "0.5 s of processor time where this was written"


# name: s, c, p and pp as in the file, distinct fills, lights (the table in the scenes' own README)
TABLE = {
    "balls_2": (91, 0, 1, 0, 2, 3),
    "balls_3": (820, 0, 1, 0, 2, 3),
    "gears_1": (0, 0, 147, 0, 2, 5),
    "gears_2": (0, 0, 1169, 0, 8, 5),
    "mount_4": (4, 0, 512, 0, 2, 1),
    "mount_5": (4, 0, 2048, 0, 2, 1),
    "mount_6": (4, 0, 8192, 0, 2, 1),
    "rings_2": (150, 150, 1, 0, 7, 3),
    "rings_3": (420, 420, 1, 0, 7, 3),
    "rings_4": (900, 900, 1, 0, 7, 3),
    "teapot_3": (0, 0, 9, 552, 3, 2),
    "teapot_6": (0, 0, 36, 2256, 3, 2),
    "teapot_12": (0, 0, 144, 9120, 3, 2),
    "tetra_4": (0, 0, 256, 0, 1, 1),
    "tetra_5": (0, 0, 1024, 0, 1, 1),
    "tetra_6": (0, 0, 4096, 0, 1, 1),
}
BOXES = {
    "balls": ((-12, -12, -0.5), (12, 12)),
    "gears": ((-2, -2, 0), (2, 2, 1)),
    "mount": ((-1.16, -1, -0.703), (1, 1.16, 1.378)),
    "teapot": ((-4, -4, 0), (4, 4, 3.15)),
    "tetra": ((-1, -1, -1), (1, 1, 1)),
}


@needs_spd
@pytest.mark.parametrize("name", TABLE)
def test_spd_scenes_have_the_counts_of_their_table(name):
    scene = load_nff(SPD / f"{name}.nff")
    s, c, p, pp, fills, lights = TABLE[name]
    count = scene.surfaces.count
    assert (count(Kind.SPHERE), count(Kind.CYLINDER) + count(Kind.CONE)) == (s, c)
    assert (count(Kind.TRIANGLE) + count(Kind.POLYGON), count(Kind.SMOOTH)) == (p, pp)
    assert (len(scene.materials), len(scene.lights)) == (fills, lights)
    assert (scene.size, scene.background) == ((512, 512), (0.078, 0.361, 0.753))
    assert scene.remarks == ()
    assert np.allclose(scene.lights["intensity"], 1 / np.sqrt(lights))
    low, high = BOXES.get(name.split("_")[0], ((), ()))
    bounds = scene.surfaces.bounds()
    assert np.allclose(bounds[0][: len(low)], low, atol=5e-4)
    assert np.allclose(bounds[1][: len(high)], high, atol=5e-4)


@needs_spd
def test_spd_gears_keep_their_concave_faces_and_glass():
    scene = load_nff(SPD / "gears_1.nff")
    polygons = only_batch(scene, Kind.POLYGON)
    assert np.diff(polygons.starts).max() == 144
    assert scene.materials["transmission"].max() == 0.8
    assert scene.materials["ior"].max() == 1.1


@needs_spd
@pytest.mark.parametrize("file", sorted(SPD.glob("*_[23].nff")), ids=lambda path: path.stem)
def test_spd_scenes_cut_anywhere_are_refused_or_shorter(file):
    data = file.read_bytes()
    whole = len(load_nff(file).surfaces)
    for end in np.linspace(1, len(data) - 2, 25).astype(int):
        text = data[:end].rpartition(b" ")[0]  # a cut inside a number looks like another number
        try:
            assert len(parse_nff(file, text).surfaces) < whole
        except SceneError as error:
            assert str(error).startswith(str(file))
