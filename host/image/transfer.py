"""Converts exact sums to the bytes of a picture, by tables.

What a sum becomes is defined by a formula with a power, which takes 16 ns a value. The formula rises with the sum, and so
slowly that of sums in a range of `1 << shift` there are at most two bytes: so a table says the byte of the first of a
range, and from which sum on it is one more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.tracing import UNIT

TRANSFERS = ("srgb", "linear")
FINE = 12  # the steepest part of sRGB has a byte for every 2^24 / (12.92 * 255) = 5,092 units
BLOCK = 1 << 16  # values that are worked on at a time: what is made for them stays in the cache
NEVER = np.iinfo(np.int64).max

Sums = NDArray[np.int64]


def byte_of(sums: Sums, samples: int, transfer: str) -> NDArray[np.uint8]:
    """Define the bytes of sums over so many samples, values above 1 cut off."""
    values = np.minimum(sums / (UNIT * samples), 1.0)
    if transfer == "srgb":
        values = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)
    return np.floor(values * 255.0 + 0.5).astype(np.uint8)


class TransferTable(NamedTuple):
    """Tabulates the bytes of ranges of sums.

    top    sums from here on have the last byte
    shift  the range of a sum is its number without so many bits
    first  uint8 (ranges,), byte of the first sum of a range
    more   int64 (ranges,), sum of the range from which on it is one more, or NEVER
    """

    top: int
    shift: int
    first: NDArray[np.uint8]
    more: Sums


def make_table(samples: int, transfer: str) -> TransferTable:
    """Make the table of a number of samples."""
    top, shift = int(UNIT) * samples, FINE + samples.bit_length() - 1
    bytes_above = np.arange(1, 256)
    below, least = np.zeros(255, np.int64) - 1, np.full(255, top, np.int64)
    while (least - below > 1).any():  # the least sum of each byte lies in (below, least]
        middle = (below + least) >> 1
        reached = byte_of(middle, samples, transfer) >= bytes_above
        below, least = np.where(reached, below, middle), np.where(reached, middle, least)
    first = np.searchsorted(least, np.arange((top >> shift) + 1) << shift, "right")
    return TransferTable(top, shift, first.astype(np.uint8), np.append(least, NEVER)[first])


def to_bytes(sums: Sums, samples: int, transfer: str) -> NDArray[np.uint8]:
    """Convert all of a picture's sums as `byte_of` does, uint8 of the same shape."""
    table = make_table(samples, transfer)
    flat, picture = sums.reshape(-1), np.empty(sums.size, np.uint8)
    for start in range(0, len(flat), BLOCK):
        block = np.minimum(flat[start : start + BLOCK], table.top)
        place = block >> table.shift
        picture[start : start + BLOCK] = table.first[place] + (block >= table.more[place])
    return picture.reshape(sums.shape)
