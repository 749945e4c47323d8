"""Cameras: the table against the formulas of the formats, framing, and what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raygrid.host.scene.cameras import (
    Span,
    look_at_everything,
    nearest_axis,
    nff_camera,
    orthographic_camera,
    perspective_camera,
)
from raygrid.node.errors import SceneError

coordinates = st.floats(-100, 100).map(lambda x: round(x, 3))
points = st.tuples(coordinates, coordinates, coordinates)


def rays(camera, width, height, i, j):
    """Origin and direction through the image point (i, j), by the table."""
    row = camera.table(width, height)[0]
    return row["eye"] + i * row["eye_di"] + j * row["eye_dj"], row["base"] + i * row["base_di"] + j * row["base_dj"]


def nff_direction(eye, at, up, angle, width, height, i, j):
    """Straight from the format's text."""
    eye, at, up = (np.array(v, float) for v in (eye, at, up))
    forward = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    above = np.cross(right, forward)
    t = math.tan(math.radians(angle) / 2)
    across = t * (width - 1) / (height - 1)
    return forward + across * (2 * i / (width - 1) - 1) * right + t * (1 - 2 * j / (height - 1)) * above


@pytest.mark.parametrize(("width", "height"), [(512, 512), (5, 5), (64, 48), (3, 200), (2, 2)])
def test_nff_rays_are_those_of_the_formula(width, height):
    view = ((2.1, 1.3, 1.7), (0, 0, 0), (0, 0, 1), 45)
    camera = nff_camera(*view)
    for i, j in ((0, 0), (width - 1, 0), (0, height - 1), (width // 2, height // 3)):
        origin, direction = rays(camera, width, height, i, j)
        assert np.allclose(origin, view[0], rtol=0, atol=0)
        assert np.allclose(direction, nff_direction(*view, width, height, i, j), rtol=0, atol=1e-14)


@given(eye=points, at=points, up=points, angle=st.floats(1, 179))
def test_nff_formula_over_wild_views(eye, at, up, angle):
    try:
        camera = nff_camera(eye, at, up, angle)
    except SceneError:
        view = np.subtract(at, eye)
        length = np.linalg.norm(view) * np.linalg.norm(up)
        assert length == 0 or np.linalg.norm(np.cross(view, up)) <= 1e-8 * length
        return
    _, direction = rays(camera, 7, 5, 2, 4)
    assert np.allclose(direction, nff_direction(eye, at, up, angle, 7, 5, 2, 4), rtol=1e-7, atol=1e-7)


def test_nff_pictures_of_one_row_column_or_pixel_look_straight_ahead_along_it():
    camera = nff_camera((0, 0, 0), (0, 0, -1), (0, 1, 0), 90)
    assert np.allclose(rays(camera, 1, 1, 0, 0)[1], (0, 0, -1))
    assert np.allclose(rays(camera, 1, 3, 0, 0)[1], (0, 1, -1))
    assert np.allclose(rays(camera, 3, 1, 0, 0)[1], (-1, 0, -1))
    assert np.allclose(rays(camera, 3, 1, 2, 0)[1], (1, 0, -1))


def test_perspective_angles_reach_from_edge_to_edge():
    camera = perspective_camera((1, 2, 3), (1, 2, -7), (0, 5, 1), 90)
    width, height = 40, 20
    origin, direction = rays(camera, width, height, -0.5, -0.5)  # the picture's upper left corner
    assert np.allclose(origin, (1, 2, 3))
    assert np.allclose(direction, (-2, 1, -1))
    assert np.allclose(rays(camera, width, height, width - 0.5, height - 0.5)[1], (2, -1, -1))


def test_orthographic_rays_are_parallel_and_start_in_a_window():
    camera = orthographic_camera((0, 0, 5), (0, 0, 0), (0, 1, 0), 6)
    origin, direction = rays(camera, 20, 10, -0.5, -0.5)
    assert np.allclose(origin, (-6, 3, 5))
    assert np.allclose(direction, (0, 0, -1))
    origin, direction = rays(camera, 20, 10, 9.5, 4.5)
    assert np.allclose(origin, (0, 0, 5))
    assert np.allclose(direction, (0, 0, -1))


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
@pytest.mark.parametrize("size", [(300, 200), (200, 300), (64, 64)])
@given(low=points, edges=points.map(np.abs))
def test_looking_at_everything_has_all_corners_in_the_picture(up, size, low, edges):
    box = np.array((low, np.add(low, edges)))
    camera = look_at_everything(box, up)
    assert camera.span is Span.NARROW
    pitch = camera.pitch(*size)
    axes = np.array((camera.right, camera.up, camera.forward))
    for corner in np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3):
        x, y, z = axes @ (corner - camera.eye)
        assert z > 0
        assert abs(x / z) <= pitch * size[0] / 2 + 1e-9
        assert abs(y / z) <= pitch * size[1] / 2 + 1e-9
    assert camera.up @ np.array(up) > 0.8


def test_the_whole_box_nearly_fills_the_picture():
    camera = look_at_everything(np.array([[-1.0, -1, -1], [1, 1, 1]]))
    corners = np.stack(np.meshgrid(*[(-1, 1)] * 3), axis=-1).reshape(-1, 3)
    x, y, z = np.array((camera.right, camera.up, camera.forward)) @ (corners - camera.eye).T
    assert 0.85 < max(np.abs(x / z).max(), np.abs(y / z).max()) / camera.half <= 1


@pytest.mark.parametrize("make", [nff_camera, perspective_camera, orthographic_camera])
def test_degenerate_views_are_refused(make):
    with pytest.raises(SceneError, match=r"looks from \(1, 2, 3\) at that same point"):
        make((1, 2, 3), (1, 2, 3), (0, 0, 1), 45)
    with pytest.raises(SceneError, match=r"up \(0, 0, -2\) is parallel to its view"):
        make((0, 0, 5), (0, 0, 1), (0, 0, -2), 45)
    with pytest.raises(SceneError, match=r"up \(0, 0, 0\) is parallel"):
        make((0, 0, 5), (0, 0, 1), (0, 0, 0), 45)
    with pytest.raises(SceneError, match="not finite"):
        make((0, 0, math.nan), (0, 0, 1), (0, 1, 0), 45)
    with pytest.raises(SceneError, match="not finite"):
        make((0, 0, 1), (0, math.inf, 1), (0, 1, 0), 45)


@pytest.mark.parametrize("angle", [0, -10, 180, 200, math.nan, math.inf])
def test_impossible_angles_are_refused(angle):
    for make in (nff_camera, perspective_camera):
        with pytest.raises(SceneError, match=r"the camera's angle is .* wanted more than 0 and less than 180"):
            make((0, 0, 5), (0, 0, 1), (0, 1, 0), angle)


@pytest.mark.parametrize("height", [0, -1, math.nan, math.inf])
def test_impossible_heights_are_refused(height):
    with pytest.raises(SceneError, match=r"the camera's view is .* high"):
        orthographic_camera((0, 0, 5), (0, 0, 1), (0, 1, 0), height)


def test_a_picture_must_have_pixels():
    with pytest.raises(SceneError, match="the picture is 0 x 5 pixels"):
        nff_camera((0, 0, 5), (0, 0, 1), (0, 1, 0), 45).table(0, 5)


@pytest.mark.parametrize(
    ("up", "axis"), [((0.0, 0.1, 0.0), (0, 1, 0)), ((0.5, 0.2, -0.6), (0, 0, -1)), ((-9.0, 2.0, 8.0), (-1, 0, 0))]
)
def test_the_axis_nearest_to_what_is_up(up, axis):
    assert nearest_axis(up).tolist() == list(axis)
