"""Pictures whose answers are worked out by hand: light, shadows, mirrors, glass, cameras.

A primary ray's direction has 48 bits, the weight of a bounced ray an 11-bit mantissa: what is seen directly is right
to about 1e-5, what is seen in a mirror or through glass to about 1e-3.
"""

import math

import numpy as np
import pytest
from support.render import EIGHT, ONE, rendered
from support.stage import UP, Stage, edge, line_camera, places

from raygrid.host.scene.cameras import orthographic_camera, perspective_camera
from raygrid.host.scene.lights import directional_light, point_light, spot_light

DIRECT, BOUNCED = 3e-5, 1e-3

pytestmark = pytest.mark.parametrize("shape", [ONE, EIGHT], ids=["1x1x1", "2x2x2"])


def grid(width, height, pitch):
    """x to the right and y upwards of every pixel's middle, the middle of the picture being 0."""
    x, y = np.meshgrid(places(width, pitch), -places(height, pitch))
    return x, y


def row_of(scene, shape, count, **settings):
    return rendered(scene, shape, size=(count, 1), **settings).linear()[0]


# ---- light ----


def test_a_sphere_in_the_light_of_the_sun_is_lit_by_the_cosine(shape):
    towards = np.array([1.0, 2.0, 3.0]) / math.sqrt(14.0)
    stage = Stage(directional_light(towards, [1.0, 0.9, 0.8]))
    stage.sphere((0, 0, 0), 1.0, stage.material(diffuse=[0.8, 0.5, 0.2]))
    scene = stage.scene(orthographic_camera((0, 0, 5), (0, 0, 0), (0, 1, 0), 2.4), (0.1, 0.2, 0.3))
    picture = rendered(scene, shape, size=(120, 120)).linear()
    x, y = grid(120, 120, 2.4 / 120)
    r = np.hypot(x, y)
    normal = np.stack((x, y, np.sqrt(np.maximum(1.0 - r * r, 0.0))), axis=2)
    lit = np.maximum(normal @ towards, 0.0)[:, :, None] * np.array([0.8, 0.45, 0.16])
    assert np.abs(picture - lit)[r < 0.99].max() < 1e-4  # near the rim the normal turns fast
    assert np.allclose(picture[r > 1.0001], (0.1, 0.2, 0.3), atol=1e-6, rtol=0.0)
    assert (r < 1.0).sum() > 7000


@pytest.mark.parametrize("height", [1.0, 2.0, 5.0, 300.0], ids=lambda h: f"light {h:g} above")
def test_light_falls_with_the_square_of_the_distance(shape, height):
    """Also from outside the world box: at 5 and 300 the light is far above it."""
    stage = Stage(point_light((0.0, 0.0, height), height**2, falloff=True))
    stage.level((-2, 2), (-2, 2), 0.0, stage.material(diffuse=0.6))
    stage.sphere((0, 1.5, 1.0), 0.25, stage.material(diffuse=1.0))  # gives the world a height
    row = row_of(stage.scene(line_camera((0, 0, 0.5), (0, 0, -1), (0, 1, 0), 0.02)), shape, 181)
    x = places(181, 0.02)
    expected = 0.6 * height**2 * height / (x * x + height**2) ** 1.5
    assert np.abs(row - expected[:, None]).max() < DIRECT


def test_light_without_falloff_depends_on_the_angle_alone(shape):
    stage = Stage(point_light((0.0, 0.0, 3.0), 0.5))
    stage.level((-2, 2), (-2, 2), 0.0, stage.material(diffuse=1.0))
    row = row_of(stage.scene(line_camera((0, 0, 0.5), (0, 0, -1), (0, 1, 0), 0.02)), shape, 181)
    assert np.abs(row[:, 1] - 0.5 * 3.0 / np.hypot(places(181, 0.02), 3.0)).max() < DIRECT


def test_a_spot_shines_in_its_cone(shape):
    inner, outer = math.radians(15.0), math.radians(30.0)
    stage = Stage(spot_light((0.0, 0.0, 3.0), (0.0, 0.0, -1.0), 1.0, inner, outer))
    stage.level((-4, 4), (-4, 4), 0.0, stage.material(diffuse=1.0))
    row = row_of(stage.scene(line_camera((0, 0, 1), (0, 0, -1), (0, 1, 0), 0.02)), shape, 251)
    cosine = 3.0 / np.hypot(places(251, 0.02), 3.0)
    fade = np.clip((cosine - math.cos(outer)) / (math.cos(inner) - math.cos(outer)), 0.0, 1.0) ** 2
    assert np.abs(row[:, 2] - fade * cosine).max() < DIRECT
    assert row[0, 0] == 0.0  # outside the cone


