"""Adds what samples see whose rays never enter the world box: they have no home, so the host does it.

Without visible lights that is the background for every sample that no home has counted, and nothing here is
needed. Where a light can be seen, each such ray is looked at.
"""

from __future__ import annotations

import numpy as np

from raygrid.node.jit.closures import made_of_parts
from raygrid.node.jit.decorators import Function, kernel
from raygrid.node.tracing.framebuffer import fixed_point
from raygrid.node.tracing.primaries import ray_of_sample
from raygrid.node.tracing.shading import edge_colour


@made_of_parts
def make_add_missed(edge_colour: Function) -> Function:
    """Make `add_missed`, over what a ray sees that leaves the scene."""

    @kernel
    def add_missed(frame, step, sums):
        """Add to sums int64 (pixels, 3) what every sample sees whose ray misses the world box."""
        for pixel in range(frame.width * frame.height):
            for number in range(frame.samples):
                enters, _, direction = ray_of_sample(frame, step, pixel * frame.samples + number)
                if not enters:
                    colour = edge_colour(frame, direction)
                    for k in range(3):
                        sums[pixel, k] += fixed_point(np.float32(colour[k]))

    return add_missed


add_missed = make_add_missed(edge_colour)
