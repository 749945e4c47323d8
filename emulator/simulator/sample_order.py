"""Orders the samples of a whole frame by the nodes that emit them, for the simulator.

The same order as `node.tracing.primaries`, where every home goes over its own part of the picture.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry import Space
from raygrid.node.jit import kernel
from raygrid.node.protocol import Frame
from raygrid.node.tracing import COARSEST, entry, eye_ray, home, image_point

Long = NDArray[np.int64]


@kernel
def _homes(frame, space, homes):
    """The node that is home to each sample, -1 if its ray misses the world box: int32 (samples,)."""
    for sample in range(len(homes)):
        x, y = image_point(sample, frame.width, frame.samples)
        origin, direction = eye_ray(frame.camera, x, y)
        enters, point, _ = entry(space.step, origin, direction)
        homes[sample] = -1
        if enters:
            cell = home(space, point)
            homes[sample] = (cell[2] * space.shape[1] + cell[1]) * space.shape[0] + cell[0]


@kernel
def _deal(frame, homes, places, order):
    """Put samples coarse to fine into `order`; places int64 (nodes,): where each node's next one goes."""
    for number in range(frame.samples):
        for level in range(COARSEST, -1, -1):
            stride = 1 << level
            for j in range(0, frame.height, stride):
                coarser = level < COARSEST and j % (2 * stride) == 0
                for i in range(0, frame.width, stride):
                    sample = (j * frame.width + i) * frame.samples + number
                    node = homes[sample]
                    if node >= 0 and not (coarser and i % (2 * stride) == 0):
                        order[places[node]] = sample
                        places[node] += 1


def order_of_samples(frame: Frame, space: Space) -> tuple[NDArray[np.uint32], Long]:
    """(samples uint32, borders int64 (nodes + 1,)): node k emits samples borders[k] to borders[k + 1] - 1, in order."""
    homes = np.empty(frame.width * frame.height * frame.samples, np.int32)
    _homes(frame, space, homes)
    nodes = space.shape[0] * space.shape[1] * space.shape[2]
    counts = np.bincount(homes[homes >= 0], minlength=nodes)
    borders = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
    order = np.empty(int(borders[-1]), np.uint32)
    _deal(frame, homes, borders[:-1].copy(), order)
    return order, borders


def order_of_pixels(frame: Frame, samples: NDArray[np.uint32], borders: Long) -> tuple[NDArray[np.uint32], Long]:
    """The same for the pixel packets of the read-out: each node's pixels, row by row, once however many samples."""
    pixels = samples.astype(np.int64) // frame.samples
    nodes = np.repeat(np.arange(len(borders) - 1), np.diff(borders))
    every = np.unique(nodes * np.int64(frame.width * frame.height) + pixels)
    node_of = every // (frame.width * frame.height)
    counts = np.bincount(node_of, minlength=len(borders) - 1)
    return (every % (frame.width * frame.height)).astype(np.uint32), np.concatenate(([0], np.cumsum(counts))).astype(
        np.int64
    )
