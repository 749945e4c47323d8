"""Stores the pixels of a home: integer sums of intensities, one span of columns a row.

An intensity is a binary32; the store adds round(intensity * 2^24) as 64-bit integers, so the order in
which packets come home cannot matter (law 4). Intensities above MAX_INTENSITY count as MAX_INTENSITY, so
that the sum of 2^22 packets cannot overflow.

A home holds the samples whose rays enter the world box in its cell. Seen from the eye these lie in the
outlines of the cell's outer faces (of the whole cell, if parallel rays begin in it), so the store keeps one
span of columns a row, a little larger than the outlines. Two homes may each hold some samples of the same
pixel; the host adds what they send.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.lattice import HALF, LATTICE, Cell, Space
from raygrid.node.jit.decorators import kernel, part
from raygrid.node.protocol.counters import BORN
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.protocol.packets import MAX_PIXEL_SAMPLES, MAX_PIXEL_SUM, PIXEL, SIZE, put_pixel

UNIT = 2.0**24  # fixed-point units in an intensity of 1
MAX_INTENSITY = 65536.0
MARGIN = 4  # lattice steps by which outlines are widened before they are projected
NEAREST_DEPTH = 1e-12  # outlines are cut off this near to the eye's plane; no ray enters the world box nearer
PARALLEL = 1e-6  # rays this near to a face may enter by it or by the next one

Columns = NDArray[np.int64]


class Pixels(NamedTuple):
    """The store of one home.

    first_row      the span of row first_row + r is columns first[r] .. first[r] + offsets[r+1] - offsets[r] - 1
    first          int64 (rows,)
    offsets        int64 (rows + 1,), place of each row's span in `sums` and `samples`
    sums           int64 (pixels, 3), fixed point
    samples        int64 (pixels,), how many samples were spawned for the pixel
    """

    first_row: int
    first: Columns
    offsets: Columns
    sums: NDArray[np.int64]
    samples: NDArray[np.int64]


@part
def slot(pixels, i, j):
    """Place of pixel (i, j) in the store, -1 if there is none."""
    row = j - pixels.first_row
    if row < 0 or row >= len(pixels.first):
        return -1
    column = i - pixels.first[row]
    if column < 0 or column >= pixels.offsets[row + 1] - pixels.offsets[row]:
        return -1
    return pixels.offsets[row] + column


@part
def fixed_point(intensity):
    """A binary32 intensity in units of 2^-24, rounded to nearest."""
    return np.int64(min(np.float64(intensity), MAX_INTENSITY) * UNIT + 0.5)


def make_pixels(frame: Frame, space: Space, cell: Cell, before: Pixels | None = None) -> Pixels:
    """An empty store with room for every sample whose home is this cell.

    before  a store that nobody needs any more: its memory is used if it has the right size, since fresh memory is dear
    """
    first = np.full(frame.height, frame.width, np.int64)
    last = np.full(frame.height, -1, np.int64)
    _outline(frame, space, cell, first, last)
    rows = np.flatnonzero(last >= first)
    if len(rows) == 0:
        none = np.zeros(0, np.int64)
        return Pixels(0, none, np.zeros(1, np.int64), np.zeros((0, 3), np.int64), none)
    begin, end = int(rows[0]), int(rows[-1]) + 1
    widths = np.maximum(last[begin:end] - first[begin:end] + 1, 0)
    offsets = np.concatenate(([0], np.cumsum(widths))).astype(np.int64)
    total = int(offsets[-1])
    if before is not None and len(before.samples) == total:
        sums, samples = before.sums, before.samples
        sums[:], samples[:] = 0, 0
    else:
        sums, samples = np.zeros((total, 3), np.int64), np.zeros(total, np.int64)
    return Pixels(begin, first[begin:end].copy(), offsets, sums, samples)


def _outline(frame: Frame, space: Space, cell: Cell, first: Columns, last: Columns) -> None:
    """Widen the spans first..last until they cover every pixel that a sample at home here can have."""
    eye, along = frame.camera[0], frame.camera[3:]
    perspective = not frame.camera[1:3].any()
    solver = frame.camera[3:6] if perspective else np.stack((along[0], frame.camera[1], frame.camera[2]))
    if abs(np.linalg.det(solver)) < 1e-30 or not (perspective or not along[1:].any()):
        first[:], last[:] = 0, frame.width - 1  # a one-pixel axis, or neither kind of camera: no outline
        return
    inverse: NDArray[np.float64] = np.linalg.inv(solver).astype(np.float64)
    step = np.array(space.step, np.float64)
    low, high = np.array(cell.low_at) - MARGIN * step, np.array(cell.high_at) + MARGIN * step
    if perspective:
        nearest_inside = np.clip(eye, -HALF * step, HALF * step)
        near_world = np.all(np.abs(eye - nearest_inside) <= MARGIN * step)
        if near_world and np.all((nearest_inside >= low) & (nearest_inside <= high)):
            first[:], last[:] = 0, frame.width - 1  # the eye's own cell holds the whole picture
            return
    else:
        corners = _corners(low, high)
        depths = ((corners - eye) @ inverse)[:, 0]
        if depths.min() <= 0.0 <= depths.max():  # rays begin in this cell
            _add_outline(corners, eye, inverse, False, first, last, frame.width)
            return
    for axis in range(3):
        for side, outer in ((-1, cell.low[axis] == 0), (1, cell.high[axis] == LATTICE)):
            if perspective:
                enters = side * eye[axis] > (HALF - MARGIN) * step[axis]
            else:
                enters = side * along[0, axis] < PARALLEL * np.abs(along[0]).max()
            if outer and enters:
                face_low, face_high = low.copy(), high.copy()
                face_low[axis] = face_high[axis] = side * HALF * step[axis]
                _add_outline(_face(face_low, face_high, axis), eye, inverse, perspective, first, last, frame.width)


def _corners(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """The eight corners of a box."""
    return np.array([[(low, high)[n >> axis & 1][axis] for axis in range(3)] for n in range(8)])


def _face(low: NDArray[np.float64], high: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """The four corners of a flat box, in order round it."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    corners = np.tile(low, (4, 1))
    corners[1:3, u], corners[2:4, v] = high[u], high[v]
    return corners


