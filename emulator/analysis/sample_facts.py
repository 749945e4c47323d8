"""Tells what one ray step does not: where a sample begins, what it sees outside, what was brought home.

For explanations, never for pictures. All by the functions that the step calls.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.jit import lean
from raygrid.node.tracing import edge_colour, fixed_point, home, noted_return, ray_of_sample


@lean
def begin(space, frame, sample):
    """(whether the eye's ray of a sample enters the world box, the sample's home, the ray's direction)."""
    enters, point, direction = ray_of_sample(frame, space.step, sample)
    return enters, home(space, point), direction


@lean
def sees_outside(frame, direction):
    """The units of 2^-24 that a sample adds whose ray never enters the world box."""
    colour = edge_colour(frame, direction)
    return (
        fixed_point(np.float32(colour[0])),
        fixed_point(np.float32(colour[1])),
        fixed_point(np.float32(colour[2])),
    )


@lean
def brought_home(outputs):
    """The intensity, three binary32, of the return packet that a step has spawned last of the one ray that it was given."""
    _, _, intensity = noted_return(outputs.seen, 0)
    return intensity
