"""Rays and shadow rays set up eight at once: what is known of them before any surface is looked at.

A search for hits ends in branches that no processor foresees, and each would wait for the root and the quotients of
its own ray. Here there is no branch, and one instruction works on eight rays (AVX-512; elsewhere on four or two).

The operations, and their order, are those of `packets.unit_vector`, `shading.light_direction`, `walk.passage` and
`walk.is_walking`: so are the bits, which a test compares.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from .compiled import part
from .lanes import WIDE
from .lattice import T_MIN
from .packets import HALF_DIRECTION, LATTICE, SIZE, read_origin, read_u16, read_u64
from .tables import LIGHT_KIND
from .tables import PLACE as LIGHT_PLACE
from .traverse import open_root
from .vectors import EIGHT, Lanes, Table, least, most, splats
from .walk import HUGE

AHEAD = 128  # rays that are set up before the first of them is looked for hits; a multiple of EIGHT
ASTRAY = 8  # the way of a ray that has to go to the cell of its origin first
# rows of Ahead.whole: lattice coordinates, direction codes, port
ORIGIN, CODES, PORT, WHOLE = 0, 3, 5, 6
# rows of Ahead.known: origin, direction, inverse direction, times of entry and exit, distance of the light
PLACE, DIRECTION, INVERSE, T_IN, T_OUT, DISTANCE, KNOWN = 0, 3, 6, 9, 10, 11, 12


class Ahead(NamedTuple):
    """Rays that are set up, a column each; flat.

    whole  int32 (WHOLE * AHEAD,), what their packets say
    known  float64 (KNOWN * AHEAD,), what is worked out; of a shadow ray place and kind of its light before
    ways   int64 (AHEAD,), exit ports, or ASTRAY
    roots  int64 (AHEAD * WIDE,), keys of the root's boxes that each ray meets (`node.lanes`); met  int64 (AHEAD,), how many
    """

    whole: NDArray[np.int32]
    known: NDArray[np.float64]
    ways: NDArray[np.int64]
    roots: NDArray[np.int64]
    met: NDArray[np.int64]


def make_ahead() -> Ahead:
    """Room for AHEAD rays."""
    return Ahead(
        np.zeros(WHOLE * AHEAD, np.int32),
        np.zeros(KNOWN * AHEAD),
        np.zeros(AHEAD, np.int64),
        np.zeros(AHEAD * WIDE, np.int64),
        np.zeros(AHEAD, np.int64),
    )


def _unit_vector(whole: Table, _known: Table, _places: list[Lanes]) -> tuple[list[Lanes], Lanes | None]:
    """As `packets.unit_vector`; no distance."""
    u, v = ((whole.read(CODES + k) - HALF_DIRECTION).as_float() * (1.0 / HALF_DIRECTION) for k in range(2))
    z = 1.0 - abs(u) - abs(v)
    x = (z < 0.0).choose((1.0 - abs(v)).signed_as(u), u)
    y = (z < 0.0).choose((1.0 - abs(u)).signed_as(v), v)
    scale = 1.0 / (x * x + y * y + z * z).root()
    return [x * scale, y * scale, z * scale], None


def _light_direction(_whole: Table, known: Table, places: list[Lanes]) -> tuple[list[Lanes], Lanes | None]:
    """As `shading.light_direction`, of lights whose places and kinds stand where direction and distance will."""
    lights = known.read_three(DIRECTION)
    x, y, z = (light - place for light, place in zip(lights, places, strict=True))
    distance = (x * x + y * y + z * z).root()
    scale = (distance <= 0.0).choose(0.0, 1.0 / distance)
    endless = known.read(DISTANCE).equals(0.0)
    towards = [endless.choose(light, one * scale) for light, one in zip(lights, (x, y, z), strict=True)]
    return towards, endless.choose(float("inf"), distance)


def inverse_eight(d: Lanes) -> Lanes:
    """As `walk.inverse`."""
    return (abs(d) < 1.0 / HUGE).choose(HUGE, 1.0 / d)


def _passage(places: list[Lanes], inverses: list[Lanes], bounds: list[Lanes]) -> tuple[Lanes, Lanes, Lanes]:
    """As `walk.passage`."""
    times = [
        ((bounds[axis] - places[axis]) * inverses[axis], (bounds[3 + axis] - places[axis]) * inverses[axis])
        for axis in range(3)
    ]
    (in_x, in_y, in_z), (out_x, out_y, out_z) = ([of(*pair) for pair in times] for of in (least, most))
    out_yz = least(out_y, out_z)
    x, y, z = ((inverses[axis] >= 0.0).as_long() + 2 * axis for axis in range(3))
    way = (out_x <= out_yz).choose(x, (out_y <= out_z).choose(y, z))
    return most(in_x, most(in_y, in_z)), least(out_x, out_yz), way


def behind(origin: list[Lanes], corners: list[Lanes]) -> Lanes:
    """Six bits, one a port: behind which of them the origin lies, as int32. The lowest is `walk.towards_start`."""
    bits = [(at < corners[axis]).as_int() << (2 * axis) for axis, at in enumerate(origin)]
    bits += [(at >= corners[3 + axis]).as_int() << (2 * axis + 1) for axis, at in enumerate(origin)]
    low, high = (one[0] | one[1] | one[2] for one in (bits[:3], bits[3:]))
    return low | high


def _astray(whole: Table, corners: list[Lanes]) -> Lanes:
    """Which have to go to the cell of their origin first: those behind a port, unless they came by one of these ports
    (`walk.is_walking`)."""
    ports = behind(whole.read_three(ORIGIN), corners)
    came_by_one = ports >> whole.read(PORT) & 1
    return (ports >= 1).lacks(came_by_one >= 1)


def _set_up(direction_of: Callable[..., tuple[list[Lanes], Lanes | None]]) -> Any:
    """The intrinsic that sets up eight rays whose directions are found like this."""

    def intrinsic_function(
        typingctx: Any, whole: Any, known: Any, ways: Any, at: Any, step: Any, bounds: Any, corners: Any
    ) -> Any:
        """Set up the rays of columns at..at+7 of the tables of `Ahead`.

        step    three float64
        bounds  six float64, the cell's low and high planes; corners  the same on the lattice, six int32
        """

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            rows, numbers, out = (Table(context, builder, signature.args[k], args[k], args[3], AHEAD) for k in range(3))
            _write_all(direction_of, rows, numbers, out, *(splats(builder, packed) for packed in args[4:]))
            return context.get_dummy_value()

        single, number = types.float64, types.int32
        tuples = types.UniTuple(single, 3), types.UniTuple(single, 6), types.UniTuple(number, 6)
        return types.void(whole, known, ways, types.int64, *tuples), codegen

    return intrinsic(intrinsic_function)


def _write_all(
    direction_of: Callable[..., tuple[list[Lanes], Lanes | None]],
    whole: Table,
    known: Table,
    ways: Table,
    step: list[Lanes],
    bounds: list[Lanes],
    corners: list[Lanes],
) -> None:
    places = [(at - LATTICE // 2).as_float() * step[axis] for axis, at in enumerate(whole.read_three(ORIGIN))]
    directions, distance = direction_of(whole, known, places)
    inverses = [inverse_eight(d) for d in directions]
    t_in, t_out, way = _passage(places, inverses, bounds)
    for axis in range(3):
        known.write(PLACE + axis, places[axis])
        known.write(DIRECTION + axis, directions[axis])
        known.write(INVERSE + axis, inverses[axis])
    known.write(T_IN, t_in)
    known.write(T_OUT, t_out)
    if distance is not None:
        known.write(DISTANCE, distance)
    ways.write(0, _astray(whole, corners).choose(ASTRAY, way))


# kernels call them without the first argument
_rays: Any = _set_up(_unit_vector)
_shadows: Any = _set_up(_light_direction)


@part
def _read_origins(packets, ports, first, last, whole):
    for k in range(first, last):
        x, y, z = read_origin(packets, k * SIZE)
        j = k - first
        whole[ORIGIN * AHEAD + j], whole[(ORIGIN + 1) * AHEAD + j] = np.int32(x), np.int32(y)
        whole[(ORIGIN + 2) * AHEAD + j], whole[PORT * AHEAD + j] = np.int32(z), np.int32(ports[k])


@part
def read_ahead(frame, packets, ports, first, last, shadows, ahead):
    """Read what packets first..last-1, at most AHEAD and all of shadow rays or none, say of their rays."""
    whole, known = ahead.whole, ahead.known
    _read_origins(packets, ports, first, last, whole)
    if shadows:
        for k in range(first, last):
            light, j = read_u16(packets, k * SIZE + 14), k - first
            known[DISTANCE * AHEAD + j] = frame.lights[light, LIGHT_KIND]
            for axis in range(3):
                known[(DIRECTION + axis) * AHEAD + j] = frame.lights[light, LIGHT_PLACE + axis]
    else:
        for k in range(first, last):
            codes, j = read_u64(packets, k * SIZE + 14), k - first
            whole[CODES * AHEAD + j] = np.int32(codes & 0xFFFFFF)
            whole[(CODES + 1) * AHEAD + j] = np.int32((codes >> 24) & 0xFFFFFF)


@part
def corners(cell):
    """The corners of a cell on the lattice: six int32, the low ones first."""
    return (
        np.int32(cell.low[0]),
        np.int32(cell.low[1]),
        np.int32(cell.low[2]),
        np.int32(cell.high[0]),
        np.int32(cell.high[1]),
        np.int32(cell.high[2]),
    )


@part
def set_up_ahead(cell, space, many, shadows, ahead):
    """Set up the rays that were read."""
    bounds = (*cell.low_at, *cell.high_at)
    if shadows:
        for j in range(0, many, EIGHT):
            _shadows(ahead.whole, ahead.known, ahead.ways, j, space.step, bounds, corners(cell))
    else:
        for j in range(0, many, EIGHT):
            _rays(ahead.whole, ahead.known, ahead.ways, j, space.step, bounds, corners(cell))


@part
def column(ahead, j):
    """A ray that was set up: (way, origin, direction, inverse direction, t_in, t_out, distance), as `step._set_up`."""
    known = ahead.known
    return (
        ahead.ways[j],
        (known[PLACE * AHEAD + j], known[(PLACE + 1) * AHEAD + j], known[(PLACE + 2) * AHEAD + j]),
        (known[DIRECTION * AHEAD + j], known[(DIRECTION + 1) * AHEAD + j], known[(DIRECTION + 2) * AHEAD + j]),
        (known[INVERSE * AHEAD + j], known[(INVERSE + 1) * AHEAD + j], known[(INVERSE + 2) * AHEAD + j]),
        known[T_IN * AHEAD + j],
        known[T_OUT * AHEAD + j],
        known[DISTANCE * AHEAD + j],
    )


@part
def open_roots(surfaces, many, shadows, ahead):
    """Find the boxes of the hierarchy's root that the rays meet: without a branch, as far as it goes."""
    if len(surfaces.floats) == 0:
        for j in range(many):
            ahead.met[j] = 0
        return
    for j in range(many):
        _, o, _, inv, t_in, t_out, distance = column(ahead, j)
        upper = min(t_out, distance) if shadows else t_out
        ahead.met[j] = open_root(surfaces, ahead.roots, j * WIDE, o, inv, max(t_in, T_MIN), upper)


@part
def take_root(ahead, j, stack):
    """Put the keys of a ray on the stack of a walk; how many."""
    for k in range(WIDE):
        stack[k] = ahead.roots[j * WIDE + k]
    return ahead.met[j]
