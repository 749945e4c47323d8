"""Sets up one ray after the other: the definition of what `node.tracing.ray_setup` does with eight at once."""

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.grid_walk import NO_PORT, inverse, is_walking, passage, towards_start
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.packets import SHADOW, read_origin, read_u16, read_u24, unit_vector
from raygrid.node.tracing.ray_setup import NOT_AT_START
from raygrid.node.tracing.shading import light_direction, place


@part
def set_up(cell, space, frame, packets, at, port, kind):
    """Set up a ray or shadow ray before any surface is looked at: (way, o, d, inv, t_in, t_out, distance).

    way  the exit port; NOT_AT_START for one that has to go to the cell of its origin first
    """
    origin = read_origin(packets, at)
    o = place(origin, space.step)
    if kind == SHADOW:
        d, distance = light_direction(frame.lights, read_u16(packets, at + 14), o)
    else:
        d, distance = unit_vector(read_u24(packets, at + 14), read_u24(packets, at + 17)), np.inf
    inv = (inverse(d[0]), inverse(d[1]), inverse(d[2]))
    t_in, t_out, way = passage(cell, o, inv)
    if not is_walking(cell, origin, port) and towards_start(cell, origin) != NO_PORT:
        way = NOT_AT_START
    return way, o, d, inv, t_in, t_out, distance
