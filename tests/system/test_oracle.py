"""The oracle against answers known by hand, and against the ray counts that another program found."""

import itertools
import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from oracle import (
    Camera,
    NffError,
    OracleScene,
    SceneBuilder,
    first_hit,
    intersect_one,
    kernels,
    nff_camera,
    orthographic_camera,
    parse_nff,
    radiance,
    read_nff,
    render,
    tables,
)
from oracle.examples import AHEAD, HAND, TEXT, U_SHAPE, crowd, mirror_room, square, zoo
from support import paths

INF = math.inf


def seen(scene: OracleScene, origin, direction) -> np.ndarray:
    return radiance(scene, origin, direction)[0]


# ---- local light ----


@pytest.fixture
def lit_sphere() -> SceneBuilder:
    builder = SceneBuilder()
    builder.sphere((0, 0, 0), 1.0, builder.material(diffuse=(0.5, 0.4, 0.3), shine=2.0, highlight=0.25))
    return builder


def test_sphere_centre_pixel(lit_sphere):
    lit_sphere.directional_light((0, 3, 4), (1.0, 0.5, 2.0))
    image, counts = render(lit_sphere.build(AHEAD, (0.1, 0.2, 0.3)), 3, 3)
    diffuse = 0.8 * np.array([0.5, 0.2, 0.6])  # N = (0, 0, 1), N.L = 4/5
    highlight = 0.25 * 0.8**2 * np.array([1.0, 0.5, 2.0])  # R = N
    np.testing.assert_allclose(image[1, 1], diffuse + highlight, rtol=1e-14)
    np.testing.assert_array_equal(image[0, 0], (0.1, 0.2, 0.3))
    assert counts == {"primary": 9, "reflected": 0, "refracted": 0, "shadow": 1}


def test_light_behind_the_surface_costs_no_shadow_ray(lit_sphere):
    lit_sphere.directional_light((0, 0, -1))
    image, counts = render(lit_sphere.build(AHEAD), 3, 3)
    assert counts["shadow"] == 0
    assert not image.any()


def test_orthographic_sphere(lit_sphere):
    lit_sphere.directional_light((0, 0, 1))
    matt = lit_sphere.build(orthographic_camera((0, 0, 9), (0, 0, 0), (0, 1, 0), 1.0, 11, 11), 1.0)
    matt.materials.highlight[:] = 0.0
    image, _ = render(matt, 11, 11)  # pixels 0.2 apart
    np.testing.assert_allclose(image[5, 8], 0.8 * np.array([0.5, 0.4, 0.3]), rtol=1e-12)  # x = 0.6, so N = (.6, 0, .8)
    np.testing.assert_allclose(image[2, 5], 0.8 * np.array([0.5, 0.4, 0.3]), rtol=1e-12)
    np.testing.assert_array_equal(image[0, 0], 1.0)


def test_shadow_edge_is_where_similar_triangles_put_it():
    builder = SceneBuilder()
    white = builder.material(diffuse=1.0)
    glass = builder.material(transmission=1.0, ior=1.0)
    builder.polygon(square(50, 0), white)
    builder.triangle([(1, -9, 2), (9, 0, 2), (1, 9, 2)], glass)  # transparent things cast shadows as others do
    builder.point_light((0, 0, 4))
    scene = builder.build(AHEAD)
    for x, lit in ((2 - 1e-6, 1.0), (2 + 1e-6, 0.0)):  # the edge at x = 1 half way up throws its shadow twice as far
        expected = lit * 4.0 / math.hypot(x, 4.0)
        np.testing.assert_allclose(seen(scene, (x, -0.3, 0.4), (0, 0.3, -0.4)), expected, rtol=1e-12)


