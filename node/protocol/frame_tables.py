"""Puts the facts of a frame into columns, as kernels read them and a command carries them: camera, lights, materials."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.surfaces import F64, NUMBERS
from raygrid.node.protocol.frame import LIGHT_RECORD, MATERIAL_RECORD
from raygrid.node.protocol.packets import MAX_LIGHTS, PacketLimits

# columns of Frame.materials; rules of a program, if there are any: whether it has one, and its numbers
DIFFUSE, HIGHLIGHT, SHINE, SPECULAR, TRANSMISSION, IOR, MATERIAL_COLUMNS = 0, 3, 6, 7, 10, 13, 14
RULE, RULE_NUMBER, RULE_COLUMNS = MATERIAL_COLUMNS, MATERIAL_COLUMNS + 1, 1 + NUMBERS
# columns of Frame.lights
LIGHT_KIND, LIGHT_PLACE, LIGHT_INTENSITY, LIGHT_FALLOFF, LIGHT_SPOT, LIGHT_AXIS = 0, 1, 4, 7, 8, 9
COS_INNER, COS_OUTER, COS_DISC, DISC = 12, 13, 14, 15
LIGHT_COLUMNS = 18
# Frame.layer: what pixels are to say of the first surface that is seen through their middles (`node.tracing.layer_values`)
LAYER_NONE, LAYER_DEPTH, LAYER_NORMAL, LAYER_SURFACE = 0, 1, 2, 3


class Frame(NamedTuple):
    """Facts of a frame, in machine coordinates.

    camera      float64 (6, 3), rows as the fields of `node.protocol.frame.CAMERA_RECORD`
    materials   float64 (m, MATERIAL_COLUMNS); lights float64 (l, LIGHT_COLUMNS), at least one row each
    n_lights    how many lights there are (0 allowed)
    background  linear RGB of rays that leave the scene
    width, height, samples   pixels, and samples a pixel
    depth       depth of the last hit that is lit; a primary ray has depth 1
    min_weight  rays whose largest weight is below this are not spawned
    discs       whether any light can be seen
    layer       LAYER_NONE: a picture; else the layer that is traced in its place, with one sample a pixel
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
    layer: int = LAYER_NONE


def material_table(materials: NDArray[Any]) -> F64:
    """MATERIAL_RECORD records as plain columns."""
    return np.column_stack([materials[name].reshape(len(materials), -1) for name in MATERIAL_RECORD.names or ()])


def light_table(lights: NDArray[Any]) -> F64:
    """LIGHT_RECORD records as plain columns; one unused row if there are none."""
    if len(lights) == 0:
        return np.zeros((1, LIGHT_COLUMNS))
    return np.column_stack(
        [lights[name].reshape(len(lights), -1).astype(np.float64) for name in LIGHT_RECORD.names or ()]
    )


def frame_limits(frame: Frame, shape: tuple[int, int, int]) -> PacketLimits:
    """Limits of what packets of this frame may name."""
    pixels = frame.width * frame.height
    return PacketLimits(pixels * frame.samples, pixels, min(frame.n_lights, MAX_LIGHTS), frame.depth, shape)
