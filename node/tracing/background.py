"""Adds what samples see whose rays never enter the world box: they have no home, so the host does it.

Without visible lights that is the background for every sample that no home has counted, and nothing here is
needed. Where a light can be seen, each such ray is looked at.
"""

from __future__ import annotations

import numpy as np

from raygrid.node.jit.decorators import kernel
from raygrid.node.tracing.camera import entry, eye_ray, image_point
from raygrid.node.tracing.framebuffer import fixed_point
from raygrid.node.tracing.shading import edge_colour


@kernel
def add_missed(frame, step, sums):
    """Add to sums int64 (pixels, 3) what every sample sees whose ray misses the world box."""
    for pixel in range(frame.width * frame.height):
        for number in range(frame.samples):
            i, j = image_point(pixel * frame.samples + number, frame.width, frame.samples)
            origin, direction = eye_ray(frame.camera, i, j)
            enters, _, _ = entry(step, origin, direction)
            if not enters:
                colour = edge_colour(frame, direction)
                for k in range(3):
                    sums[pixel, k] += fixed_point(np.float32(colour[k]))
