"""Builds the tables that the ray step reads from the surfaces that one node retains.

Everything derived here is a function of the description alone (never of the cell), so two nodes that
hold the same surface test it with the same numbers. Only boxes in the hierarchy are cut to the cell.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.bvh import NODE_WORDS, build
from raygrid.node.geometry.bvh_refit import refitted
from raygrid.node.geometry.intersect import (
    CONE_AXIS,
    CONE_BASE,
    CONE_COLUMNS,
    CONE_HEIGHT,
    CONE_INSIDE,
    CONE_RADIUS,
    CONE_SLOPE,
    PLANE_BIN_SCALE,
    PLANE_COLUMNS,
    PLANE_FIRST_BIN,
    PLANE_NORMAL,
    PLANE_OFFSET,
    POLY_BIN_START,
    POLY_BINS,
    POLY_COLUMNS,
    POLY_DROP,
)
from raygrid.node.geometry.lattice import SLACK, Cell
from raygrid.node.geometry.quaternion import rotation_matrices
from raygrid.node.geometry.surface_tables import KIND_SHIFT, Surfaces
from raygrid.node.geometry.surfaces import F64, STORED_AS, STRIDE, AddedKind, AnyKind, Batch, Kind, SurfaceSet
from raygrid.node.jit.decorators import kernel
from raygrid.node.protocol.packing import SHORTEST

MOST_BINS = 1024  # strips of a polygon's height


def cone_table(data: F64) -> F64:
    """Derived columns of cylinders and cones, float64 (n, CONE_COLUMNS), from their 8 numbers."""
    table = np.zeros((len(data), CONE_COLUMNS))
    axis = data[:, 4:7] - data[:, 0:3]
    height = np.sqrt(np.sum(axis * axis, axis=1))
    has_one = height >= SHORTEST
    length = np.where(has_one, height, 1.0)
    table[:, CONE_BASE : CONE_BASE + 3] = data[:, 0:3]
    table[:, CONE_AXIS : CONE_AXIS + 3] = np.where(has_one[:, None], axis / length[:, None], 0.0)
    table[:, CONE_HEIGHT] = np.where(has_one, height, -1.0)  # no height lies below 0: nothing is met
    table[:, CONE_RADIUS] = np.abs(data[:, 3])
    table[:, CONE_SLOPE] = (np.abs(data[:, 7]) - np.abs(data[:, 3])) / length
    table[:, CONE_INSIDE] = (data[:, 3] < 0.0) | (data[:, 7] < 0.0)
    return table


def polygon_tables(points: F64, starts: NDArray[np.int64]) -> tuple[F64, NDArray[np.int64], NDArray[np.int64], F64]:
    """(planes, headers, bins, edges) of polygons, see `node.geometry.intersect.in_polygon`.

    The normal is Newell's: twice the area vector, the best plane through points that are not quite planar.
    """
    n = len(starts) - 1
    planes, headers = np.zeros((n, PLANE_COLUMNS)), np.zeros((n, POLY_COLUMNS), np.int64)
    if n == 0:
        return planes, headers, np.zeros(1, np.int64), np.zeros((0, 4))
    sizes = np.diff(starts)
    most_bins = np.minimum(np.where(sizes <= 6, 1, sizes), MOST_BINS)
    # a strip lists an edge once; an edge may lie in every strip, so strips are halved until the lists are short
    bins = np.zeros(int(most_bins.sum()) + n + 1, np.int64)
    edges = np.zeros((int((8 * sizes + most_bins).sum()) + 16, 4))
    used_bins, used_edges = _polygons(points, starts, most_bins, planes, headers, bins, edges)
    return planes, headers, bins[:used_bins].copy(), edges[:used_edges].copy()


@kernel
def _newell(points, first, last):
    """Area vector and middle of a polygon."""
    nx, ny, nz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(first, last):
        after = k + 1 if k + 1 < last else first
        # taken about the first point, so that a polygon far from the origin keeps its digits
        ax, ay, az = points[k, 0] - points[first, 0], points[k, 1] - points[first, 1], points[k, 2] - points[first, 2]
        bx, by, bz = (
            points[after, 0] - points[first, 0],
            points[after, 1] - points[first, 1],
            points[after, 2] - points[first, 2],
        )
        nx += ay * bz - az * by
        ny += az * bx - ax * bz
        nz += ax * by - ay * bx
        mx += ax
        my += ay
        mz += az
    n = last - first
    return nx, ny, nz, points[first, 0] + mx / n, points[first, 1] + my / n, points[first, 2] + mz / n


@kernel
def _count_in_bins(points, first, last, v, low, scale, bins):
    """Count the entries of the lists of all strips together."""
    total = 0
    for k in range(first, last):
        after = k + 1 if k + 1 < last else first
        a, b = min(points[k, v], points[after, v]), max(points[k, v], points[after, v])
        if a < b:
            total += min(np.int64((b - low) * scale), bins - 1) - np.int64((a - low) * scale) + 1
    return total


@kernel
def _polygons(points, starts, most_bins, planes, headers, bins, edges):
    """Fill the tables; returns how much of `bins` and `edges` is used."""
    next_bin, next_edge = 0, 0
    for row in range(len(starts) - 1):
        first, last = starts[row], starts[row + 1]
        nx, ny, nz, mx, my, mz = _newell(points, first, last)
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        length = length if length >= SHORTEST else 1.0  # then no ray meets its plane
        nx, ny, nz = nx / length, ny / length, nz / length
        planes[row, PLANE_NORMAL], planes[row, PLANE_NORMAL + 1], planes[row, PLANE_NORMAL + 2] = nx, ny, nz
        planes[row, PLANE_OFFSET] = nx * mx + ny * my + nz * mz
        drop = 0 if abs(nx) >= abs(ny) and abs(nx) >= abs(nz) else (1 if abs(ny) >= abs(nz) else 2)
        u, v = (drop + 1) % 3, (drop + 2) % 3
        low, high = np.inf, -np.inf
        for k in range(first, last):
            low, high = min(low, points[k, v]), max(high, points[k, v])
        count, most_entries = most_bins[row], 8 * (last - first)
        while count > 1 and _count_in_bins(points, first, last, v, low, count / (high - low), count) > most_entries:
            count //= 2
        # a little less, so that rounding cannot lift what is just below the top over the last strip
        scale = count / (high - low) * (1.0 - 2.0**-50)
        headers[row, POLY_DROP], headers[row, POLY_BIN_START], headers[row, POLY_BINS] = drop, next_bin, count
        planes[row, PLANE_FIRST_BIN], planes[row, PLANE_BIN_SCALE] = low, scale
        for strip in range(count):
            bins[next_bin] = next_edge
            next_bin += 1
            next_edge = _edges_of_strip(points, (first, last), (u, v), (low, scale), strip, edges, next_edge)
        bins[next_bin] = next_edge
        next_bin += 1
    return next_bin, next_edge


@kernel
def _edges_of_strip(points, span, axes, strips, strip, edges, next_edge):
    """Append the edges whose height range touches a strip; each runs from its lower end to its upper one.

    span  (first, last) point of the polygon; axes  along which strips lie, and in which they follow each other
    strips  (where the first begins, strips a unit)
    """
    (first, last), (u, v), (low, scale) = span, axes, strips
    for k in range(first, last):
        after = k + 1 if k + 1 < last else first
        a, b = (k, after) if points[k, v] < points[after, v] else (after, k)
        if not points[a, v] < points[b, v]:
            continue
        # the product is the one of the lookup, and rounds monotonically: no strip is missed
        if np.int64((points[a, v] - low) * scale) <= strip and strip <= np.int64((points[b, v] - low) * scale):
            edges[next_edge, 0] = points[a, u]
            edges[next_edge, 1] = points[a, v]
            edges[next_edge, 2] = points[b, v]
            edges[next_edge, 3] = (points[b, u] - points[a, u]) / (points[b, v] - points[a, v])
            next_edge += 1
    return next_edge


def build_surfaces(retained: SurfaceSet, cell: Cell) -> Surfaces:
    """The tables of a node that retains these surfaces (machine coordinates, at most one batch a kind)."""
    batches = [batch for batch in retained if len(batch)]
    if not batches:
        return empty_surfaces()
    return _assembled(batches, *build(_boxes(batches, cell), _kinds(batches)))


def refit_surfaces(retained: SurfaceSet, cell: Cell, before: Surfaces) -> Surfaces | None:
    """The tables with the tree that a node had `before` for the same surfaces; None if they are not the same."""
    batches = [batch for batch in retained if len(batch)]
    ids = np.concatenate([np.zeros(0, np.uint32), *(batch.ids for batch in batches)])
    sorter = np.argsort(ids)
    if len(ids) == 0 or not np.array_equal(ids[sorter], np.sort(before.ids)):
        return None
    order = sorter[np.searchsorted(ids[sorter], before.ids)]
    return _assembled(batches, order, refitted(before.floats, _boxes(batches, cell)[order]))


def _boxes(batches: list[Batch], cell: Cell) -> F64:
    """The boxes of all surfaces, cut to the cell, float64 (n, 2, 3)."""
    boxes = np.concatenate([batch.bounds() for batch in batches])
    boxes[:, 0] = np.maximum(boxes[:, 0], np.array(cell.low_at) - 2 * SLACK)
    boxes[:, 1] = np.minimum(boxes[:, 1], np.array(cell.high_at) + 2 * SLACK)
    boxes[:, 0] = np.minimum(boxes[:, 0], boxes[:, 1])
    return boxes


def _kinds(batches: list[Batch]) -> NDArray[np.int8]:
    return np.repeat(np.array([batch.kind for batch in batches], np.int8), [len(batch) for batch in batches])


def _assembled(batches: list[Batch], order: NDArray[np.intp], floats: NDArray[np.float32]) -> Surfaces:
    """The tables of surfaces, in the order of a tree's leaves."""
    rows = np.concatenate([np.arange(len(batch)) for batch in batches])[order]
    kinds = _kinds(batches)[order]
    items = kinds.astype(np.uint32) << np.uint32(KIND_SHIFT)
    held: dict[AnyKind, Batch] = {}
    for batch in batches:
        mine = kinds == batch.kind
        held[batch.kind] = batch.select(rows[mine])  # in leaf order
        first = len(held[Kind.CYLINDER]) if batch.kind == Kind.CONE and Kind.CYLINDER in held else 0
        items[mine] |= np.arange(first, first + len(batch), dtype=np.uint32)
    return Surfaces(
        floats,
        floats.view(np.uint32),
        items,
        np.concatenate([batch.ids for batch in batches])[order],
        np.concatenate([batch.materials for batch in batches])[order],
        *_tables(held),
    )


