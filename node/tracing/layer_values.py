"""Turns facts of a primary ray's hit into three intensities that a pixel store keeps, and pixel sums into layers again.

A return packet brings home three binary32 of 0 or more, which the store rounds to whole units of 2^-24 and cuts off at 65536:
so whole numbers below that are kept exactly, and numbers up to 1 to half a unit. A pixel of three zeros meets nothing.

    depth    1 + floor(d) div 2^16, floor(d) mod 2^16, d - floor(d), of the distance d from the eye in machine coordinates
    normal   1 + x, 1 + y, 1 + z of the unit normal that is shaded with, on the side that the ray comes from
    surface  number mod 2^16, number div 2^16, 1 + its material
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from raygrid.node.jit.decorators import part
from raygrid.node.protocol.frame_tables import LAYER_NORMAL, LAYER_SURFACE
from raygrid.node.tracing.camera import eye_ray, image_point
from raygrid.node.tracing.framebuffer import UNIT

BASE = 65536  # of the digits into which whole numbers are cut

Sums = NDArray[np.int64]


@part
def layer_values(frame, sample, d, p, n, surface, material):
    """Three numbers that say what `frame.layer` wants of a hit.

    sample  of the primary ray, which is that of a pixel's middle; d: its direction, a unit vector
    p, n    the hit, and the shading normal there, turned against the ray
    """
    if frame.layer == LAYER_NORMAL:
        return 1.0 + n[0], 1.0 + n[1], 1.0 + n[2]
    if frame.layer == LAYER_SURFACE:
        return np.float64(surface % BASE), np.float64(surface // BASE), np.float64(material + 1)
    column, row = image_point(sample, frame.width, frame.samples)
    eye, _ = eye_ray(frame.camera, column, row)
    distance = 0.0
    for k in range(3):
        distance += (p[k] - eye[k]) * d[k]
    whole = math.floor(max(distance, 0.0))
    return 1.0 + np.float64(whole // BASE), np.float64(whole % BASE), max(distance, 0.0) - whole


def read_distances(sums: Sums) -> NDArray[np.float64]:
    """Distances from the eye, float64 (pixels,), of the sums (pixels, 3) of a layer: in machine coordinates, to 2^-24; inf where
    nothing is met."""
    there = sums[:, 0] > 0
    distances = (sums[:, 0] / UNIT - 1.0) * BASE + sums[:, 1] / UNIT + sums[:, 2] / UNIT
    return np.where(there, distances, np.inf)


def read_normals(sums: Sums) -> NDArray[np.float32]:
    """Normals, float32 (pixels, 3), of the sums of a layer: each number to 2^-24, or 0 where nothing is met."""
    there = (sums[:, 0] > 0) | (sums[:, 1] > 0) | (sums[:, 2] > 0)
    return np.where(there[:, None], sums / UNIT - 1.0, 0.0).astype(np.float32)


def read_surfaces(sums: Sums) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(numbers of surfaces, of their materials), int32 (pixels,), of the sums of a layer; -1 where nothing is met."""
    there = sums[:, 2] > 0
    digits = sums // int(UNIT)
    numbers = np.where(there, digits[:, 0] + BASE * digits[:, 1], -1)
    return numbers.astype(np.int32), (digits[:, 2] - 1).astype(np.int32)