@pytest.mark.parametrize(("cos_a", "part"), [(0.95, 1.0), (0.9, 1.0), (0.85, 0.25), (0.8, 0.0), (0.7, 0.0)])
def test_spot_with_inverse_square(cos_a, part):
    builder = SceneBuilder()
    builder.polygon(square(50, 0), builder.material(diffuse=1.0))
    builder.point_light((0, 0, 4), 100.0, inverse_square=True, spot=((0, 0, -2), 0.9, 0.8))
    x, distance = 4.0 * math.tan(math.acos(cos_a)), 4.0 / cos_a
    colour, counts = radiance(builder.build(AHEAD), (x, 0, 1), (0, 0, -1))
    np.testing.assert_allclose(colour, 100.0 * part / distance**2 * cos_a, rtol=1e-9, atol=1e-9)
    assert counts["shadow"] == 1  # a shadow ray is for N.L > 0, whether or not the spot reaches


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_smooth_triangle_weights_its_normals(side):
    builder = SceneBuilder()
    normals = [(0, 0, 1), (1, 0, 1), (0, 1, 1)]
    builder.smooth_triangle([(0, 0, 0), (1, 0, 0), (0, 1, 0)], normals, builder.material(diffuse=1.0))
    builder.directional_light((0, 0, side))
    expected = 1.0 / math.sqrt(0.25**2 + 0.5**2 + 1.0)  # N = (1/4, 1/2, 1) at weights 1/4, 1/4, 1/2; from below -N
    np.testing.assert_allclose(seen(builder.build(AHEAD), (0.25, 0.5, side), (0, 0, -side)), expected, rtol=1e-12)


# ---- reflected and refracted rays ----


def test_mirror_by_hand():
    # From (4, 0, 3) towards the mirrored centre (0, 0, -3): by (2, 0, 0) to the sphere, where N = (2, 0, -3)/sqrt(13).
    expected = np.array([0.9, 0.8, 0.7]) * np.array([1.0, 0.5, 0.2]) * 2.0 / math.sqrt(13.0)
    colour, counts = radiance(mirror_room(True), (4, 0, 3), (-4, 0, -6))
    np.testing.assert_allclose(colour, expected, rtol=1e-12)
    assert counts == {"primary": 1, "reflected": 1, "refracted": 0, "shadow": 1}


def test_mirror_shows_what_the_mirrored_eye_sees():
    rng = np.random.default_rng(1)
    for target in rng.uniform(-3, 3, (200, 2)):
        eye, there = np.array([4.0, 1.0, 3.0]), np.array([*target, 0.0])
        if first_hit(mirror_room(True), eye, there - eye)[1] != 1:
            continue  # the sphere is in the way
        flip = np.array([1.0, 1.0, -1.0])
        expected = np.array([0.9, 0.8, 0.7]) * seen(mirror_room(False), eye * flip, (there - eye) * flip)
        np.testing.assert_allclose(seen(mirror_room(True), eye, there - eye), expected, rtol=1e-9)


@pytest.mark.parametrize("max_depth", [1, 2, 5])
def test_depth_between_two_mirrors(max_depth):
    builder = SceneBuilder()
    half_mirror = builder.material(diffuse=1.0, specular=0.5)
    builder.polygon(square(50, 0), half_mirror)
    builder.polygon(square(50, 1), half_mirror)
    builder.point_light((0, 0, 0.5))
    scene = builder.build(AHEAD, 1.0, max_depth=max_depth)
    colour, counts = radiance(scene, (1, 0, 0.5), (0, 0, -1))
    lit = 0.5 / math.hypot(1.0, 0.5)  # at each hit; the next adds half of it
    np.testing.assert_allclose(colour, lit * sum(0.5**k for k in range(max_depth)), rtol=1e-12)
    assert counts == {"primary": 1, "reflected": max_depth - 1, "refracted": 0, "shadow": max_depth}
    cut = radiance(replace(scene, max_depth=5, min_weight=0.2), (1, 0, 0.5), (0, 0, -1))[1]
    assert cut["reflected"] == 2  # weights 1/2 and 1/4, not 1/8


