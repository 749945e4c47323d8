"""Sets up one ray, for those who serve packets one at a time: a service of machine time costs what its own packet did.

`node.tracing.ray_setup` does the same with eight rays, and a test compares the bits. A batch of one through that took the
simulator 360 instead of 241 ns an event (balls_3 at 64x64 on 4x4x4).
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.lattice import T_MIN
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.packets import SHADOW, read_origin, read_u16, read_u24
from raygrid.node.protocol.packing import unit_vector
from raygrid.node.tracing.ray_setup import way_through
from raygrid.node.tracing.shading import light_direction, place
from raygrid.node.tracing.traverse import open_root


@part
def set_up_ray(cell, space, frame, packets, at, port, kind):
    """Set up a ray or shadow ray before any surface is looked at: (way, o, d, inv, t_in, t_out, distance).

    way  the exit port; NOT_AT_START for one that has to go to the cell of its origin first
    """
    origin = read_origin(packets, at)
    o = place(origin, space.step)
    if kind == SHADOW:
        d, distance = light_direction(frame.lights, read_u16(packets, at + 14), o)
    else:
        d, distance = unit_vector(read_u24(packets, at + 14), read_u24(packets, at + 17)), np.inf
    way, inv, t_in, t_out = way_through(cell, origin, o, d, port)
    return way, o, d, inv, t_in, t_out, distance


@part
def open_root_for(surfaces, ray, stack):
    """Put the keys of the root's boxes that a ray meets on the stack; returns how many. ray  as `set_up_ray` gives it"""
    if len(surfaces.floats) == 0:
        return 0
    _, o, _, inv, t_in, t_out, distance = ray
    return open_root(surfaces, stack, 0, o, inv, max(t_in, T_MIN), min(t_out, distance))
