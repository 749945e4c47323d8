"""Traces packets once more, as far as it is asked to, so that `node.runtime.profile` can time the parts of a ray step."""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.lattice import T_MIN
from raygrid.node.jit.decorators import lean
from raygrid.node.protocol.packets import SHADOW, SIZE
from raygrid.node.tracing.ray_setup import SETUP_RAYS, column, read_prepared, set_up_rays
from raygrid.node.tracing.traverse import blocked, closest

DECODE, WALK, HIT = 0, 1, 2


@lean
def trace_again(cell, space, frame, surfaces, packets, ports, first, last, what, stack, ahead, counts):
    """Decode packets first..last-1, of one class, and walk and search as far as `what` says; a number that depends on
    all of it."""
    used = 0.0
    shadow = (np.int64(packets[first * SIZE]) & 7) == SHADOW
    for k in range(first, last, SETUP_RAYS):
        many = min(SETUP_RAYS, last - k)
        read_prepared(frame, packets, ports, k, k + many, shadow, ahead)
        used += ahead.words[0]
        if what == DECODE:
            continue
        set_up_rays(cell, space, many, shadow, ahead)
        used += ahead.ways[0]
        if what == WALK or len(surfaces.floats) == 0:
            continue
        for j in range(many):
            _, o, d, inv, t_in, t_out, distance = column(ahead, j)
            lower = max(t_in, T_MIN)
            if shadow:
                used += blocked(surfaces, stack, o, d, inv, lower, min(t_out, distance), counts)
            else:
                used += closest(surfaces, stack, o, d, inv, lower, t_out, counts)[1]
    return used
