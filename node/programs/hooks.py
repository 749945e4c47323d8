"""Puts a program into the ray step. This text is executed once for each program, with its functions in place.

`node.programs.programs` runs the texts of `traverse`, `step`, `batch`, `event_loop` and `background` again, in namespaces in
which the functions below stand for those of the same purpose, and compiles them: the step without a program is another
function and knows nothing of it. The three functions under "the program's" are those of the program, or these if it has
not got them.

That every array gives the same bits does not depend on the program: where its surfaces are hit is asked without saying
in which cell, a hit counts only inside the surface's own box, by which cells retain it, and what is no number, or
below 0, is nothing.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.surface_tables import KIND_SHIFT, OWN_BOX, OWN_NUMBER, OWN_SCALE, OWN_SHIFT, SLOT_MASK
from raygrid.node.geometry.surfaces import AddedKind
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.frame_tables import RULE, RULE_NUMBER
from raygrid.node.tracing.shading import light_discs, unit
from raygrid.node.tracing.shading import normals as plain_normals
from raygrid.node.tracing.step import _spawn_shadows as plain_shadows
from raygrid.node.tracing.traverse import _meet as plain_meet

KIND = int(AddedKind.PROGRAMMED)
BRIGHTEST = 1e6  # of a tint or background
TINT_LIMIT = 1.0 + 1e-9  # of the box, for rounding: far below lattice.SLACK


# --- the program's -----------------------------------------------------------------------------------------


@part
def surface_hits(origin, direction, numbers):
    """No surface."""
    return np.inf, np.inf, np.inf, np.inf


@part
def surface_normal(point, numbers):
    """No surface."""
    return 0.0, 0.0, 1.0


@part
def tint(point, normal, numbers):
    """No rule."""
    return 1.0, 1.0, 1.0


@part
def background(direction):
    """No background of its own: see `edge_colour`."""
    return -1.0, -1.0, -1.0


# --- what takes the place of the step's own ---------------------------------------------------------------


@part
def _numbers(table, row, at):
    return (
        table[row, at],
        table[row, at + 1],
        table[row, at + 2],
        table[row, at + 3],
        table[row, at + 4],
        table[row, at + 5],
        table[row, at + 6],
        table[row, at + 7],
    )


@part
def _to_own(table, row, x, y, z):
    """A vector turned into a surface's own coordinates."""
    return (
        table[row, 0] * x + table[row, 3] * y + table[row, 6] * z,
        table[row, 1] * x + table[row, 4] * y + table[row, 7] * z,
        table[row, 2] * x + table[row, 5] * y + table[row, 8] * z,
    )


@part
def _own_point(table, row, p):
    x, y, z = _to_own(
        table, row, p[0] - table[row, OWN_SHIFT], p[1] - table[row, OWN_SHIFT + 1], p[2] - table[row, OWN_SHIFT + 2]
    )
    scale = table[row, OWN_SCALE]
    return x / scale, y / scale, z / scale


@part
def _meet_own(table, row, o, d, lower):
    """The first t >= lower of the program's hits inside the surface's box.

    The program gets the ray from the point nearest to the middle, so that its numbers have the size of the surface.
    """
    start, way, scale = _own_point(table, row, o), _to_own(table, row, d[0], d[1], d[2]), table[row, OWN_SCALE]
    shift = -(start[0] * way[0] + start[1] * way[1] + start[2] * way[2])
    middle = (start[0] + shift * way[0], start[1] + shift * way[1], start[2] + shift * way[2])
    hits = surface_hits(middle, way, _numbers(table, row, OWN_NUMBER))
    best = np.inf
    for k in range(4):
        s = hits[k]
        inside = (
            abs(middle[0] + s * way[0]) <= table[row, OWN_BOX] * TINT_LIMIT
            and abs(middle[1] + s * way[1]) <= table[row, OWN_BOX + 1] * TINT_LIMIT
            and abs(middle[2] + s * way[2]) <= table[row, OWN_BOX + 2] * TINT_LIMIT
        )
        t = (s + shift) * scale
        if inside and t >= lower and t < best:
            best = t
    return best


@part
def _meet(surfaces, kind, row, o, d, lower, upper):
    if kind == KIND:
        return _meet_own(surfaces.programmed, row, o, d, lower), 0.0, 0.0
    return plain_meet(surfaces, kind, row, o, d, lower, upper)


@part
def _own_normal(table, row, p):
    x, y, z = surface_normal(_own_point(table, row, p), _numbers(table, row, OWN_NUMBER))
    squared = x * x + y * y + z * z
    if not (squared > 1e-300 and squared < 1e300):
        x, y, z = 0.0, 0.0, 1.0
    return unit(
        table[row, 0] * x + table[row, 1] * y + table[row, 2] * z,
        table[row, 3] * x + table[row, 4] * y + table[row, 5] * z,
        table[row, 6] * x + table[row, 7] * y + table[row, 8] * z,
    )


@part
def normals(surfaces, item, p, u, v):
    word = np.int64(surfaces.items[item])
    if word >> KIND_SHIFT == KIND:
        n = _own_normal(surfaces.programmed, word & SLOT_MASK, p)
        return n, n
    return plain_normals(surfaces, item, p, u, v)


@part
def _sound(value):
    """A number from 0 to BRIGHTEST, whatever came."""
    return min(value, BRIGHTEST) if value > 0.0 else 0.0


@part
def _spawn_shadows(cell, space, frame, material, depth, sample, p, g, n, mirror, weight, outputs, counts):
    m = frame.materials
    if m.shape[1] > RULE and m[material, RULE] > 0.0:
        colour = tint(p, n, _numbers(m, material, RULE_NUMBER))
        weight = (weight[0] * _sound(colour[0]), weight[1] * _sound(colour[1]), weight[2] * _sound(colour[2]))
    plain_shadows(cell, space, frame, material, depth, sample, p, g, n, mirror, weight, outputs, counts)


@part
def edge_colour(frame, d):
    """As `shading.edge_colour`, over the program's background if it has one."""
    red, green, blue = background(d)
    if red == -1.0 and green == -1.0 and blue == -1.0:
        red, green, blue = frame.background
    red, green, blue = _sound(red), _sound(green), _sound(blue)
    return light_discs(frame, d, red, green, blue)
