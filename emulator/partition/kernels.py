"""Records the rays of a sampling pre-pass, counts the work along them, and searches for planes: compiled."""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry import (
    FAREST,
    LEAF_BIT,
    NODE_WORDS,
    T_MIN,
    cell_index,
    coordinate,
    for_boxes,
    inverse,
    nearest,
    push_boxes,
)
from raygrid.node.jit import lean, part
from raygrid.node.protocol import PRIMARY, SHADOW, SIZE, read_kind, read_origin, read_u32
from raygrid.node.tracing import (
    FOUND_DIRECTION,
    FOUND_DISTANCE,
    FOUND_OUT,
    FOUND_TIME,
    edge_colour,
    place,
    ray_of_sample,
)

T_END, IS_PRIMARY, SHADED, RETURNS, FACTS = 3, 4, 5, 6, 7  # columns of PrepassRays.facts
TOTAL_SHARE = 0.5  # weight of the mean over cells beside the largest cell: they share a computer's cores, too
SWEEPS = 20


@lean
def record_rays(tables, packets, rays):
    """Note of each packet (a ray that starts in the one cell), which an observed step was given, where it begins and ends."""
    found, frame = tables.outputs.found, tables.frame
    for k in range(len(rays.facts)):
        at = k * SIZE
        kind, origin = read_kind(packets, at), read_origin(packets, at)
        direction = (
            found.facts[k, FOUND_DIRECTION],
            found.facts[k, FOUND_DIRECTION + 1],
            found.facts[k, FOUND_DIRECTION + 2],
        )
        distance, misses = found.facts[k, FOUND_DISTANCE], found.items[k] < 0
        end = found.facts[k, FOUND_TIME]
        if misses:  # a shadow ray stays in the cell where it reaches its light
            end = np.nextafter(distance, 0.0) if distance <= found.facts[k, FOUND_OUT] else np.inf
        returns = misses
        if kind != SHADOW:
            red, green, blue = edge_colour(frame, direction)
            returns = returns and (red > 0.0 or green > 0.0 or blue > 0.0)
        _, point, _ = ray_of_sample(frame, tables.space.step, read_u32(packets, at + 1))
        for axis in range(3):
            rays.origins[k, axis] = origin[axis]
            rays.homes[k, axis] = point[axis]
            rays.facts[k, axis] = direction[axis]
        rays.facts[k, T_END] = end
        rays.facts[k, IS_PRIMARY] = kind == PRIMARY
        rays.facts[k, SHADED] = not misses and kind != SHADOW
        rays.facts[k, RETURNS] = returns


@part
def _next_plane(grid, axis, voxel, o, inv):
    """(time of the plane by which a ray leaves its voxel along an axis, the plane's index)."""
    index = voxel + 1 if inv >= 0.0 else voxel
    return (coordinate(grid.planes[axis, index], grid.step[axis]) - o) * inv, index


