"""Takes the ray step: does with packets what a node has to. A pure function of cell, surfaces, frame and packets.

Packets go in as 25-byte rows with the port by which each came; what comes out is written to one row of
bytes an output (six ports, host, and what starts in this node), intensities that are at home here to the
pixel store, and costs to an array of counts. The node process, the in-memory array, the timed emulator
and the simulator all call `step`.
"""

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.bvh_boxes import for_boxes
from raygrid.node.geometry.grid_walk import (
    HOST,
    NO_PORT,
    inverse,
    is_before_start,
    leaves_array,
    passage,
    towards_cell,
    towards_start,
)
from raygrid.node.geometry.lattice import T_MIN
from raygrid.node.geometry.power import power
from raygrid.node.geometry.spanning_tree import towards_corner_part
from raygrid.node.jit.decorators import lean, part
from raygrid.node.protocol.counters import BOXES, DIED, HITS, WALKS
from raygrid.node.protocol.frame_tables import DIFFUSE, HIGHLIGHT, IOR, SHINE, SPECULAR, TRANSMISSION
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import (
    PIXEL,
    REFLECTED,
    REFRACTED,
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
from raygrid.node.protocol.packing import unit_vector
from raygrid.node.tracing.output_queues import (
    emit,
    fullest,
    give_back,
    hand_on,
    hand_on_all,
    keep,
    noted,
    write_all_noted,
)
from raygrid.node.tracing.ray_classify import ENDING, PASSING, box_of_all, classify, ends_of_array, unfinished
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
from raygrid.node.tracing.shading import edge_colour, light_direction, light_intensity, normals, place, refract
from raygrid.node.tracing.spawn import RAY_BATCH, SHADOW_BATCH
from raygrid.node.tracing.traverse import blocked_below, closest_below, open_root

# what is done with a packet, by its kind
WALKS_ON, SHADOWS_ON, SETTLES = 0, 1, 2


@part
def _spawn_ray(cell, space, frame, kind, depth, sample, p, g, d, weight, outputs, counts):
    """Spawn a reflected or refracted ray, unless it is too faint."""
    if max(weight[0], weight[1], weight[2]) > frame.min_weight:
        emit(cell, space, RAY_BATCH, kind, sample, depth, 0, p, g, d, weight, outputs, counts)


@part
def _spawn_shadows(cell, space, frame, material, depth, sample, p, g, n, mirror, weight, outputs, counts):
    """Spawn a shadow ray to each light that faces the surface; it carries what it will add."""
    m = frame.materials
    for light in range(frame.n_lights):
        to_light, distance = light_direction(frame.lights, light, p)
        cosine = n[0] * to_light[0] + n[1] * to_light[1] + n[2] * to_light[2]
        if not cosine > 0.0:
            continue
        intensity = light_intensity(frame.lights, light, to_light, distance)
        shine = 0.0
        if m[material, HIGHLIGHT] > 0.0 or m[material, HIGHLIGHT + 1] > 0.0 or m[material, HIGHLIGHT + 2] > 0.0:
            along = mirror[0] * to_light[0] + mirror[1] * to_light[1] + mirror[2] * to_light[2]
            shine = power(max(along, 0.0), m[material, SHINE])
        adds = (
            weight[0] * intensity[0] * (m[material, DIFFUSE] * cosine + m[material, HIGHLIGHT] * shine),
            weight[1] * intensity[1] * (m[material, DIFFUSE + 1] * cosine + m[material, HIGHLIGHT + 1] * shine),
            weight[2] * intensity[2] * (m[material, DIFFUSE + 2] * cosine + m[material, HIGHLIGHT + 2] * shine),
        )
        emit(cell, space, SHADOW_BATCH, SHADOW, sample, depth, light, p, g, to_light, adds, outputs, counts)


@part
def _shade(cell, space, frame, surfaces, packets, at, kind, o, d, t, item, u, v, outputs, counts):
    """Shade a hit, at which the incoming ray dies; the rays that it spawns are put on the outputs."""
    sample, depth = read_u32(packets, at + 1), read_depth(packets, at)
    weight = read_weight(packets, at)
    p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    g, n = normals(surfaces, item, p, u, v)
    material = np.int64(surfaces.materials[item])
    counts[DIED + kind] += 1
    counts[HITS] += 1
    cosine = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    if cosine < 0.0:
        n, cosine = (-n[0], -n[1], -n[2]), -cosine
    mirror = (d[0] + 2.0 * cosine * n[0], d[1] + 2.0 * cosine * n[1], d[2] + 2.0 * cosine * n[2])
    _spawn_shadows(cell, space, frame, material, depth, sample, p, g, n, mirror, weight, outputs, counts)
    if depth >= frame.depth:
        return
    m = frame.materials
    ks = (m[material, SPECULAR], m[material, SPECULAR + 1], m[material, SPECULAR + 2])
    if ks[0] > 0.0 or ks[1] > 0.0 or ks[2] > 0.0:
        reflected = (weight[0] * ks[0], weight[1] * ks[1], weight[2] * ks[2])
        _spawn_ray(cell, space, frame, REFLECTED, depth + 1, sample, p, g, mirror, reflected, outputs, counts)
    kt = (m[material, TRANSMISSION], m[material, TRANSMISSION + 1], m[material, TRANSMISSION + 2])
    if kt[0] > 0.0 or kt[1] > 0.0 or kt[2] > 0.0:
        entering = d[0] * g[0] + d[1] * g[1] + d[2] * g[2] < 0.0
        ratio = 1.0 / m[material, IOR] if entering else m[material, IOR]
        passes, direction = refract(d, n, cosine, ratio)
        if passes:
            weight = (weight[0] * kt[0], weight[1] * kt[1], weight[2] * kt[2])
        else:  # total internal reflection: a reflected ray in its place, with the whole weight
            direction = mirror
        spawned = REFRACTED if passes else REFLECTED
        _spawn_ray(cell, space, frame, spawned, depth + 1, sample, p, g, direction, weight, outputs, counts)


@part
def _at_edge(cell, space, frame, pixels, packets, at, kind, d, outputs, counts):
    """A ray that leaves the scene brings home the background, or the light that it is directed towards."""
    sample, depth = read_u32(packets, at + 1), read_depth(packets, at)
    weight = read_weight(packets, at)
    red, green, blue = edge_colour(frame, d)
    counts[DIED + kind] += 1
    give_back(
        cell, space, frame, pixels, sample, depth, weight[0] * red, weight[1] * green, weight[2] * blue, outputs, counts
    )


@part
def _set_up(cell, space, frame, packets, at, port, kind):
    """Set up a ray or shadow ray before any surface is looked at: (way, o, d, inv, t_in, t_out, distance).

    way  the exit port; NOT_AT_START for one that has to go to the cell of its origin first
    """
    origin = read_origin(packets, at)
    o = place(origin, space.step)
    if kind == SHADOW:
        d, distance = light_direction(frame.lights, read_u16(packets, at + 14), o)
    else:
        d, distance = unit_vector(read_u24(packets, at + 14), read_u24(packets, at + 17)), np.inf
    inv = (inverse(d[0]), inverse(d[1]), inverse(d[2]))
    t_in, t_out, way = passage(cell, o, inv)
    if is_before_start(cell, origin, port):
        way = NOT_AT_START
    return way, o, d, inv, t_in, t_out, distance


@part
def _step_ray(cell, space, frame, surfaces, pixels, packets, at, kind, ray, boxes, met, outputs, counts):
    """Step a primary, reflected or refracted ray.

    ray  what `_set_up` gives; boxes  what `for_boxes` does; met  keys of the root on the stack
    """
    way, o, d, _, t_in, t_out, _ = ray
    if way == NOT_AT_START:
        hand_on(packets, at, towards_start(cell, read_origin(packets, at)), outputs, counts)
        return
    counts[WALKS] += 1
    if met == 0:
        counts[BOXES] += len(surfaces.floats) > 0
    else:
        t, item, u, v = closest_below(surfaces, outputs.stack, met, o, d, boxes, max(t_in, T_MIN), t_out, counts)
        if item >= 0:
            _shade(cell, space, frame, surfaces, packets, at, kind, o, d, t, item, u, v, outputs, counts)
            return
    if leaves_array(cell.index, space.shape, way):
        _at_edge(cell, space, frame, pixels, packets, at, kind, d, outputs, counts)
    else:
        hand_on(packets, at, way, outputs, counts)


@part
def _step_shadow(cell, space, frame, surfaces, pixels, packets, at, ray, boxes, met, outputs, counts):
    """Step a shadow ray: forgotten at the first surface, a return packet where it reaches its light."""
    way, o, d, _, t_in, t_out, distance = ray
    if way == NOT_AT_START:
        hand_on(packets, at, towards_start(cell, read_origin(packets, at)), outputs, counts)
        return
    counts[WALKS] += 1
    upper = min(t_out, distance)
    if met == 0:
        counts[BOXES] += len(surfaces.floats) > 0
    if met > 0 and blocked_below(surfaces, outputs.stack, met, o, d, boxes, max(t_in, T_MIN), upper, counts):
        counts[DIED + SHADOW] += 1
    elif distance <= t_out or leaves_array(cell.index, space.shape, way):
        counts[DIED + SHADOW] += 1
        red = unpack_shadow_weight(read_u24(packets, at + 16))
        green = unpack_shadow_weight(read_u24(packets, at + 19))
        blue = unpack_shadow_weight(read_u24(packets, at + 22))
        sample, depth = read_u32(packets, at + 1), read_depth(packets, at)
        give_back(cell, space, frame, pixels, sample, depth, red, green, blue, outputs, counts)
    else:
        hand_on(packets, at, way, outputs, counts)


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
def _settle(cell, space, frame, pixels, packets, at, kind, outputs, counts):
    """Step a return packet, kept at its home, else handed on towards it; or a pixel packet."""
    if kind == RETURN:
        port = _way_home(cell, packets, at)
        if port == NO_PORT:
            _keep(frame, pixels, packets, at, counts)
        else:
            hand_on(packets, at, port, outputs, counts)
    else:
        output = towards_corner_part(cell.index, space.shape)
        if output == HOST:
            counts[DIED + PIXEL] += 1
        hand_on(packets, at, output, outputs, counts)


@part
def step_one(cell, space, frame, surfaces, pixels, packets, at, port, outputs, counts):
    """Take the ray step of one packet."""
    kind = read_kind(packets, at)
    if kind == RETURN or kind == PIXEL:
        _settle(cell, space, frame, pixels, packets, at, kind, outputs, counts)
        return
    ray = _set_up(cell, space, frame, packets, at, port, kind)
    _, o, _, inv, t_in, t_out, distance = ray
    met, upper = 0, min(t_out, distance)
    if len(surfaces.floats) > 0:
        met = open_root(surfaces, outputs.stack, 0, o, inv, max(t_in, T_MIN), upper)
    boxes = for_boxes(o, inv)
    if kind == SHADOW:
        _step_shadow(cell, space, frame, surfaces, pixels, packets, at, ray, boxes, met, outputs, counts)
    else:
        _step_ray(cell, space, frame, surfaces, pixels, packets, at, kind, ray, boxes, met, outputs, counts)
    write_all_noted(cell, space, frame, pixels, outputs, counts)


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
def _settle_each(cell, space, frame, pixels, packets, first, last, outputs, counts):
    """Step packets first..last-1, all of them returns or pixels: as `_settle`, those that go on before those that are at
    home, without a branch for each."""
    ways, lists = outputs.setup.ways, outputs.setup.lists
    output, passing, ending = towards_corner_part(cell.index, space.shape), 0, 0
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
        _keep(frame, pixels, packets, (first + (lists[ENDING * SETUP_ROOM + k] & (SETUP_RAYS - 1))) * SIZE, counts)


@part
def _step_each(cell, space, frame, surfaces, pixels, packets, first, many, shadows, marks, outputs, counts):
    """Take the ray step of `many` packets from the first on, all of shadow rays or none, that are set up already.

    marks  (box of all, ways that lead to no neighbour), see `node.tracing.ray_classify`
    """
    setup = outputs.setup
    passing, ending, searched = classify(surfaces, many, shadows, *marks, setup)
    counts[WALKS] += passing
    counts[BOXES] += passing if len(surfaces.floats) > 0 else 0
    hand_on_all(packets, first, setup.lists, PASSING * SETUP_ROOM, passing, setup.ways, outputs, counts)
    for k in range(ending + searched):
        j = unfinished(setup, k, ending)
        at = (first + j) * SIZE
        ray, boxes, met = column(setup, j), boxes_of(setup, j), take_root(setup, j, outputs.stack)
        if shadows:
            _step_shadow(cell, space, frame, surfaces, pixels, packets, at, ray, boxes, met, outputs, counts)
        else:
            kind = read_kind(packets, at)
            _step_ray(cell, space, frame, surfaces, pixels, packets, at, kind, ray, boxes, met, outputs, counts)


@lean
def step(cell, space, frame, surfaces, pixels, packets, ports, first, last, outputs, counts):
    """Process packets first..last-1 of `packets` (uint8, 25 bytes each) that came by `ports` (uint8).

    Stops early when an output might overflow, and returns the number of the first packet not processed.
    A packet gives at most one packet a light, a reflected and a refracted ray.
    """
    room = (outputs.data.shape[1] - HEAD) // SIZE
    marks = (box_of_all(surfaces.floats), ends_of_array(cell.index, space.shape))
    k = first
    while True:
        # so many packets cannot fill an output, whatever they spawn: no need to look at each
        stop = min(last, k + min(SETUP_RAYS, (room - fullest(outputs.held) - noted(outputs)) // (frame.n_lights + 2)))
        if stop <= k:
            if noted(outputs) == 0:
                return k
            write_all_noted(cell, space, frame, pixels, outputs, counts)
            continue
        what, stop = _alike(packets, k, stop)
        if what == SETTLES:
            _settle_each(cell, space, frame, pixels, packets, k, stop, outputs, counts)
        else:
            shadows = what == SHADOWS_ON
            read_prepared(frame, packets, ports, k, stop, shadows, outputs.setup)
            set_up_rays(cell, space, stop - k, shadows, outputs.setup)
            _step_each(cell, space, frame, surfaces, pixels, packets, k, stop - k, shadows, marks, outputs, counts)
        k = stop
