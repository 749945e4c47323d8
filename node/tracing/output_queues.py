"""Queues what a step writes: packets handed on, spawned rays, returns to their homes, intensities that are at home here.

Spawned rays and returns are noted first and written many at once (`node.tracing.spawn`, `node.tracing.primary_rays`):
`write_all_noted` must be the end of a step.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.grid_walk import HOST, NO_PORT, OUTPUTS, SELF, SELF_RAYS, towards_start
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.counters import BORN, DIED, HOMES, MISADDRESSED, SENT
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import RETURN, SIZE, copy_packet, put_return
from raygrid.node.tracing.camera import home
from raygrid.node.tracing.framebuffer import fixed_point, slot
from raygrid.node.tracing.primary_rays import (
    entered_at,
    make_primary_batch,
    note_return,
    noted_return,
    pixel_of,
    work_out_returns,
)
from raygrid.node.tracing.ray_setup import SETUP_RAYS, make_ray_setup
from raygrid.node.tracing.spawn import (
    RAY_BATCH,
    SHADOW_BATCH,
    make_spawn_batch,
    note,
    put,
    starts_behind,
    work_out,
)
from raygrid.node.tracing.step_tables import FOUND_FACTS, Found, Outputs


def make_outputs(room: int, stack: int, observed: int = 0) -> Outputs:
    """Empty outputs with room for this many packets each; `observed`: most packets that an observed step is given."""
    return Outputs(
        np.empty((OUTPUTS, HEAD + room * SIZE), np.uint8),  # zeros may write all of it
        np.zeros(OUTPUTS, np.int64),
        np.zeros(stack, np.int64),
        make_ray_setup(),
        make_spawn_batch(),
        make_primary_batch(),
        Found(np.zeros((observed, FOUND_FACTS)), np.full(observed, -1, np.int64), np.zeros(observed, np.uint8)),
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
def give_back(tables, sample, depth, colour):
    """Spawn a return packet, unless it would bring nothing; all are written if there is room to note no more."""
    intensity = (np.float32(colour[0]), np.float32(colour[1]), np.float32(colour[2]))
    if not (intensity[0] > 0.0 or intensity[1] > 0.0 or intensity[2] > 0.0):
        return
    tables.counts[BORN + RETURN] += 1
    tables.counts[HOMES] += 1
    if note_return(tables.outputs.seen, tables.frame, sample, depth, intensity):
        _write_returns(tables)


@part
def _write_returns(tables):
    """Send home all return packets that are noted; those whose home is here die at once, in the pixel store."""
    seen = tables.outputs.seen
    work_out_returns(tables.space, tables.frame, seen)
    for j in range(seen.held[0]):
        sample, depth, intensity = noted_return(seen, j)
        point = entered_at(seen, j)
        port = towards_start(tables.cell, point)  # that to the sample's home, which holds this point
        if port == NO_PORT:
            keep(tables.pixels, pixel_of(seen, j), intensity, tables.counts)
        else:
            row, at = _claim(tables.outputs, port, tables.counts)
            put_return(row, at, depth, sample, intensity, home(tables.space, point))
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
def emit(tables, spawn_batch, head, light, p, g, d, weight):
    """Note a ray to be spawned, and write all that are noted if there is room for no more.

    head  what its packet begins with: kind, depth << 3, sample << 8
    """
    tables.counts[BORN + (head & 7)] += 1
    if note(tables.outputs.spawns, spawn_batch, head, light, p, g, d, weight):
        _write_spawned(tables, spawn_batch)


@part
def _write_spawned(tables, spawn_batch):
    """Put all rays of a spawn batch on the outputs."""
    outputs, spawns = tables.outputs, tables.outputs.spawns
    work_out(tables.cell, tables.space, spawns, spawn_batch)
    for j in range(spawns.held[spawn_batch]):
        ports = starts_behind(spawns, spawn_batch, j)
        output = SELF if spawn_batch == SHADOW_BATCH else SELF_RAYS
        if ports != 0:
            output = 0
            while (ports >> output) & 1 == 0:
                output += 1
        row, at = _claim(outputs, output, tables.counts)
        put(spawns, spawn_batch, j, row, at)
    spawns.held[spawn_batch] = 0


@part
def write_all_noted(tables):
    """Put all that is noted on the outputs."""
    _write_spawned(tables, SHADOW_BATCH)
    _write_spawned(tables, RAY_BATCH)
    _write_returns(tables)


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
