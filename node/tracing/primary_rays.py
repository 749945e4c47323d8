"""Works out primary rays, eight at once: those that may be spawned, and the homes of return packets.

Both begin with the ray of a sample and the point at which it enters the world box. The operations, and their order,
are those of `camera.eye_ray`, `camera.entry`, `camera.primary_origin` and `packets.put_ray`: so are the bits, which a
test compares.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from raygrid.node.geometry.lattice import FINE, HALF, LONGEST_STEP
from raygrid.node.jit.decorators import part
from raygrid.node.jit.simd import EIGHT, Lanes, Table, least, most, splat, splats
from raygrid.node.protocol.packets import PRIMARY, SHORTEST, pack_weight
from raygrid.node.tracing.camera import R2_X, R2_Y, TRIES
from raygrid.node.tracing.ray_setup import behind, corners, inverse_eight
from raygrid.node.tracing.spawn import nearest_eight, next_on_lattice, put_made, rest_of_ray, words_of

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


PRIMARY_ROOM = 128  # samples that are noted before they are worked out; a multiple of EIGHT
# rows of `facts`: of a primary the point in the image; of a return its intensity
IMAGE_X, IMAGE_Y, RETURN_INTENSITY, PRIMARY_FACTS = 0, 1, 2, 5
# rows of `words`: the first five bytes of a packet, the place in the store of its pixel; then of a primary the packet's
# words (`spawn.words_of`), and the ports behind which it enters, or a number below 0; of a return the point where its
# sample's ray enters, and column and row of its pixel
PRIMARY_HEAD, PRIMARY_PLACE = 0, 1
PRIMARY_WORD, PRIMARY_BEHIND, PRIMARY_POINT, PRIMARY_PIXEL, PRIMARY_WORDS = 2, 6, 2, 5, 7
WHITE = int(pack_weight(1.0, 1.0, 1.0))
NO_HOME = -1
CAMERA_COLUMNS = 18  # numbers of a camera


class PrimaryBatch(NamedTuple):
    """Samples that are noted, a column each; flat.

    facts  float64 (PRIMARY_FACTS * PRIMARY_ROOM,); words  int64 (PRIMARY_WORDS * PRIMARY_ROOM,); held  int64 (1,)
    """

    facts: NDArray[np.float64]
    words: NDArray[np.int64]
    held: NDArray[np.int64]


def make_primary_batch() -> PrimaryBatch:
    """Make an empty batch."""
    return PrimaryBatch(
        np.zeros(PRIMARY_FACTS * PRIMARY_ROOM), np.zeros(PRIMARY_WORDS * PRIMARY_ROOM, np.int64), np.zeros(1, np.int64)
    )


# --- primaries -----------------------------------------------------------------------------------------


@part
def note_primary(seen, x, y, sample, place):
    """Note a sample whose ray may be spawned; `place`: of its pixel in the store."""
    j = seen.held[0] & (PRIMARY_ROOM - 1)
    seen.facts[IMAGE_X * PRIMARY_ROOM + j], seen.facts[IMAGE_Y * PRIMARY_ROOM + j] = x, y
    seen.words[PRIMARY_HEAD * PRIMARY_ROOM + j], seen.words[PRIMARY_PLACE * PRIMARY_ROOM + j] = (
        PRIMARY | (1 << 3) | (sample << 8),
        place,
    )
    seen.held[0] = j + 1


@part
def work_out_primaries(cell, space, frame, seen):
    """Make the words of all that are noted."""
    for j in range(0, seen.held[0], EIGHT):
        _primary_words(seen.facts, seen.words, j, frame.camera, space.step, corners(cell))


@part
def is_at_home(seen, j):
    """Tell whether the ray of a sample that was worked out enters the world box in this cell."""
    return seen.words[PRIMARY_BEHIND * PRIMARY_ROOM + j] == 0


@part
def put_primary(seen, j, row, at):
    """Write the packet of a sample that was worked out."""
    put_made(seen.words, PRIMARY_WORD * PRIMARY_ROOM + j, PRIMARY_ROOM, row, at)


# --- homes of returns ----------------------------------------------------------------------------------


@part
def note_return(seen, frame, sample, depth, intensity):
    """Note a return packet to be spawned; returns whether there is room for no more."""
    j = seen.held[0] & (PRIMARY_ROOM - 1)
    for k in range(3):
        seen.facts[(RETURN_INTENSITY + k) * PRIMARY_ROOM + j] = intensity[k]
    seen.words[PRIMARY_HEAD * PRIMARY_ROOM + j] = (depth << 32) | sample
    seen.held[0] = j + 1
    return j + 1 == PRIMARY_ROOM


@part
def work_out_returns(space, frame, seen):
    """Find the pixels of all samples that are noted, and where their rays enter the world box."""
    for j in range(0, seen.held[0], EIGHT):
        _entries(
            seen.facts, seen.words, j, frame.camera, space.step, (np.float64(frame.width), np.float64(frame.samples))
        )


@part
def entered_at(seen, j):
    """Lattice point at which the ray of a sample that was worked out enters the world box."""
    words = seen.words
    return (
        words[PRIMARY_POINT * PRIMARY_ROOM + j],
        words[(PRIMARY_POINT + 1) * PRIMARY_ROOM + j],
        words[(PRIMARY_POINT + 2) * PRIMARY_ROOM + j],
    )


@part
def pixel_of(seen, j):
    """Column and row of the pixel of a sample that was worked out."""
    return seen.words[PRIMARY_PIXEL * PRIMARY_ROOM + j], seen.words[(PRIMARY_PIXEL + 1) * PRIMARY_ROOM + j]


@part
def noted_return(seen, j):
    """(sample, depth, intensity) of a return packet that was noted."""
    head, facts = seen.words[PRIMARY_HEAD * PRIMARY_ROOM + j], seen.facts
    intensity = (
        np.float32(facts[RETURN_INTENSITY * PRIMARY_ROOM + j]),
        np.float32(facts[(RETURN_INTENSITY + 1) * PRIMARY_ROOM + j]),
        np.float32(facts[(RETURN_INTENSITY + 2) * PRIMARY_ROOM + j]),
    )
    return head & 0xFFFFFFFF, head >> 32, intensity


# --- eight at once -------------------------------------------------------------------------------------


def _hash(x: Lanes) -> Lanes:
    """As `camera.hash32`, of int64 below 2^32."""
    x = ((x ^ x >> 16) * 0x85EBCA6B) & 0xFFFFFFFF
    x = ((x ^ x >> 13) * 0xC2B2AE35) & 0xFFFFFFFF
    return x ^ x >> 16


def _image_point(sample: Lanes, width: Lanes, samples: Lanes) -> tuple[list[Lanes], list[Lanes]]:
    """As `camera.image_point`: (column and row of the pixel, the point). Wholes in binary64: quotients of numbers below
    2^32 lie farther below the next whole than rounding can raise them, so those of divisions are theirs."""
    pixel = math.floor(sample.as_float() / samples)
    row = math.floor(pixel / width)
    column = pixel - row * width
    number = sample.as_float() - pixel * samples + 1.0
    mixed = _hash(pixel.as_number())
    alone = samples.equals(1.0)
    point = []
    for middle, bits, ratio in ((column, mixed & 0xFFFF, R2_X), (row, mixed >> 16, R2_Y)):
        at = bits.as_float() * (1.0 / 65536.0) + number * ratio
        point.append(alone.choose(middle, middle + (at - math.floor(at)) - 0.5))
    return [column, row], point


def _eye_ray(camera: list[Lanes], x: Lanes, y: Lanes) -> tuple[list[Lanes], list[Lanes]]:
    """As `camera.eye_ray`."""
    origin, (u, v, w) = (
        [camera[row + axis] + x * camera[row + 3 + axis] + y * camera[row + 6 + axis] for axis in range(3)]
        for row in (0, 9)
    )
    squared = u * u + v * v + w * w
    has_one = squared >= SHORTEST * SHORTEST
    scale = has_one.choose(1.0 / squared.root(), squared.every(0.0))
    return origin, [u * scale, v * scale, has_one.choose(w * scale, w.every(1.0))]


def _entry(origin: list[Lanes], direction: list[Lanes], step: list[Lanes]) -> tuple[Lanes, list[Lanes], list[Lanes]]:
    """As `camera.entry`: (enters, lattice point, the point itself)."""
    nears, fars = [], []
    for at, d, one in zip(origin, direction, step, strict=True):
        inverse, half = inverse_eight(d), one * float(HALF)
        a, b = (-half - at) * inverse, (half - at) * inverse
        nears.append((inverse >= 0.0).choose(a, b))
        fars.append((inverse >= 0.0).choose(b, a))
    near = most(nears[0], most(nears[1], most(nears[2], nears[2].every(0.0))))
    far = least(fars[0], least(fars[1], fars[2]))
    point = [origin[axis] + near * direction[axis] for axis in range(3)]
    return near <= far, [nearest_eight(point[axis], step[axis]) for axis in range(3)], point


def _beside_ray(p: list[Lanes], d: list[Lanes], step: list[Lanes]) -> list[Lanes]:
    """As `lattice.beside_ray` with TRIES tries."""
    places, speeds = ([of[axis] / step[axis] for axis in range(3)] for of in (p, d))
    first, speed = next_on_lattice(places, speeds, d, step)
    inverse = 1.0 / speed
    stride = most(speed.every(1.0), math.floor(abs(speed) * LONGEST_STEP)) * abs(inverse)
    least_aside, t = first.every(float("inf")), first
    for k in range(TRIES):
        after = first + stride * float(k)
        rests = []
        for axis in range(3):
            at = places[axis] + after * speeds[axis]
            rests.append((at - math.floor(at + 0.5)) * step[axis])
        a, b, c = rests
        along = a * d[0] + b * d[1] + c * d[2]
        aside = math.trunc((a * a + b * b + c * c - along * along) * FINE)
        better = aside < least_aside
        least_aside, t = better.choose(aside, least_aside), better.choose(after, t)
    return [nearest_eight(p[axis] + t * d[axis], step[axis]) for axis in range(3)]


def _tables(
    context: BaseContext, builder: IRBuilder, signature: Signature, args: Values
) -> tuple[Table, Table, list[Lanes], list[Lanes]]:
    """Facts, words, camera and step among the arguments of an intrinsic."""
    facts, words = (Table(context, builder, signature.args[k], args[k], args[2], PRIMARY_ROOM) for k in range(2))
    camera = context.make_array(signature.args[3])(context, builder, args[3]).data
    numbers = [builder.load(builder.gep(camera, [context.get_constant(types.intp, k)])) for k in range(CAMERA_COLUMNS)]
    return facts, words, [splat(builder, number) for number in numbers], splats(builder, args[4])


def _make_primary_words(
    typingctx: TypingContext, facts: Type, words: Type, at: Type, camera: Type, step: Type, edges: Type
) -> Typed:
    """Make the words of eight primaries, columns at..at+7; camera  float64 (6, 3); edges  six int32, the cell's corners."""

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, args: Values) -> Value:
        known, made, numbers, steps = _tables(context, builder, signature, args)
        origin, d = _eye_ray(numbers, known.read(IMAGE_X), known.read(IMAGE_Y))
        enters, point, start = _entry(origin, d, steps)
        head = made.read(PRIMARY_HEAD)
        for k, word in enumerate(words_of(head, _beside_ray(start, d, steps), rest_of_ray(d, head.every(WHITE)))):
            made.write(PRIMARY_WORD + k, word)
        ports = behind(point, splats(builder, args[5])).as_long()
        made.write(PRIMARY_BEHIND, enters.choose(ports, ports.every(NO_HOME)))
        return context.get_dummy_value()

    tuples = types.UniTuple(types.float64, 3), types.UniTuple(types.int32, 6)
    return types.void(facts, words, types.int64, camera, *tuples), codegen


def _make_entries(
    typingctx: TypingContext, facts: Type, words: Type, at: Type, camera: Type, step: Type, sizes: Type
) -> Typed:
    """Find the pixels of eight samples and where their rays enter the world box, columns at..at+7.

    camera  float64 (6, 3); sizes  two float64, width of the picture and samples a pixel
    """

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, args: Values) -> Value:
        _, made, numbers, steps = _tables(context, builder, signature, args)
        pixel, image = _image_point(made.read(PRIMARY_HEAD) & 0xFFFFFFFF, *splats(builder, args[5]))
        origin, direction = _eye_ray(numbers, *image)
        _, point, _ = _entry(origin, direction, steps)
        for axis in range(3):
            made.write(PRIMARY_POINT + axis, point[axis].as_long())
        for k in range(2):
            made.write(PRIMARY_PIXEL + k, pixel[k].as_number())
        return context.get_dummy_value()

    tuples = types.UniTuple(types.float64, 3), types.UniTuple(types.float64, 2)
    return types.void(facts, words, types.int64, camera, *tuples), codegen


# kernels call them without the first argument
_primary_words: Intrinsic = intrinsic(_make_primary_words)
_entries: Intrinsic = intrinsic(_make_entries)
