"""Orders the samples of a whole frame by the nodes that emit them, for the simulator.

The same order as `node.tracing.primaries`, where every home goes over its own part of the picture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.simulator.kernels import deal_samples, find_homes
from raygrid.node.geometry import Space
from raygrid.node.protocol import Frame

Long = NDArray[np.int64]


def order_of_samples(frame: Frame, space: Space) -> tuple[NDArray[np.uint32], Long]:
    """(samples uint32, borders int64 (nodes + 1,)): node k emits samples borders[k] to borders[k + 1] - 1, in order."""
    homes = np.empty(frame.width * frame.height * frame.samples, np.int32)
    find_homes(frame, space, homes)
    nodes = space.shape[0] * space.shape[1] * space.shape[2]
    counts = np.bincount(homes[homes >= 0], minlength=nodes)
    borders = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
    order = np.empty(int(borders[-1]), np.uint32)
    deal_samples(frame, homes, borders[:-1].copy(), order)
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
