"""Marble: veins along x, bent by noise. numbers[0] is how many veins there are in a machine unit, numbers[1] how strongly
they are bent, numbers[2] to numbers[4] the colour of the veins; the stone has the material's own.

Points are in machine coordinates: the longest half edge of the world box is between 1/2 and 1.
"""

import math


def _hash(i, j, k):
    """A number between 0 and 1 for each point of a lattice of whole numbers."""
    value = math.sin(i * 127.1 + j * 311.7 + k * 74.7) * 43758.5453
    return value - math.floor(value)


def _smooth(t):
    return t * t * (3.0 - 2.0 * t)


def _noise(x, y, z):
    """Between 0 and 1, smooth, with bumps one unit apart."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = _smooth(x - i), _smooth(y - j), _smooth(z - k)
    total = 0.0
    for corner in range(8):
        a, b, c = corner & 1, corner >> 1 & 1, corner >> 2
        share = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if c else 1.0 - w)
        total += share * _hash(i + a, j + b, k + c)
    return total


def tint(point, normal, numbers):
    x, y, z = point[0] * numbers[0], point[1] * numbers[0], point[2] * numbers[0]
    bent, size = 0.0, 1.0
    for _ in range(5):
        bent += _noise(x / size, y / size, z / size) * size
        size *= 0.5
    vein = abs(math.sin(math.pi * (x + numbers[1] * bent)))
    part = (1.0 - vein) ** 4
    return (
        1.0 + part * (numbers[2] - 1.0),
        1.0 + part * (numbers[3] - 1.0),
        1.0 + part * (numbers[4] - 1.0),
    )
