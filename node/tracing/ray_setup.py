"""Sets up rays and shadow rays eight at once: works out what is known of them before any surface is looked at.

A search for hits ends in branches that no processor foresees, and each would wait for the root and the quotients of
its own ray. Here there is no branch, and one instruction works on eight rays (AVX-512; elsewhere on four or two).
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.bvh_boxes import FAREST, WIDE, copy_keys, for_boxes, push_boxes
from raygrid.node.geometry.grid_walk import inverse, is_before_start, passage
from raygrid.node.geometry.lattice import CELL, T_MIN, coordinate
from raygrid.node.jit.decorators import part
from raygrid.node.jit.formula import eight, formula
from raygrid.node.jit.intrinsics import copy_bytes
from raygrid.node.jit.lanes import (
    ARRAY,
    EIGHT,
    F32,
    F64,
    I32,
    I64,
    LATTICE_POINT,
    VECTOR,
    Columns,
    Lanes,
    Staged,
    Three,
    least,
    most,
)
from raygrid.node.protocol.frame_tables import LIGHT_KIND, LIGHT_PLACE
from raygrid.node.protocol.packets import SIZE, read_u64
from raygrid.node.protocol.packing import unit_vector
from raygrid.node.tracing.shading import towards_light

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
    nears    int64 (3 * SETUP_RAYS,), words of a node at which each axis' near planes begin (`bvh_boxes.for_boxes`)
    ways     int64 (SETUP_RAYS,), exit ports, or NOT_AT_START
    lists    int64 (LISTS * SETUP_ROOM,), numbers of rays (`node.tracing.ray_classify`)
    roots    int64 (SETUP_RAYS * WIDE,), keys of the root's boxes that each ray meets (`node.geometry.bvh_boxes`)
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


SETUP = RaySetup(*(9 * (ARRAY,)))  # type: ignore[arg-type]  # as formulas take it


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


def _read_packets(words: Columns) -> tuple[list[Lanes], list[Lanes]]:
    """(lattice coordinates, direction codes), int32; of shadow rays the codes mean nothing."""
    front, back = words.read(FRONT), words.read(BACK)
    z = front >> 48 & 0xFFFF | (back & 0xFF) << 16
    numbers = (front & 0xFFFFFF, front >> 24 & 0xFFFFFF, z, back >> 8 & 0xFFFFFF, back >> 32 & 0xFFFFFF)
    x, y, z, a, b = (number.to(I32) for number in numbers)
    return [x, y, z], [a, b]


@eight(takes=(SETUP, I64, CELL, VECTOR))
def _set_up_rays(setup: Staged, at: Lanes, cell: Staged, step: Three) -> None:
    """Set up the rays from column `at` on."""
    origin, codes = _read_packets(Columns(setup.words, at, SETUP_RAYS))
    places = [coordinate(k, one) for k, one in zip(origin, step, strict=True)]
    _write(setup, at, cell, origin, places, unit_vector(*codes))


@eight(takes=(SETUP, I64, CELL, VECTOR))
def _set_up_shadows(setup: Staged, at: Lanes, cell: Staged, step: Three) -> None:
    """Set up the shadow rays from column `at` on; places and kinds of lights stand where direction and distance will."""
    origin, _ = _read_packets(Columns(setup.words, at, SETUP_RAYS))
    places = [coordinate(k, one) for k, one in zip(origin, step, strict=True)]
    known = Columns(setup.known, at, SETUP_RAYS)
    direction, distance = towards_light(known.three(DIRECTION_COLUMN), known.read(DISTANCE), places)
    known.write(DISTANCE, distance)
    _write(setup, at, cell, origin, places, direction, distance)


@formula(takes=(CELL, LATTICE_POINT, VECTOR, VECTOR, I64), gives=(I64, VECTOR, F64, F64))
def way_through(
    cell: Staged, origin: Three, places: Three, direction: Three, port: Lanes
) -> tuple[Lanes, list[Lanes], Lanes, Lanes]:
    """(way, inverse direction, t_in, t_out) of a ray that came by `port`.

    origin  on the lattice; places  the same as numbers
    way     the exit port; NOT_AT_START for a ray that has to go to the cell of its origin first
    """
    inv = [inverse(d) for d in direction]
    t_in, t_out, way = passage(cell, places, inv)
    return is_before_start(cell, origin, port).choose(NOT_AT_START, way), inv, t_in, t_out


def _write(
    setup: Staged,
    at: Lanes,
    cell: Staged,
    origin: Three,
    places: Three,
    direction: Three,
    distance: Lanes | None = None,
) -> None:
    """Write all that is known of rays from these origins, on the lattice and as numbers, in these directions."""
    known, singles, nears = (Columns(of, at, SETUP_RAYS) for of in (setup.known, setup.singles, setup.nears))
    port = setup.ports.read(at).to(I32)
    way, inv, t_in, t_out = way_through(cell, origin, places, direction, port)
    ray, begins = for_boxes(places, inv)
    for axis in range(3):
        known.write(ORIGIN_COLUMN + axis, places[axis])
        known.write(DIRECTION_COLUMN + axis, direction[axis])
        known.write(INVERSE_COLUMN + axis, inv[axis])
        singles.write(BOX_PLACE + axis, ray[axis])
        singles.write(BOX_INVERSE + axis, ray[3 + axis])
        nears.write(axis, begins[axis])
    known.write(T_IN, t_in)
    known.write(T_OUT, t_out)
    upper = t_out if distance is None else least(t_out, distance)
    singles.write(BOX_LOW, most(t_in, t_in.every(T_MIN)).to(F32))
    singles.write(BOX_HIGH, least(upper, upper.every(FAREST)).to(F32))
    setup.ways.write(at, way)


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
def set_up_rays(cell, space, many, shadows, setup):
    """Set up the rays that were read."""
    for j in range(0, many, EIGHT):
        if shadows:
            _set_up_shadows(setup, j, cell, space.step)
        else:
            _set_up_rays(setup, j, cell, space.step)


@part
def column(setup, j):
    """A ray that was set up: (way, origin, direction, inverse direction, t_in, t_out, distance)."""
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
    """(ray, near planes) of a ray that was set up, as `bvh_boxes.for_boxes` gives them."""
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
    met = push_boxes(surfaces.floats, 0, near, ray, low, high, setup.roots, j * WIDE) - j * WIDE
    setup.met[j] = met
    return met


@part
def take_root(setup, j, stack):
    """Put the keys of a ray on the stack of a walk; returns how many."""
    copy_keys(setup.roots, j * WIDE, stack, 0)
    return setup.met[j]
