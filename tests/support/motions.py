"""Surfaces in groups, motions that keep them in the world box, and a look at what nodes hold."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.node.geometry.lattice import HALF, Space
from raygrid.node.geometry.rigid_motion import MOTION, Groups, Moves, make_groups
from raygrid.node.geometry.surfaces import Kind, SurfaceSet
from support.surfaces import F64, Generator, batch, random_rows, shuffled_ids, unit_vectors


class Troupe(NamedTuple):
    """Surfaces at rest, some of them in groups; each group lies round the origin.

    reaches  how far from the origin each group's surfaces come
    """

    surfaces: SurfaceSet
    groups: Groups
    reaches: F64


def troupe(rng: Generator, groups: int, each: int, fixed: int = 2, materials: int = 1) -> Troupe:
    """`each` surfaces of each kind in each group, and `fixed` ones of each kind that stay."""
    batches = []
    for kind in Kind:
        rows = random_rows(kind, rng, groups * each + fixed, reach=0.2, size=(3e-3, 0.12))
        batches.append(batch(kind, rows, materials=rng.integers(0, materials, len(rows))))
    surfaces = shuffled_ids(batches, rng)
    ids, numbers, reaches = [], [], np.zeros(groups)
    for rows in surfaces:
        chosen = rng.permutation(len(rows))[: groups * each]
        number = np.arange(len(chosen)) % groups
        ids.append(rows.ids[chosen])
        numbers.append(number)
        far = np.linalg.norm(np.abs(rows.bounds()).max(axis=1), axis=1)
        np.maximum.at(reaches, number, far[chosen])
    return Troupe(surfaces, make_groups(np.concatenate(ids), np.concatenate(numbers), groups), reaches)


def random_motion(rng: Generator, reach: float, space: Space, size: float | None = None) -> F64:
    """Turned, scaled and put anywhere in the world box. `size`: how far it may come from its middle."""
    half = HALF * np.array(space.step)
    size = float(np.exp(rng.uniform(np.log(0.02), np.log(0.9)))) * float(half.min()) if size is None else size
    turn = rng.normal(size=4)
    shift = rng.uniform(-1.0, 1.0, 3) * (half - size) * 0.999
    return np.array([*turn / np.linalg.norm(turn), size / reach, *shift])


def random_motions(rng: Generator, cast: Troupe, space: Space) -> F64:
    """A motion for each group."""
    return np.stack([random_motion(rng, reach, space) for reach in cast.reaches]).reshape(-1, MOTION)


def next_motions(rng: Generator, before: F64, first: F64, cast: Troupe, space: Space) -> F64:
    """Some groups go on: far, a little, back to where they were at first, or all of them into one small corner."""
    now = before.copy()
    how = rng.random()
    if how < 0.1:
        half, corner = HALF * np.array(space.step), rng.choice([-1.0, 1.0], 3)
        for group, reach in enumerate(cast.reaches):
            size = 0.04 * float(half.min())
            now[group] = random_motion(rng, reach, space, size)
            now[group, 5:] = corner * (half - 1.5 * size)
        return now
    for group in np.flatnonzero(rng.random(len(now)) < 0.5):
        if how < 0.25:
            now[group] = first[group]
        elif how < 0.6:
            half = HALF * np.array(space.step)
            reach = now[group, 4] * cast.reaches[group]
            now[group, 5:] += rng.normal(size=3) * 0.1 * half
            now[group, 5:] = np.clip(now[group, 5:], -(half - reach) * 0.999, (half - reach) * 0.999)
        else:
            now[group] = random_motion(rng, cast.reaches[group], space)
    return now


def holdings(array: MemoryArray) -> list[dict[str, bytes]]:
    """What each node holds: descriptions at rest, and every table of the ray step in the order of ids."""
    found = []
    for processor in array.processors:
        node_state = processor.node_state
        held = {
            f"{b.kind.name} {what}": getattr(b, what).tobytes() for b in node_state.retained for what in ("ids", "data")
        }
        held |= {f"{b.kind.name} materials": b.materials.tobytes() for b in node_state.retained}
        held |= {f"{b.kind.name} where": node_state.increments.place(b).data.tobytes() for b in node_state.retained}
        tables = node_state.surfaces
        order = np.argsort(tables.ids)
        held |= {"built ids": tables.ids[order].tobytes(), "built materials": tables.materials[order].tobytes()}
        for kind, table in (
            (Kind.TRIANGLE, tables.triangles),
            (Kind.SMOOTH, tables.smooth),
            (Kind.SPHERE, tables.spheres),
        ):
            mine = tables.items >> 29 == int(kind)  # rows of a kind are in leaf order too
            held[f"built {kind.name}"] = table[np.argsort(tables.ids[mine])].tobytes()
        found.append(held)
    return found


def moves_of(cast: Troupe, motions: F64) -> Moves:
    """The same groups somewhere else."""
    return Moves(cast.groups, motions)


__all__ = ["holdings", "moves_of", "next_motions", "random_motion", "random_motions", "troupe", "unit_vectors"]
