"""Spawns secondary rays and shadow rays: notes them at a hit, and works out their packets eight at once.

Which rays a hit spawns depends on branches that no processor foresees; where a spawned ray starts on the lattice, how
its direction and weight are packed and which bytes that makes does not, but for a dozen quotients, roots and roundings
each. So a step only notes a ray, and when it has gone over its packets all rays are worked out without a branch.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.grid_walk import behind
from raygrid.node.geometry.lattice import CELL, GENTLE, LIFT, beside_ray
from raygrid.node.jit.decorators import part
from raygrid.node.jit.formula import eight, formula
from raygrid.node.jit.intrinsics import put_words
from raygrid.node.jit.lanes import ARRAY, EIGHT, I64, LATTICE_POINT, VECTOR, Columns, Lanes, Staged, Three, dot, most
from raygrid.node.protocol.packing import pack_weight, ray_words, shadow_words

SPAWN_ROOM = 128  # rays that are noted before they are written; a multiple of EIGHT
SHADOW_BATCH, RAY_BATCH, SPAWN_BATCHES = 0, 1, 2
# rows of `facts`: point, normal, direction, weight
SPAWN_POINT, SPAWN_NORMAL, SPAWN_DIRECTION, SPAWN_WEIGHT, SPAWN_FACTS = 0, 3, 6, 9, 12
# rows of `words`: the first five bytes and the light; then the packet's words (`node.protocol.packing`), and the ports behind which
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


SPAWNS = SpawnBatch(ARRAY, ARRAY, ARRAY)  # type: ignore[arg-type]  # as formulas take it


def make_spawn_batch() -> SpawnBatch:
    """Make empty batches."""
    return SpawnBatch(
        np.zeros(SPAWN_BATCHES * SPAWN_FACTS * SPAWN_ROOM),
        np.zeros(SPAWN_BATCHES * SPAWN_WORDS * SPAWN_ROOM, np.int64),
        np.zeros(SPAWN_BATCHES, np.int64),
    )


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
        if spawn_batch == SHADOW_BATCH:
            _make_shadows(spawns, j, cell, space.step)
        else:
            _make_rays(spawns, j, cell, space.step)


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
    """Write a packet whose words (`node.protocol.packing`) stand at every `stride` places of a table from place `first` on."""
    put_words(row, at, words[first], words[first + stride], words[first + 2 * stride])
    row[at + 24] = np.uint8(words[first + 3 * stride])


# --- eight at once -------------------------------------------------------------------------------------


@formula(takes=(VECTOR, VECTOR, VECTOR, VECTOR), gives=LATTICE_POINT)
def origin_beside(step: Three, p: Three, g: Three, d: Three) -> list[Lanes]:
    """Lattice origin of a ray spawned at p: lifted off the surface to the side that it goes to, then rounded.

    It is moved along itself, which changes nothing of what it sees. A ray that leaves at a grazing angle would have to
    go far, so it is lifted along the normal g by what is lacking.
    """
    slope = dot(g, d)
    size = abs(slope)
    along = LIFT / most(size, size.every(GENTLE))
    lacking = LIFT - along * size
    side = (slope >= 0.0).choose(lacking, -lacking)
    return beside_ray(step, [p[axis] + along * d[axis] + side * g[axis] for axis in range(3)], d, 1)


def _make_words(spawns: Staged, at: Lanes, cell: Staged, step: Three, batch: int) -> None:
    """Make the words of the packets from column `at` on of a batch."""
    facts = Columns(spawns.facts, at + batch * SPAWN_FACTS * SPAWN_ROOM, SPAWN_ROOM)
    words = Columns(spawns.words, at + batch * SPAWN_WORDS * SPAWN_ROOM, SPAWN_ROOM)
    point, normal, direction, weight = map(facts.three, (SPAWN_POINT, SPAWN_NORMAL, SPAWN_DIRECTION, SPAWN_WEIGHT))
    origin, head = origin_beside(step, point, normal, direction), words.read(SPAWN_HEAD)
    if batch == SHADOW_BATCH:
        made = shadow_words(head, origin, words.read(SPAWN_LIGHT), weight)
    else:
        made = ray_words(head, origin, direction, pack_weight(*weight))
    for k, word in enumerate(made):
        words.write(SPAWN_WORD + k, word)
    words.write(SPAWN_BEHIND, behind(cell, origin).to(I64))


@eight(takes=(SPAWNS, I64, CELL, VECTOR))
def _make_shadows(spawns: Staged, at: Lanes, cell: Staged, step: Three) -> None:
    """Make the words of the shadow rays from column `at` on."""
    _make_words(spawns, at, cell, step, SHADOW_BATCH)


@eight(takes=(SPAWNS, I64, CELL, VECTOR))
def _make_rays(spawns: Staged, at: Lanes, cell: Staged, step: Three) -> None:
    """Make the words of the other rays from column `at` on."""
    _make_words(spawns, at, cell, step, RAY_BATCH)
