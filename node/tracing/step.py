"""Takes the ray step: does with packets what a node has to. A pure function of cell, surfaces, frame and packets.

Packets go in as 25-byte rows with the port by which each came; what comes out is written to one row of
bytes an output (six ports, host, and what starts in this node), intensities that are at home here to the
pixel store, and costs to an array of counts. The node process and the in-memory array call `step`, with many packets;
the timed processes and the simulator, which have to know what each costs, call `step_one`. The two set up rays in different
ways, and whatever is done with a ray that is set up is the same function.

A step is made of its parts (`make_step`): what a program brings takes the place of some of them, and a step that is
observed, for explanations and for the sampling pre-pass, notes what each ray met.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raygrid.node.geometry.bvh_boxes import for_boxes
from raygrid.node.geometry.grid_walk import HOST, NO_PORT, leaves_array, towards_cell, towards_start
from raygrid.node.geometry.lattice import T_MIN
from raygrid.node.geometry.spanning_tree import towards_corner_part
from raygrid.node.jit.closures import made_of_parts
from raygrid.node.jit.decorators import Function, lean, part
from raygrid.node.protocol.counters import BOXES, DIED, WALKS
from raygrid.node.protocol.frame_tables import LAYER_NONE
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
from raygrid.node.tracing.shading import edge_colour, normals
from raygrid.node.tracing.single_ray import open_root_for, set_up_ray
from raygrid.node.tracing.step_tables import note_hit, note_ray
from raygrid.node.tracing.traverse import Search, make_blocked, make_closest, meet

# what is done with a packet, by its kind
WALKS_ON, SHADOWS_ON, SETTLES = 0, 1, 2


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
def _walks_here(tables, packets, at, way, met):
    """Tell whether a ray walks through this cell, and count that, and the root if it meets none of its boxes. One that has to
    go to the cell of its origin first is handed on towards it."""
    outputs, counts = tables.outputs, tables.counts
    if way == NOT_AT_START:
        hand_on(packets, at, towards_start(tables.cell, read_origin(packets, at)), outputs, counts)
        return False
    counts[WALKS] += 1
    counts[BOXES] += (met == 0) & (len(tables.surfaces.floats) > 0)
    return True


@part
def _bring_home(tables, packets, at, kind, colour):
    """Let a ray die that leaves the scene, and send home what it sees there: in a layer, nothing."""
    sample, depth = read_u32(packets, at + 1), read_depth(packets, at)
    weight = read_weight(packets, at)
    tables.counts[DIED + kind] += 1
    if tables.frame.layer == LAYER_NONE:
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
def _settle(tables, packets, at, kind):
    """Step one return packet, kept at its home, else handed on towards it; or a pixel, on its way to the host."""
    cell, counts = tables.cell, tables.counts
    if kind == RETURN:
        output = _way_home(cell, packets, at)
    else:
        output = towards_corner_part(cell.index, tables.space.shape)
        counts[DIED + PIXEL] += output == HOST
    if output == NO_PORT:
        _keep(tables.frame, tables.pixels, packets, at, counts)
    else:
        hand_on(packets, at, output, tables.outputs, counts)


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
    """Step packets first..last-1, all of them returns or pixels, as `_settle` does each.

    Those that go on before those that are at home, without a branch for each.
    """
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


# --- a ray that is set up ------------------------------------------------------------------------------


@part
def _note_rays(outputs, first, many, shadows):
    """Note the rays that are set up, of the packets from the first on."""
    for j in range(many):
        ray = column(outputs.setup, j)
        note_ray(outputs.found, first + j, ray, ray[6] if shadows else np.inf)


@made_of_parts
def _make_step_ray(parts: Parts) -> Function:
    """Make `step_ray`, which steps a primary, reflected or refracted ray."""
    closest_below, shade = make_closest(parts.meet), make_shade(parts.normals, parts.lit)
    edge_colour, observed = parts.edge_colour, parts.observed

    @part
    def step_ray(tables, packets, at, ray, boxes, met):
        """Step the ray of the packet at `at`, which is set up.

        ray    (way, origin, direction, inverse direction, t_in, t_out, distance), as of `ray_setup.column`
        boxes  the same as `bvh_boxes.for_boxes` gives it; met  how many keys of the root's boxes are on the stack
        """
        outputs, counts, kind = tables.outputs, tables.counts, read_kind(packets, at)
        way, o, d, _, t_in, t_out, _ = ray
        if not _walks_here(tables, packets, at, way, met):
            return
        if met > 0:
            search = Search(o, d, boxes, max(t_in, T_MIN), t_out)
            t, item, u, v = closest_below(tables.surfaces, outputs.stack, met, search, counts)
            if item >= 0:
                p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
                inside = shade(tables, packets, at, kind, d, (t, item, u, v, p))
                if observed:
                    note_hit(outputs.found, at // SIZE, item, t, inside)
                return
        if leaves_array(tables.cell.index, tables.space.shape, way):
            _bring_home(tables, packets, at, kind, edge_colour(tables.frame, d))
        else:
            hand_on(packets, at, way, outputs, counts)

    return step_ray


@made_of_parts
def _make_is_blocked(meet: Function, observed: bool) -> Function:
    """Make `is_blocked`, which tells whether a shadow ray meets anything; one that is observed meets the nearest."""
    closest_below, blocked_below = make_closest(meet), make_blocked(meet)

    @part
    def is_blocked(tables, at, met, search):
        """Tell whether the ray of the packet at `at` meets anything."""
        return blocked_below(tables.surfaces, tables.outputs.stack, met, search, tables.counts)

    @part
    def is_seen_blocked(tables, at, met, search):
        t, item, _, _ = closest_below(tables.surfaces, tables.outputs.stack, met, search, tables.counts)
        note_hit(tables.outputs.found, at // SIZE, item, t, False)
        return item >= 0

    return is_seen_blocked if observed else is_blocked


@made_of_parts
def _make_step_shadow(meet: Function, observed: bool) -> Function:
    """Make `step_shadow`, which steps a shadow ray."""
    is_blocked = _make_is_blocked(meet, observed)

    @part
    def step_shadow(tables, packets, at, ray, boxes, met):
        """Step a shadow ray, arguments as of `step_ray`: forgotten at the first surface, a return packet where it reaches its
        light."""
        outputs, counts = tables.outputs, tables.counts
        way, o, d, _, t_in, t_out, distance = ray
        if not _walks_here(tables, packets, at, way, met):
            return
        search = Search(o, d, boxes, max(t_in, T_MIN), min(t_out, distance))
        if met > 0 and is_blocked(tables, at, met, search):
            counts[DIED + SHADOW] += 1
        elif distance <= t_out or leaves_array(tables.cell.index, tables.space.shape, way):
            _reach_light(tables, packets, at)
        else:
            hand_on(packets, at, way, outputs, counts)

    return step_shadow


# --- the step ------------------------------------------------------------------------------------------


@made_of_parts
def _make_step_each(parts: Parts) -> Function:
    """Make `step_each`, which steps rays that are set up."""
    step_ray, step_shadow = _make_step_ray(parts), _make_step_shadow(parts.meet, parts.observed)
    observed = parts.observed

    @part
    def step_each(tables, packets, first, many, shadows, marks):
        """Step `many` packets from the first on, all of shadow rays or none, that are set up already.

        marks  (box of all, ways that lead to no neighbour), see `node.tracing.ray_classify`
        """
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
            at = (first + j) * SIZE
            ray, boxes, met = column(setup, j), boxes_of(setup, j), take_root(setup, j, outputs.stack)
            if shadows:
                step_shadow(tables, packets, at, ray, boxes, met)
            else:
                step_ray(tables, packets, at, ray, boxes, met)

    return step_each


@made_of_parts
def make_step(parts: Parts) -> Function:
    """Make the ray step of these parts. The same parts give the same step, while it is among the last that were made."""
    step_each = _make_step_each(parts)

    @lean
    def step(tables, packets, ports, first, last):
        """Process packets first..last-1 of `packets` (uint8, 25 bytes each) that came by `ports` (uint8).

        tables  `step_tables.StepTables`
        Stops early when an output might overflow, and returns the number of the first packet not processed.
        A packet gives at most one packet a light, a reflected and a refracted ray.
        """
        outputs, frame = tables.outputs, tables.frame
        room = (outputs.data.shape[1] - HEAD) // SIZE
        marks = (box_of_all(tables.surfaces.floats), ends_of_array(tables.cell.index, tables.space.shape))
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


step, observed_step = make_step(Parts()), make_step(Parts(observed=True))
_step_ray, _step_shadow = _make_step_ray(Parts()), _make_step_shadow(Parts().meet, Parts().observed)


@part
def step_one(tables, packets, at, port):
    """Process the packet at byte `at` of `packets` that came by a port, for those who serve packets one at a time."""
    outputs, kind = tables.outputs, read_kind(packets, at)
    if kind == RETURN or kind == PIXEL:
        _settle(tables, packets, at, kind)
        return
    ray = set_up_ray(tables.cell, tables.space, tables.frame, packets, at, port, kind)
    met = open_root_for(tables.surfaces, ray, outputs.stack)
    boxes = for_boxes(ray[1], ray[3])
    if kind == SHADOW:
        _step_shadow(tables, packets, at, ray, boxes, met)
    else:
        _step_ray(tables, packets, at, ray, boxes, met)
    write_all_noted(tables)
