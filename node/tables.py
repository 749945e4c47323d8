"""The tables that kernels read: surfaces of a node, facts of a frame, and where costs are counted.

Named tuples of flat arrays. `node.holdings` makes `Surfaces`, `make_frame` makes `Frame`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .frame import LIGHT, MATERIAL
from .packets import KINDS, MAX_LIGHTS, Limits
from .surfaces import NUMBERS, SURFACE_KINDS
from .walk import OUTPUTS

F64 = NDArray[np.float64]

KIND_SHIFT = 29
SLOT_MASK = (1 << KIND_SHIFT) - 1

# columns of Surfaces.programmed: rotation matrix, scale, shift, half the box, numbers
OWN_TURN, OWN_SCALE, OWN_SHIFT, OWN_BOX, OWN_NUMBER = 0, 9, 10, 13, 16
OWN_COLUMNS = OWN_NUMBER + NUMBERS
# columns of Frame.materials; rules of a program, if there are any: whether it has one, and its numbers
DIFFUSE, HIGHLIGHT, SHINE, SPECULAR, TRANSMISSION, IOR, MATERIAL_COLUMNS = 0, 3, 6, 7, 10, 13, 14
RULE, RULE_NUMBER, RULE_COLUMNS = MATERIAL_COLUMNS, MATERIAL_COLUMNS + 1, 1 + NUMBERS
# columns of Frame.lights
LIGHT_KIND, PLACE, INTENSITY, FALLOFF, SPOT, AXIS = 0, 1, 4, 7, 8, 9
COS_INNER, COS_OUTER, COS_DISC, DISC = 12, 13, 14, 15
LIGHT_COLUMNS = 18

# places in the array of counts (int64) that a step adds to
BORN = 0  # by packet kind
DIED = BORN + KINDS
SENT = DIED + KINDS  # packets put on each output
TESTS = SENT + OUTPUTS  # ray against surface, by kind of surface
WALKS = TESTS + len(SURFACE_KINDS)  # rays walked through this cell
BOXES = WALKS + 1  # nodes of the hierarchy opened
HITS = BOXES + 1
HOMES = HITS + 1  # homes worked out for return packets
MISADDRESSED = HOMES + 1  # returns for a pixel that this node does not hold
COUNTS = MISADDRESSED + 1


class Surfaces(NamedTuple):
    """What a node holds, built for the ray step. Items are surfaces in the order of the hierarchy's leaves.

    floats, words  the hierarchy (`node.hierarchy`), the same memory seen twice
    items          uint32, kind << 29 | row in the table of its kind; rows of a kind are in leaf order too
    ids            uint32, number in the scene
    materials      uint16, row of the material table
    triangles      float32 (n, 9); smooth float32 (n, 18); spheres float64 (n, 4)
    cones          float64 (n, CONE_COLUMNS), cylinders too
    planes, headers, bins, edges    polygons, see `node.intersect.in_polygon`
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


class Frame(NamedTuple):
    """Facts of a frame, in machine coordinates.

    camera      float64 (6, 3), rows as the fields of `node.frame.CAMERA`
    materials   float64 (m, MATERIAL_COLUMNS); lights float64 (l, LIGHT_COLUMNS), at least one row each
    n_lights    how many lights there are (0 allowed)
    background  linear RGB of rays that leave the scene
    width, height, samples   pixels, and samples a pixel
    depth       depth of the last hit that is lit; the eye's ray has depth 1
    min_weight  rays whose largest weight is below this are not born
    discs       whether any light can be seen
    """

    camera: F64
    materials: F64
    lights: F64
    n_lights: int
    background: tuple[float, float, float]
    width: int
    height: int
    samples: int
    depth: int
    min_weight: float
    discs: bool


def material_table(materials: NDArray[Any]) -> F64:
    """MATERIAL records as plain columns."""
    return np.column_stack([materials[name].reshape(len(materials), -1) for name in MATERIAL.names or ()])


def light_table(lights: NDArray[Any]) -> F64:
    """LIGHT records as plain columns; one unused row if there are none."""
    if len(lights) == 0:
        return np.zeros((1, LIGHT_COLUMNS))
    return np.column_stack([lights[name].reshape(len(lights), -1).astype(np.float64) for name in LIGHT.names or ()])


def frame_limits(frame: Frame, shape: tuple[int, int, int]) -> Limits:
    """What packets of this frame may name."""
    pixels = frame.width * frame.height
    return Limits(pixels * frame.samples, pixels, min(frame.n_lights, MAX_LIGHTS), frame.depth, shape)