def test_what_is_behind_a_light_casts_no_shadow(shape):
    stage = Stage(point_light((0.0, 0.0, 1.0), 1.0))
    grey = stage.material(diffuse=0.5)
    stage.level((-2, 2), (-2, 2), 0.0, grey)
    stage.level((-2, 2), (-2, 2), 1.001, grey)
    row = row_of(stage.scene(line_camera((0, 0, 0.5), (0, 0, -1), (0, 1, 0), 0.02)), shape, 101)
    assert np.abs(row[:, 0] - 0.5 / np.hypot(places(101, 0.02), 1.0)).max() < DIRECT


def test_both_sides_of_a_surface_are_lit(shape):
    stage = Stage(directional_light((0, 0, -1), 1.0))
    stage.level((-2, 2), (-2, 2), 0.0, stage.material(diffuse=0.5))
    below = line_camera((0, 0, -1), (0, 0, 1), (0, 1, 0), 0.02)
    above = line_camera((0, 0, 1), (0, 0, -1), (0, 1, 0), 0.02)
    for camera, seen in ((below, 0.5), (above, 0.0)):
        assert np.abs(row_of(stage.scene(camera), shape, 9) - seen).max() < DIRECT


def test_a_highlight_is_brightest_where_the_light_is_mirrored(shape):
    """Straight below the eye and the light R.L = 1; beside it R and L part by twice the angle of the normal to both."""
    stage = Stage(directional_light((0, 0, 1), 0.4))
    stage.sphere((0, 0, 0), 1.0, stage.material(diffuse=0.3, highlight=0.5, shine=20.0))
    camera = line_camera((0, 0, 2), (0, 0, -1), (0, 1, 0), 0.005)
    x = places(161, 0.005)
    cosine = np.sqrt(1.0 - x * x)
    shine = np.maximum(2.0 * cosine**2 - 1.0, 0.0) ** 20
    on = row_of(stage.scene(camera), shape, 161, highlights=True)
    off = row_of(stage.scene(camera), shape, 161, highlights=False)
    assert np.abs(on[:, 0] - 0.4 * (0.3 * cosine + 0.5 * shine)).max() < DIRECT
    assert np.abs(off[:, 0] - 0.4 * 0.3 * cosine).max() < DIRECT


# ---- shadows ----


@pytest.mark.parametrize("far", [False, True], ids=["lamp", "sun"])
def test_the_edge_of_a_shadow_is_where_the_line_from_the_light_over_the_edge_meets_the_floor(shape, far):
    """A screen at height 5 ends at x = 1. The lamp at height 10 over 0 throws its edge to x = 2; so does a sun along
    the direction (-1, 0, 5)."""
    stage = Stage(directional_light((-1, 0, 5), 1.0) if far else point_light((0, 0, 10), 1.0))
    grey = stage.material(diffuse=1.0)
    stage.level((-9, 9), (-9, 9), 0.0, grey)
    stage.level((-9, 1), (-9, 9), 5.0, grey)
    row = row_of(stage.scene(line_camera((2, 0, 1), (0, 0, -1), (0, 1, 0), 0.0005)), shape, 801)
    assert abs(edge(row, places(801, 0.0005))) < 0.0005
    assert row[0, 0] == 0.0
    assert row[-1, 0] > 0.9


def test_a_shadow_of_a_ball_on_the_floor_is_a_disc(shape):
    stage = Stage(directional_light((0, 0, 1), 1.0))
    stage.level((-2, 2), (-2, 2), 0.0, stage.material(diffuse=1.0))
    stage.sphere((0.1, 0.2, 1.0), 0.5, stage.material(diffuse=1.0))
    scene = stage.scene(orthographic_camera((0, 0, 0.3), (0, 0, 0), (0, 1, 0), 2.0))
    picture = rendered(scene, shape, size=(100, 100)).linear()[:, :, 0]
    x, y = grid(100, 100, 0.02)
    r = np.hypot(x - 0.1, y - 0.2)
    assert (picture[r < 0.4999] == 0.0).all()
    assert (picture[r > 0.5001] > 0.9999).all()


def test_glass_throws_a_shadow_like_anything_else(shape):
    stage = Stage(directional_light((0, 0, 1), 1.0))
    stage.level((-2, 2), (-2, 2), 0.0, stage.material(diffuse=1.0))
    stage.level((0, 2), (-2, 2), 1.0, stage.material(transmission=0.9, ior=1.5))
    row = row_of(stage.scene(line_camera((0, 0, 0.5), (0, 0, -1), (0, 1, 0), 0.01)), shape, 100)
    assert abs(edge(row, places(100, 0.01))) < 0.01


