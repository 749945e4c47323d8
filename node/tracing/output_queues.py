"""Queues what a step writes: packets handed on, spawned rays, returns to their homes, intensities that are at home here.

Spawned rays and returns are noted first and written many at once (`node.tracing.spawn`, `node.tracing.primary_rays`):
`write_all_noted` must be the end of a step.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.grid_walk import HOST, NO_PORT, OUTPUTS, SELF, SELF_RAYS, towards_start
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.counters import BORN, DIED, HOMES, MISADDRESSED, SENT
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import RETURN, SIZE, copy_packet, put_return
from raygrid.node.tracing.camera import home
from raygrid.node.tracing.framebuffer import fixed_point, slot
from raygrid.node.tracing.primary_rays import (
    PrimaryBatch,
    entered_at,
    make_primary_batch,
    note_return,
    noted_return,
    pixel_of,
    work_out_returns,
)
from raygrid.node.tracing.ray_setup import SETUP_RAYS, RaySetup, make_ray_setup
from raygrid.node.tracing.spawn import (
    RAY_BATCH,
    SHADOW_BATCH,
    SpawnBatch,
    make_spawn_batch,
    note,
    put,
    starts_behind,
    work_out,
)


class Outputs(NamedTuple):
    """Output queues and scratch of a step: bytes uint8 (OUTPUTS, HEAD + room * SIZE), packets held int64 (OUTPUTS,).

    stack  int64, keys of the hierarchy; setup  rays that are set up; spawns, seen  rays to be spawned, and samples, noted
    """

    data: NDArray[np.uint8]
    held: NDArray[np.int64]
    stack: NDArray[np.int64]
    setup: RaySetup
    spawns: SpawnBatch
    seen: PrimaryBatch


def make_outputs(room: int, stack: int) -> Outputs:
    """Empty outputs with room for this many packets each."""
    return Outputs(
        np.empty((OUTPUTS, HEAD + room * SIZE), np.uint8),  # zeros may write all of it
        np.zeros(OUTPUTS, np.int64),
        np.zeros(stack, np.int64),
        make_ray_setup(),
        make_spawn_batch(),
        make_primary_batch(),
    )


def clear(outputs: Outputs) -> None:
    """Forget what outputs hold."""
    outputs.held[:] = 0
    outputs.spawns.held[:] = 0
    outputs.seen.held[:] = 0


@part
def _claim(outputs, output, counts):
    """Claim the next free packet of an output: its bytes, and the place in them at which it begins."""
    output = output & 15
    at = HEAD + outputs.held[output] * SIZE
    outputs.held[output] += 1
    counts[SENT + output] += 1
    return outputs.data[output], at


@part
def hand_on(packets, at, output, outputs, counts):
    """Copy a packet to an output."""
    row, to = _claim(outputs, output, counts)
    copy_packet(packets, at, row, to)


@part
def hand_on_all(packets, first, numbers, begin, many, ways, outputs, counts):
    """Hand on the packets first + j, each by the port ways[j], for the numbers j at places begin..begin+many-1."""
    held, data = outputs.held, outputs.data
    for port in range(HOST + 1):
        counts[SENT + port] -= held[port]
    for k in range(begin, begin + many):
        j = numbers[k] & (SETUP_RAYS - 1)
        port = ways[j] & 7
        copy_packet(packets, (first + j) * SIZE, data[port], HEAD + held[port] * SIZE)
        held[port] += 1
    for port in range(HOST + 1):
        counts[SENT + port] += held[port]


@part
def give_back(cell, space, frame, pixels, sample, depth, red, green, blue, outputs, counts):
    """Spawn a return packet, unless it would bring nothing; all are written if there is room to note no more."""
    intensity = (np.float32(red), np.float32(green), np.float32(blue))
    if not (intensity[0] > 0.0 or intensity[1] > 0.0 or intensity[2] > 0.0):
        return
    counts[BORN + RETURN] += 1
    counts[HOMES] += 1
    if note_return(outputs.seen, frame, sample, depth, intensity):
        _write_returns(cell, space, frame, pixels, outputs, counts)


@part
def _write_returns(cell, space, frame, pixels, outputs, counts):
    """Send home all return packets that are noted; those whose home is here die at once, in the pixel store."""
    seen = outputs.seen
    work_out_returns(space, frame, seen)
    for j in range(seen.held[0]):
        sample, depth, intensity = noted_return(seen, j)
        point = entered_at(seen, j)
        port = towards_start(cell, point)  # that to the sample's home, which holds this point
        if port == NO_PORT:
            keep(pixels, pixel_of(seen, j), intensity, counts)
        else:
            row, at = _claim(outputs, port, counts)
            put_return(row, at, depth, sample, intensity, home(space, point))
    seen.held[0] = 0


@part
def keep(pixels, pixel, intensity, counts):
    """Add an intensity to its pixel (column, row). The return packet dies."""
    here = slot(pixels, pixel[0], pixel[1])
    counts[DIED + RETURN] += 1
    if here < 0:
        counts[MISADDRESSED] += 1
        return
    for k in range(3):
        pixels.sums[here, k] += fixed_point(intensity[k])


@part
def emit(cell, space, spawn_batch, kind, sample, depth, light, p, g, d, weight, outputs, counts):
    """Note a ray to be spawned, and write all that are noted if there is room for no more."""
    counts[BORN + kind] += 1
    head = kind | (depth << 3) | (sample << 8)
    if note(outputs.spawns, spawn_batch, head, light, p, g, d, weight):
        _write_spawned(cell, space, spawn_batch, outputs, counts)


@part
def _write_spawned(cell, space, spawn_batch, outputs, counts):
    """Put all rays of a spawn batch on the outputs."""
    spawns = outputs.spawns
    work_out(cell, space, spawns, spawn_batch)
    for j in range(spawns.held[spawn_batch]):
        ports = starts_behind(spawns, spawn_batch, j)
        output = SELF if spawn_batch == SHADOW_BATCH else SELF_RAYS
        if ports != 0:
            output = 0
            while (ports >> output) & 1 == 0:
                output += 1
        row, at = _claim(outputs, output, counts)
        put(spawns, spawn_batch, j, row, at)
    spawns.held[spawn_batch] = 0


@part
def write_all_noted(cell, space, frame, pixels, outputs, counts):
    """Put all that is noted on the outputs."""
    _write_spawned(cell, space, SHADOW_BATCH, outputs, counts)
    _write_spawned(cell, space, RAY_BATCH, outputs, counts)
    _write_returns(cell, space, frame, pixels, outputs, counts)


@part
def noted(outputs):
    """Count the packets that are noted: they may all go to one output."""
    return outputs.spawns.held[SHADOW_BATCH] + outputs.spawns.held[RAY_BATCH] + outputs.seen.held[0]


@part
def fullest(held):
    """Count the packets of the fullest output."""
    most = np.int64(0)
    for k in range(len(held)):
        most = max(most, held[k])
    return most
