"""Traces and spawns once more, aside, and times each part of it, for `node.runtime.profile`."""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.lattice import T_MIN
from raygrid.node.jit.decorators import lean
from raygrid.node.protocol.packets import SHADOW, SIZE
from raygrid.node.runtime.timers import DECODING, NO_PLACE, SEARCHING, SPAWNING, WALKING, count_time
from raygrid.node.tracing.primaries import spawn_primaries
from raygrid.node.tracing.ray_setup import SETUP_RAYS, column, read_prepared, set_up_rays
from raygrid.node.tracing.traverse import blocked, closest


@lean
def _trace_again(tables, packets, ports, first, last, until, counts):
    """Decode packets first..last-1, of one class, and walk and search up to the part `until`; a number that depends on
    all of it. tables  `step_tables.StepTables`"""
    surfaces, outputs = tables.surfaces, tables.outputs
    used, ahead = 0.0, outputs.setup
    shadow = (np.int64(packets[first * SIZE]) & 7) == SHADOW
    for k in range(first, last, SETUP_RAYS):
        many = min(SETUP_RAYS, last - k)
        read_prepared(tables.frame, packets, ports, k, k + many, shadow, ahead)
        used += ahead.words[0]
        if until == DECODING:
            continue
        set_up_rays(tables.cell, tables.space, many, shadow, ahead)
        used += ahead.ways[0]
        if until == WALKING or len(surfaces.floats) == 0:
            continue
        for j in range(many):
            _, o, d, inv, t_in, t_out, distance = column(ahead, j)
            lower = max(t_in, T_MIN)
            if shadow:
                used += blocked(surfaces, outputs.stack, o, d, inv, lower, min(t_out, distance), counts)
            else:
                used += closest(surfaces, outputs.stack, o, d, inv, lower, t_out, counts)[1]
    return used


@lean
def time_tracing(node, packets, ports, first, last, counts):
    """Time decoding, walking and searching of packets first..last-1, of one class: `Timers.spent` gets each part's own time.

    node    `node_tables.NodeTables`, of which nothing but scratch is written
    counts  int64 (COUNTS,), others than the node's; returns a number that depends on all that was worked out
    """
    timers, before, used = node.timers, np.int64(0), 0.0
    for until in range(DECODING, SEARCHING + 1):
        since = count_time(timers, NO_PLACE, np.int64(0))
        used += _trace_again(node.step, packets, ports, first, last, until, counts)
        spent = count_time(timers, NO_PLACE, np.int64(0)) - since
        timers.spent[until] += max(spent - before, 0)  # each begins with what the one before did
        before = spent
    return used


@lean
def time_spawning(timers, tables, cursor, packets, most):
    """Time the spawning of primary rays, at most so many, into `packets`, uint8 (most * SIZE,); returns how many were.

    tables  `step_tables.StepTables`; its pixels and counts, and cursor, others than the node's
    """
    since = count_time(timers, NO_PLACE, np.int64(0))
    made = spawn_primaries(tables, cursor, packets, 0, most)
    count_time(timers, SPAWNING, since)
    return made
