"""Asks the same tables again, by the same functions, what the ray step found. For explanations, never for pictures."""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry import T_MIN, inverse, passage
from raygrid.node.jit import lean
from raygrid.node.protocol import IOR, SHADOW, TRANSMISSION, read_u16, read_u24, read_u32, unit_vector, unpack_weight
from raygrid.node.tracing import (
    closest,
    edge_colour,
    entry,
    eye_ray,
    fixed_point,
    home,
    image_point,
    light_direction,
    normals,
    place,
    refract,
)


@lean
def begin(space, frame, sample):
    """(whether the eye's ray of a sample enters the world box, the sample's home, the ray's direction)."""
    x, y = image_point(sample, frame.width, frame.samples)
    origin, direction = eye_ray(frame.camera, x, y)
    enters, point, _ = entry(space.step, origin, direction)
    return enters, home(space, point), direction


@lean
def sees_outside(frame, direction):
    """The units of 2^-24 that a sample adds whose ray never enters the world box."""
    colour = edge_colour(frame, direction)
    return (
        fixed_point(np.float32(colour[0])),
        fixed_point(np.float32(colour[1])),
        fixed_point(np.float32(colour[2])),
    )


@lean
def carries_home(frame, packet):
    """The intensity, three binary32, that a ray (not a shadow ray) brings home if it leaves the world here."""
    weight = unpack_weight(read_u32(packet, 20) | (np.int64(packet[24]) << 32))
    colour = edge_colour(frame, unit_vector(read_u24(packet, 14), read_u24(packet, 17)))
    return np.float32(weight[0] * colour[0]), np.float32(weight[1] * colour[1]), np.float32(weight[2] * colour[2])


@lean
def find_hit(cell, space, frame, surfaces, packet, stack, counts):
    """What a ray or shadow ray that walks through a cell meets first in it.

    (item or -1, surface id, material, t, point, direction, whether all of it is reflected inside, exit port of the cell).
    stack: scratch as for `closest`; counts: scratch, int64 (COUNTS,).
    """
    origin = (read_u24(packet, 5), read_u24(packet, 8), read_u24(packet, 11))
    o = place(origin, space.step)
    if np.int64(packet[0]) & 7 == SHADOW:
        d, upper = light_direction(frame.lights, read_u16(packet, 14), o)
    else:
        d, upper = unit_vector(read_u24(packet, 14), read_u24(packet, 17)), np.inf
    inv = (inverse(d[0]), inverse(d[1]), inverse(d[2]))
    t_in, t_out, leave = passage(cell, o, inv)
    item, t, u, v = np.int64(-1), upper, 0.0, 0.0
    if len(surfaces.floats) > 0:
        t, item, u, v = closest(surfaces, stack, o, d, inv, max(t_in, T_MIN), min(t_out, upper), counts)
    if item < 0:
        return np.int64(-1), np.int64(-1), np.int64(-1), t, o, d, False, leave
    p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    material = np.int64(surfaces.materials[item])
    m = frame.materials
    inside = False
    if m[material, TRANSMISSION] > 0.0 or m[material, TRANSMISSION + 1] > 0.0 or m[material, TRANSMISSION + 2] > 0.0:
        g, n = normals(surfaces, item, p, u, v)
        cosine = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
        if cosine < 0.0:
            n, cosine = (-n[0], -n[1], -n[2]), -cosine
        entering = d[0] * g[0] + d[1] * g[1] + d[2] * g[2] < 0.0
        passes, _ = refract(d, n, cosine, 1.0 / m[material, IOR] if entering else m[material, IOR])
        inside = not passes
    return np.int64(item), np.int64(surfaces.ids[item]), material, t, p, d, inside, leave