def test_slab_moves_the_ray_sideways():
    ior, theta = 1.5, math.radians(40.0)
    inner = math.asin(math.sin(theta) / ior)
    shift = math.sin(theta - inner) / math.cos(inner)  # across the ray, for a slab of thickness 1
    arrival = 3.0 * math.tan(theta) - shift / math.cos(theta)  # from z = 1 to z = -2, without the slab 3 tan theta
    for edge, dark in ((arrival - 1e-9, True), (arrival + 1e-9, False)):
        builder = SceneBuilder()
        glass = builder.material(transmission=(0.9, 0.8, 0.7), ior=ior)
        builder.polygon(square(50, 0), glass)
        builder.polygon(square(50, -1)[::-1], glass)
        builder.polygon([(edge, -9, -2), (99, -9, -2), (99, 9, -2), (edge, 9, -2)], builder.material())
        colour, counts = radiance(builder.build(AHEAD, 1.0), (0, 0, 1), (math.sin(theta), 0, -math.cos(theta)))
        np.testing.assert_allclose(colour, 0.0 if dark else np.array([0.9, 0.8, 0.7]) ** 2, rtol=1e-12)
        assert counts["refracted"] == 2


CRITICAL = math.degrees(math.asin(1.0 / 1.5))


@pytest.mark.parametrize("degrees", [0.0, 40.0, CRITICAL - 1e-6, CRITICAL + 1e-6, 43.0, 89.0])
def test_total_internal_reflection_begins_at_the_critical_angle(degrees):
    angle = math.radians(degrees)
    builder = SceneBuilder()
    builder.polygon(square(1e4, 0), builder.material(transmission=0.9, ior=1.5))  # glass below, black sheet above
    builder.polygon(square(1e9, 0.01), builder.material())
    D = np.array([math.sin(angle), 0.0, math.cos(angle)])
    colour, counts = radiance(builder.build(AHEAD, (0.2, 0.4, 0.6), epsilon=1e-6), -D, D)
    turned = degrees > CRITICAL
    np.testing.assert_allclose(colour, np.array([0.2, 0.4, 0.6]) if turned else 0.0, rtol=1e-12)  # weight 1, not T
    assert counts["refracted"] == 1
    assert counts["reflected"] == 0


@pytest.mark.parametrize("eta", [1.0 / 1.5, 1.0, 1.3])
def test_refract_obeys_snell(eta):
    N = (0.0, 0.6, 0.8)
    D = kernels.unit((0.1, -0.3, -0.9))
    R, passes = kernels.refract(D, N, eta)
    assert passes
    assert np.linalg.norm(R) == pytest.approx(1.0)
    np.testing.assert_allclose(np.cross(R, N), eta * np.cross(D, N), atol=1e-14)  # sines, and one plane
    assert np.dot(R, N) < 0.0


# ---- each kind of surface ----


@pytest.mark.parametrize("axes", list(itertools.permutations(range(3))))
@pytest.mark.parametrize("start", range(len(U_SHAPE)))
def test_concave_polygon(axes, start):
    outline = U_SHAPE[start:] + U_SHAPE[:start]
    builder = SceneBuilder()
    builder.polygon([np.array([x, y, 0.3 * x - 0.2 * y])[list(axes)] for x, y in outline], builder.material())
    scene = builder.build(AHEAD)
    hits = {
        (i, j)
        for i, j in itertools.product(range(-3, 33), repeat=2)
        if intersect_one(
            scene, 0, np.array([i / 10 + 0.05, j / 10 + 0.05, 9.0])[list(axes)], np.array([0.0, 0.0, -1.0])[list(axes)]
        )
    }
    expected = {(i, j) for i, j in itertools.product(range(30), repeat=2) if not (10 <= i < 20 and j >= 10)}
    assert hits == expected


