"""Works out origins, directions and times of one ray with branches: the reference of formulas over lanes."""

import math

import numpy as np

from raygrid.node.geometry.bvh_boxes import FAREST, WIDE
from raygrid.node.geometry.grid_walk import HUGE, NO_PORT, SELF
from raygrid.node.geometry.lattice import FINE, GENTLE, HALF, LATTICE, LIFT, LONGEST_STEP, SLOW
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.frame_tables import LIGHT_KIND, LIGHT_PLACE
from raygrid.node.protocol.packets import SHADOW, read_origin, read_u16, read_u24
from raygrid.node.protocol.packing import SHORTEST
from raygrid.node.tracing.camera import R2_X, R2_Y, TRIES
from raygrid.node.tracing.ray_setup import NOT_AT_START
from reference.packing import unit_vector

MOST_TRIES = 16
LARGEST_INTEGER = 2**63 - 1


@part
def inverse(d):
    """1 / d, finite for d = 0 (and never larger than HUGE)."""
    return HUGE if abs(d) < 1.0 / HUGE else 1.0 / d


@part
def towards_start(cell, origin):
    """The port on the way to the cell that holds this lattice origin, x before y before z; NO_PORT: it is here."""
    if origin[0] < cell.low[0]:
        return 0
    if origin[0] >= cell.high[0]:
        return 1
    if origin[1] < cell.low[1]:
        return 2
    if origin[1] >= cell.high[1]:
        return 3
    if origin[2] < cell.low[2]:
        return 4
    if origin[2] >= cell.high[2]:
        return 5
    return NO_PORT


@part
def is_walking(cell, origin, port):
    """Tell whether a ray that came in by `port` has left the cell of its origin behind on that axis.

    If its hop brought it nearer to that cell instead, it is still on its way to its start.
    """
    if port == SELF:
        return False
    if port == 0:  # came from the neighbour at -x, so it moved along +x
        return origin[0] < cell.low[0]
    if port == 1:
        return origin[0] >= cell.high[0]
    if port == 2:
        return origin[1] < cell.low[1]
    if port == 3:
        return origin[1] >= cell.high[1]
    if port == 4:
        return origin[2] < cell.low[2]
    return origin[2] >= cell.high[2]


@part
def _axis_times(at, inv, low_at, high_at):
    """(time of entry, time of exit) of one axis; entry is not above 0 if the origin lies between the planes, or where
    the ray goes away from them."""
    low, high = (low_at - at) * inv, (high_at - at) * inv
    return min(low, high), max(low, high)


@part
def passage(cell, at, inv):
    """(t_in, t_out, exit port) of a walking ray.

    at  its origin, inv  its inverse direction.
    A hit at t belongs to this cell if t_in <= t < t_out; t_in is not above 0 in the cell of the origin.
    The exit port is the axis with the least exit time, ties in the order x, y, z.

    There are no branches: which way a ray goes can hardly be foreseen, and a processor that guessed wrong begins again.
    """
    in_x, out_x = _axis_times(at[0], inv[0], cell.low_at[0], cell.high_at[0])
    in_y, out_y = _axis_times(at[1], inv[1], cell.low_at[1], cell.high_at[1])
    in_z, out_z = _axis_times(at[2], inv[2], cell.low_at[2], cell.high_at[2])
    out_yz = min(out_y, out_z)
    x, y, z = 1 if inv[0] >= 0.0 else 0, 3 if inv[1] >= 0.0 else 2, 5 if inv[2] >= 0.0 else 4
    yz = y if out_y <= out_z else z
    return max(in_x, max(in_y, in_z)), min(out_x, out_yz), x if out_x <= out_yz else yz


@part
def towards_cell(index, target):
    """The port on the way to another cell, x before y before z; NO_PORT: it is this one. Without a branch."""
    x, y, z = 0 if target[0] < index[0] else 1, 2 if target[1] < index[1] else 3, 4 if target[2] < index[2] else 5
    port = z if target[2] != index[2] else NO_PORT
    port = y if target[1] != index[1] else port
    return x if target[0] != index[0] else port


@part
def coordinate(k, step):
    """The number that a lattice coordinate stands for."""
    return (k - HALF) * step