# ---- mirrors ----


def test_a_plane_mirror_shows_what_a_mirrored_eye_sees(shape):
    """The eye and its up are mirrored at z = 0; its picture comes out turned left to right."""
    weights = np.array([0.9, 0.6, 0.3])
    pictures = []
    for mirrored in (False, True):
        stage = Stage(directional_light((1, 1, 0), 1.0))
        stage.sphere((0.3, 0.0, 1.2), 0.7, stage.material(diffuse=[1.0, 0.5, 0.2]))
        if not mirrored:
            stage.level((-9, 9), (-9, 9), 0.0, stage.material(specular=weights))
        side = -1.0 if mirrored else 1.0
        camera = perspective_camera((0, -4, 2.0 * side), (0, -1, 0), (0, 0, side), 20.0)
        pictures.append(rendered(stage.scene(camera, (0.3, 0.6, 0.9)), shape, size=(80, 60)).linear())
    by_the_mirror, by_the_mirrored_eye = pictures[0], pictures[1][:, ::-1] * weights
    different = np.abs(by_the_mirror - by_the_mirrored_eye).max(axis=2)
    assert (different > BOUNCED).mean() < 0.001  # single pixels at the ball's rim
    assert np.ptp(by_the_mirror[:, :, 0]) > 0.5


@pytest.mark.parametrize("depth", [1, 2, 5, 31])
def test_two_facing_mirrors_add_up_to_the_depth(shape, depth):
    """Each hit is lit with 0.2 and passes 0.8 of the rest on: 0.2 (1 + 0.8 + ... + 0.8^(depth - 1)), no more."""
    stage = Stage(point_light((0, 0, 0), 1.0))
    mirror = stage.material(diffuse=0.2, specular=0.8)
    stage.level((-1, 1), (-1, 1), 1.0, mirror)
    stage.level((-1, 1), (-1, 1), -1.0, mirror)
    picture = rendered(
        stage.scene(line_camera((0, 0, 0.5), (0, 0, 1), (0, 1, 0), 0.001)), shape, size=(1, 1), depth=depth
    )
    expected = 0.2 * sum(0.8**k for k in range(depth))
    assert np.abs(picture.linear() - expected).max() < BOUNCED * expected
    born = picture.stats["total"]["born"]
    assert (born["primary"], born["reflected"], born["shadow"]) == (1, depth - 1, depth)


def test_faint_rays_are_not_born(shape):
    stage = Stage(point_light((0, 0, 0), 1.0))
    mirror = stage.material(diffuse=0.2, specular=0.5)
    stage.level((-1, 1), (-1, 1), 1.0, mirror)
    stage.level((-1, 1), (-1, 1), -1.0, mirror)
    scene = stage.scene(line_camera((0, 0, 0.5), (0, 0, 1), (0, 1, 0), 0.001))
    picture = rendered(scene, shape, size=(1, 1), depth=31, min_weight=0.1)
    assert picture.stats["total"]["born"]["reflected"] == 3  # of weights 1/2, 1/4 and 1/8


# ---- glass ----


def test_a_glass_slab_moves_what_is_behind_it_aside(shape):
    """By d sin a (1 - cos a / sqrt(n^2 - sin^2 a)) across the ray, for a slab d thick and rays at the angle a."""
    thick, ior, angle, pitch = 0.8, 1.5, math.radians(40.0), 0.0005
    ahead = np.array([math.sin(angle), 0.0, -math.cos(angle)])
    edges = []
    for slab in (False, True):
        stage = Stage(directional_light((1, 0, 0.2), 1.0))  # below the slab, which would throw a shadow
        stage.level((-6, 0), (-1, 1), -3.0, stage.material(diffuse=0.1))
        stage.level((0, 6), (-1, 1), -3.0, stage.material(diffuse=1.0))
        if slab:
            glass = stage.material(transmission=1.0, ior=ior)
            stage.level((-6, 3), (-1, 1), 0.0, glass)
            stage.polygon([(-6, -1, -thick), (-6, 1, -thick), (3, 1, -thick), (3, -1, -thick)], glass)
        eye = np.array([0.0, 0.0, -3.0]) - 4.5 * ahead
        row = row_of(stage.scene(line_camera(eye, ahead, (0, 1, 0), pitch)), shape, 1201)
        edges.append(edge(row, places(1201, pitch)))
    aside = thick * math.sin(angle) * (1.0 - math.cos(angle) / math.sqrt(ior**2 - math.sin(angle) ** 2))
    assert abs(edges[0]) <= pitch
    # The light is bent towards the normal, so it leaves lower, and the edge is seen by rays further up (to the right).
    assert abs(edges[1] - edges[0] - aside) <= 2.0 * pitch


