"""Quaternions against their rotation matrices, and against turns known by hand."""

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.quaternion import (
    quaternion_of_angles,
    quaternion_of_matrix,
    quaternion_products,
    rotation_matrices,
    slerp,
    unit_quaternions,
)

DEGREES = [*np.random.default_rng(1).uniform(-180, 180, (200, 3)), [180, 0, 0], [0, 180, 0], [0, 0, 180], [120, 180, 0]]


def test_rotation_matrices_become_quaternions():
    for degrees in DEGREES:
        turn = rotation_matrices(quaternion_of_angles(degrees)[None])[0]
        again = rotation_matrices(quaternion_of_matrix(turn)[None])[0]
        assert np.allclose(turn, again, atol=1e-12)


def test_products_turn_as_products_of_matrices_and_one_by_one_with_the_same_bits():
    first = np.array([quaternion_of_angles(degrees) for degrees in DEGREES])
    second = first[::-1]
    products = quaternion_products(second, first)
    assert np.allclose(rotation_matrices(products), rotation_matrices(second) @ rotation_matrices(first), atol=1e-12)
    for k, product in enumerate(products):
        assert quaternion_products(second[k], first[k]).tobytes() == product.tobytes()


def test_what_has_no_length_stays():
    assert unit_quaternions(np.array([[0.0, 0, 0, 0], [0, 0, 3, 4]])).tolist() == [[0, 0, 0, 0], [0, 0, 0.6, 0.8]]


def test_turns_go_the_short_way_at_even_speed():
    half = np.array([np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0])  # a quarter about x
    for other in (half, -half):
        third = slerp(np.array([1.0, 0, 0, 0]), other, 1 / 3)
        assert np.allclose(np.abs(third), [np.cos(np.pi / 12), np.sin(np.pi / 12), 0, 0])
    assert np.allclose(slerp(half, half, 0.3), half)