@lean
def walk_rays(rays, surfaces, stack, grid, weights, work, places, held):
    """Walk every ray through the grid, add what each surface costs that is held at a place, and sum up.

    Voxel (i, j, k) is counted at (i + 1, j + 1, k + 1), for running sums.
    """
    for r in range(len(rays.facts)):
        facts = rays.facts[r]
        o = place((rays.origins[r, 0], rays.origins[r, 1], rays.origins[r, 2]), grid.step)
        d = (facts[0], facts[1], facts[2])
        inv = (inverse(d[0]), inverse(d[1]), inverse(d[2]))
        x = cell_index(grid.planes, 0, grid.shape[0], rays.origins[r, 0])
        y = cell_index(grid.planes, 1, grid.shape[1], rays.origins[r, 1])
        z = cell_index(grid.planes, 2, grid.shape[2], rays.origins[r, 2])
        work.done[x + 1, y + 1, z + 1] += weights.walk + weights.primary * facts[IS_PRIMARY]
        end = facts[T_END]
        cost = weights.walk + weights.hop
        while True:
            at_x, plane_x = _next_plane(grid, 0, x, o[0], inv[0])
            at_y, plane_y = _next_plane(grid, 1, y, o[1], inv[1])
            at_z, plane_z = _next_plane(grid, 2, z, o[2], inv[2])
            if at_x <= at_y and at_x <= at_z:  # ties as in `node.geometry.grid_walk.passage`
                if at_x > end or plane_x == 0 or plane_x == grid.shape[0]:
                    break
                work.crossed[0, 0 if inv[0] >= 0.0 else 1, plane_x, y + 1, z + 1] += cost
                x += 1 if inv[0] >= 0.0 else -1
            elif at_y <= at_z:
                if at_y > end or plane_y == 0 or plane_y == grid.shape[1]:
                    break
                work.crossed[1, 0 if inv[1] >= 0.0 else 1, x + 1, plane_y, z + 1] += cost
                y += 1 if inv[1] >= 0.0 else -1
            else:
                if at_z > end or plane_z == 0 or plane_z == grid.shape[2]:
                    break
                work.crossed[2, 0 if inv[2] >= 0.0 else 1, x + 1, y + 1, plane_z] += cost
                z += 1 if inv[2] >= 0.0 else -1
        work.done[x + 1, y + 1, z + 1] += weights.hit * facts[SHADED]
        if facts[RETURNS] != 0.0:
            _go_home(rays, r, grid, x, y, z, weights, work)
        if weights.box > 0.0 and len(surfaces.floats) > 0:
            _open_boxes(surfaces, stack, grid, (o, d, inv, end), weights.box, work)
    for k in range(places.shape[1]):
        work.done[places[0, k], places[1, k], places[2, k]] += held
    _sum_up(work.done, True, True, True)
    for way in range(2):
        _sum_up(work.crossed[0, way], False, True, True)
        _sum_up(work.crossed[1, way], True, False, True)
        _sum_up(work.crossed[2, way], True, True, False)


@part
def _sum_up(values, along_x, along_y, along_z):
    """Running sums along some axes, one after the other."""
    nx, ny, nz = values.shape
    if along_x:
        for i in range(1, nx):
            for j in range(ny):
                for k in range(nz):
                    values[i, j, k] += values[i - 1, j, k]
    if along_y:
        for i in range(nx):
            for j in range(1, ny):
                for k in range(nz):
                    values[i, j, k] += values[i, j - 1, k]
    if along_z:
        for i in range(nx):
            for j in range(ny):
                for k in range(1, nz):
                    values[i, j, k] += values[i, j, k - 1]


@part
def _go_home(rays, r, grid, x, y, z, weights, work):
    """A return packet goes along x to its home's x, then along y, then along z (`walk.towards_cell`)."""
    to_x = cell_index(grid.planes, 0, grid.shape[0], rays.homes[r, 0])
    to_y = cell_index(grid.planes, 1, grid.shape[1], rays.homes[r, 1])
    to_z = cell_index(grid.planes, 2, grid.shape[2], rays.homes[r, 2])
    work.done[x + 1, y + 1, z + 1] += weights.returned
    work.done[to_x + 1, to_y + 1, to_z + 1] += weights.taken_in
    up = 0 if to_x > x else 1
    for plane in range(min(x, to_x) + 1, max(x, to_x) + 1):
        work.crossed[0, up, plane, y + 1, z + 1] += weights.hop
    up = 0 if to_y > y else 1
    for plane in range(min(y, to_y) + 1, max(y, to_y) + 1):
        work.crossed[1, up, to_x + 1, plane, z + 1] += weights.hop
    up = 0 if to_z > z else 1
    for plane in range(min(z, to_z) + 1, max(z, to_z) + 1):
        work.crossed[2, up, to_x + 1, to_y + 1, plane] += weights.hop


@part
def _open_boxes(surfaces, stack, grid, whole, weight, work):
    """Count each node of the hierarchy that a ray (origin, direction, inverse direction, end) opens where it enters the
    node's box."""
    o, d, inv, end = whole
    ray, near = for_boxes(o, inv)
    high = np.float32(min(end, FAREST))
    stack[0] = 0
    top = np.int64(1)
    while top > 0:
        top -= 1
        key = stack[top]
        child = key & 0xFFFFFFFF
        t = np.float64(np.uint32(key >> 32).view(np.float32))
        if child >= LEAF_BIT:
            continue
        top = push_boxes(surfaces.floats, child * NODE_WORDS, near, ray, np.float32(T_MIN), high, stack, top)
        x = cell_index(grid.planes, 0, grid.shape[0], nearest(o[0] + t * d[0], grid.step[0]))
        y = cell_index(grid.planes, 1, grid.shape[1], nearest(o[1] + t * d[1], grid.step[1]))
        z = cell_index(grid.planes, 2, grid.shape[2], nearest(o[2] + t * d[2], grid.step[2]))
        work.done[x + 1, y + 1, z + 1] += weight