def prism(ior, tint, light):
    """A right-angled prism seen straight through one leg: rays meet the long side at 45 degrees. A wall with the
    colour (0.2, 0.4, 0.8) faces the other leg; behind the long side there is nothing but the background."""
    stage = Stage(light)
    glass = stage.material(transmission=tint, ior=ior)
    wall = stage.material(diffuse=[0.2, 0.4, 0.8])
    stage.polygon([(0, -1, 0), (0, 1, 0), (0, 1, -1), (0, -1, -1)][::-1], glass)  # the leg x = 0, front to -x
    stage.polygon([(1, -1, -1), (0, -1, -1), (0, 1, -1), (1, 1, -1)], glass)  # the leg z = -1, front to -z
    stage.polygon([(0, -1, 0), (1, -1, -1), (1, 1, -1), (0, 1, 0)], glass)  # the long side, front to +x +z
    stage.level((-0.4, 1.4), (-1, 1), -2.0, wall)
    return stage


def test_total_reflection_turns_a_ray_without_loss(shape):
    """At 45 degrees glass of index 1.5 (limit 41.8) reflects all: the weight is T^2 for the two legs, not T^3.

    The light comes from the side of the wall, for the prism would keep it off.
    """
    stage = prism(1.5, [0.9, 0.8, 0.7], directional_light((0, 1, 0.05), 1.0))
    camera = line_camera((-0.5, 0, -0.5), (1, 0, 0), UP, 0.002)
    picture = rendered(stage.scene(camera, (9.0, 9.0, 9.0)), shape, size=(101, 1))
    cosine = 0.05 / math.hypot(1.0, 0.05)
    expected = cosine * np.array([0.2, 0.4, 0.8]) * np.array([0.9, 0.8, 0.7]) ** 2
    assert np.abs(picture.linear() - expected).max() < BOUNCED
    born = picture.stats["total"]["born"]
    assert (born["reflected"], born["refracted"]) == (101, 202)


def test_below_the_limit_of_total_reflection_a_ray_passes(shape):
    """At 45 degrees glass of index 1.3 (limit 50.3) lets the ray out, to the background."""
    stage = prism(1.3, 0.9, directional_light((0, 1, 0.05), 1.0))
    camera = line_camera((-0.5, 0, -0.5), (1, 0, 0), UP, 0.002)
    picture = rendered(stage.scene(camera, (0.5, 0.6, 0.7)), shape, size=(101, 1))
    assert np.abs(picture.linear() - 0.81 * np.array([0.5, 0.6, 0.7])).max() < BOUNCED
    assert picture.stats["total"]["born"]["reflected"] == 0


def test_a_glass_ball_turns_the_world_upside_down(shape):
    """Rays parallel to the axis of a ball of index 1.5 cross at most 1.5 radii from its middle."""
    stage = Stage(directional_light((-1, 3, 0), 1.0))
    stage.sphere((0, 0, 0), 1.0, stage.material(transmission=1.0, ior=1.5))
    for low, high, grey in ((-9.0, 0.0, 0.2), (0.0, 9.0, 0.9)):  # a wall at x = 6: dark below z = 0, bright above
        corners = [(6, -9, low), (6, -9, high), (6, 9, high), (6, 9, low)]
        stage.polygon(corners, stage.material(diffuse=grey))
    camera = line_camera((-2, 0, 0), (1, 0, 0), (0, 1, 0), 0.01)  # right is +z
    row = row_of(stage.scene(camera), shape, 190)
    z = places(190, 0.01)
    cosine = 1.0 / math.sqrt(10.0)
    clear = (np.abs(z) > 0.02) & (np.abs(z) < 0.93)  # at the rim the ray is turned so far that it misses the wall
    expected = np.where(z > 0.0, 0.2, 0.9) * cosine
    assert np.abs(row[clear, 0] - expected[clear]).max() < BOUNCED


# ---- cameras, the edge of the scene ----


def test_an_eye_inside_the_scene_sees_all_around(shape):
    """From the middle of a hollow ball with the light in the middle every cosine is 1."""
    for radius in (2.0, -2.0):  # two-sided, and inside only
        stage = Stage(point_light((0, 0, 0), 0.7))
        stage.sphere((0, 0, 0), radius, stage.material(diffuse=[1.0, 0.5, 0.25]))
        scene = stage.scene(perspective_camera((0, 0, 0), (1, 1, 1), UP, 120.0), (5.0, 5.0, 5.0))
        picture = rendered(scene, shape, size=(40, 40)).linear()
        assert np.abs(picture - 0.7 * np.array([1.0, 0.5, 0.25])).max() < DIRECT


