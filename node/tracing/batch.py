"""Runs a batch: as many ray steps as are worth one look at the links, over the packets that wait, the most urgent first.

All in compiled code: between two looks at its links a node goes over its work queues in portions that stay in the
processor's cache, and what a portion spawns for this node is served by the next one.
"""

from __future__ import annotations

from raygrid.node.geometry.grid_walk import SELF, SELF_RAYS
from raygrid.node.jit.decorators import part
from raygrid.node.jit.indirect import call_at
from raygrid.node.jit.intrinsics import copy_bytes
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import SIZE
from raygrid.node.tracing.output_queues import fullest
from raygrid.node.tracing.primaries import DONE, spawn_primaries
from raygrid.node.tracing.work_queues import CLASSES, IN_TRANSIT, MOST, RAYS, SHADOWS

PORTION = 2048  # packets in a call of the step
BATCH_RAYS = 8192  # packets after which the links are looked at
WORTHWHILE = 256  # packets for which a portion is worth more than serving classes strictly in order
ADMIT_BELOW = 1024  # primaries are spawned only while fewer rays than this wait
ADMIT_AT_ONCE = 2048
# why a batch ended: nothing waits; as many packets were served as the tuning says; an output, or a stack, is full
BATCH_IDLE, BATCH_LONG, BATCH_FULL, BATCH_CROWDED = 0, 1, 2, 3


@part
def _most_urgent(held):
    """Choose the class to serve next: the first with WORTHWHILE packets, else the first with any, else -1."""
    for kind in range(CLASSES):
        if held[kind] >= WORTHWHILE:
            return kind
    for kind in range(CLASSES):
        if held[kind] > 0:
            return kind
    return -1


@part
def _sink(packets, ports, first, done, held):
    """Remove the packets first..done-1 of a stack; what lies above them sinks. Returns how many are left."""
    above = held - done
    if done > first:
        for k in range(above * SIZE):
            packets[first * SIZE + k] = packets[done * SIZE + k]
        for k in range(above):
            ports[first + k] = ports[done + k]
    return first + above


@part
def _take_own(outputs, output, packets, ports, held):
    """Move what starts in this node to its stack; returns how many are there."""
    many = outputs.held[output]
    row, to = outputs.data[output], held * SIZE
    copy_bytes(row, HEAD, packets, to, many * SIZE)
    for k in range(many):
        ports[held + k] = SELF
    outputs.held[output] = 0
    return held + many


@part
def run_batch(tables, ray_step, cursor, quota, tuning, stacks, held):
    """Serve what waits until nothing does or one of the reasons above. Returns (quota left, why it ended, packets
    served).

    tables    `step_tables.StepTables`
    ray_step  the `indirect.Address` of a `step` (`node.tracing.step`): it is called by its address, so that this is compiled
              once, whatever the step is made of
    cursor    the place of the next primary (`node.tracing.primaries`); quota: primaries that may be spawned
    tuning    a record with batch_packets (after which it ends), admit_below (rays that wait, below which primaries are
              spawned) and admit_at_once (how many primaries)
    stacks    `work_queues.Stacks`; held: int64 (CLASSES + 1,), updated
    """
    outputs, frame, served = tables.outputs, tables.frame, 0
    room = (outputs.data.shape[1] - HEAD) // SIZE
    lights = max(frame.n_lights, 2)
    while served < tuning.batch_packets:
        if quota > 0 and cursor[DONE] == 0 and held[RAYS] < tuning.admit_below:
            many = min(quota, min(tuning.admit_at_once, len(stacks.ray_ports) - held[RAYS]))
            if many == 0:
                return quota, BATCH_CROWDED, served
            made = spawn_primaries(tables, cursor, stacks.rays, held[RAYS], many)
            for k in range(held[RAYS], held[RAYS] + made):
                stacks.ray_ports[k] = SELF
            held[RAYS] += made
            quota -= made
            served += made
        kind = _most_urgent(held)
        if kind < 0:
            return quota, BATCH_IDLE, served
        first = max(0, held[kind] - PORTION)
        many = (held[kind] - first) * lights
        if held[SHADOWS] + many > len(stacks.shadow_ports) or held[RAYS] + many > len(stacks.ray_ports):
            return quota, BATCH_CROWDED, served
        packets, ports = stacks.rays, stacks.ray_ports
        if kind == IN_TRANSIT:
            packets, ports = stacks.in_transit, stacks.transit_ports
        elif kind == SHADOWS:
            packets, ports = stacks.shadows, stacks.shadow_ports
        done = call_at(ray_step, (tables, packets, ports, first, held[kind]))
        held[kind] = _sink(packets, ports, first, done, held[kind])
        held[SHADOWS] = _take_own(outputs, SELF, stacks.shadows, stacks.shadow_ports, held[SHADOWS])
        held[RAYS] = _take_own(outputs, SELF_RAYS, stacks.rays, stacks.ray_ports, held[RAYS])
        held[MOST] = max(held[MOST], held[IN_TRANSIT] + held[SHADOWS] + held[RAYS])
        served += done - first
        if room - fullest(outputs.held) < frame.n_lights + 2:
            return quota, BATCH_FULL, served
    return quota, BATCH_LONG, served