@part
def nearest(x, step):
    """The lattice coordinate nearest to a number, inside the world box."""
    k = math.floor(x / step + 0.5) + HALF
    return np.int64(min(k if k > 0.0 else 0.0, LATTICE - 1.0))  # what is no number lies at 0, too


@part
def _worth(speed, step):
    """Worth of an axis' coordinate on the lattice: the more, the coarser its lattice, if the ray is not slow on it."""
    return abs(speed) * step if abs(speed) >= SLOW else 0.0


@part
def beside_ray(step, p, d, tries):
    """The lattice coordinates of a point beside the ray that starts at p in direction d, at p or a little further on.

    Rounding p would put the ray up to 0.87 steps aside, but a step along itself changes nothing of what it sees. So of
    the next `tries` points (at most MOST_TRIES) at which one coordinate lies on the lattice, the one is taken whose
    others miss it least.
    """
    x, y, z = p[0] / step[0], p[1] / step[1], p[2] / step[2]
    u, v, w = d[0] / step[0], d[1] / step[1], d[2] / step[2]
    of_x, of_y, of_z = _worth(d[0], step[0]), _worth(d[1], step[1]), _worth(d[2], step[2])
    place, speed = (x, u) if of_x >= max(of_y, of_z) else ((y, v) if of_y >= of_z else (z, w))
    inverse = 1.0 / speed
    first = ((math.ceil(place) if speed > 0.0 else math.floor(place)) - place) * inverse
    stride = max(1.0, math.floor(LONGEST_STEP * abs(speed))) * abs(inverse)
    # the number of the point is kept in the low bits of what is compared: so the loop runs on vectors
    best = np.int64(LARGEST_INTEGER)
    for k in range(tries):
        t = first + k * stride
        a, b, c = x + t * u, y + t * v, z + t * w
        a = (a - math.floor(a + 0.5)) * step[0]
        b = (b - math.floor(b + 0.5)) * step[1]
        c = (c - math.floor(c + 0.5)) * step[2]
        along = a * d[0] + b * d[1] + c * d[2]
        aside = a * a + b * b + c * c - along * along
        best = min(best, np.int64(aside * FINE) * MOST_TRIES + k)
    t = first + (best & (MOST_TRIES - 1)) * stride
    return (
        nearest(p[0] + t * d[0], step[0]),
        nearest(p[1] + t * d[1], step[1]),
        nearest(p[2] + t * d[2], step[2]),
    )


@part
def hash32(x):
    """Mix the bits of a 32-bit number (the finaliser of MurmurHash3)."""
    x = np.uint32(x)
    x = np.uint32((x ^ (x >> np.uint32(16))) * np.uint32(0x85EBCA6B))
    x = np.uint32((x ^ (x >> np.uint32(13))) * np.uint32(0xC2B2AE35))
    return np.uint32(x ^ (x >> np.uint32(16)))


@part
def image_point(sample, width, samples):
    """(i, j) of a sample: the pixel's middle for one sample a pixel, else spread evenly over the pixel."""
    pixel = sample // samples
    j = pixel // width
    i = pixel - j * width
    if samples == 1:
        return np.float64(i), np.float64(j)
    number = sample - pixel * samples
    mixed = np.int64(hash32(pixel))
    x = (mixed & 0xFFFF) / 65536.0 + (number + 1) * R2_X
    y = (mixed >> 16) / 65536.0 + (number + 1) * R2_Y
    return i + (x - np.floor(x)) - 0.5, j + (y - np.floor(y)) - 0.5


@part
def eye_ray(camera, i, j):
    """((origin), (direction)) of the ray through an image point; the direction is a unit vector, +z if it has none."""
    origin = (
        camera[0, 0] + i * camera[1, 0] + j * camera[2, 0],
        camera[0, 1] + i * camera[1, 1] + j * camera[2, 1],
        camera[0, 2] + i * camera[1, 2] + j * camera[2, 2],
    )
    direction = (
        camera[3, 0] + i * camera[4, 0] + j * camera[5, 0],
        camera[3, 1] + i * camera[4, 1] + j * camera[5, 1],
        camera[3, 2] + i * camera[4, 2] + j * camera[5, 2],
    )
    squared = direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2]
    if not squared >= SHORTEST * SHORTEST:
        return origin, (0.0, 0.0, 1.0)
    scale = 1.0 / np.sqrt(squared)
    return origin, (direction[0] * scale, direction[1] * scale, direction[2] * scale)


