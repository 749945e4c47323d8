"""Works out primary rays, eight at once: those that may be spawned, and the homes of return packets.

Both begin with the ray of a sample and the point at which it enters the world box (`node.tracing.camera`).
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.grid_walk import behind
from raygrid.node.geometry.lattice import CELL
from raygrid.node.jit.decorators import part
from raygrid.node.jit.formula import eight
from raygrid.node.jit.lanes import ARRAY, EIGHT, F64, I64, VECTOR, Columns, Lanes, Memory, Staged, Three
from raygrid.node.protocol.packets import PRIMARY
from raygrid.node.protocol.packing import pack_weight, ray_words
from raygrid.node.tracing.camera import entry, eye_ray, pixel_and_point, primary_origin
from raygrid.node.tracing.spawn import put_made

PRIMARY_ROOM = 128  # samples that are noted before they are worked out; a multiple of EIGHT
# rows of `facts`: of a primary the point in the image; of a return its intensity
IMAGE_X, IMAGE_Y, RETURN_INTENSITY, PRIMARY_FACTS = 0, 1, 2, 5
# rows of `words`: the first five bytes of a packet, the place in the store of its pixel; then of a primary the packet's
# words (`node.protocol.packing`), and the ports behind which it enters, or a number below 0; of a return the point where its
# sample's ray enters, and column and row of its pixel
PRIMARY_HEAD, PRIMARY_PLACE = 0, 1
PRIMARY_WORD, PRIMARY_BEHIND, PRIMARY_POINT, PRIMARY_PIXEL, PRIMARY_WORDS = 2, 6, 2, 5, 7
WHITE = int(pack_weight(1.0, 1.0, 1.0))
NO_HOME = -1


class PrimaryBatch(NamedTuple):
    """Samples that are noted, a column each; flat.

    facts  float64 (PRIMARY_FACTS * PRIMARY_ROOM,); words  int64 (PRIMARY_WORDS * PRIMARY_ROOM,); held  int64 (1,)
    """

    facts: NDArray[np.float64]
    words: NDArray[np.int64]
    held: NDArray[np.int64]


BATCH = PrimaryBatch(ARRAY, ARRAY, ARRAY)  # type: ignore[arg-type]  # as formulas take it


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
        _make_primaries(seen, j, frame.camera, cell, space.step)


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
        _find_homes(seen, j, frame.camera, space.step, frame.width, frame.samples)


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


@eight(takes=(BATCH, I64, ARRAY, CELL, VECTOR))
def _make_primaries(seen: Staged, at: Lanes, camera: Memory, cell: Staged, step: Three) -> None:
    """Make the words of the primaries from column `at` on; camera  float64 (6, 3)."""
    facts, words = (Columns(of, at, PRIMARY_ROOM) for of in (seen.facts, seen.words))
    origin, direction = eye_ray(camera, facts.read(IMAGE_X), facts.read(IMAGE_Y))
    enters, point, near = entry(step, origin, direction)
    start = primary_origin(step, origin, direction, near)
    head = words.read(PRIMARY_HEAD)
    for k, word in enumerate(ray_words(head, start, direction, head.every(WHITE))):
        words.write(PRIMARY_WORD + k, word)
    words.write(PRIMARY_BEHIND, enters.choose(behind(cell, point).to(I64), NO_HOME))


@eight(takes=(BATCH, I64, ARRAY, VECTOR, F64, F64))
def _find_homes(seen: Staged, at: Lanes, camera: Memory, step: Three, width: Lanes, samples: Lanes) -> None:
    """Find the pixels of the samples from column `at` on, and where their rays enter the world box."""
    words = Columns(seen.words, at, PRIMARY_ROOM)
    pixel, point = pixel_and_point(words.read(PRIMARY_HEAD) & 0xFFFFFFFF, width, samples)
    _, entered, _ = entry(step, *eye_ray(camera, *point))
    for axis in range(3):
        words.write(PRIMARY_POINT + axis, entered[axis].to(I64))
    for k in range(2):
        words.write(PRIMARY_PIXEL + k, pixel[k].to(I64))
