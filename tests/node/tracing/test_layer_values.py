"""What a layer says of a hit, and how it is read from the sums of pixels again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady
from support.frames import make_frame, orthographic, perspective

from raygrid.node.geometry.surfaces import MAX_MATERIALS, MAX_SURFACES
from raygrid.node.protocol.frame_tables import LAYER_DEPTH, LAYER_NORMAL, LAYER_SURFACE
from raygrid.node.tracing.framebuffer import fixed_point
from raygrid.node.tracing.layer_values import layer_values, read_distances, read_normals, read_surfaces

SIZE = (8, 6)
CAMERA = perspective((0.1, 0.2, 3.0), (0.0, 0.0, -1.0), 40.0, SIZE)
NOTHING = np.zeros((1, 3), np.int64)
BOUND = 2.0**-24


def stored(
    layer, sample=0, d=(0.0, 0.0, -1.0), p=(0.0, 0.0, 0.0), n=(0.0, 0.0, 1.0), surface=0, material=0, camera=CAMERA
):
    """The sums of a pixel, int64 (1, 3), after one return packet with a layer's values."""
    frame = make_frame(camera, SIZE)._replace(layer=layer)
    values = layer_values(frame, sample, d, p, n, surface, material)
    return np.array([[fixed_point(np.float32(value)) for value in values]], np.int64)


def unit(vector):
    return np.asarray(vector, np.float64) / np.linalg.norm(vector)


@given(st.integers(0, SIZE[0] * SIZE[1] - 1), st.floats(1e-7, 70_000.0), st.tuples(*[st.floats(-1.0, 1.0)] * 3))
@steady(200)
def test_a_distance_comes_back_to_half_a_unit(sample, distance, towards):
    d = unit(np.add(towards, (0.0, 0.0, 2.0)))
    p = tuple(CAMERA[0] + distance * d)
    (found,) = read_distances(stored(LAYER_DEPTH, sample, tuple(d), p))
    assert abs(found - distance) <= BOUND + 4e-16 * distance


@pytest.mark.parametrize("distance", [0.0, 2.0**-30, 1.0 - 2.0**-30, 1.0, 65535.5, 65536.0, 1e9])
def test_distances_at_the_ends_of_digits_come_back(distance):
    straight = np.array(CAMERA)
    straight[0] = 0.0
    (found,) = read_distances(stored(LAYER_DEPTH, d=(0.0, 0.0, 1.0), p=(0.0, 0.0, distance), camera=straight))
    assert abs(found - distance) <= BOUND


def test_a_hit_behind_the_eye_by_rounding_has_the_distance_0():
    (found,) = read_distances(stored(LAYER_DEPTH, d=(0.0, 0.0, -1.0), p=(0.1, 0.2, 3.0 + 1e-9)))
    assert found == 0.0


def test_parallel_rays_have_an_eye_each():
    camera = orthographic((0.0, 0.0, 5.0), (0.3, 0.1, -1.0), 1.0, SIZE)
    d = unit(camera[3])
    for sample in (0, 7, 8, 47):
        eye = camera[0] + (sample % SIZE[0]) * camera[1] + (sample // SIZE[0]) * camera[2]
        (found,) = read_distances(stored(LAYER_DEPTH, sample, tuple(d), tuple(eye + 4.25 * d), camera=camera))
        assert abs(found - 4.25) <= BOUND


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda n: np.linalg.norm(n) > 0.1))
@steady(200)
def test_a_normal_comes_back_to_a_rounding(vector):
    n = unit(vector)
    found = read_normals(stored(LAYER_NORMAL, n=tuple(n)))
    assert found.dtype == np.float32
    assert np.abs(found[0] - n).max() <= BOUND


@pytest.mark.parametrize("n", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)])
def test_normals_along_axes_are_exact(n):
    assert read_normals(stored(LAYER_NORMAL, n=n)).tolist() == [list(n)]


@given(st.integers(0, MAX_SURFACES - 1), st.integers(0, MAX_MATERIALS - 1))
@steady(200)
def test_numbers_are_exact(surface, material):
    numbers, materials = read_surfaces(stored(LAYER_SURFACE, surface=surface, material=material))
    assert (numbers[0], materials[0]) == (surface, material)
    assert numbers.dtype == materials.dtype == np.int32


def test_the_largest_numbers_are_exact():
    numbers, materials = read_surfaces(stored(LAYER_SURFACE, surface=MAX_SURFACES - 1, material=MAX_MATERIALS - 1))
    assert (numbers[0], materials[0]) == (MAX_SURFACES - 1, MAX_MATERIALS - 1)


def test_a_pixel_that_meets_nothing_is_told_from_all_others():
    assert read_distances(NOTHING).tolist() == [np.inf]
    assert read_normals(NOTHING).tolist() == [[0.0, 0.0, 0.0]]
    assert [each.tolist() for each in read_surfaces(NOTHING)] == [[-1], [-1]]
