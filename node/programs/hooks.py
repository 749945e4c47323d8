"""Makes the parts of a ray step of a program's functions. See `node.tracing.step.Parts` for what takes their place.

That every array gives the same bits does not depend on the program: where its surfaces are hit is asked without saying
in which cell, a hit counts only inside the surface's own box, by which cells retain it, and what is no number, or
below 0, is nothing.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from raygrid.node.geometry.surface_tables import KIND_SHIFT, OWN_BOX, OWN_NUMBER, OWN_SCALE, OWN_SHIFT, SLOT_MASK
from raygrid.node.geometry.surfaces import AddedKind
from raygrid.node.jit.decorators import Function, part
from raygrid.node.protocol.frame_tables import RULE, RULE_NUMBER
from raygrid.node.tracing.shading import light_discs, unit
from raygrid.node.tracing.shading import normals as plain_normals
from raygrid.node.tracing.step import Parts
from raygrid.node.tracing.traverse import meet as plain_meet

KIND = int(AddedKind.PROGRAMMED)
BRIGHTEST = 1e6  # of a tint or background
BOX_LIMIT = 1.0 + 1e-9  # of the box, for rounding: far below lattice.SLACK


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
def _sound(value):
    """A number from 0 to BRIGHTEST, whatever came."""
    return min(value, BRIGHTEST) if value > 0.0 else 0.0


def make_meet(surface_hits: Function) -> Function:
    """Make `Parts.meet` with the surfaces of a program."""

    @part
    def meet_own(table, row, o, d, lower):
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
                abs(middle[0] + s * way[0]) <= table[row, OWN_BOX] * BOX_LIMIT
                and abs(middle[1] + s * way[1]) <= table[row, OWN_BOX + 1] * BOX_LIMIT
                and abs(middle[2] + s * way[2]) <= table[row, OWN_BOX + 2] * BOX_LIMIT
            )
            t = (s + shift) * scale
            if inside and t >= lower and t < best:
                best = t
        return best

    @part
    def meet(surfaces, kind, row, o, d, lower, upper):
        """(t, u, v) of one surface."""
        if kind == KIND:
            return meet_own(surfaces.programmed, row, o, d, lower), 0.0, 0.0
        return plain_meet(surfaces, kind, row, o, d, lower, upper)

    return meet


def make_normals(surface_normal: Function) -> Function:
    """Make `Parts.normals` with the surfaces of a program."""

    @part
    def own_normal(table, row, p):
        """The unit normal of a surface of the program."""
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
        """((outward geometric normal), (shading normal)) of an item at point p."""
        word = np.int64(surfaces.items[item])
        if word >> KIND_SHIFT == KIND:
            n = own_normal(surfaces.programmed, word & SLOT_MASK, p)
            return n, n
        return plain_normals(surfaces, item, p, u, v)

    return normals


def make_lit(tint: Function) -> Function:
    """Make `Parts.lit` with the rule of a program."""

    @part
    def lit(frame, material, p, n, weight):
        """The weight with which light counts, times the program's tint where the material has a rule."""
        m = frame.materials
        if m.shape[1] > RULE and m[material, RULE] > 0.0:
            colour = tint(p, n, _numbers(m, material, RULE_NUMBER))
            weight = (weight[0] * _sound(colour[0]), weight[1] * _sound(colour[1]), weight[2] * _sound(colour[2]))
        return weight

    return lit


def make_edge_colour(background: Function) -> Function:
    """Make `Parts.edge_colour` with the background of a program."""

    @part
    def edge_colour(frame, d):
        """What a ray sees that leaves the scene: the program's background, or the disc of a light before it."""
        red, green, blue = background(d)
        return light_discs(frame, d, _sound(red), _sound(green), _sound(blue))

    return edge_colour


def parts_of(functions: Mapping[str, Function]) -> Parts:
    """The parts of a ray step with the compiled functions of a program, by their names; the others are the usual ones."""
    parts = Parts()
    if "surface_hits" in functions:
        parts = parts._replace(
            meet=make_meet(functions["surface_hits"]), normals=make_normals(functions["surface_normal"])
        )
    if "tint" in functions:
        parts = parts._replace(lit=make_lit(functions["tint"]))
    if "background" in functions:
        parts = parts._replace(edge_colour=make_edge_colour(functions["background"]))
    return parts
