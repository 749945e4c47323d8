"""Primary rays are born at their homes, coarse to fine, so that an unfinished frame is a usable preview.

Order: sample 0 of every pixel, then sample 1, and so on; within a sample number the pixels whose row and
column are multiples of 8, then of 4, of 2, and the rest; within a level row by row. Each home goes over the
spans of its own store only, and takes the samples whose rays enter the world box in its cell.
"""

from __future__ import annotations

import numpy as np

from .camera import entry, eye_ray, image_point, primary_origin
from .compiled import lean, part
from .packets import PRIMARY, SIZE, octahedral, pack_weight, put_ray
from .pixels import slot
from .tables import BORN
from .walk import NO_PORT, towards_start

COARSEST = 3  # log2 of the stride of the first level
# fields of the cursor
NUMBER, LEVEL, ROW, COLUMN, DONE = 0, 1, 2, 3, 4
CURSOR = 5


def new_cursor(has_pixels: bool) -> np.ndarray:
    """The cursor before the first sample (int64, CURSOR fields)."""
    cursor = np.zeros(CURSOR, np.int64)
    cursor[LEVEL] = COARSEST
    cursor[DONE] = 0 if has_pixels else 1
    return cursor


@lean
def bear_primaries(cell, space, frame, pixels, cursor, packets, first, room, counts):
    """Write up to `room` primary rays to `packets` (uint8) from packet number `first`; returns how many.

    `cursor` keeps the place between calls; cursor[DONE] is 1 when no sample is left.
    """
    made = 0
    white = pack_weight(1.0, 1.0, 1.0)
    while made < room and cursor[DONE] == 0:
        level, row = cursor[LEVEL], cursor[ROW]
        j = pixels.first_row + row
        stride = 1 << level
        if row < len(pixels.first) and j % stride == 0:
            begin = pixels.first[row]
            end = begin + pixels.offsets[row + 1] - pixels.offsets[row]
            coarser = level < COARSEST and j % (2 * stride) == 0
            i = max(cursor[COLUMN], begin)
            i += (stride - i % stride) % stride
            while i < end and made < room:
                if not (coarser and i % (2 * stride) == 0):
                    place = pixels.offsets[row] + i - pixels.first[row]
                    to = (first + made) * SIZE
                    made += _bear(cell, space, frame, pixels, i, j, place, cursor[NUMBER], packets, to, white)
                i += stride
            cursor[COLUMN] = i
            if i < end:
                continue
        cursor[COLUMN] = 0
        cursor[ROW] += 1
        if cursor[ROW] >= len(pixels.first):
            _next_level(frame, cursor)
    counts[BORN + PRIMARY] += made
    return made


@part
def _next_level(frame, cursor):
    cursor[ROW] = 0
    cursor[LEVEL] -= 1
    if cursor[LEVEL] < 0:
        cursor[LEVEL] = COARSEST
        cursor[NUMBER] += 1
        if cursor[NUMBER] >= frame.samples:
            cursor[DONE] = 1


@part
def _bear(cell, space, frame, pixels, i, j, place, number, packets, to, white):
    """Write the primary ray of one sample if its home is here; returns 1 or 0. `place`: of its pixel in the store."""
    sample = (j * frame.width + i) * frame.samples + number
    x, y = np.float64(i), np.float64(j)
    if frame.samples > 1:
        x, y = image_point(sample, frame.width, frame.samples)
    origin, direction = eye_ray(frame.camera, x, y)
    enters, point, near = entry(space.step, origin, direction)
    if not enters or towards_start(cell, point) != NO_PORT:
        return 0
    start = primary_origin(space.step, origin, direction, near)
    put_ray(packets, to, PRIMARY, 1, sample, start, octahedral(direction[0], direction[1], direction[2]), white)
    pixels.samples[place] += 1
    return 1


@lean
def bear_primary(cell, space, frame, pixels, i, j, number, packet, counts):
    """Write the primary ray of one sample of pixel (i, j) to `packet` if its home is here; returns 1 or 0."""
    made = _bear(cell, space, frame, pixels, i, j, slot(pixels, i, j), number, packet, 0, pack_weight(1.0, 1.0, 1.0))
    counts[BORN + PRIMARY] += made
    return made