@pytest.mark.parametrize(("name", "origin", "direction", "expected"), HAND)
def test_intersections_by_hand(name, origin, direction, expected):
    scene, index = zoo()
    assert intersect_one(scene, index[name], origin, direction) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "point", "normal"),
    [
        ("sphere of radius 2", (0, 2, 0), (0, 1, 0)),
        ("cylinder", (0, -1, 1), (0, -1, 0)),
        ("cone", (1, 0, 1), (1, 0, 1)),
        ("frustum", (0, 1.5, 1), (0, 2, 1)),
        ("triangle", (0.2, 0.2, 0), (0, 0, 1)),
    ],
)
def test_outward_normals(name, point, normal):
    scene, index = zoo()
    found = kernels.outward_normal(scene.surfaces, index[name], tuple(float(c) for c in point))
    np.testing.assert_allclose(found, np.array(normal) / np.linalg.norm(normal), atol=1e-14)


def test_first_hit_is_the_least_of_all_hits():
    rng = np.random.default_rng(2)
    scene = crowd(rng)
    hits = 0
    for _ in range(500):
        origin, direction = rng.uniform(-4, 4, 3), rng.normal(size=3)
        t_min, t_max = rng.choice([0.0, 1.0]), rng.choice([2.0, INF])
        found = [(t, s) for s in range(50) for t in intersect_one(scene, s, origin, direction) if t_min < t < t_max]
        t, s = min(found, default=(INF, -1))
        assert first_hit(scene, origin, direction, t_min, t_max) == (pytest.approx(t, rel=1e-12), s)
        hits += s >= 0
    assert 100 < hits < 500


def test_equal_hits_go_to_the_smaller_index():
    builder = SceneBuilder()
    m = builder.material()
    for z in (0, 1, 1):
        builder.polygon(square(1, z), m)
    assert first_hit(builder.build(AHEAD), (0.1, 0.2, 3), (0, 0, -1)) == (2.0, 1)


# ---- cameras and samples ----


def test_nff_camera_spans_from_first_row_to_last():
    camera = nff_camera((1, 2, 3), (4, 1, 0), (0, 0, 1), 50, 21, 11)
    forward = camera.ray(10, 5)[1]
    np.testing.assert_allclose(forward, np.array([3, -1, -3]) / math.sqrt(19), rtol=1e-14)
    assert camera.ray(10, 0)[1] @ camera.ray(10, 10)[1] == pytest.approx(math.cos(math.radians(50)))
    half_width = math.tan(math.radians(25)) * 20 / 10
    assert camera.ray(0, 5)[1] @ forward == pytest.approx(1.0 / math.hypot(1.0, half_width))
    assert camera.ray(10, 0)[1][2] > forward[2]  # row 0 is at the top
    right = np.cross(forward, (0, 0, 1))
    assert camera.ray(20, 5)[1] @ right > 0.0
    for w, h in ((1, 5), (5, 1), (1, 1)):
        lone = nff_camera((1, 2, 3), (4, 1, 0), (0, 0, 1), 50, w, h)
        np.testing.assert_allclose(lone.ray((w - 1) / 2, (h - 1) / 2)[1], forward, rtol=1e-14)


def test_a_pixel_is_the_mean_of_its_samples():
    rng = np.random.default_rng(3)
    scene = replace(mirror_room(True), camera=nff_camera((9, 2, 4), (0, 0, 2), (0, 0, 1), 40, 6, 4))
    offsets = rng.uniform(-0.5, 0.5, (4, 6, 3, 2))
    image, counts = render(scene, 6, 4, offsets)
    assert counts["primary"] == 72
    for y, x in itertools.product(range(4), range(6)):
        rays = [scene.camera.ray(x + di, y + dj) for di, dj in offsets[y, x]]
        np.testing.assert_allclose(image[y, x], np.mean([seen(scene, *ray) for ray in rays], axis=0), rtol=1e-9)
    with pytest.raises(ValueError, match=r"\(4, 6, samples, 2\), not \(6, 4, 3, 2\)"):
        render(scene, 6, 4, offsets.transpose(1, 0, 2, 3))


