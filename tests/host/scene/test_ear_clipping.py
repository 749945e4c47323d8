"""Polygons of many corners: cut by a library where that loses nothing, else as those of few."""

from __future__ import annotations

import numpy as np
import pytest

from raygrid.host.scene import ear_clipping
from raygrid.host.scene.ear_clipping import MANY, clip_ears, clip_many


def star(many, inner=0.4, seed=3):
    """A star whose points are not all as long."""
    angles = np.arange(many) * (2.0 * np.pi / many)
    lengths = np.where(np.arange(many) % 2, inner, np.random.default_rng(seed).uniform(0.7, 1.0, many))
    return np.stack((lengths * np.cos(angles), lengths * np.sin(angles)), axis=1)


def doubled_area(plane):
    x, y = plane.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def doubled(plane, ears):
    a, b, c = (plane[ears[:, k]] for k in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def check(plane, ears):
    """They use every corner, turn left, and have the area of the polygon: so they do not overlap."""
    assert ears.shape == (len(plane) - 2, 3)
    assert ears.dtype == np.int64
    assert set(ears.ravel().tolist()) == set(range(len(plane)))
    areas = doubled(plane, ears)
    assert areas.min() >= -1e-12
    assert areas.sum() == pytest.approx(doubled_area(plane), rel=1e-9)


@pytest.mark.parametrize("many", [MANY - 2, MANY, 1000])
def test_a_polygon_comes_apart_into_ears(many):
    plane = star(many)
    ears, clean = clip_ears(plane, doubled_area(plane))
    assert clean
    check(plane, ears)


def test_few_corners_are_cut_as_ever(monkeypatch):
    plane = star(MANY - 2)
    expected = clip_ears(plane, doubled_area(plane))[0]
    monkeypatch.setattr(ear_clipping, "clip_many", lambda *_: pytest.fail("not for so few"))
    np.testing.assert_array_equal(clip_ears(plane, doubled_area(plane))[0], expected)


def test_vertices_in_a_line_are_kept():
    """They may be corners of a neighbour; a polygon that was bent is not even straight there."""
    corners = star(MANY)
    plane = np.stack((corners, (corners + np.roll(corners, -1, axis=0)) / 2.0), axis=1).reshape(-1, 2)
    ears, clean = clip_ears(plane, doubled_area(plane))
    assert clean
    check(plane, ears)


def test_a_bridge_to_a_hole_may_visit_its_ends_twice():
    angles = np.linspace(0.0, 2.0 * np.pi, MANY + 1)
    outer = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    outer[-1] = outer[0]
    plane = np.concatenate((outer, 0.5 * outer[::-1]))
    ears, clean = clip_ears(plane, doubled_area(plane))
    assert clean
    check(plane, ears)


def test_what_leaves_out_a_vertex_is_not_taken():
    plane = np.concatenate((star(MANY), star(MANY)[-1:]))
    assert clip_many(plane, doubled_area(plane)) is None
    ears, clean = clip_ears(plane, doubled_area(plane))
    assert clean
    check(plane, ears)


def test_a_polygon_that_crosses_itself_is_still_told():
    plane = star(MANY)
    plane[[10, 31]] = plane[[31, 10]]
    area = abs(doubled_area(plane))
    assert clip_many(plane, area) is None
    ears, clean = clip_ears(plane, area)
    assert not clean
    assert ears.shape == (MANY - 2, 3)


def test_any_unit_of_length_will_do():
    for scale in (1e-20, 1e20):
        plane = star(200) * scale
        ears = clip_many(plane, doubled_area(plane))
        assert ears is not None
        np.testing.assert_array_equal(ears, clip_many(star(200), doubled_area(star(200))))


def test_it_is_clockwise_in_no_case():
    plane = star(200)
    assert (doubled(plane, clip_many(plane, doubled_area(plane))) > 0.0).all()