@part
def _slab(at, inv, half):
    a, b = (-half - at) * inv, (half - at) * inv
    return (a, b) if inv >= 0.0 else (b, a)


@part
def reach(step, origin, direction):
    """(t, t): at which a primary ray enters the world box, 0 if the eye is inside, and leaves it."""
    near_x, far_x = _slab(origin[0], inverse(direction[0]), HALF * step[0])
    near_y, far_y = _slab(origin[1], inverse(direction[1]), HALF * step[1])
    near_z, far_z = _slab(origin[2], inverse(direction[2]), HALF * step[2])
    return max(near_x, max(near_y, max(near_z, 0.0))), min(far_x, min(far_y, far_z))


@part
def entry(step, origin, direction):
    """(enters, (lattice point), t) of a primary ray and the world box; its home is the cell of that point."""
    near, far = reach(step, origin, direction)
    point = (
        nearest(origin[0] + near * direction[0], step[0]),
        nearest(origin[1] + near * direction[1], step[1]),
        nearest(origin[2] + near * direction[2], step[2]),
    )
    return near <= far, point, near


@part
def primary_origin(step, origin, direction, near):
    """Lattice origin of a primary ray that enters the world box at t = near: a little further on, to be on the ray."""
    start = (origin[0] + near * direction[0], origin[1] + near * direction[1], origin[2] + near * direction[2])
    return beside_ray(step, start, direction, TRIES)


@part
def origin_beside(step, p, g, d):
    """Lattice origin of a ray spawned at p: lifted off the surface to the side that it goes to, then rounded.

    It is moved along itself, which changes nothing of what it sees. A ray that leaves at a grazing angle would have to
    go far, so it is lifted along the normal g by what is lacking.
    """
    slope = g[0] * d[0] + g[1] * d[1] + g[2] * d[2]
    along = LIFT / max(abs(slope), GENTLE)
    lacking = LIFT - along * abs(slope)
    side = lacking if slope >= 0.0 else -lacking
    start = (p[0] + along * d[0] + side * g[0], p[1] + along * d[1] + side * g[1], p[2] + along * d[2] + side * g[2])
    return beside_ray(step, start, d, 1)


@part
def light_direction(lights, light, p):
    """((unit vector from p to a light), distance); the distance of a directional light is infinite."""
    x, y, z = lights[light, LIGHT_PLACE], lights[light, LIGHT_PLACE + 1], lights[light, LIGHT_PLACE + 2]
    if lights[light, LIGHT_KIND] == 0.0:
        return (x, y, z), np.inf
    x, y, z = x - p[0], y - p[1], z - p[2]
    distance = np.sqrt(x * x + y * y + z * z)
    scale = 1.0 / distance if distance > 0.0 else 0.0
    return (x * scale, y * scale, z * scale), distance


@part
def place(origin, step):
    """The numbers that lattice coordinates stand for."""
    return coordinate(origin[0], step[0]), coordinate(origin[1], step[1]), coordinate(origin[2], step[2])


@part
def _narrow(inverse):
    """An inverse direction in binary32, finite."""
    return np.float32(min(max(inverse, -FAREST), FAREST))


@part
def for_boxes(o, inv):
    """(origin and inverse direction in binary32, the words of a node at which each axis' near planes begin)."""
    ray = (np.float32(o[0]), np.float32(o[1]), np.float32(o[2]), _narrow(inv[0]), _narrow(inv[1]), _narrow(inv[2]))
    near = (
        np.int64(0 if inv[0] >= 0.0 else 3 * WIDE),
        np.int64(WIDE if inv[1] >= 0.0 else 4 * WIDE),
        np.int64(2 * WIDE if inv[2] >= 0.0 else 5 * WIDE),
    )
    return ray, near


@part
def set_up(cell, space, frame, packets, at, port, kind):
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
    if not is_walking(cell, origin, port) and towards_start(cell, origin) != NO_PORT:
        way = NOT_AT_START
    return way, o, d, inv, t_in, t_out, distance
