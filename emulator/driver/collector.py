"""Collects the pixels of a pass as they come to the host: exact sums, and how many samples each pixel has.

Fresh memory is dear: on a virtual machine it may take longer to get a page than to fill it. So there is no more of it than
needed, and it can be touched piece by piece while the nodes trace and the host has nothing else to do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import PacketError
from raygrid.node.jit import is_on_disk
from raygrid.node.protocol import HEAD, MAX_PIXEL_SAMPLES, add_pixels

Samples = NDArray[np.integer]  # uint16 or int64
PIECE = 1 << 18  # pixels that are touched at a time, in some 10 milliseconds at worst


class Collected:
    """What has come of a picture of so many pixels.

    most      samples that a pixel should have; more than these can be told from these
    sums      int64 (pixels, 3), fixed point
    samples   uint16 (pixels,), int64 if `most` asks for it
    received  pixel packets that came
    """

    def __init__(self, pixels: int, most: int = 1) -> None:
        self.sums: NDArray[np.int64] = np.zeros((pixels, 3), np.int64)
        kind: type[np.integer] = np.uint16 if most < MAX_PIXEL_SAMPLES else np.int64
        self.samples: Samples = np.zeros(pixels, kind)
        self.received = 0
        self._top = np.int64(np.iinfo(kind).max)
        self._touched = 0

    def take(self, message: bytes, count: int) -> None:
        """Add the `count` pixel packets of a message of HEAD bytes and these.

        Raises PacketError if one is of another kind or names a pixel that is not there; then none is added.
        """
        buffer = np.frombuffer(message, np.uint8)
        if not add_pixels(buffer, HEAD, count, self.sums, self.samples, self._top):
            raise PacketError(f"{count} pixel packets came with another kind, or a pixel beyond {len(self.samples)}")
        self.received += count

    def touch(self) -> None:
        """Have the computer give the next piece of the memory, before anything is taken in."""
        if self.received == 0:
            piece = slice(self._touched, self._touched + PIECE)
            self.sums[piece], self.samples[piece] = 0, 0
            self._touched += PIECE


def load() -> None:
    """Have the kernel ready, if it is in the cache on disk; if not, another process is about to compile it."""
    if is_on_disk(add_pixels):
        Collected(0).take(bytes(HEAD), 0)
