"""Names the cells of an array: their coordinates in order, as text, and those of a neighbour."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

Index = tuple[int, int, int]


def indices(shape: Index) -> Iterator[Index]:
    """Every cell, x fastest."""
    for z in range(shape[2]):
        for y in range(shape[1]):
            for x in range(shape[0]):
                yield (x, y, z)


def name_of(index: Iterable[int]) -> str:
    """A cell as people read it: "1,0,0"."""
    return ",".join(map(str, index))


def beyond(index: Index, port: int) -> Index:
    """The neighbour behind a port: two for each axis, towards its lower end and towards its upper one."""
    there = list(index)
    there[port >> 1] += 1 if port & 1 else -1
    return there[0], there[1], there[2]
