"""Declares the tables of a node's surfaces that kernels read: flat arrays, made by `node.tracing.local_geometry`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.surfaces import F64, NUMBERS

KIND_SHIFT = 29
SLOT_MASK = (1 << KIND_SHIFT) - 1

# columns of Surfaces.programmed: rotation matrix, scale, shift, half the box, numbers
OWN_TURN, OWN_SCALE, OWN_SHIFT, OWN_BOX, OWN_NUMBER = 0, 9, 10, 13, 16
OWN_COLUMNS = OWN_NUMBER + NUMBERS


class Surfaces(NamedTuple):
    """The surfaces of a node, built for the ray step. Items are surfaces in the order of the hierarchy's leaves.

    floats, words  the hierarchy (`node.geometry.bvh`), the same memory seen twice
    items          uint32, kind << 29 | row in the table of its kind; rows of a kind are in leaf order too
    ids            uint32, number in the scene
    materials      uint16, row of the material table
    triangles      float32 (n, 9); smooth float32 (n, 18); spheres float64 (n, 4)
    cones          float64 (n, CONE_COLUMNS), cylinders too
    planes, headers, bins, edges    polygons, see `node.geometry.intersect.in_polygon`
    programmed     float64 (n, OWN_COLUMNS), surfaces of the kind that a program adds
    """

    floats: NDArray[np.float32]
    words: NDArray[np.uint32]
    items: NDArray[np.uint32]
    ids: NDArray[np.uint32]
    materials: NDArray[np.uint16]
    triangles: NDArray[np.float32]
    smooth: NDArray[np.float32]
    spheres: F64
    cones: F64
    planes: F64
    headers: NDArray[np.int64]
    bins: NDArray[np.int64]
    edges: F64
    programmed: F64
