"""Polygons: planes, flatness, convexity, and cutting into triangles, against areas and points known otherwise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raygrid.host.scene.polygons import (
    area_vectors,
    convex_polygons,
    flat_polygons,
    flat_triangles,
    planar_polygons,
    select_polygons,
    triangulate,
)

SQUARE = [(0, 0), (2, 0), (2, 2), (0, 2)]
ARROW = [(0, 0), (2, 1), (4, 0), (2, 4)]  # its second corner is dented inwards
EL = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
COMB = [(0, 0), (7, 0), (7, 3), (6, 3), (6, 1), (5, 1), (5, 3), (4, 3), (4, 1), (2, 1), (2, 3), (0, 3)]
STAR = [((1 + (k % 2)) * np.cos(k * np.pi / 5), (1 + (k % 2)) * np.sin(k * np.pi / 5)) for k in range(10)]
STRAIGHT = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)]  # corners in the middle of edges
PENTAGRAM = [(np.cos(4 * k * np.pi / 5), np.sin(4 * k * np.pi / 5)) for k in range(5)]
SIMPLE = {"square": SQUARE, "arrow": ARROW, "el": EL, "comb": COMB, "star": STAR, "straight": STRAIGHT}


def in_space(flat, seed=0):
    """A polygon of the plane, turned and shifted somewhere; its normal comes along."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    points = np.column_stack((np.array(flat, float), np.zeros(len(flat))))
    return points @ turn.T + rng.normal(size=3), turn[:, 2]


def joined(*polygons):
    starts = np.cumsum([0, *map(len, polygons)])
    return np.concatenate(polygons), starts


def area(flat):
    x, y = np.array(flat, float).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@pytest.mark.parametrize("name", SIMPLE)
@pytest.mark.parametrize("seed", range(4))
def test_triangles_cover_the_polygon_once_and_face_its_way(name, seed):
    flat = SIMPLE[name]
    points, normal = in_space(flat, seed)
    corners, owner, crossing = triangulate(points, np.array([0, len(points)]))
    assert crossing == 0
    assert (owner == 0).all()
    assert len(corners) == len(flat) - 2
    a, b, c = points[corners].transpose(1, 0, 2)
    doubled = np.cross(b - a, c - a) @ normal
    assert (doubled >= -1e-12).all()
    assert doubled.sum() / 2 == pytest.approx(area(flat))
    # No overlaps: random points of the plane lie in exactly as many triangles as in the polygon.
    rng = np.random.default_rng(seed)
    low, high = np.min(flat, 0), np.max(flat, 0)
    for x, y in rng.uniform(low, high, size=(60, 2)):
        inside = sum(_in_triangle((x, y), np.array(flat)[corner]) for corner in corners)
        assert inside == _even_odd((x, y), flat)


def _in_triangle(point, corners):
    u, v = np.roll(corners, -1, axis=0) - corners, point - corners
    sides = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return bool((sides > 0).all() or (sides < 0).all())


def _even_odd(point, flat):
    x, y = point
    odd = False
    for (ax, ay), (bx, by) in zip(flat, flat[1:] + flat[:1], strict=True):
        if (ay <= y) != (by <= y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            odd = not odd
    return odd


def test_area_vectors_of_many_polygons_at_once():
    made = [in_space(flat, seed) for seed, flat in enumerate(SIMPLE.values())]
    vectors = area_vectors(*joined(*[points for points, _ in made]))
    for vector, flat, (_, normal) in zip(vectors, SIMPLE.values(), made, strict=True):
        assert np.allclose(vector, 2 * area(flat) * normal)


def test_convexity():
    made = joined(*[in_space(flat, 5)[0] for flat in (SQUARE, ARROW, EL, STRAIGHT, PENTAGRAM, SQUARE[:3], STAR)])
    assert convex_polygons(*made).tolist() == [True, False, False, True, False, True, False]


def test_backwards_polygons_are_as_convex_and_keep_their_own_front():
    points, normal = in_space(SQUARE[::-1], 2)
    assert convex_polygons(points, np.array([0, 4])).all()
    corners, _, _ = triangulate(points, np.array([0, 4]))
    a, b, c = points[corners].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a) @ normal < 0).all()


def test_planarity_is_measured_against_extent_and_place():
    points = in_space(EL, 1)[0]
    bent = points.copy()
    bent[2] += 1e-5
    far = points + 1e6
    rounded = np.array([float(f"{x:.6g}") for x in bent.ravel()]).reshape(-1, 3)
    assert planar_polygons(*joined(points, bent, far, rounded)).tolist() == [True, False, True, False]


def test_polygons_without_area():
    line, spot = np.array([[0.0, 0, 0], [1, 1, 1], [3, 3, 3], [2, 2, 2]]), np.ones((5, 3))
    assert flat_polygons(*joined(line, in_space(SQUARE)[0], spot)).tolist() == [True, False, True]
    thin = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [1, 1, 1], [2, 2, 2]], np.zeros((3, 3))])
    assert flat_triangles(thin).tolist() == [False, True, True]


def test_a_crossing_polygon_is_cut_by_guess_and_counted():
    bow_tie = np.array([[0.0, 0, 0], [2, 2, 0], [2, 0, 0], [0, 3, 0]])
    corners, owner, crossing = triangulate(*joined(bow_tie, in_space(SQUARE)[0]))
    assert crossing == 1
    assert owner.tolist() == [0, 0, 1, 1]
    assert sorted(set(corners[:2].ravel())) == [0, 1, 2, 3]
    assert triangulate(*joined(in_space(PENTAGRAM)[0]))[0].shape == (3, 3)


def test_nothing_in_nothing_out():
    none, start = np.zeros((0, 3)), np.array([0])
    corners, owner, crossing = triangulate(none, start)
    assert (corners.shape, len(owner), crossing) == ((0, 3), 0, 0)
    assert not len(flat_polygons(none, start))
    assert not len(planar_polygons(none, start))


def test_selection():
    points, starts = joined(*[in_space(flat)[0] for flat in (SQUARE, EL, ARROW)])
    chosen, begins = select_polygons(points, starts, np.array([True, False, True]))
    assert begins.tolist() == [0, 4, 8]
    assert np.array_equal(chosen, points[[0, 1, 2, 3, 10, 11, 12, 13]])


@given(st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(-10, 10)), min_size=3, max_size=9))
def test_any_points_give_two_triangles_less_than_corners(points):
    corners, _, _ = triangulate(np.array(points), np.array([0, len(points)]))
    assert corners.shape == (len(points) - 2, 3)
    assert set(corners.ravel()) == set(range(len(points)))