def test_a_camera_that_looks_away_sees_the_background(shape):
    stage = Stage(directional_light((0, 0, 1), 1.0))
    stage.sphere((0, 0, 0), 1.0, stage.material(diffuse=1.0))
    scene = stage.scene(perspective_camera((0, -5, 0), (0, -6, 0), UP, 60.0), (0.25, 0.5, 0.75))
    picture = rendered(scene, shape, size=(40, 30))
    assert (picture.linear() == (0.25, 0.5, 0.75)).all()
    assert picture.stats["total"]["born"]["primary"] == 0


def test_a_perspective_camera_shows_a_square_where_its_angle_says(shape):
    """A square of half edge 1 at distance 4, in a view of 2 atan(1/2) from edge to edge: the middle half."""
    stage = Stage(directional_light((0, 0, 1), 1.0))
    stage.level((-1, 1), (-1, 1), 0.0, stage.material(diffuse=1.0))
    scene = stage.scene(perspective_camera((0, 0, 4), (0, 0, 0), (0, 1, 0), math.degrees(2.0 * math.atan(0.5))))
    picture = rendered(scene, shape, size=(64, 48)).linear()[:, :, 0] > 0.5
    assert picture.sum() == 24 * 24
    assert picture[12:36, 20:44].all()


@pytest.mark.parametrize("eye", [(0, 0, 0), (0, -30, 0)], ids=["eye inside the world", "eye outside the world"])
def test_rays_that_leave_the_scene_see_the_disc_of_a_light(shape, eye):
    """Whether they cross the world box, as from inside, or never enter it."""
    towards = np.array([0.1, 1.0, 0.2]) / math.sqrt(1.05)
    radius = math.radians(6.0)
    stage = Stage(directional_light(towards, 1.0, radius, [4.0, 3.0, 2.0]))
    stage.sphere((0, -1.0, -2.0), 0.5, stage.material(diffuse=1.0))
    stage.sphere((0, 1.0, 2.0), 0.001, stage.material(diffuse=1.0))
    ahead = np.add(eye, towards)
    scene = stage.scene(perspective_camera(eye, ahead, UP, 30.0), (0.1, 0.2, 0.3))
    picture = rendered(scene, shape, size=(90, 60)).linear()
    x, y = grid(90, 60, 2.0 * math.tan(math.radians(15.0)) / 60)
    angle = np.arctan(np.hypot(x, y))
    assert np.allclose(picture[angle < radius - 1e-4], (4.0, 3.0, 2.0), atol=1e-6, rtol=0.0)
    outside = picture[angle > radius + 1e-4]
    assert np.isclose(outside, (0.1, 0.2, 0.3), atol=1e-6, rtol=0.0).all(axis=1).mean() > 0.99  # but for the spheres


def test_a_mirror_shows_the_disc_of_a_light(shape):
    stage = Stage(directional_light((0, 0, 1), 1.0, math.radians(10.0), 3.0))
    stage.level((-5, 5), (-5, 5), 0.0, stage.material(specular=0.5))
    scene = stage.scene(perspective_camera((0, 0, 1), (0, 0, 0), (0, 1, 0), 40.0), (0.1, 0.1, 0.1))
    picture = rendered(scene, shape, size=(60, 60)).linear()[:, :, 0]
    angle = np.degrees(np.arctan(np.hypot(*grid(60, 60, 2.0 * math.tan(math.radians(20.0)) / 60))))
    assert np.abs(picture[angle < 9.99] - 1.5).max() < BOUNCED * 1.5
    assert np.abs(picture[angle > 10.01] - 0.05).max() < BOUNCED


def test_the_picture_of_many_samples_is_their_mean(shape):
    """The edge of a bright half plane through the middle of a pixel column lights about half of its samples."""
    stage = Stage(directional_light((0, 0, 1), 1.0))
    stage.level((0, 2), (-2, 2), 0.0, stage.material(diffuse=1.0))
    scene = stage.scene(orthographic_camera((0, 0, 1), (0, 0, 0), (0, 1, 0), 2.0))
    picture = rendered(scene, shape, size=(21, 20), samples=64).linear()[:, :, 0]
    assert (picture[:, :10] == 0.0).all()
    assert (picture[:, 11:] > 0.99999).all()
    assert np.abs(picture[:, 10] - 0.5).max() < 1.5 / 64