def _add_outline(
    points: NDArray[np.float64],
    eye: NDArray[np.float64],
    inverse: NDArray[np.float64],
    perspective: bool,
    first: Columns,
    last: Columns,
    width: int,
) -> None:
    """Project points, and widen the spans over what they enclose, a pixel and a half to each side."""
    seen = (points - eye) @ inverse  # (s, s i, s j), orthographic: (s, i, j)
    if perspective:
        seen = _in_front(seen)
        if len(seen) < 3:
            return
        image = seen[:, 1:] / seen[:, :1]
    else:
        low, high = seen[:, 1:].min(0), seen[:, 1:].max(0)
        image = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    _scan(np.ascontiguousarray(image), first, last, width)


def _in_front(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Clip a polygon (s, s i, s j) to s >= NEAREST_DEPTH."""
    kept = []
    for here, there in zip(points, np.roll(points, -1, axis=0), strict=True):
        if here[0] >= NEAREST_DEPTH:
            kept.append(here)
        if (here[0] >= NEAREST_DEPTH) != (there[0] >= NEAREST_DEPTH):
            cut = here + (there - here) * ((NEAREST_DEPTH - here[0]) / (there[0] - here[0]))
            cut[0] = NEAREST_DEPTH  # exactly: all of the image is divided by it
            kept.append(cut)
    return np.array(kept).reshape(-1, 3)


@kernel
def _scan(image, first, last, width):
    """Widen the span of each row over a convex outline (n, 2), 1.5 pixels to each side.

    A sample lies within half a pixel of its pixel's middle; the rest is for rounding.
    """
    n = len(image)
    for row in range(len(first)):
        top, bottom = row - 1.5, row + 1.5
        low, high = np.inf, -np.inf
        for k in range(n):
            ax, ay = image[k]
            bx, by = image[(k + 1) % n]
            if top <= ay <= bottom:
                low, high = min(low, ax), max(high, ax)
            for border in (top, bottom):
                if (ay < border) != (by < border):
                    # from the nearer end: the other may be so far away that its digits do not reach to pixels
                    if abs(ay - border) <= abs(by - border):
                        x = ax + (bx - ax) * ((border - ay) / (by - ay))
                    else:
                        x = bx + (ax - bx) * ((border - by) / (ay - by))
                    low, high = min(low, x), max(high, x)
        if low <= high and high >= -1.5 and low <= width + 0.5:
            first[row] = min(first[row], max(np.int64(np.floor(low - 1.5)), 0))
            last[row] = max(last[row], min(np.int64(np.ceil(high + 1.5)), width - 1))


@kernel
def send_pixels(pixels, width, cursor, buffer, at, room, counts):
    """Write up to `room` pixel packets to `buffer` from byte `at`; returns (packets, next cursor), -1 at the end.

    `cursor` is (row << 32 | column in the row's span). A pixel whose sum or samples do not fit in one packet is sent in
    several; what is sent is taken out of the store, so an unfinished pixel simply stays.
    """
    row, column, made = cursor >> 32, cursor & 0xFFFFFFFF, 0
    while row < len(pixels.first):
        here = pixels.offsets[row] + column
        if here >= pixels.offsets[row + 1]:
            row, column = row + 1, 0
            continue
        left = pixels.samples[here] + pixels.sums[here, 0] + pixels.sums[here, 1] + pixels.sums[here, 2]
        if left == 0:
            column += 1
            continue
        if made == room:
            counts[BORN + PIXEL] += made
            return made, (row << 32) | column
        samples = min(pixels.samples[here], MAX_PIXEL_SAMPLES)
        r, g, b = (
            min(pixels.sums[here, 0], MAX_PIXEL_SUM),
            min(pixels.sums[here, 1], MAX_PIXEL_SUM),
            min(pixels.sums[here, 2], MAX_PIXEL_SUM),
        )
        number = (pixels.first_row + row) * width + pixels.first[row] + column
        put_pixel(buffer, at + made * SIZE, number, (r, g, b), samples)
        pixels.samples[here] -= samples
        pixels.sums[here, 0] -= r
        pixels.sums[here, 1] -= g
        pixels.sums[here, 2] -= b
        made += 1
    counts[BORN + PIXEL] += made
    return made, np.int64(-1)