def test_any_linear_camera():
    eye = Camera((1.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    origin, direction = eye.ray(2, 3)
    np.testing.assert_array_equal(origin, (2, 6, 0))
    np.testing.assert_array_equal(direction, (0, 0, -1))


# ---- the format ----


def test_nff_by_tokens():
    scene = parse_nff(TEXT)
    assert scene.camera == nff_camera((0, 0, 5), (0, 0, 0), (0, 1, 0), 45, 7, 5)
    kinds = [tables.SPHERE, tables.CONE, tables.POLYGON, tables.TRIANGLE, tables.SMOOTH_TRIANGLE]
    assert scene.surfaces.kind.tolist() == kinds
    assert scene.surfaces.material.tolist() == [0, 0, 0, 1, 1]
    np.testing.assert_allclose(scene.materials.diffuse, [(0.8, 0.4, 0), (0, 0, 1)])
    np.testing.assert_allclose(scene.materials.specular[:, 0], (0.5, 0))
    np.testing.assert_allclose(scene.lights.colour, np.array([(1, 0.5, 0.25), (1, 1, 1)]) / math.sqrt(2))
    assert scene.background == (0.1, 0.2, 0.3)
    assert not scene.materials.highlight.any()
    assert parse_nff(TEXT, highlights=True).materials.highlight[0].tolist() == [0.5, 0.5, 0.5]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("s 0 0", "s 0 x", "nff:7: a number is wanted, not 'x'"),
        ("resolution", "hither", "nff:4: each of from at .* not 'hither'"),
        ("f 1 .5 0 .8 .5 3 .25 1.5", "", "nff:7: an f before the first surface is wanted, not 's'"),
        ("pp 3", "pp 4", "nff:13: a pp of 3 points is wanted"),
        ("0 1 0 0 0 1\n", "0 1 0", "nff: ends in the middle of an entity"),
        ("# a comment", "comment", "nff:1: one of v b l f s c p pp is wanted, not 'comment'"),
    ],
)
def test_nff_errors_say_where(old, new, message):
    with pytest.raises(NffError, match=message):
        parse_nff(TEXT.replace(old, new, 1))


# ---- the Standard Procedural Databases ----


SHARED = paths.SHARED
RAYS_TO_EXPECT = {  # reflected, refracted, shadow at 512 x 512, by POV-Ray; see the scenes' README
    "balls_2": (112_997, 0, 870_887),
    "gears_1": (231_542, 304_687, 2_113_585),
    "mount_4": (354_766, 354_766, 409_926),
    "rings_2": (116_863, 0, 877_583),
    "teapot_3": (230_270, 0, 416_656),
    "tetra_4": (0, 0, 54_623),
}


def count_rays(name: str, size: int) -> tuple[int, int, int]:
    """As the table has them: a refracted ray that was totally reflected is there a reflected one."""
    path = SHARED / "scenes" / "spd" / f"{name}.nff"
    if not path.exists():
        pytest.skip(f"{path} is not there; name the folder that holds scenes/spd in RAYGRID_SHARED")
    if numba.config.DISABLE_JIT:
        pytest.skip("takes hours when interpreted")
    scene = read_nff(path, size, size)
    counts = np.zeros(5, dtype=np.int64)
    kernels.render(scene.world(), tuple(scene.camera), np.zeros((size, size, 1, 2)), np.zeros((size, size, 3)), counts)
    turned = counts[tables.INTERNAL]
    return counts[tables.REFLECTED] + turned, counts[tables.REFRACTED] - turned, counts[tables.SHADOW]


@pytest.mark.parametrize("name", ["balls_2", "mount_4", "tetra_4"])
def test_ray_counts_of_small_pictures(name):
    expected = np.array(RAYS_TO_EXPECT[name]) * (128 / 512) ** 2
    np.testing.assert_allclose(count_rays(name, 128), expected, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", RAYS_TO_EXPECT)
def test_ray_counts(name):
    np.testing.assert_allclose(count_rays(name, 512), RAYS_TO_EXPECT[name], rtol=0.005)
