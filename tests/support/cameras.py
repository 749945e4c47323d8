"""The cameras with which births and pixel stores are tested: ordinary ones, and those that sit in bad places."""

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.lattice import HALF, Space
from support.frames import orthographic, perspective
from support.surfaces import F64, Generator, unit_vectors

Size = tuple[int, int]


def bad_places(space: Space, size: Size) -> dict[str, F64]:
    """Cameras by name: on, near and behind faces, edges and corners of the world box and of cells."""
    half = HALF * np.array(space.step)
    step = np.array(space.step)
    plane = (float(space.planes[0, space.shape[0] // 2]) - HALF) * space.step[0]
    x, y, z = np.eye(3)
    along = np.array([0.2, 0.1, -1.0])
    cameras = {
        "in front": perspective(3.0 * half[2] * z + 0.1 * y, -z, 40, size),
        "in front, straight": perspective(3.0 * half[2] * z, -z, 40, size, up=y),
        "far away": perspective([40.0, 30.0, 20.0], [-4, -3, -2], 2, size),
        "askew and near": perspective(1.3 * half, -half, 80, size),
        "so near that it sees little": perspective(half[2] * 1.01 * z, -z + 0.3 * x, 60, size),
        "behind": perspective(3.0 * half[2] * z, z, 60, size),
        "sideways": perspective(2.0 * half[2] * z, x, 120, size),
        "very wide": perspective(1.5 * half[0] * x, -x, 175, size),
        "inside": perspective(0.3 * half, [1, 2, 3], 70, size),
        "inside, on a plane between cells": perspective([plane, 0.1 * half[1], 0.0], [1, 0, -1], 90, size),
        "on a face, looking in": perspective(half[2] * z, -z + 0.2 * x, 90, size),
        "on a face, looking out": perspective(half[2] * z, z, 90, size),
        "on a face, along it": perspective(half[2] * z, x, 90, size, up=z),
        "on an edge": perspective(half * np.array([1, 1, 0]), [-1, -0.5, 0.1], 100, size),
        "on a corner": perspective(half, -half, 100, size),
        "parallel": orthographic(2.0 * half[2] * z, -z, 1.2 * half[1], size),
        "parallel, straight": orthographic(2.0 * half[2] * z, -z, half[1], size, up=y),
        "parallel, askew": orthographic([2.0, 1.5, 1.0], [-4, -3, -2], 0.9, size),
        "parallel, from inside": orthographic([0.0, 0.0, 0.0], along, half[1], size),
        "parallel, away": orthographic(2.0 * half[2] * z, z, half[1], size),
        "parallel, in a face": orthographic([half[0], 0.0, 2.0], -z, half[1], size, up=y),
    }
    for steps in (-6, -1, 0.4, 1, 3, 5, 100, 10000):
        eye = (half[2] + steps * step[2]) * z + 0.3 * half[0] * x
        cameras[f"{steps} steps off a face, along it"] = perspective(eye, x - 1e-3 * z, 100, size, up=z)
        cameras[f"{steps} steps off a face, down"] = perspective(eye, -z + 0.5 * y, 140, size)
    return cameras


def random_cameras(rng: Generator, space: Space, size: Size, n: int) -> list[F64]:
    """Eyes inside, outside and near faces, of all angles."""
    half = HALF * np.array(space.step)
    cameras = []
    for _ in range(n):
        eye = half * rng.uniform(-1, 1, 3) * rng.choice([0.9, 1.0, 1.001, 1.5, 4.0])
        if rng.random() < 0.3:
            axis = int(rng.integers(3))
            eye[axis] = np.sign(eye[axis]) * half[axis] * (1.0 + rng.choice([0.0, 1e-7, -1e-7, 1e-5, 1e-3]))
        forward = half * rng.uniform(-1, 1, 3) - eye if rng.random() < 0.7 else unit_vectors(rng, 1)[0]
        if rng.random() < 0.3:
            cameras.append(orthographic(eye, forward, 10.0 ** rng.uniform(-2, 0.3), size))
        else:
            cameras.append(perspective(eye, forward, rng.choice([5.0, 40.0, 90.0, 160.0, 179.0]), size))
    return cameras
