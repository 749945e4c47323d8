"""One packet, one node, answers known by hand: rays spawned at a hit, shadows, returns, edges and ways."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from support.frames import directional_light, make_frame, material, point_light
from support.one import FRONT, SIZE_OF_PICTURE, Vector, lattice, place, ray, returning, serve, shadow
from support.packets import pixel_bytes
from support.surfaces import F64

from raygrid.node.geometry.grid_walk import HOST, SELF, SELF_RAYS
from raygrid.node.geometry.lattice import HALF, LIFT, T_MIN
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.protocol import packets
from raygrid.node.protocol.counters import BORN, DIED, HITS, MISADDRESSED, WALKS
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.protocol.packets import PRIMARY, REFLECTED, REFRACTED, RETURN, SHADOW

STEP = 2.0**-24
CODE = 4.25 * 2.0**-24  # most that a direction is off
X, Y, Z = np.eye(3)
FLOOR = (Kind.POLYGON, [[-0.4, -0.4, 0.0], [0.4, -0.4, 0.0], [0.4, 0.4, 0.0], [-0.4, 0.4, 0.0]], 0)  # front side up
TRIANGLE = (Kind.TRIANGLE, [-0.4, -0.4, 0.0, 0.4, -0.4, 0.0, 0.0, 0.4, 0.0], 0)
SMOOTH = (Kind.SMOOTH, [*TRIANGLE[1], 0, 0, 1, 0.6, 0, 0.8, 0, 0.6, 0.8], 0)
BALL = (Kind.SPHERE, [0.0, 0.0, 0.0, 0.25], 0)
CAN = (Kind.CYLINDER, [0.0, 0.0, -0.3, 0.25, 0.0, 0.0, 0.3, 0.25], 0)
HAT = (Kind.CONE, [0.0, 0.0, -0.25, 0.5, 0.0, 0.0, 0.25, 0.0], 0)


def unit(v: Vector) -> F64:
    return np.array(v, float) / np.linalg.norm(v)


LOOKS = ("diffuse", "highlight", "shine", "specular", "transmission", "ior")


def frame_of(*lights: np.ndarray, **facts: Any) -> Frame:
    """A frame with these lights, and one material of these looks."""
    look = {name: facts.pop(name) for name in LOOKS if name in facts}
    return make_frame(FRONT, SIZE_OF_PICTURE, materials=[material(**look)], lights=lights, **facts)


# --- a hit --------------------------------------------------------------------------------------------------

HITS_AT = [  # surface, origin, direction, point, outward normal
    (FLOOR, [0.1, 0.05, 0.3], -Z, [0.1, 0.05, 0], Z),
    (FLOOR, [0.2, 0.0, 0.2], [-1, 0, -1], [0, 0, 0], Z),
    (FLOOR, [0.2, 0.0, -0.2], [-1, 0, 1], [0, 0, 0], Z),
    (TRIANGLE, [0.2, -0.1, 0.2], [-1, 0, -1], [0, -0.1, 0], Z),
    (BALL, [-0.4, 0.0, 0.0], X, [-0.25, 0, 0], -X),
    (BALL, [-0.4, 0.15, 0.0], X, [-0.2, 0.15, 0], [-0.8, 0.6, 0]),
    (BALL, [0.0, 0.0, 0.0], Y, [0, 0.25, 0], Y),
    (CAN, [-0.4, 0.15, 0.1], X, [-0.2, 0.15, 0.1], [-0.8, 0.6, 0]),
    (CAN, [0.0, 0.0, 0.1], [0, 1, 0.5], [0, 0.25, 0.225], Y),
    (HAT, [-0.4, 0.0, 0.0], X, [-0.25, 0, 0], [-1, 0, 1]),
]


@pytest.mark.parametrize(("surface", "origin", "direction", "point", "normal"), HITS_AT)
def test_reflection(surface, origin, direction, point, normal):
    """R = D - 2 (D.N) N, from a point lifted along R off the side that the ray came from, with weight times specular."""
    frame = frame_of(specular=(0.5, 0.25, 1.0), depth=3)
    served = serve(ray(origin, direction, depth=2, sample=7, weight=(1.0, 0.5, 0.25)), [surface], frame)
    born = served.only(SELF_RAYS, REFLECTED)
    d, n = unit(direction), unit(normal)
    np.testing.assert_allclose(born.direction, d - 2 * (d @ n) * n, rtol=0, atol=3 * CODE)
    side = n if d @ n < 0 else -n
    lifted = place(born.origin) - point
    assert lifted @ side == pytest.approx(LIFT, abs=3 * STEP)
    assert lifted @ side > 0, "born behind the surface"
    assert np.linalg.norm(np.cross(lifted, born.direction)) <= 3 * STEP
    assert (born.depth, born.number) == (3, 7)
    assert born.values == pytest.approx((0.5, 0.125, 0.25), rel=1 / 2047)
    assert served.number(SHADOW) == served.number(REFRACTED) == 0
    assert (served.counts[HITS], served.counts[DIED + PRIMARY], served.counts[BORN + REFLECTED]) == (1, 1, 1)


@pytest.mark.parametrize("ior", [1.0, 1.5, 0.7, 2.4])
@pytest.mark.parametrize("angle", [0.0, 10.0, 35.0, 44.0])
@pytest.mark.parametrize("below", [False, True])
def test_refraction_obeys_snell(ior, angle, below):
    """sin i / sin r = n2 / n1; total internal reflection beyond the critical angle, with the whole weight."""
    sine, down = math.sin(math.radians(angle)), 1.0 if below else -1.0
    way = np.array([sine, 0.0, down * math.cos(math.radians(angle))])
    frame = frame_of(transmission=(0.5, 1.0, 0.5), ior=ior)
    served = serve(ray(-0.2 * way, way, weight=(1, 0.5, 0.25)), [FLOOR], frame)
    bent = sine * (ior if below else 1.0 / ior)
    if bent > 1.0:
        born = served.only(SELF_RAYS, REFLECTED)
        expected, weight, side = way * [1, 1, -1], (1.0, 0.5, 0.25), -down
        assert served.number(REFRACTED) == 0
    else:
        born = served.only(SELF_RAYS, REFRACTED)
        expected, weight, side = np.array([bent, 0.0, down * math.sqrt(1.0 - bent * bent)]), (0.5, 0.5, 0.125), down
        assert served.number(REFLECTED) == 0
    # near the critical angle the direction is off by much more than the code of the ray that came
    np.testing.assert_allclose(born.direction, expected, rtol=0, atol=20 * CODE)
    assert born.values == pytest.approx(weight, rel=1 / 2047)
    assert place(born.origin)[2] * side == pytest.approx(LIFT, abs=2 * STEP)
    assert born.depth == 2


def test_a_hit_of_the_deepest_rays_bears_shadows_only():
    frame = frame_of(point_light([0, 0, 0.4]), diffuse=1.0, specular=1.0, transmission=1.0, ior=1.0, depth=3)
    served = serve(ray([0, 0, 0.2], -Z, depth=3), [FLOOR], frame)
    assert list(served.out) == [SELF]
    assert served.number(SHADOW) == 1
    assert served.only(SELF, SHADOW).depth == 3
    served = serve(ray([0, 0, 0.2], -Z, depth=2), [FLOOR], frame)
    assert [served.number(kind) for kind in (SHADOW, REFLECTED, REFRACTED)] == [1, 1, 1]


def test_rays_that_are_too_faint_are_not_born():
    frame = frame_of(specular=(0.25, 0.125, 0.0), transmission=0.125, ior=1.0, min_weight=0.2)
    served = serve(ray([0, 0, 0.2], -Z), [FLOOR], frame)
    assert (served.number(REFLECTED), served.number(REFRACTED)) == (1, 0)
    assert serve(ray([0, 0, 0.2], -Z, weight=(0.7, 1, 1)), [FLOOR], frame).out == {}


# --- light --------------------------------------------------------------------------------------------------


def test_shadow_rays_carry_what_they_will_add():
    """w I (diffuse N.L + highlight (R.L)^shine), for each light that faces the surface."""
    lights = [
        directional_light([0, 3, 4], (1.0, 0.5, 0.25)),
        directional_light([0, 0, -1]),  # behind
        directional_light([1, 0, 0]),  # along the surface
        point_light([0.3, 0.0, 0.4], (2.0, 2.0, 2.0)),
    ]
    frame = frame_of(*lights, diffuse=(0.5, 0.25, 1.0), highlight=(0.5, 0.0, 0.25), shine=3.0)
    served = serve(ray([0, 0, 0.2], -Z, weight=(1.0, 0.5, 1.0)), [FLOOR], frame)
    first, second = served.out[SELF]
    assert (first.light, second.light) == (0, 3)
    for born, intensity in ((first, (1.0, 0.5, 0.25)), (second, (2.0, 2.0, 2.0))):
        seen = 0.8 * np.array([0.5, 0.25, 1.0]) + 0.512 * np.array([0.5, 0.0, 0.25])  # N.L = R.L = 4/5, as R = N
        expected = np.array([1.0, 0.5, 1.0]) * intensity * seen
        assert born.values == pytest.approx(expected, rel=1e-5)
        lifted, to_light = place(born.origin), np.array([0, 0.6, 0.8]) if born is first else np.array([0.6, 0, 0.8])
        assert lifted[2] == pytest.approx(LIFT, abs=2 * STEP)
        assert np.linalg.norm(np.cross(lifted, to_light)) <= STEP


def test_light_from_below_lights_the_underside():
    frame = frame_of(directional_light(-Z), directional_light(Z), diffuse=1.0)
    served = serve(ray([0, 0, -0.2], Z), [FLOOR], frame)
    (born,) = served.out[SELF]
    assert (born.light, born.values) == (0, (1.0, 1.0, 1.0))
    assert place(born.origin)[2] == pytest.approx(-LIFT, abs=STEP)


def test_smooth_triangles_are_lit_by_their_interpolated_normal():
    corners, normals = np.array(SMOOTH[1]).reshape(2, 3, 3)
    frame = frame_of(directional_light(Z), diffuse=1.0, specular=1.0)
    for weights in ([0.998, 0.001, 0.001], [0.2, 0.5, 0.3], [0.1, 0.1, 0.8]):
        normal = unit(np.array(weights) @ normals)
        served = serve(ray(np.array(weights) @ corners + 0.2 * Z, -Z), [SMOOTH], frame)
        assert served.only(SELF, SHADOW).values[0] == pytest.approx(normal[2], rel=1e-5)
        mirrored = served.only(SELF_RAYS, REFLECTED).direction
        np.testing.assert_allclose(mirrored, -Z + 2 * normal[2] * normal, rtol=0, atol=1e-6)


HALF_LIT = ((0.4 / 0.2**0.5 - 0.8) / 0.15) ** 2


@pytest.mark.parametrize(("at", "fade"), [(0.0, 1.0), (0.1, 1.0), (0.2, HALF_LIT), (0.4, 0.0)])
def test_spots_and_falloff(at, fade):
    """Full inside cos 0.95, none outside cos 0.8, between them the square of the part (KHR_lights_punctual)."""
    spot = point_light([0, 0, 0.4], 1.0, spot=1, axis=-Z, cos_inner=0.95, cos_outer=0.8, falloff=1)
    served = serve(ray([at, 0, 0.2], -Z), [FLOOR], frame_of(spot, diffuse=1.0))
    squared = at * at + 0.16
    expected = fade * 0.4 / math.sqrt(squared) / squared
    assert served.only(SELF, SHADOW).values[0] == pytest.approx(expected, rel=1e-4)


# --- shadow rays --------------------------------------------------------------------------------------------

POINT = point_light([0, 0, 0.4])
SHADOWS = {  # surfaces, light, origin, whether it arrives
    "nothing in the way": ([], POINT, [0, 0, -0.2], True),
    "a surface in the way": ([FLOOR], POINT, [0, 0, -0.2], False),
    "a surface from its other side": ([FLOOR], point_light([0, 0, -0.4]), [0, 0, 0.2], False),
    "a surface behind the light": ([FLOOR], point_light([0, 0, -0.1]), [0, 0, -0.2], True),
    "a surface behind the origin": ([FLOOR], POINT, [0, 0, 0.2], True),
    "a surface under the origin": ([FLOOR], POINT, [0, 0, 0.5 * T_MIN], True),
    "to infinity": ([], directional_light(Z), [0, 0, -0.2], True),
    "to infinity, blocked": ([FLOOR], directional_light([1, 1, 1]), [0, 0, -0.2], False),
    "a light outside": ([FLOOR], point_light([0, 0, 9]), [0, 0, 0.2], True),
    "at the light itself": ([FLOOR], POINT, [0, 0, 0.4], True),
}


@pytest.mark.parametrize("case", SHADOWS)
def test_shadow_rays(case):
    surfaces, light, origin, arrives = SHADOWS[case]
    served = serve(shadow(origin, sample=42), surfaces, frame_of(light))
    assert served.out == {}  # one node is home to all
    np.testing.assert_array_equal(served.sums[42], np.array([0.5, 0.25, 1.0]) * 2**24 * arrives)
    assert served.counts[DIED + SHADOW] == 1
    assert served.counts[BORN + RETURN] == served.counts[DIED + RETURN] == arrives


def test_a_shadow_ray_returns_from_the_cell_of_its_light_and_not_before():
    frame = frame_of(point_light([0.3, 0.3, 0.1]))
    onward = serve(shadow([-0.3, 0.3, 0.1]), [], frame, shape="2x2x2", index=(0, 1, 1))
    assert onward.only(1, SHADOW).origin == lattice([-0.3, 0.3, 0.1])
    arrived = serve(shadow([-0.3, 0.3, 0.1]), [], frame, shape="2x2x2", index=(1, 1, 1), port=0)
    # sample 0 enters at the top left of the front: home (0, 1, 1)
    assert arrived.only(0, RETURN).home == (0, 1, 1)
    assert arrived.only(0, RETURN).values == (0.5, 0.25, 1.0)


# --- the edge of the scene ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [PRIMARY, REFLECTED, REFRACTED])
def test_what_leaves_the_scene_brings_the_background(kind):
    frame = frame_of(background=(0.5, 0.0, 0.25))
    served = serve(ray([0, 0, 0], [1, 2, 3], kind=kind, sample=3, weight=(1, 1, 0.5)), [], frame)
    np.testing.assert_array_equal(served.sums[3], np.array([0.5, 0.0, 0.125]) * 2**24)
    assert served.counts[DIED + kind] == served.counts[DIED + RETURN] == served.counts[BORN + RETURN] == 1
    black = serve(ray([0, 0, 0], [1, 2, 3], kind=kind), [], frame_of())
    assert black.counts[DIED + kind] == 1
    assert black.counts[BORN + RETURN] == 0


@pytest.mark.parametrize(("direction", "seen"), [(X, True), ([1, 0.1, 0], True), ([1, 0.3, 0], False), (-X, False)])
def test_a_light_that_can_be_seen(direction, seen):
    sun = directional_light(X, cos_disc=0.98, disc=(2.0, 3.0, 4.0))
    served = serve(ray([0, 0, 0], direction), [], frame_of(sun, POINT, background=(0.5, 0.5, 0.5)))
    np.testing.assert_array_equal(served.sums[0], np.array((2.0, 3.0, 4.0) if seen else (0.5, 0.5, 0.5)) * 2**24)


def test_what_is_too_bright_for_a_packet_comes_home_as_the_brightest():
    """Of a scene that the front end takes: the product of its brightest background and a mirror above 1."""
    frame, data = frame_of(background=(1e30, 0.5, 0.0)), ray([0.2, 0, 0], X, kind=REFLECTED, weight=(1e10, 1e10, 0.0))
    sent = serve(data, [], frame, shape="2x2x2", index=(1, 1, 1)).only(0, RETURN)
    assert sent.values == (float(np.finfo(np.float32).max), pytest.approx(5e9, rel=1 / 2047), 0.0)
    kept = serve(returning((0, 1, 1), intensity=sent.values), [], frame, shape="2x2x2", index=(0, 1, 1))
    np.testing.assert_array_equal(kept.sums, serve(data, [], frame).sums)


# --- ways ---------------------------------------------------------------------------------------------------


def test_rays_go_to_their_start_first_and_then_walk():
    """A ray born in the cell diagonally beside the one of its origin, and what the nodes on its way make of it."""
    data, surfaces = ray([-0.1, -0.1, -0.1], [1, 0.5, 0.25]), [(Kind.SPHERE, [0.25, 0.05, 0.0, 0.05], 0)]
    for index, port, onward in (((1, 1, 1), SELF, 0), ((0, 1, 1), 1, 2), ((0, 0, 1), 3, 4)):
        served = serve(data, surfaces, port=port, shape="2x2x2", index=index)
        assert list(served.out) == [onward]
        assert served.counts[WALKS] == 0
    start = serve(data, surfaces, port=5, shape="2x2x2", index=(0, 0, 0))
    assert (list(start.out), start.counts[WALKS]) == ([1], 1)
    assert serve(data, surfaces, port=0, shape="2x2x2", index=(1, 0, 0)).counts[WALKS] == 1


def test_a_hit_belongs_to_the_cell_that_holds_it():
    """The same ray and surfaces: cells before and behind the hit hand on, the cell of the hit shades."""
    surfaces, data = [BALL], ray([-0.45, 0.2, 0.1], X)  # hit at x = -0.11
    for shape, y, z in (("2x2x2", 1, 1), ("4x3x1", 2, 0), ("8x8x8", 5, 4)):
        cells = int(shape[0])
        for x in range(cells):
            served = serve(data, surfaces, port=0 if x else SELF, shape=shape, index=(x, y, z))
            if x <= (-0.11 + 0.5) * cells:  # it comes no farther
                assert served.counts[HITS] == (x == int((-0.11 + 0.5) * cells))


def test_returns_go_along_x_then_y_then_z_and_are_kept_at_home():
    for index, output in (((2, 2, 2), 0), ((0, 2, 2), 2), ((0, 0, 2), 4)):
        served = serve(returning((0, 0, 0), sample=99), shape="3x3x3", index=index)
        assert served.only(output, RETURN).home == (0, 0, 0)
    for index, output in (((0, 0, 0), 1), ((2, 0, 0), 3), ((2, 2, 0), 5)):
        assert list(serve(returning((2, 2, 2)), shape="3x3x3", index=index).out) == [output]
    # sample 99 enters at the bottom right of the front
    kept = serve(returning((1, 0, 1), sample=99), shape="2x2x2", index=(1, 0, 1))
    np.testing.assert_array_equal(kept.sums[99], np.array([0.5, 0.25, 1.0]) * 2**24)
    assert (kept.counts[DIED + RETURN], kept.counts[MISADDRESSED]) == (1, 0)


def test_a_return_for_a_pixel_that_is_not_held_dies_and_is_counted():
    lost = serve(returning((0, 0, 0), sample=99), shape="2x2x2", index=(0, 0, 0))
    assert (lost.counts[DIED + RETURN], lost.counts[MISADDRESSED]) == (1, 1)
    assert not lost.sums.any()


def test_pixels_go_to_the_nearest_corner():
    data = pixel_bytes(42, (1, 2, 3), 4)
    ways = {(0, 0, 0): HOST, (4, 4, 4): HOST, (4, 0, 4): HOST}
    ways |= {(1, 4, 4): 0, (3, 0, 0): 1, (2, 2, 2): 0, (0, 3, 1): 3, (4, 4, 1): 4}
    for index, output in ways.items():
        served = serve(data, shape="5x5x5", index=index)
        assert served.only(output, packets.PIXEL).values == (1, 2, 3)
        assert served.counts[DIED + packets.PIXEL] == (output == HOST)


def test_a_surface_nearer_than_t_min_is_not_met():
    """Against re-hits, in every cell: a ray that starts on a surface does not meet it at once."""
    origin = [0.1, 0.1, T_MIN / 2]
    assert serve(ray(origin, -Z), [FLOOR]).counts[HITS] == 0
    assert serve(ray([0.1, 0.1, 2 * T_MIN], -Z), [FLOOR]).counts[HITS] == 1
    assert lattice(origin)[2] == HALF + 1