@cache
def empty_surfaces() -> Surfaces:
    """The tables of a node that retains nothing: no hierarchy, which the ray step skips. Not to be written to."""
    floats = np.zeros((0, NODE_WORDS), np.float32)
    numbers = np.zeros(0, np.uint32)
    return Surfaces(floats, floats.view(np.uint32), numbers, numbers, np.zeros(0, np.uint16), *_tables({}))


def _tables(held: dict[AnyKind, Batch]) -> tuple[Any, ...]:
    """The fields of `Surfaces` from `triangles` on."""

    def data(kind: AnyKind) -> NDArray[np.floating]:
        if kind not in held:
            return np.zeros((0, STRIDE[kind]), STORED_AS[kind])
        return np.ascontiguousarray(held[kind].data, STORED_AS[kind])

    cones = np.concatenate([cone_table(data(kind).astype(np.float64)) for kind in (Kind.CYLINDER, Kind.CONE)])
    starts = held[Kind.POLYGON].starts if Kind.POLYGON in held else np.zeros(1, np.int64)
    return (
        data(Kind.TRIANGLE),
        data(Kind.SMOOTH),
        data(Kind.SPHERE),
        cones,
        *polygon_tables(data(Kind.POLYGON).astype(np.float64), starts),
        programmed_table(data(AddedKind.PROGRAMMED).astype(np.float64)),
    )


def programmed_table(data: F64) -> F64:
    """Columns of programmed surfaces, float64 (n, OWN_COLUMNS), from their numbers."""
    matrices = rotation_matrices(data[:, :4]).reshape(-1, 9)
    return np.ascontiguousarray(np.concatenate((matrices, data[:, 4:]), axis=1))
