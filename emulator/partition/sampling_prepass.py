"""Samples what a frame's rays will do, before any array traces them: a quick pre-pass.

A coarse grid of the picture's rays is traced to full depth through the whole scene in one cell, by the nodes' own step
and hierarchy, and of each ray and shadow ray is kept where it begins, its direction, and how far it goes.
`emulator.partition.cost_grid` counts from that what any cell would have to do.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.partition.kernels import FACTS, record_rays
from raygrid.node import geometry, tracing
from raygrid.node.protocol import COUNTS, HEAD, SIZE, Frame

Bytes = NDArray[np.uint8]
ACROSS = 48  # rays of the pre-pass along a side of the picture
MOST_RAYS = 200_000  # rays followed, whatever lights and mirrors there are
CHUNK = 8192  # packets in a call
ROOM = 65_536  # packets that an output holds
MOST_SURFACES = 20_000  # a hierarchy of these is built in 25 ms
LARGEST = 2_000  # of them, how many are kept for their size


class PrepassRays(NamedTuple):
    """Rays of a pre-pass, shadow rays among them.

    origins  int64 (n, 3), lattice; homes int64 (n, 3), where the primary ray of the sample begins
    facts    float64 (n, FACTS): direction; T_END, the ray crosses planes up to this time; whether it is a primary
             ray, is shaded where it ends, and brings an intensity home from there
    """

    origins: NDArray[np.int64]
    homes: NDArray[np.int64]
    facts: geometry.F64


class SamplingPrepass(NamedTuple):
    """What was seen of a frame.

    surfaces  the hierarchy of the whole scene, or of a part that stands for it
    boxes     of these surfaces, float64 (n, 2, 3); each stands for `each` of the scene
    step      of the lattice, on each axis
    share     samples of the frame for each one of the pre-pass
    """

    rays: PrepassRays
    surfaces: geometry.Surfaces
    boxes: geometry.F64
    each: float
    step: tuple[float, float, float]
    share: float


def run_prepass(
    steps: tuple[float, float, float], surfaces: geometry.SurfaceSet, frame: Frame, across: int = ACROSS
) -> SamplingPrepass:
    """Trace a coarse grid of the frame's rays through surfaces in machine coordinates."""
    space = geometry.make_space(steps, [[0, geometry.LATTICE]] * 3)
    cell = geometry.make_cell(space, (0, 0, 0))
    coarse = coarse_frame(frame, across)
    chosen = stand_ins(surfaces)
    boxes = np.concatenate([batch.bounds() for batch in chosen])
    built = tracing.build_surfaces(chosen, cell)
    share = frame.width * frame.height * frame.samples / (coarse.width * coarse.height)
    return SamplingPrepass(_trace(space, cell, coarse, built), built, boxes, len(surfaces) / len(boxes), steps, share)


def coarse_frame(frame: Frame, across: int) -> Frame:
    """The same view with few pixels, in arrays of the types for which kernels were compiled."""
    width, height = min(frame.width, across), min(frame.height, across)
    wide, high = frame.width / width, frame.height / height
    camera = np.array(frame.camera, np.float64, order="C")
    for at, along, down in ((0, 1, 2), (3, 4, 5)):
        camera[at] += (0.5 * wide - 0.5) * camera[along] + (0.5 * high - 0.5) * camera[down]
        camera[along] *= wide
        camera[down] *= high
    materials, lights = (np.array(table, np.float64, order="C") for table in (frame.materials, frame.lights))
    return frame._replace(camera=camera, materials=materials, lights=lights, width=width, height=height, samples=1)


# --- a part of a large scene -----------------------------------------------------------------------------


def stand_ins(surfaces: geometry.SurfaceSet, most: int = MOST_SURFACES) -> geometry.SurfaceSet:
    """At most about this many surfaces that stand for all: the largest, and every so manieth of the others, made
    larger to cover twice the area of those that they stand for (then a ray misses one in e^2)."""
    if len(surfaces) <= most:
        return geometry.merge(surfaces)
    sizes = [_sizes(batch) for batch in surfaces]
    limit = np.partition(np.concatenate(sizes), len(surfaces) - LARGEST)[len(surfaces) - LARGEST]
    stride = math.ceil(len(surfaces) / (most - LARGEST))
    chosen = []
    for batch, size in zip(surfaces, sizes, strict=True):
        large = np.flatnonzero(size > limit)  # fewer than LARGEST, none if all are of one size
        others = np.arange(0, len(batch), stride)
        chosen += [batch.select(large), _enlarged(batch.select(others[size[others] <= limit]), math.sqrt(2 * stride))]
    return geometry.merge(chosen)


