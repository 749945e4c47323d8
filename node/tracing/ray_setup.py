"""Sets up rays and shadow rays eight at once: works out what is known of them before any surface is looked at.

A search for hits ends in branches that no processor foresees, and each would wait for the root and the quotients of
its own ray. Here there is no branch, and one instruction works on eight rays (AVX-512; elsewhere on four or two).

The operations, and their order, are those of `packets.unit_vector`, `shading.light_direction`, `grid_walk.passage` and
`grid_walk.is_walking`: so are the bits, which a test compares.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from raygrid.node.geometry.bvh_simd import WIDE, copy_keys, push_boxes
from raygrid.node.geometry.grid_walk import HUGE
from raygrid.node.geometry.lattice import LATTICE, T_MIN
from raygrid.node.jit.decorators import part
from raygrid.node.jit.intrinsics import copy_bytes
from raygrid.node.jit.simd import EIGHT, Lanes, Table, least, most, splats, within
from raygrid.node.protocol.frame_tables import LIGHT_KIND
from raygrid.node.protocol.frame_tables import LIGHT_PLACE as LIGHT_PLACE
from raygrid.node.protocol.packets import HALF_DIRECTION, SIZE, read_u64
from raygrid.node.tracing.traverse import FAREST

if TYPE_CHECKING:
    from raygrid.node.jit.code_types import (
        BaseContext,
        Intrinsic,
        IRBuilder,
        Signature,
        Type,
        Typed,
        TypingContext,
        Value,
        Values,
    )


LISTS = 4
SETUP_RAYS = 128  # rays that are set up before the first of them is looked for hits; a multiple of EIGHT
SETUP_ROOM = SETUP_RAYS + EIGHT  # of a list: eight places are written at once
NOT_AT_START = 8  # the way of a ray that has to go to the cell of its origin first
# rows of RaySetup.words: eight bytes of a packet each, that hold its origin, and the rest of it with the direction or light
FRONT, BACK, SETUP_WORDS = 0, 1, 2
FRONT_BYTE, BACK_BYTE = 5, 13  # where they begin in a packet
# rows of RaySetup.known: origin, direction, inverse direction, times of entry and exit, distance of the light
ORIGIN_COLUMN, DIRECTION_COLUMN, INVERSE_COLUMN, T_IN, T_OUT, DISTANCE, KNOWN = 0, 3, 6, 9, 10, 11, 12
# rows of RaySetup.singles, for boxes: origin, inverse direction, and the times between which they are looked for
BOX_PLACE, BOX_INVERSE, BOX_LOW, BOX_HIGH, SINGLES = 0, 3, 6, 7, 8


class RaySetup(NamedTuple):
    """Rays that are set up, a column each; flat.

    words    int64 (SETUP_WORDS * SETUP_RAYS,), what their packets say; ports  uint8 (SETUP_RAYS,), by which each came
    known    float64 (KNOWN * SETUP_RAYS,), what is worked out; of a shadow ray place and kind of its light before
    singles  float32 (SINGLES * SETUP_RAYS,), the same as boxes want it
    nears    int64 (3 * SETUP_RAYS,), words of a node at which each axis' near planes begin (`traverse.for_boxes`)
    ways     int64 (SETUP_RAYS,), exit ports, or NOT_AT_START
    lists    int64 (LISTS * SETUP_ROOM,), numbers of rays (`node.tracing.ray_classify`)
    roots    int64 (SETUP_RAYS * WIDE,), keys of the root's boxes that each ray meets (`node.geometry.bvh_simd`)
    met      int64 (SETUP_RAYS,), how many these are
    """

    words: NDArray[np.int64]
    ports: NDArray[np.uint8]
    known: NDArray[np.float64]
    singles: NDArray[np.float32]
    nears: NDArray[np.int64]
    ways: NDArray[np.int64]
    lists: NDArray[np.int64]
    roots: NDArray[np.int64]
    met: NDArray[np.int64]


def make_ray_setup() -> RaySetup:
    """Room for SETUP_RAYS rays."""
    return RaySetup(
        np.zeros(SETUP_WORDS * SETUP_RAYS, np.int64),
        np.zeros(SETUP_RAYS, np.uint8),
        np.zeros(KNOWN * SETUP_RAYS),
        np.zeros(SINGLES * SETUP_RAYS, np.float32),
        np.zeros(3 * SETUP_RAYS, np.int64),
        np.zeros(SETUP_RAYS, np.int64),
        np.zeros(LISTS * SETUP_ROOM, np.int64),
        np.zeros(SETUP_RAYS * WIDE, np.int64),
        np.zeros(SETUP_RAYS, np.int64),
    )


def _read_packets(words: Table) -> tuple[list[Lanes], list[Lanes]]:
    """(lattice coordinates, direction codes), int32; of shadow rays the codes mean nothing."""
    front, back = words.read(FRONT), words.read(BACK)
    z = front >> 48 & 0xFFFF | (back & 0xFF) << 16
    numbers = (front & 0xFFFFFF, front >> 24 & 0xFFFFFF, z, back >> 8 & 0xFFFFFF, back >> 32 & 0xFFFFFF)
    x, y, z, a, b = (number.lower_half() for number in numbers)
    return [x, y, z], [a, b]


def _unit_vector(codes: list[Lanes], _known: Table, _places: list[Lanes]) -> tuple[list[Lanes], Lanes | None]:
    """As `packets.unit_vector`; no distance."""
    u, v = ((code - HALF_DIRECTION).as_float() * (1.0 / HALF_DIRECTION) for code in codes)
    z = 1.0 - abs(u) - abs(v)
    x = (z < 0.0).choose((1.0 - abs(v)).signed_as(u), u)
    y = (z < 0.0).choose((1.0 - abs(u)).signed_as(v), v)
    scale = 1.0 / (x * x + y * y + z * z).root()
    return [x * scale, y * scale, z * scale], None


def _light_direction(_codes: list[Lanes], known: Table, places: list[Lanes]) -> tuple[list[Lanes], Lanes | None]:
    """As `shading.light_direction`, of lights whose places and kinds stand where direction and distance will."""
    lights = known.read_three(DIRECTION_COLUMN)
    x, y, z = (light - place for light, place in zip(lights, places, strict=True))
    distance = (x * x + y * y + z * z).root()
    scale = (distance <= 0.0).choose(0.0, 1.0 / distance)
    endless = known.read(DISTANCE).equals(0.0)
    towards = [endless.choose(light, one * scale) for light, one in zip(lights, (x, y, z), strict=True)]
    return towards, endless.choose(float("inf"), distance)


def inverse_eight(d: Lanes) -> Lanes:
    """As `grid_walk.inverse`."""
    return (abs(d) < 1.0 / HUGE).choose(HUGE, 1.0 / d)


def _passage(places: list[Lanes], inverses: list[Lanes], bounds: list[Lanes]) -> tuple[Lanes, Lanes, Lanes]:
    """As `grid_walk.passage`."""
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
    """Mark the ports behind which the origin lies, six bits as int32. The lowest is `grid_walk.towards_start`."""
    bits = [(at < corners[axis]).as_int() << (2 * axis) for axis, at in enumerate(origin)]
    bits += [(at >= corners[3 + axis]).as_int() << (2 * axis + 1) for axis, at in enumerate(origin)]
    low, high = (one[0] | one[1] | one[2] for one in (bits[:3], bits[3:]))
    return low | high


def _not_at_start(origin: list[Lanes], port: Lanes, corners: list[Lanes]) -> Lanes:
    """Choose the rays that have to go to the cell of their origin first: those behind a port, unless they came by one of
    these ports (`grid_walk.is_walking`)."""
    ports = behind(origin, corners)
    came_by_one = ports >> port & 1
    return (ports >= 1).lacks(came_by_one >= 1)


def _for_boxes(inverses: list[Lanes]) -> tuple[list[Lanes], list[Lanes]]:
    """As `traverse.for_boxes`: (inverse directions in binary32, the words at which near planes begin)."""
    narrow = [within(inverse, -FAREST, FAREST).as_single() for inverse in inverses]
    nears = [
        (inverse >= 0.0).choose(axis * WIDE, bits.every((3 + axis) * WIDE))
        for axis, (inverse, bits) in enumerate(zip(inverses, (one.bits() for one in inverses), strict=True))
    ]
    return narrow, nears


def _set_up(direction_of: Callable[..., tuple[list[Lanes], Lanes | None]]) -> Intrinsic:
    """Make the intrinsic that sets up eight rays whose directions are found like this."""

    def intrinsic_function(
        typingctx: TypingContext,
        words: Type,
        ports: Type,
        known: Type,
        singles: Type,
        nears: Type,
        ways: Type,
        at: Type,
        step: Type,
        bounds: Type,
        corners: Type,
    ) -> Typed:
        """Set up the rays of columns at..at+7 of the tables of `RaySetup`.

        step    three float64
        bounds  six float64, the cell's low and high planes; corners  the same on the lattice, six int32
        """

        def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, args: Values) -> Value:
            tables = [Table(context, builder, signature.args[k], args[k], args[6], SETUP_RAYS) for k in range(6)]
            _write_all(direction_of, tables, *(splats(builder, packed) for packed in args[7:]))
            return context.get_dummy_value()

        single, number = types.float64, types.int32
        tuples = types.UniTuple(single, 3), types.UniTuple(single, 6), types.UniTuple(number, 6)
        return types.void(words, ports, known, singles, nears, ways, types.int64, *tuples), codegen

    return intrinsic(intrinsic_function)


def _write_all(
    direction_of: Callable[..., tuple[list[Lanes], Lanes | None]],
    tables: list[Table],
    step: list[Lanes],
    bounds: list[Lanes],
    corners: list[Lanes],
) -> None:
    words, ports, known, singles, nears, ways = tables
    origin, codes = _read_packets(words)
    places = [(at - LATTICE // 2).as_float() * step[axis] for axis, at in enumerate(origin)]
    directions, distance = direction_of(codes, known, places)
    inverses = [inverse_eight(d) for d in directions]
    t_in, t_out, way = _passage(places, inverses, bounds)
    narrow, begins = _for_boxes(inverses)
    for axis in range(3):
        known.write(ORIGIN_COLUMN + axis, places[axis])
        known.write(DIRECTION_COLUMN + axis, directions[axis])
        known.write(INVERSE_COLUMN + axis, inverses[axis])
        singles.write(BOX_PLACE + axis, places[axis].as_single())
        singles.write(BOX_INVERSE + axis, narrow[axis])
        nears.write(axis, begins[axis])
    known.write(T_IN, t_in)
    known.write(T_OUT, t_out)
    singles.write(BOX_LOW, most(t_in, t_in.every(T_MIN)).as_single())
    upper = t_out
    if distance is not None:
        known.write(DISTANCE, distance)
        upper = least(t_out, distance)
    singles.write(BOX_HIGH, least(upper, upper.every(FAREST)).as_single())
    ways.write(0, _not_at_start(origin, ports.read(0).as_int(), corners).choose(NOT_AT_START, way))


# kernels call them without the first argument
_rays: Intrinsic = _set_up(_unit_vector)
_shadows: Intrinsic = _set_up(_light_direction)


@part
def read_prepared(frame, packets, ports, first, last, shadows, setup):
    """Read what packets first..last-1, at most SETUP_RAYS and all of shadow rays or none, say of their rays."""
    words, known = setup.words, setup.known
    copy_bytes(ports, first, setup.ports, 0, last - first)
    for k in range(first, last):
        at, j = k * SIZE, k - first
        words[FRONT * SETUP_RAYS + j] = read_u64(packets, at + FRONT_BYTE)
        words[BACK * SETUP_RAYS + j] = read_u64(packets, at + BACK_BYTE)
    if shadows:
        for j in range(last - first):
            light = (words[BACK * SETUP_RAYS + j] >> 8) & 0xFFFF
            known[DISTANCE * SETUP_RAYS + j] = frame.lights[light, LIGHT_KIND]
            for axis in range(3):
                known[(DIRECTION_COLUMN + axis) * SETUP_RAYS + j] = frame.lights[light, LIGHT_PLACE + axis]


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
def set_up_rays(cell, space, many, shadows, setup):
    """Set up the rays that were read."""
    words, ports, known, singles, nears, ways = setup[:6]
    bounds = (*cell.low_at, *cell.high_at)
    if shadows:
        for j in range(0, many, EIGHT):
            _shadows(words, ports, known, singles, nears, ways, j, space.step, bounds, corners(cell))
    else:
        for j in range(0, many, EIGHT):
            _rays(words, ports, known, singles, nears, ways, j, space.step, bounds, corners(cell))


@part
def column(setup, j):
    """A ray that was set up: (way, origin, direction, inverse direction, t_in, t_out, distance), as `step._set_up`."""
    known = setup.known
    return (
        setup.ways[j],
        (
            known[ORIGIN_COLUMN * SETUP_RAYS + j],
            known[(ORIGIN_COLUMN + 1) * SETUP_RAYS + j],
            known[(ORIGIN_COLUMN + 2) * SETUP_RAYS + j],
        ),
        (
            known[DIRECTION_COLUMN * SETUP_RAYS + j],
            known[(DIRECTION_COLUMN + 1) * SETUP_RAYS + j],
            known[(DIRECTION_COLUMN + 2) * SETUP_RAYS + j],
        ),
        (
            known[INVERSE_COLUMN * SETUP_RAYS + j],
            known[(INVERSE_COLUMN + 1) * SETUP_RAYS + j],
            known[(INVERSE_COLUMN + 2) * SETUP_RAYS + j],
        ),
        known[T_IN * SETUP_RAYS + j],
        known[T_OUT * SETUP_RAYS + j],
        known[DISTANCE * SETUP_RAYS + j],
    )


@part
def boxes_of(setup, j):
    """(ray, near planes) of a ray that was set up, as `traverse.for_boxes` gives them."""
    singles, nears = setup.singles, setup.nears
    ray = (
        singles[BOX_PLACE * SETUP_RAYS + j],
        singles[(BOX_PLACE + 1) * SETUP_RAYS + j],
        singles[(BOX_PLACE + 2) * SETUP_RAYS + j],
        singles[BOX_INVERSE * SETUP_RAYS + j],
        singles[(BOX_INVERSE + 1) * SETUP_RAYS + j],
        singles[(BOX_INVERSE + 2) * SETUP_RAYS + j],
    )
    return ray, (nears[j], nears[SETUP_RAYS + j], nears[2 * SETUP_RAYS + j])


@part
def open_root_of(surfaces, setup, j):
    """Find the boxes of the hierarchy's root that a ray meets; returns how many. There must be a root."""
    ray, near = boxes_of(setup, j)
    low, high = setup.singles[BOX_LOW * SETUP_RAYS + j], setup.singles[BOX_HIGH * SETUP_RAYS + j]
    met = push_boxes(surfaces.floats, np.int64(0), near, ray, low, high, setup.roots, j * WIDE)
    setup.met[j] = met
    return met


@part
def take_root(setup, j, stack):
    """Put the keys of a ray on the stack of a walk; returns how many."""
    copy_keys(setup.roots, j * WIDE, stack, 0)
    return setup.met[j]
