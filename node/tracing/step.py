"""Takes the ray step: does with packets what a node has to. A pure function of cell, surfaces, frame and packets.

Packets go in as 25-byte rows with the port by which each came; what comes out is written to one row of
bytes an output (six ports, host, and what starts in this node), intensities that are at home here to the
pixel store, and costs to an array of counts. The node process, the in-memory array, the timed emulator
and the simulator all call `step`, the last two with one packet at a time.

A step is made of its parts (`make_step`): what a program brings takes the place of some of them, and a step that is
observed, for explanations and for the sampling pre-pass, notes what each ray met.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from raygrid.node.geometry.grid_walk import HOST, NO_PORT, leaves_array, towards_cell, towards_start
from raygrid.node.geometry.lattice import T_MIN
from raygrid.node.geometry.spanning_tree import towards_corner_part
from raygrid.node.jit.decorators import Function, part
from raygrid.node.jit.simd import EIGHT
from raygrid.node.protocol.counters import BOXES, DIED, WALKS
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import (
    PIXEL,
    RETURN,
    SHADOW,
    SIZE,
    get_intensity,
    read_depth,
    read_kind,
    read_origin,
    read_u16,
    read_u24,
    read_u32,
    read_weight,
    unpack_shadow_weight,
)
from raygrid.node.tracing.output_queues import fullest, give_back, hand_on, hand_on_all, keep, noted, write_all_noted
from raygrid.node.tracing.ray_classify import (
    ENDING,
    PASSING,
    box_of_all,
    classify,
    ends_of_array,
    unfinished,
)
from raygrid.node.tracing.ray_setup import (
    NOT_AT_START,
    SETUP_RAYS,
    SETUP_ROOM,
    boxes_of,
    column,
    read_prepared,
    set_up_rays,
    take_root,
)
from raygrid.node.tracing.secondary_rays import in_full, make_shade
from raygrid.node.tracing.shading import light_discs, normals
from raygrid.node.tracing.step_tables import note_hit, note_ray
from raygrid.node.tracing.traverse import Search, make_blocked, make_closest, meet

# what is done with a packet, by its kind
WALKS_ON, SHADOWS_ON, SETTLES = 0, 1, 2
EVERYWHERE = np.float32(1e38)  # a box from minus to plus this holds whatever a ray meets


@part
def edge_colour(frame, d):
    """Colour of a ray that leaves the scene in direction d: the background, or the disc of a light."""
    red, green, blue = frame.background
    return light_discs(frame, d, red, green, blue)


class Parts(NamedTuple):
    """What a ray step is made of; each a `part`.

    meet         (t, u, v) of one surface: meet(surfaces, kind, row, origin, direction, lower, upper)
    normals      (outward, shading): normals(surfaces, item, point, u, v)
    lit          the weight with which light counts: lit(frame, material, point, normal, weight)
    edge_colour  what a ray sees that leaves the scene: edge_colour(frame, direction)
    observed     whether what each ray meets is noted in `Outputs.found`, of a shadow ray the nearest surface. So other
                 boxes and tests are counted of shadow rays; nothing else differs
    """

    meet: Function = meet
    normals: Function = normals
    lit: Function = in_full
    edge_colour: Function = edge_colour
    observed: bool = False


# --- what ends or goes on ------------------------------------------------------------------------------


@part
def _hand_to_start(tables, packets, at):
    """Hand a ray on towards the cell of its origin."""
    port = towards_start(tables.cell, read_origin(packets, at))
    hand_on(packets, at, port, tables.outputs, tables.counts)


@part
def _bring_home(tables, packets, at, kind, colour):
    """Let a ray die that leaves the scene, and send home what it sees there."""
    sample, depth = read_u32(packets, at + 1), read_depth(packets, at)
    weight = read_weight(packets, at)
    tables.counts[DIED + kind] += 1
    give_back(tables, sample, depth, (weight[0] * colour[0], weight[1] * colour[1], weight[2] * colour[2]))


@part
def _reach_light(tables, packets, at):
    """Let a shadow ray die that reaches its light, and send home what it carries."""
    tables.counts[DIED + SHADOW] += 1
    red = unpack_shadow_weight(read_u24(packets, at + 16))
    green = unpack_shadow_weight(read_u24(packets, at + 19))
    blue = unpack_shadow_weight(read_u24(packets, at + 22))
    sample, depth = read_u32(packets, at + 1), read_depth(packets, at)
    give_back(tables, sample, depth, (red, green, blue))


@part
def _way_home(cell, packets, at):
    """The port by which a return packet is handed on to its home; NO_PORT: that is here."""
    return towards_cell(
        cell.index, (read_u16(packets, at + 17), read_u16(packets, at + 19), read_u16(packets, at + 21))
    )


@part
def _keep(frame, pixels, packets, at, counts):
    """Add the intensity of a return packet to its pixel."""
    pixel = read_u32(packets, at + 1) // frame.samples
    row = pixel // frame.width
    keep(pixels, (pixel - row * frame.width, row), get_intensity(packets, at), counts)


@part
def _sort_of_step(kind):
    """Number of the sort of step that a packet of this kind takes."""
    return np.int64(kind >= SHADOW) + np.int64(kind > SHADOW)


@part
def _alike(packets, first, last):
    """(sort of step of packet `first`, the first packet after it with another, or `last`)."""
    what, others = _sort_of_step(read_kind(packets, first * SIZE)), 0
    for k in range(first + 1, last):  # nearly always there are none, and without a branch that is soon known
        others |= _sort_of_step(read_kind(packets, k * SIZE)) ^ what
    end = last
    if others != 0:
        end = first + 1
        while _sort_of_step(read_kind(packets, end * SIZE)) == what:
            end += 1
    return what, end


@part
def _settle_each(tables, packets, first, last):
    """Step packets first..last-1, all of them returns or pixels: a return is kept at its home, else handed on towards it, a
    pixel goes to the host. Those that go on before those that are at home, without a branch for each."""
    cell, outputs, counts = tables.cell, tables.outputs, tables.counts
    ways, lists = outputs.setup.ways, outputs.setup.lists
    output, passing, ending = towards_corner_part(cell.index, tables.space.shape), 0, 0
    for j in range(last - first):
        at = (first + j) * SIZE
        is_return = read_kind(packets, at) == RETURN
        ways[j] = _way_home(cell, packets, at) if is_return else output
        counts[DIED + PIXEL] += (not is_return) & (output == HOST)
        lists[PASSING * SETUP_ROOM + passing] = lists[ENDING * SETUP_ROOM + ending] = j
        passing += ways[j] != NO_PORT
        ending += ways[j] == NO_PORT
    hand_on_all(packets, first, lists, PASSING * SETUP_ROOM, passing, ways, outputs, counts)
    for k in range(ending):
        at = (first + (lists[ENDING * SETUP_ROOM + k] & (SETUP_RAYS - 1))) * SIZE
        _keep(tables.frame, tables.pixels, packets, at, counts)


@part
def _marks(tables, many):
    """(box of all, ways that lead to no neighbour) for `many` rays, see `node.tracing.ray_classify`.

    To work out the box takes longer than to look into the root for a ray or two: they get one that holds everything.
    """
    floats = tables.surfaces.floats
    ends = ends_of_array(tables.cell.index, tables.space.shape)
    if many >= EIGHT or len(floats) == 0:
        return box_of_all(floats), ends
    return (-EVERYWHERE, -EVERYWHERE, -EVERYWHERE, EVERYWHERE, EVERYWHERE, EVERYWHERE), ends


# --- a ray that is set up ------------------------------------------------------------------------------


@part
def _note_rays(outputs, first, many, shadows):
    """Note the rays that are set up, of the packets from the first on."""
    for j in range(many):
        ray = column(outputs.setup, j)
        note_ray(outputs.found, first + j, ray, ray[6] if shadows else np.inf)


@cache
def _make_step_ray(parts: Parts) -> Function:
    """Make `step_ray`, which steps a primary, reflected or refracted ray."""
    closest_below, shade = make_closest(parts.meet), make_shade(parts.normals, parts.lit)
    edge_colour, observed = parts.edge_colour, parts.observed

    @part
    def step_ray(tables, packets, k, j):
        """Step the ray of packet k, which is set up in column j."""
        outputs, counts, at = tables.outputs, tables.counts, k * SIZE
        kind = read_kind(packets, at)
        way, o, d, _, t_in, t_out, _ = column(outputs.setup, j)
        if way == NOT_AT_START:
            _hand_to_start(tables, packets, at)
            return
        met = take_root(outputs.setup, j, outputs.stack)
        counts[WALKS] += 1
        if met == 0:
            counts[BOXES] += len(tables.surfaces.floats) > 0
        else:
            ray = Search(o, d, boxes_of(outputs.setup, j), max(t_in, T_MIN), t_out)
            t, item, u, v = closest_below(tables.surfaces, outputs.stack, met, ray, counts)
            if item >= 0:
                p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
                inside = shade(tables, packets, at, kind, d, (t, item, u, v, p))
                if observed:
                    note_hit(outputs.found, k, item, t, inside)
                return
        if leaves_array(tables.cell.index, tables.space.shape, way):
            _bring_home(tables, packets, at, kind, edge_colour(tables.frame, d))
        else:
            hand_on(packets, at, way, outputs, counts)

    return step_ray


@cache
def _make_is_blocked(meet: Function, observed: bool) -> Function:
    """Make `is_blocked`, which tells whether a shadow ray meets anything; one that is observed meets the nearest."""
    closest_below, blocked_below = make_closest(meet), make_blocked(meet)

    @part
    def is_blocked(tables, met, ray, k):
        """Tell whether the ray of packet k meets anything; met  keys of the root that are on the stack."""
        return blocked_below(tables.surfaces, tables.outputs.stack, met, ray, tables.counts)

    @part
    def is_seen_blocked(tables, met, ray, k):
        t, item, _, _ = closest_below(tables.surfaces, tables.outputs.stack, met, ray, tables.counts)
        note_hit(tables.outputs.found, k, item, t, False)
        return item >= 0

    return is_seen_blocked if observed else is_blocked


@cache
def _make_step_shadow(meet: Function, observed: bool) -> Function:
    """Make `step_shadow`, which steps a shadow ray."""
    is_blocked = _make_is_blocked(meet, observed)

    @part
    def step_shadow(tables, packets, k, j):
        """Step the shadow ray of packet k, which is set up in column j: forgotten at the first surface, a return packet
        where it reaches its light."""
        outputs, counts, at = tables.outputs, tables.counts, k * SIZE
        way, o, d, _, t_in, t_out, distance = column(outputs.setup, j)
        if way == NOT_AT_START:
            _hand_to_start(tables, packets, at)
            return
        met = take_root(outputs.setup, j, outputs.stack)
        counts[WALKS] += 1
        if met == 0:
            counts[BOXES] += len(tables.surfaces.floats) > 0
        ray = Search(o, d, boxes_of(outputs.setup, j), max(t_in, T_MIN), min(t_out, distance))
        if met > 0 and is_blocked(tables, met, ray, k):
            counts[DIED + SHADOW] += 1
        elif distance <= t_out or leaves_array(tables.cell.index, tables.space.shape, way):
            _reach_light(tables, packets, at)
        else:
            hand_on(packets, at, way, outputs, counts)

    return step_shadow


# --- the step ------------------------------------------------------------------------------------------


@cache
def _make_step_each(parts: Parts) -> Function:
    """Make `step_each`, which steps rays that are set up."""
    step_ray, step_shadow = _make_step_ray(parts), _make_step_shadow(parts.meet, parts.observed)
    observed = parts.observed

    @part
    def step_each(tables, packets, first, many, shadows, marks):
        """Step `many` packets from the first on, all of shadow rays or none, that are set up already; marks as `_marks`."""
        outputs, counts = tables.outputs, tables.counts
        setup = outputs.setup
        if observed:
            _note_rays(outputs, first, many, shadows)
        passing, ending, searched = classify(tables.surfaces, many, shadows, *marks, setup)
        counts[WALKS] += passing
        counts[BOXES] += passing if len(tables.surfaces.floats) > 0 else 0
        hand_on_all(packets, first, setup.lists, PASSING * SETUP_ROOM, passing, setup.ways, outputs, counts)
        for k in range(ending + searched):
            j = unfinished(setup, k, ending)
            if shadows:
                step_shadow(tables, packets, first + j, j)
            else:
                step_ray(tables, packets, first + j, j)

    return step_each


@cache
def make_step(parts: Parts) -> Function:
    """Make the ray step of these parts. The same parts give the same step, which is compiled once."""
    step_each = _make_step_each(parts)

    @part
    def step(tables, packets, ports, first, last):
        """Process packets first..last-1 of `packets` (uint8, 25 bytes each) that came by `ports` (uint8).

        tables  `step_tables.StepTables`
        Stops early when an output might overflow, and returns the number of the first packet not processed.
        A packet gives at most one packet a light, a reflected and a refracted ray.
        """
        outputs, frame = tables.outputs, tables.frame
        room = (outputs.data.shape[1] - HEAD) // SIZE
        marks = _marks(tables, last - first)
        k = first
        while True:
            # so many packets cannot fill an output, whatever they spawn: no need to look at each
            free = room - fullest(outputs.held) - noted(outputs)
            stop = min(last, k + min(SETUP_RAYS, free // (frame.n_lights + 2)))
            if stop <= k:
                if noted(outputs) == 0:
                    return k
                write_all_noted(tables)
                continue
            what, stop = _alike(packets, k, stop)
            if what == SETTLES:
                _settle_each(tables, packets, k, stop)
            else:
                shadows = what == SHADOWS_ON
                read_prepared(frame, packets, ports, k, stop, shadows, outputs.setup)
                set_up_rays(tables.cell, tables.space, stop - k, shadows, outputs.setup)
                step_each(tables, packets, k, stop - k, shadows, marks)
            k = stop

    return step


step = make_step(Parts())
observed_step = make_step(Parts(observed=True))