@part
def _rectangle(sums, y0, y1, z0, z1):
    return sums[y1, z1] - sums[y0, z1] - sums[y1, z0] + sums[y0, z0]


@part
def _cell(done, crossed, x0, x1, y0, y1, z0, z1):
    """Work of the box between these planes: what is done in it, and what enters by its six faces."""
    cost = _rectangle(done[x1], y0, y1, z0, z1) - _rectangle(done[x0], y0, y1, z0, z1)
    cost += _rectangle(crossed[0, 0, x0], y0, y1, z0, z1) + _rectangle(crossed[0, 1, x1], y0, y1, z0, z1)
    cost += _rectangle(crossed[1, 0, :, y0], x0, x1, z0, z1) + _rectangle(crossed[1, 1, :, y1], x0, x1, z0, z1)
    cost += _rectangle(crossed[2, 0, :, :, z0], x0, x1, y0, y1) + _rectangle(crossed[2, 1, :, :, z1], x0, x1, y0, y1)
    return cost


@lean
def _slab(done, crossed, shape, planes, axis, between, unit, order):
    """(sum of powers 2^order of cells, in this unit; sum of cells) over the cells between two planes of an axis."""
    low, high = between
    powers, total = 0.0, 0.0
    for i in range(1 if axis == 0 else shape[0]):
        x0, x1 = (low, high) if axis == 0 else (planes[0, i], planes[0, i + 1])
        for j in range(1 if axis == 1 else shape[1]):
            y0, y1 = (low, high) if axis == 1 else (planes[1, j], planes[1, j + 1])
            for k in range(1 if axis == 2 else shape[2]):
                z0, z1 = (low, high) if axis == 2 else (planes[2, k], planes[2, k + 1])
                cost = _cell(done, crossed, x0, x1, y0, y1, z0, z1)
                total += cost
                power = cost / unit
                for _ in range(order):
                    power *= power
                powers += power
    return powers, total


@lean
def _move(done, crossed, shape, planes, axis, k, unit, order):
    """Move one plane to where the cost is least; returns the cost."""
    powers, total = 0.0, 0.0
    for i in range(shape[axis]):
        if i != k - 1 and i != k:
            p, t = _slab(done, crossed, shape, planes, axis, (planes[axis, i], planes[axis, i + 1]), unit, order)
            powers, total = powers + p, total + t
    below, above, best, least = planes[axis, k - 1], planes[axis, k + 1], planes[axis, k], np.inf
    for at in range(below + 1, above):
        p0, t0 = _slab(done, crossed, shape, planes, axis, (below, at), unit, order)
        p1, t1 = _slab(done, crossed, shape, planes, axis, (at, above), unit, order)
        root = powers + p0 + p1
        for _ in range(order):
            root = np.sqrt(root)  # exactly rounded, unlike a power: the same planes on every computer
        cost = unit * root + TOTAL_SHARE * (total + t0 + t1) / (shape[0] * shape[1] * shape[2])
        if cost < least * (1.0 - 1e-12):
            best, least = at, cost
    planes[axis, k] = best
    return least


@lean
def search_planes(done, crossed, shape, planes, order):
    """Move all planes in turn until the cost falls no more; returns it."""
    _, total = _slab(done, crossed, shape, planes, 0, (np.int64(0), planes[0, shape[0]]), 1.0, 0)
    unit, best = max(total, 1e-300) / (shape[0] * shape[1] * shape[2]), np.inf
    for _ in range(SWEEPS):
        cost = best
        for axis in range(3):
            for k in range(1, shape[axis]):
                cost = _move(done, crossed, shape, planes, axis, k, unit, order)
        if not cost < best * (1.0 - 1e-9):
            break
        best = cost
    return best
