"""Works out at once what each of very many cells holds: for the simulator, whose nodes share one process.

The rule is that of the flood (`node.geometry.overlap`): a cell holds the surfaces that meet it. Only the cells that a surface's
box reaches are looked at, so empty cells cost nothing.

A node that tests a list looks at all it holds, so its ticks follow from how many surfaces of each kind that are, and
all nodes may find their hits in one hierarchy of the whole scene: a node takes only hits within its own cell, so it
finds the same ones (law 4). For nodes with a hierarchy each (`trees`) these are built as `node.tracing.local_geometry` builds them,
in one set of tables.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.simulator.kernels import relocate_leaves, touched_cells
from raygrid.node import geometry
from raygrid.node.tracing import build_surfaces, empty_surfaces

Long = NDArray[np.int64]


class SharedGeometry(NamedTuple):
    """Who holds what.

    cells  int64 (pairs,), ascending; kinds int64 (pairs,); rows int64 (pairs,) of the batch of that kind, ascending
    held   int64 (cells, 6), surfaces of each kind
    """

    cells: Long
    kinds: Long
    rows: Long
    held: Long


def ordered(surfaces: geometry.SurfaceSet) -> geometry.SurfaceSet:
    """One batch a kind, in the order of ids, as a node has them."""
    return geometry.SurfaceSet(tuple(batch.select(np.argsort(batch.ids)) for batch in geometry.merge(surfaces)))


class Described(NamedTuple):
    """All surfaces of a scene in tables of one type, so that kernels are compiled once; in the order of `ordered`.

    kinds   int64 (n,); rows int64 (n,) of the batch of that kind
    table   float64 (n, 18): the numbers of all but polygons
    points  float64 (points, 3) of polygons; starts int64 (n + 1,): where those of surface k begin
    boxes   float64 (n, 2, 3); sizes int64 (n,), bytes of the description
    """

    kinds: Long
    rows: Long
    table: NDArray[np.float64]
    points: NDArray[np.float64]
    starts: Long
    boxes: NDArray[np.float64]
    sizes: Long


NAMED = 6  # bytes of a description's id and material


def described(surfaces: geometry.SurfaceSet) -> Described:
    """The surfaces, which must be `ordered`, at most one batch a kind."""
    n = len(surfaces)
    kinds, rows, sizes = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    table, starts, boxes = np.zeros((n, 18)), np.zeros(n + 1, np.int64), np.zeros((n, 2, 3))
    points, first = np.zeros((1, 3)), 0
    for batch in surfaces:
        last = first + len(batch)
        kinds[first:last], rows[first:last], boxes[first:last] = int(batch.kind), np.arange(len(batch)), batch.bounds()
        if batch.kind == geometry.Kind.POLYGON:
            points, starts[first : last + 1] = np.ascontiguousarray(batch.data, np.float64), batch.starts
            sizes[first:last] = NAMED + 4 + 24 * np.diff(batch.starts)
        else:
            table[first:last, : batch.data.shape[1]] = batch.data
            sizes[first:last] = NAMED + batch.data.shape[1] * np.dtype(geometry.STORED_AS[batch.kind]).itemsize
        first = last
    return Described(kinds, rows, table, points, starts, boxes, sizes)


def shared_geometry(surfaces: geometry.SurfaceSet, space: geometry.Space) -> SharedGeometry:
    """What each cell holds of surfaces in the order of `ordered`."""
    nx, ny, nz = space.shape
    low_at, high_at = (np.zeros((3, max(space.shape))) for _ in range(2))
    for axis in range(3):
        planes = (space.planes[axis, : space.shape[axis] + 1] - geometry.HALF) * space.step[axis]
        low_at[axis, : space.shape[axis]] = planes[:-1] - geometry.SLACK
        high_at[axis, : space.shape[axis]] = planes[1:] + geometry.SLACK
    every = described(surfaces)
    many, room = 8 * len(surfaces), 0
    while many > room:
        room = many
        cells, found = np.empty(room, np.int64), np.empty(room, np.int64)
        many = touched_cells(every, low_at, high_at, space.shape, cells, found)
    cells, found = cells[:many], found[:many]
    order = np.lexsort((found, cells))
    kinds, rows = every.kinds[found[order]], every.rows[found[order]]
    held = np.zeros((nx * ny * nz, len(geometry.Kind)), np.int64)
    np.add.at(held, (cells[order], kinds), 1)
    return SharedGeometry(cells[order], kinds, rows, held)


def whole_world(space: geometry.Space) -> geometry.Space:
    """The same world box as one cell."""
    return geometry.make_space(space.step, [[0, geometry.LATTICE]] * 3)


def one_hierarchy(
    surfaces: geometry.SurfaceSet, space: geometry.Space, held: SharedGeometry
) -> tuple[geometry.Surfaces, Long]:
    """(tables, roots int64 (cells, 2)): all nodes look into one hierarchy, those that hold nothing into none."""
    built = build_surfaces(surfaces, geometry.make_cell(whole_world(space), (0, 0, 0)))
    roots = np.zeros((len(held.held), 2), np.int64)
    roots[held.held.any(axis=1), 1] = len(built.floats)
    return built, roots


def trees(surfaces: geometry.SurfaceSet, space: geometry.Space, held: SharedGeometry) -> tuple[geometry.Surfaces, Long]:
    """(tables, roots int64 (cells, 2)): each node has the hierarchy that it would build itself."""
    roots = np.zeros((len(held.held), 2), np.int64)
    by_kind = {batch.kind: batch for batch in surfaces}
    boxes = {batch.kind: batch.bounds() for batch in surfaces}
    everywhere = np.zeros((len(held.cells), 2, 3))
    for kind, of in boxes.items():
        everywhere[held.kinds == kind] = of[held.rows[held.kinds == kind]]
    borders = np.append(np.flatnonzero(np.diff(held.cells, prepend=-1)), len(held.cells))
    order = np.empty(len(held.cells), np.int64)
    made: list[NDArray[np.float32]] = []
    nodes = 0
    nx, ny, _ = space.shape
    for first, last in zip(borders[:-1].tolist(), borders[1:].tolist(), strict=True):
        number = int(held.cells[first])
        cell = geometry.make_cell(space, (number % nx, number // nx % ny, number // (nx * ny)))
        box = everywhere[first:last]
        box[:, 0] = np.maximum(box[:, 0], np.array(cell.low_at) - 2 * geometry.SLACK)
        box[:, 1] = np.minimum(box[:, 1], np.array(cell.high_at) + 2 * geometry.SLACK)
        box[:, 0] = np.minimum(box[:, 0], box[:, 1])
        within, floats = geometry.build(box, held.kinds[first:last].astype(np.int8))
        order[first:last] = first + within
        relocate_leaves(floats.view(np.uint32), first)
        roots[number] = nodes, nodes + len(floats)
        nodes += len(floats)
        made.append(floats)
    return _gathered(by_kind, held.kinds[order], held.rows[order], made), roots


def _gathered(
    by_kind: dict[geometry.AnyKind, geometry.Batch], kinds: Long, rows: Long, made: list[NDArray[np.float32]]
) -> geometry.Surfaces:
    """The tables of surfaces in the order of the leaves of all hierarchies; a surface is there once for each cell."""
    floats = np.concatenate([np.zeros((0, geometry.NODE_WORDS), np.float32), *made])
    items = kinds.astype(np.uint32) << np.uint32(geometry.KIND_SHIFT)
    ids, materials = np.zeros(len(kinds), np.uint32), np.zeros(len(kinds), np.uint16)
    columns: dict[str, Any] = {}
    cones = 0
    for kind in geometry.Kind:
        mine = kinds == kind
        if kind not in by_kind:
            continue
        batch, chosen = by_kind[kind], rows[mine]
        first = cones if kind == geometry.Kind.CONE else 0
        cones = len(chosen) if kind == geometry.Kind.CYLINDER else cones
        items[mine] |= np.arange(first, first + len(chosen), dtype=np.uint32)
        ids[mine], materials[mine] = batch.ids[chosen], batch.materials[chosen]
        alone = _alone(batch)
        for name, table in _tables_of(kind, alone).items():
            picked = table if name in ("bins", "edges") else table[chosen]
            columns[name] = np.concatenate((columns[name], picked)) if name in columns else picked
    empty = empty_surfaces()
    columns = {name: np.ascontiguousarray(table) for name, table in columns.items()}
    return empty._replace(
        floats=floats, words=floats.view(np.uint32), items=items, ids=ids, materials=materials, **columns
    )


def _alone(batch: geometry.Batch) -> geometry.Surfaces:
    """The tables of one kind, in the order of the batch: a leaf a surface keeps no order, so it is put back."""
    space = geometry.make_space((2.0**-23,) * 3, [[0, geometry.LATTICE]] * 3)
    built = build_surfaces(geometry.SurfaceSet((batch,)), geometry.make_cell(space, (0, 0, 0)))
    back = np.argsort(built.ids)  # batches are in the order of ids
    tables = {
        name: table[back]
        for name, table in built._asdict().items()
        if name in ("triangles", "smooth", "spheres", "cones", "planes", "headers") and len(table) == len(batch)
    }
    return built._replace(**tables)


def _tables_of(kind: geometry.Kind, built: geometry.Surfaces) -> dict[str, Any]:
    names = {
        geometry.Kind.TRIANGLE: ("triangles",),
        geometry.Kind.SMOOTH: ("smooth",),
        geometry.Kind.SPHERE: ("spheres",),
        geometry.Kind.CYLINDER: ("cones",),
        geometry.Kind.CONE: ("cones",),
        geometry.Kind.POLYGON: ("planes", "headers", "bins", "edges"),
    }
    every = built._asdict()
    return {name: every[name] for name in names[kind]}
