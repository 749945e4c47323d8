"""Spawns secondary rays and shadow rays: notes them at a hit, and works out their packets eight at once.

Which rays a hit spawns depends on branches that no processor foresees; where a spawned ray starts on the lattice, how
its direction and weight are packed and which bytes that makes does not, but for a dozen quotients, roots and roundings
each. So a step only notes a ray, and when it has gone over its packets all rays are worked out without a branch.

The operations, and their order, are those of `origin_beside`, `packets.octahedral`, `packets.put_ray` and
`packets.put_shadow`: so are the bytes, which a test compares.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from raygrid.node.geometry.lattice import GENTLE, HALF, LATTICE, LIFT, SLOW, beside_ray
from raygrid.node.jit.decorators import part
from raygrid.node.jit.intrinsics import put_words
from raygrid.node.jit.simd import EIGHT, Lanes, Table, least, most, splats, within
from raygrid.node.protocol.packets import (
    HALF_DIRECTION,
    LARGEST_BINARY32,
    LARGEST_SHADOW_WEIGHT,
    SHORTEST,
    TOO_LARGE_WEIGHT,
    WEIGHT_BIAS,
)
from raygrid.node.tracing.ray_setup import behind, corners

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


SPAWN_ROOM = 128  # rays that are noted before they are written; a multiple of EIGHT
SHADOW_BATCH, RAY_BATCH, SPAWN_BATCHES = 0, 1, 2
# rows of `facts`: point, normal, direction, weight
SPAWN_POINT, SPAWN_NORMAL, SPAWN_DIRECTION, SPAWN_WEIGHT, SPAWN_FACTS = 0, 3, 6, 9, 12
# rows of `words`: the first five bytes and the light; then the packet's words (`words_of`), and the ports behind which
# it starts
SPAWN_HEAD, SPAWN_LIGHT = 0, 1
SPAWN_WORD, SPAWN_BEHIND, SPAWN_WORDS = 0, 4, 5


class SpawnBatch(NamedTuple):
    """Rays that are noted to be spawned: shadow rays, then other rays, a column each; flat.

    facts  float64 (SPAWN_BATCHES * SPAWN_FACTS * SPAWN_ROOM,)
    words  int64 (SPAWN_BATCHES * SPAWN_WORDS * SPAWN_ROOM,)
    held   int64 (SPAWN_BATCHES,), how many there are
    """

    facts: NDArray[np.float64]
    words: NDArray[np.int64]
    held: NDArray[np.int64]


def make_spawn_batch() -> SpawnBatch:
    """Make empty batches."""
    return SpawnBatch(
        np.zeros(SPAWN_BATCHES * SPAWN_FACTS * SPAWN_ROOM),
        np.zeros(SPAWN_BATCHES * SPAWN_WORDS * SPAWN_ROOM, np.int64),
        np.zeros(SPAWN_BATCHES, np.int64),
    )


@part
def origin_beside(step, p, g, d):
    """Lattice origin of a ray spawned at p: lifted off the surface to the side that it goes to, then rounded.

    It is moved along itself, which changes nothing of what it sees. A ray that leaves at a grazing angle would have to
    go far, so it is lifted along the normal g by what is lacking. The definition, for one ray.
    """
    slope = g[0] * d[0] + g[1] * d[1] + g[2] * d[2]
    along = LIFT / max(abs(slope), GENTLE)
    lacking = LIFT - along * abs(slope)
    side = lacking if slope >= 0.0 else -lacking
    start = (p[0] + along * d[0] + side * g[0], p[1] + along * d[1] + side * g[1], p[2] + along * d[2] + side * g[2])
    return beside_ray(step, start, d, 1)


@part
def note(spawns, spawn_batch, head, light, p, g, d, weight):
    """Note a ray to be spawned; returns whether there is room for no more."""
    j = spawns.held[spawn_batch] & (SPAWN_ROOM - 1)
    fact, word = spawn_batch * SPAWN_FACTS * SPAWN_ROOM + j, spawn_batch * SPAWN_WORDS * SPAWN_ROOM + j
    for axis in range(3):
        spawns.facts[fact + (SPAWN_POINT + axis) * SPAWN_ROOM] = p[axis]
        spawns.facts[fact + (SPAWN_NORMAL + axis) * SPAWN_ROOM] = g[axis]
        spawns.facts[fact + (SPAWN_DIRECTION + axis) * SPAWN_ROOM] = d[axis]
        spawns.facts[fact + (SPAWN_WEIGHT + axis) * SPAWN_ROOM] = weight[axis]
    spawns.words[word + SPAWN_HEAD * SPAWN_ROOM], spawns.words[word + SPAWN_LIGHT * SPAWN_ROOM] = head, light
    spawns.held[spawn_batch] = j + 1
    return j + 1 == SPAWN_ROOM


@part
def work_out(cell, space, spawns, spawn_batch):
    """Make the words of all that are noted in a spawn batch."""
    for j in range(0, spawns.held[spawn_batch], EIGHT):
        fact, word = spawn_batch * SPAWN_FACTS * SPAWN_ROOM + j, spawn_batch * SPAWN_WORDS * SPAWN_ROOM + j
        if spawn_batch == SHADOW_BATCH:
            _shadow_words(spawns.facts, spawns.words, fact, word, space.step, corners(cell))
        else:
            _ray_words(spawns.facts, spawns.words, fact, word, space.step, corners(cell))


@part
def starts_behind(spawns, spawn_batch, j):
    """Six bits: the ports behind which a spawned ray starts."""
    return spawns.words[(spawn_batch * SPAWN_WORDS + SPAWN_BEHIND) * SPAWN_ROOM + j]


@part
def put(spawns, spawn_batch, j, row, at):
    """Write the packet of a spawned ray that was worked out."""
    put_made(spawns.words, (spawn_batch * SPAWN_WORDS + SPAWN_WORD) * SPAWN_ROOM + j, SPAWN_ROOM, row, at)


@part
def put_made(words, first, stride, row, at):
    """Write a packet whose words (`words_of`) stand at every `stride` places of a table from place `first` on."""
    put_words(row, at, words[first], words[first + stride], words[first + 2 * stride])
    row[at + 24] = np.uint8(words[first + 3 * stride])


# --- eight at once -------------------------------------------------------------------------------------


def nearest_eight(point: Lanes, step: Lanes) -> Lanes:
    """As `lattice.nearest`, int32."""
    return within(math.floor(point / step + 0.5) + float(HALF), 0.0, LATTICE - 1.0).as_whole()


def _origins(facts: Table, direction: list[Lanes], step: list[Lanes]) -> list[Lanes]:
    """As `origin_beside`."""
    p, g, d = facts.read_three(SPAWN_POINT), facts.read_three(SPAWN_NORMAL), direction
    slope = g[0] * d[0] + g[1] * d[1] + g[2] * d[2]
    size = abs(slope)
    along = LIFT / most(size, size.every(GENTLE))
    lacking = LIFT - along * size
    side = (slope >= 0.0).choose(lacking, -lacking)
    start = [p[axis] + along * d[axis] + side * g[axis] for axis in range(3)]
    places, speeds = ([of[axis] / step[axis] for axis in range(3)] for of in (start, d))
    t, _ = next_on_lattice(places, speeds, d, step)  # as `lattice.beside_ray` with one try
    return [nearest_eight(start[axis] + t * d[axis], step[axis]) for axis in range(3)]


def next_on_lattice(places: list[Lanes], speeds: list[Lanes], d: list[Lanes], step: list[Lanes]) -> tuple[Lanes, Lanes]:
    """(t, speed in steps) at which a ray next has a coordinate on the lattice, of the axis that is worth most there, as in
    `lattice.beside_ray`."""
    worth = [(abs(d[axis]) >= SLOW).choose(abs(d[axis]) * step[axis], d[axis].every(0.0)) for axis in range(3)]
    by_x, by_y = worth[0] >= most(worth[1], worth[2]), worth[1] >= worth[2]
    place, speed = (by_x.choose(of[0], by_y.choose(of[1], of[2])) for of in (places, speeds))
    return ((speed > 0.0).choose(math.ceil(place), math.floor(place)) - place) * (1.0 / speed), speed


def octahedral_eight(d: list[Lanes]) -> list[Lanes]:
    """As `packets.octahedral`, int32."""
    size = abs(d[0]) + abs(d[1]) + abs(d[2])
    scale = (size >= SHORTEST).choose(1.0 / size, size.every(0.0))
    u, v = d[0] * scale, d[1] * scale
    one = u.every(1.0)
    folded = ((1.0 - abs(v)) * one.signed_as(u), (1.0 - abs(u)) * one.signed_as(v))
    codes = []
    for plain, other in zip((u, v), folded, strict=True):
        code = math.floor((d[2] < 0.0).choose(other, plain) * float(HALF_DIRECTION) + 0.5)
        codes.append(within(code + float(HALF_DIRECTION), 0.0, 2.0 * HALF_DIRECTION).as_whole())
    return codes


def _weight(weight: list[Lanes]) -> Lanes:
    """As `packets.pack_weight`, int64."""
    largest = most(*weight)
    e = (largest.bits() >> 52) - 1022 + WEIGHT_BIAS  # of binary64: f * 2^e with 0.5 <= f < 1
    e = (e < 0).choose(0, e)
    e = (largest < TOO_LARGE_WEIGHT).choose(e, e.every(127))
    rounds_up = (largest * _unit(e) + 0.5 >= 2048.0).as_long()
    e = e + (e < 127).choose(rounds_up, e.every(0))
    unit = _unit(e)
    r, g, b = (least(one * unit + 0.5, unit.every(2047.0)).as_whole().as_long() for one in weight)
    return (largest > 0.0).choose(r | g << 11 | b << 22 | e << 33, e.every(0))


def _unit(e: Lanes) -> Lanes:
    """2^(WEIGHT_BIAS + 11 - e), `packets.WEIGHT_INVERSE_UNIT`."""
    return ((1023 + WEIGHT_BIAS + 11 - e) << 52).of_bits()


def _shadow_weight(value: Lanes) -> Lanes:
    """As `packets.pack_shadow_weight`, int64."""
    bits = least(value, value.every(LARGEST_BINARY32)).bits_of_single() + 64
    bits = least(bits, bits.every(int(LARGEST_SHADOW_WEIGHT)))
    return (value > 0.0).choose(bits >> 7, bits.every(0))


Rest = tuple[Lanes, Lanes, Lanes]  # bytes 14 and 15, 16 to 23, and 24 of a packet, as numbers


def rest_of_ray(direction: list[Lanes], weight: Lanes) -> Rest:
    """The rest of a ray with this direction and packed weight."""
    a, b = (code.as_long() for code in octahedral_eight(direction))
    return a & 0xFFFF, a >> 16 | b << 8 | weight << 32, weight >> 32


def words_of(head: Lanes, origin: list[Lanes], rest: Rest) -> list[Lanes]:
    """Bytes 0-7, 8-15, 16-23 and 24 of a packet as numbers; `head`: its first five bytes."""
    x, y, z = (at.as_long() for at in origin)
    two, eight, last = rest
    return [head | x << 40, y | z << 24 | two << 48, eight, last]


def _of_ray(facts: Table, words: Table, direction: list[Lanes]) -> Rest:
    return rest_of_ray(direction, _weight(facts.read_three(SPAWN_WEIGHT)))


def _of_shadow(facts: Table, words: Table, direction: list[Lanes]) -> Rest:
    red, green, blue = (_shadow_weight(one) for one in facts.read_three(SPAWN_WEIGHT))
    return words.read(SPAWN_LIGHT), red | green << 24 | blue << 48, blue >> 16


def _words(rest_of: Callable[[Table, Table, list[Lanes]], Rest]) -> Intrinsic:
    """Make the intrinsic that makes the words of eight packets whose rest, from byte 14 on, is found like this."""

    def intrinsic_function(
        typingctx: TypingContext, facts: Type, words: Type, fact: Type, word: Type, step: Type, edges: Type
    ) -> Typed:
        """Make the words of eight packets, whose columns begin at place `fact` of the facts and `word` of the words.

        step  three float64; edges  six int32, the cell's corners
        """

        def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, args: Values) -> Value:
            known = Table(context, builder, signature.args[0], args[0], args[2], SPAWN_ROOM)
            made = Table(context, builder, signature.args[1], args[1], args[3], SPAWN_ROOM)
            steps, cell = (splats(builder, packed) for packed in args[4:])
            direction = known.read_three(SPAWN_DIRECTION)
            origin = _origins(known, direction, steps)
            rest = rest_of(known, made, direction)
            for k, word in enumerate(words_of(made.read(SPAWN_HEAD), origin, rest)):
                made.write(SPAWN_WORD + k, word)
            made.write(SPAWN_BEHIND, behind(origin, cell).as_long())
            return context.get_dummy_value()

        tuples = types.UniTuple(types.float64, 3), types.UniTuple(types.int32, 6)
        return types.void(facts, words, types.int64, types.int64, *tuples), codegen

    return intrinsic(intrinsic_function)


# kernels call them without the first argument
_ray_words: Intrinsic = _words(_of_ray)
_shadow_words: Intrinsic = _words(_of_shadow)
