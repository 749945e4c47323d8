"""Spawns primary rays at their homes, coarse to fine, so that an unfinished frame is a usable preview.

Order: sample 0 of every pixel, then sample 1, and so on; within a sample number the pixels whose row and
column are multiples of 8, then of 4, of 2, and the rest; within a level row by row. Each home goes over the
spans of its own store only, and takes the samples whose rays enter the world box in its cell.
"""

from __future__ import annotations

import numpy as np

from raygrid.node.jit.decorators import lean, part
from raygrid.node.protocol.counters import BORN
from raygrid.node.protocol.packets import PRIMARY, SIZE
from raygrid.node.tracing.camera import entry, eye_ray, image_point
from raygrid.node.tracing.framebuffer import slot
from raygrid.node.tracing.primary_rays import (
    PRIMARY_PLACE,
    PRIMARY_ROOM,
    is_at_home,
    note_primary,
    put_primary,
    work_out_primaries,
)

COARSEST = 3  # log2 of the stride of the first level
# fields of the cursor
NEXT_SAMPLE, LEVEL, ROW, COLUMN, DONE = 0, 1, 2, 3, 4
CURSOR = 5


def new_cursor(has_pixels: bool) -> np.ndarray:
    """The cursor before the first sample (int64, CURSOR fields)."""
    cursor = np.zeros(CURSOR, np.int64)
    cursor[LEVEL] = COARSEST
    cursor[DONE] = 0 if has_pixels else 1
    return cursor


@part
def ray_of_sample(frame, step, sample):
    """(whether the eye's ray of a sample enters the world box, lattice point where it does, its direction)."""
    x, y = image_point(sample, frame.width, frame.samples)
    origin, direction = eye_ray(frame.camera, x, y)
    enters, point, _ = entry(step, origin, direction)
    return enters, point, direction


@lean
def spawn_primaries(tables, cursor, packets, first, room):
    """Write up to `room` primary rays to `packets` (uint8) from packet number `first`; returns how many.

    tables  `step_tables.StepTables`
    cursor  keeps the place between calls; cursor[DONE] is 1 when no sample is left
    """
    made = 0
    while made < room and cursor[DONE] == 0:
        many = min(PRIMARY_ROOM, room - made)
        _note_samples(tables.frame, tables.pixels, cursor, many, tables.outputs.seen)
        made += _spawn_noted(tables, packets, first + made)
    tables.counts[BORN + PRIMARY] += made
    return made


@part
def _note_samples(frame, pixels, cursor, many, seen):
    """Note the next samples of the store, at most `many`, and move the cursor behind them."""
    while seen.held[0] < many and cursor[DONE] == 0:
        level, row = cursor[LEVEL], cursor[ROW]
        j = pixels.first_row + row
        stride = 1 << level
        if row < len(pixels.first) and j % stride == 0:
            begin = pixels.first[row]
            end = begin + pixels.offsets[row + 1] - pixels.offsets[row]
            coarser = level < COARSEST and j % (2 * stride) == 0
            i = max(cursor[COLUMN], begin)
            i += (stride - i % stride) % stride
            while i < end and seen.held[0] < many:
                if not (coarser and i % (2 * stride) == 0):
                    _note(frame, i, j, pixels.offsets[row] + i - pixels.first[row], cursor[NEXT_SAMPLE], seen)
                i += stride
            cursor[COLUMN] = i
            if i < end:
                continue
        cursor[COLUMN] = 0
        cursor[ROW] += 1
        if cursor[ROW] >= len(pixels.first):
            _next_level(frame, cursor)


@part
def _note(frame, i, j, place, number, seen):
    """Note one sample. `place`: of its pixel in the store."""
    sample = (j * frame.width + i) * frame.samples + number
    x, y = np.float64(i), np.float64(j)
    if frame.samples > 1:
        x, y = image_point(sample, frame.width, frame.samples)
    note_primary(seen, x, y, sample, place)


@part
def _spawn_noted(tables, packets, first):
    """Write the primary rays of those samples that were noted whose home is here; returns how many."""
    seen, pixels = tables.outputs.seen, tables.pixels
    work_out_primaries(tables.cell, tables.space, tables.frame, seen)
    made = 0
    for j in range(seen.held[0]):
        if is_at_home(seen, j):
            put_primary(seen, j, packets, (first + made) * SIZE)
            pixels.samples[seen.words[PRIMARY_PLACE * PRIMARY_ROOM + j]] += 1
            made += 1
    seen.held[0] = 0
    return made


@part
def _next_level(frame, cursor):
    cursor[ROW] = 0
    cursor[LEVEL] -= 1
    if cursor[LEVEL] < 0:
        cursor[LEVEL] = COARSEST
        cursor[NEXT_SAMPLE] += 1
        if cursor[NEXT_SAMPLE] >= frame.samples:
            cursor[DONE] = 1


@part
def spawn_sample(tables, pixel, number, packet):
    """Do as `spawn_primary`, of a pixel (column, row, its place in the store), and uncounted."""
    _note(tables.frame, pixel[0], pixel[1], pixel[2], number, tables.outputs.seen)
    return _spawn_noted(tables, packet, 0)


@lean
def spawn_primary(tables, i, j, number, packet):
    """Write the primary ray of one sample of pixel (i, j) to `packet` if its home is here; returns 1 or 0."""
    made = spawn_sample(tables, (i, j, slot(tables.pixels, i, j)), number, packet)
    tables.counts[BORN + PRIMARY] += made
    return made
