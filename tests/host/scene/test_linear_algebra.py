"""Sums of products from the first to the last: against numpy's, against sums by hand to the bit, at extremes."""

from __future__ import annotations

import numpy as np
import pytest

from raygrid.host.scene.linear_algebra import (
    affine_inverse,
    cofactors,
    determinant,
    dot,
    inverse,
    lengths,
    product,
    units,
)

GENERATOR = np.random.default_rng(17)


def by_hand(a, b):
    total = float(a[0]) * float(b[0])
    for left, right in zip(a[1:], b[1:], strict=True):
        total = total + float(left) * float(right)
    return total


def test_products_have_the_bits_of_sums_by_hand():
    rows, matrix = GENERATOR.normal(size=(50, 4)), GENERATOR.normal(size=(4, 3))
    wanted = [[by_hand(row, column) for column in matrix.T] for row in rows]
    assert product(rows, matrix).tolist() == wanted
    assert [product(row, matrix).tolist() for row in rows] == wanted  # however many rows come at once
    assert product(rows.reshape(5, 10, 4), matrix).reshape(50, 3).tolist() == wanted
    assert np.allclose(product(rows, matrix), rows @ matrix, rtol=1e-14, atol=1e-14)


def test_dots_and_lengths_are_those_of_each_row():
    a, b = GENERATOR.normal(size=(30, 3)), GENERATOR.normal(size=(30, 3))
    assert dot(a, b).tolist() == [by_hand(*pair) for pair in zip(a, b, strict=True)]
    assert float(dot(a[0], b[0])) == by_hand(a[0], b[0])
    assert np.allclose(lengths(a), np.linalg.norm(a, axis=1))
    assert float(lengths(np.array((3.0, 4.0, 0.0)))) == 5.0
    assert dot(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert product(np.zeros((0, 3)), np.eye(3)).shape == (0, 3)


def test_inverses_and_determinants_are_numpys():
    for _ in range(50):
        matrix = GENERATOR.normal(size=(3, 3)) * 10.0 ** GENERATOR.uniform(-3, 3, 3)
        assert np.allclose(product(inverse(matrix), matrix), np.eye(3), atol=1e-9)
        assert np.isclose(determinant(matrix), np.linalg.det(matrix), rtol=1e-9)
        assert np.allclose(cofactors(matrix), np.linalg.inv(matrix).T * np.linalg.det(matrix), rtol=1e-7)


@pytest.mark.parametrize("scale", [1e-200, 1e-30, 1e30, 1e200])
def test_inverses_of_the_very_small_and_large(scale):
    turn = np.array(((0.6, -0.8, 0.0), (0.8, 0.6, 0.0), (0.0, 0.0, 1.0)))
    assert np.allclose(inverse(turn * scale) * scale, turn.T)
    assert np.allclose(inverse(turn * (1.0, scale, 1.0)) * np.array((1.0, scale, 1.0))[:, None], turn.T)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag((1.0, 0.0, 1.0)), np.full((3, 3), np.nan)])
def test_what_has_no_inverse_is_refused(matrix):
    with pytest.raises(np.linalg.LinAlgError, match="the determinant is"):
        inverse(matrix)


def test_an_affine_inverse_takes_points_back():
    matrix = np.eye(4)
    matrix[:3] = GENERATOR.normal(size=(3, 4))
    assert np.allclose(product(affine_inverse(matrix), matrix), np.eye(4), atol=1e-12)
    assert affine_inverse(matrix)[3].tolist() == [0.0, 0.0, 0.0, 1.0]


def test_units_have_the_length_one_and_what_has_none_is_zero():
    rows = np.concatenate((GENERATOR.normal(size=(20, 3)), np.zeros((1, 3)), np.full((1, 3), 1e-200)))
    made = units(rows)
    assert np.allclose(lengths(made[:20]), 1.0, rtol=1e-15, atol=0.0)
    assert (np.sum(made[:20] * rows[:20], axis=1) > 0.0).all()
    assert np.allclose(np.cross(made, rows), 0.0, atol=1e-15)
    assert not made[20:].any()
    assert units(rows.reshape(11, 2, 3)).reshape(22, 3).tolist() == made.tolist()