def _sizes(batch: geometry.Batch) -> NDArray[np.floating]:
    """A length of each surface, cheap to work out for a million."""
    data = batch.data
    if batch.kind not in (geometry.Kind.TRIANGLE, geometry.Kind.SMOOTH):
        boxes = batch.bounds()
        edges: geometry.F64 = (boxes[:, 1] - boxes[:, 0]).max(axis=1)
        return edges
    size = np.zeros(len(data), data.dtype)
    for column in range(3, 9):
        np.maximum(size, np.abs(data[:, column] - data[:, column % 3]), out=size)
    return size


def _enlarged(batch: geometry.Batch, factor: float) -> geometry.Batch:
    """Each surface made larger about its middle."""
    data = batch.data.astype(np.float64)
    if len(batch) == 0:
        return batch
    if batch.kind == geometry.Kind.POLYGON:
        counts = np.diff(batch.starts)
        middles = np.repeat(np.add.reduceat(data, batch.starts[:-1]) / counts[:, None], counts, axis=0)
        data = middles + (data - middles) * factor
    elif batch.kind == geometry.Kind.SPHERE:
        data[:, 3] *= factor
    else:
        points = [slice(0, 3), slice(3, 6), slice(6, 9)]
        if batch.kind in (geometry.Kind.CYLINDER, geometry.Kind.CONE):
            points = [slice(0, 3), slice(4, 7)]
            data[:, [3, 7]] *= factor
        middle = sum(data[:, point] for point in points) / len(points)
        for point in points:
            data[:, point] = middle + (data[:, point] - middle) * factor
    return geometry.Batch(
        batch.kind, batch.ids, batch.materials, data.astype(geometry.STORED_AS[batch.kind]), batch.starts
    )


# --- the rays --------------------------------------------------------------------------------------------


def _trace(space: geometry.Space, cell: geometry.Cell, frame: Frame, surfaces: geometry.Surfaces) -> PrepassRays:
    """Every ray of the frame, generation by generation, until none is left or MOST_RAYS are done."""
    outputs = tracing.make_outputs(max(ROOM, 2 * (frame.n_lights + 2)), geometry.DEPTH, CHUNK)
    counts, ports = np.zeros(COUNTS, np.int64), np.full(CHUNK, geometry.SELF, np.uint8)
    tables = tracing.StepTables(cell, space, frame, surfaces, tracing.make_pixels(frame, space, cell), outputs, counts)
    room = frame.width * frame.height
    first = np.zeros(room * SIZE, np.uint8)
    born = tracing.spawn_primaries(tables, tracing.new_cursor(len(tables.pixels.first) > 0), first, 0, room)
    waiting = _pieces(first[: born * SIZE])
    found: list[PrepassRays] = [_no_rays(0)]
    total = 0
    while waiting and total < MOST_RAYS:
        packets = waiting.pop(0)
        done, rays = _observe(tables, packets, ports)
        if done < len(packets) // SIZE:  # the outputs are full
            waiting.insert(0, packets[done * SIZE :].copy())
        shadows, others = (_taken(outputs, output) for output in (geometry.SELF, geometry.SELF_RAYS))
        found += [rays, *(_observe(tables, piece, ports)[1] for piece in _pieces(shadows))]
        total += done + len(shadows) // SIZE
        waiting += _pieces(others)
    return PrepassRays(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _observe(tables: tracing.StepTables, packets: Bytes, ports: Bytes) -> tuple[int, PrepassRays]:
    """(how many packets there was room for, those rays): hand packets, at most CHUNK, to an observed step."""
    done = tracing.observed_step(tables, packets, ports, 0, len(packets) // SIZE)
    rays = _no_rays(done)
    record_rays(tables, packets, rays)
    return done, rays


def _taken(outputs: tracing.Outputs, output: int) -> Bytes:
    """What the step has put on an output, which is empty then."""
    packets = outputs.data[output, HEAD : HEAD + int(outputs.held[output]) * SIZE].copy()
    outputs.held[output] = 0
    return packets


def _pieces(packets: Bytes) -> list[Bytes]:
    return [packets[at : at + CHUNK * SIZE] for at in range(0, len(packets), CHUNK * SIZE)]


def _no_rays(many: int) -> PrepassRays:
    return PrepassRays(np.zeros((many, 3), np.int64), np.zeros((many, 3), np.int64), np.zeros((many, FACTS)))
