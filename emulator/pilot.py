"""A quick pilot of rays: where in the world box a frame's work will be, before any array is launched.

A coarse grid of the picture's rays is traced to full depth through the whole scene in one cell, by the nodes' own step
and walk, and of each ray and shadow ray is kept where it begins, its direction, and how far it goes. Then they are
walked again through a fine grid of possible planes. What a cell of the array will have to do is a sum over

    voxels   work done at a place: rays born and walked there, boxes opened, hits shaded, samples taken in
    faces    rays and return packets that cross a plane, each a walk more in the cell that they enter

and with running sums over both, the cost of any box between any planes of the grid is a few additions. The count of
walks is exact: a path through the fine grid is the path through any planes chosen from it and some crossings more,
as both put the same times, worked out by the same arithmetic (`node.walk`), in the same order.

The idea of placing planes where the estimated cost of work divides evenly is that of Dippé and Swensen ("An adaptive
subdivision algorithm and parallel architecture for realistic image synthesis", SIGGRAPH 1984) and, with a sample of
rays as the measure, of Priol and Bouatouch ("Static load balancing for a parallel ray tracing on a MIMD hypercube",
The Visual Computer 5, 1989).
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.births import bear_primaries, new_cursor
from raygrid.node.camera import entry, eye_ray, image_point
from raygrid.node.compiled import lean, part
from raygrid.node.hierarchy import DEPTH, LEAF_BIT, WORDS
from raygrid.node.holdings import build_surfaces
from raygrid.node.lanes import WIDE, push_boxes
from raygrid.node.lattice import T_MIN, Cell, Space, cell_index, coordinate, make_cell, make_space, nearest
from raygrid.node.packets import LATTICE, PRIMARY, SHADOW, SIZE, read_u16, read_u24, read_u32, unit_vector
from raygrid.node.pixels import make_pixels
from raygrid.node.shading import light_direction, place
from raygrid.node.step import HEAD, edge_colour, make_outputs, step
from raygrid.node.surfaces import SurfaceSet, merge
from raygrid.node.tables import COUNTS, Frame, Surfaces
from raygrid.node.traverse import closest
from raygrid.node.walk import SELF, SELF_RAYS, inverse, passage

F64 = NDArray[np.float64]
ACROSS = 48  # pilot rays along a side of the picture
MOST_RAYS = 200_000  # rays followed, whatever lights and mirrors there are
CHUNK = 16_384  # packets in a call

# Microseconds of a node: least squares over the counts and busy seconds of 96 nodes (six scenes at 512x512 on 2x2x2).
WALK, BOX, HIT, PRIMARY_BORN, HOP, RETURNED, TAKEN_IN = 0.08, 0.05, 0.13, 0.15, 0.08, 0.05, 0.07

# columns of Rays.facts
T_END, IS_PRIMARY, SHADED, RETURNS, FACTS = 3, 4, 5, 6, 7


class Rays(NamedTuple):
    """Rays of a pilot, shadow rays among them.

    origins  int64 (n, 3), lattice; homes int64 (n, 3), where the primary ray of the sample begins
    facts    float64 (n, FACTS): direction; T_END, the ray crosses planes up to this time; whether it is a primary
             ray, is shaded where it ends, and brings an intensity home from there
    """

    origins: NDArray[np.int64]
    homes: NDArray[np.int64]
    facts: F64


class Pilot(NamedTuple):
    """What was seen of a frame.

    surfaces  of the whole scene, or of a part that stands for it, in one cell
    share     samples of the frame for each one of the pilot
    """

    rays: Rays
    surfaces: Surfaces
    step: tuple[float, float, float]
    share: float


def fly(step_of_axes: tuple[float, float, float], surfaces: SurfaceSet, frame: Frame, across: int = ACROSS) -> Pilot:
    """Trace a coarse grid of the frame's rays through surfaces in machine coordinates."""
    space = make_space(step_of_axes, [[0, LATTICE]] * 3)
    cell = make_cell(space, (0, 0, 0))
    coarse = coarse_frame(frame, across)
    built = build_surfaces(merge(surfaces), cell)
    rays = _trace(space, cell, coarse, built)
    share = frame.width * frame.height * frame.samples / (coarse.width * coarse.height)
    return Pilot(rays, built, step_of_axes, share)


def coarse_frame(frame: Frame, across: int) -> Frame:
    """The same view with few pixels, in arrays of the types that kernels were compiled for."""
    width, height = min(frame.width, across), min(frame.height, across)
    wide, high = frame.width / width, frame.height / height
    camera = np.array(frame.camera, np.float64, order="C")
    for at, along, down in ((0, 1, 2), (3, 4, 5)):
        camera[at] += (0.5 * wide - 0.5) * camera[along] + (0.5 * high - 0.5) * camera[down]
        camera[along] *= wide
        camera[down] *= high
    return frame._replace(
        camera=camera,
        materials=np.array(frame.materials, np.float64, order="C"),
        lights=np.array(frame.lights, np.float64, order="C"),
        width=width,
        height=height,
        samples=1,
    )


def _trace(space: Space, cell: Cell, frame: Frame, surfaces: Surfaces) -> Rays:
    """Every ray of the frame, generation by generation."""
    pixels = make_pixels(frame, space, cell)
    outputs = make_outputs(CHUNK * (frame.n_lights + 2), DEPTH)
    counts = np.zeros(COUNTS, np.int64)
    room = frame.width * frame.height
    packets = np.zeros(room * SIZE, np.uint8)
    born = bear_primaries(
        cell, space, frame, pixels, new_cursor(len(pixels.first) > 0), packets, 0, room, counts
    )
    ports = np.full(CHUNK, SELF, np.uint8)
    waiting, found, total = [packets[: born * SIZE]], [], 0
    while waiting and total < MOST_RAYS:
        bytes_ = waiting.pop(0)
        many = min(len(bytes_) // SIZE, CHUNK)
        if len(bytes_) > many * SIZE:
            waiting.insert(0, bytes_[many * SIZE :])
        if many == 0:
            continue
        head = bytes_[: many * SIZE]
        found.append(_recorded(space, cell, frame, surfaces, outputs.stack, head, counts))
        done = step(cell, space, frame, surfaces, pixels, head, ports, 0, many, outputs, counts)
        assert done == many
        shadows, others = (
            outputs.data[output, HEAD : HEAD + int(outputs.held[output]) * SIZE].copy() for output in (SELF, SELF_RAYS)
        )
        outputs.held[:] = 0
        for first in range(0, len(shadows), CHUNK * SIZE):
            found.append(
                _recorded(space, cell, frame, surfaces, outputs.stack, shadows[first : first + CHUNK * SIZE], counts)
            )
        waiting.append(others)
        total += many + len(shadows) // SIZE
    if not found:
        return Rays(np.zeros((0, 3), np.int64), np.zeros((0, 3), np.int64), np.zeros((0, FACTS)))
    return Rays(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _recorded(
    space: Space,
    cell: Cell,
    frame: Frame,
    surfaces: Surfaces,
    stack: NDArray[np.int64],
    packets: NDArray[np.uint8],
    counts: NDArray[np.int64],
) -> Rays:
    many = len(packets) // SIZE
    rays = Rays(np.zeros((many, 3), np.int64), np.zeros((many, 3), np.int64), np.zeros((many, FACTS)))
    _record(space, cell, frame, surfaces, stack, packets, rays, counts)
    return rays


@lean
def _record(space, cell, frame, surfaces, stack, packets, rays, counts):
    """Note of each packet (a ray that starts in the one cell) where it begins and ends."""
    for k in range(len(rays.facts)):
        at = k * SIZE
        kind = np.int64(packets[at]) & 7
        origin = (read_u24(packets, at + 5), read_u24(packets, at + 8), read_u24(packets, at + 11))
        o = place(origin, space.step)
        d, distance = unit_vector(read_u24(packets, at + 14), read_u24(packets, at + 17)), np.inf
        if kind == SHADOW:
            d, distance = light_direction(frame.lights, read_u16(packets, at + 14), o)
        inv = (inverse(d[0]), inverse(d[1]), inverse(d[2]))
        _, t_out, _ = passage(cell, origin, o, inv)
        t, item = min(t_out, distance), np.int64(-1)
        if len(surfaces.floats) > 0:
            t, item, _, _ = closest(surfaces, stack, o, d, inv, T_MIN, min(t_out, distance), counts)
        end = t
        if item < 0:  # a shadow ray stays in the cell where it reaches its light
            end = np.nextafter(distance, 0.0) if distance <= t_out else np.inf
        returns = item < 0
        if kind != SHADOW:
            red, green, blue = edge_colour(frame, d)
            returns = returns and (red > 0.0 or green > 0.0 or blue > 0.0)
        x, y = image_point(read_u32(packets, at + 1), frame.width, frame.samples)
        from_eye, along = eye_ray(frame.camera, x, y)
        _, point = entry(space.step, from_eye, along)
        for axis in range(3):
            rays.origins[k, axis] = origin[axis]
            rays.homes[k, axis] = point[axis]
            rays.facts[k, axis] = d[axis]
        rays.facts[k, T_END] = end
        rays.facts[k, IS_PRIMARY] = kind == PRIMARY
        rays.facts[k, SHADED] = item >= 0 and kind != SHADOW
        rays.facts[k, RETURNS] = returns


class Weights(NamedTuple):
    """Cost of each piece of work, in any unit; WALK and so on above are microseconds of a node."""

    walk: float = WALK
    box: float = BOX
    hit: float = HIT
    primary: float = PRIMARY_BORN
    hop: float = HOP
    returned: float = RETURNED
    taken_in: float = TAKEN_IN


class Work(NamedTuple):
    """Running sums over a grid of planes, nx x ny x nz voxels.

    done     float64 (nx + 1, ny + 1, nz + 1): work in all voxels before
    crossed  float64 (3, 2, nx + 1, ny + 1, nz + 1): of each axis, upwards and downwards, cost of crossings of a
             plane (its own index along the axis) in all voxels before along the two others
    """

    done: F64
    crossed: F64


def tally(pilot: Pilot, grid: Space, weights: Weights = Weights()) -> Work:
    """The pilot's work over a grid of planes."""
    nx, ny, nz = grid.shape
    work = Work(np.zeros((nx + 1, ny + 1, nz + 1)), np.zeros((3, 2, nx + 1, ny + 1, nz + 1)))
    stack = np.zeros(DEPTH, np.int64)
    rays, facts = pilot.rays, weights
    _tally(rays, pilot.surfaces, stack, grid, Weights(*map(float, facts)), work)
    return work


def run_sums(work: Work) -> None:
    """Make running sums of what was tallied, in place."""
    for axis in range(3):
        np.cumsum(work.done, axis=axis, out=work.done)
        for other in range(3):
            if other != axis:
                np.cumsum(work.crossed[axis], axis=other + 1, out=work.crossed[axis])


@part
def _next_plane(grid, axis, voxel, o, inv):
    """(time of the plane by which a ray leaves its voxel along an axis, the plane's index)."""
    index = voxel + 1 if inv >= 0.0 else voxel
    return (coordinate(grid.planes[axis, index], grid.step[axis]) - o) * inv, index


@lean
def _tally(rays, surfaces, stack, grid, weights, work):
    """Walk every ray through the grid. Voxel (i, j, k) is counted at (i + 1, j + 1, k + 1), for running sums."""
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
            if at_x <= at_y and at_x <= at_z:  # ties as in `walk.passage`
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
            _open_boxes(surfaces, stack, grid, o, d, inv, end, weights, work)


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
def _open_boxes(surfaces, stack, grid, o, d, inv, end, weights, work):
    """Count each node of the hierarchy that a ray opens where it enters the node's box."""
    most = 1e18
    ray = (
        np.float32(o[0]),
        np.float32(o[1]),
        np.float32(o[2]),
        np.float32(min(max(inv[0], -most), most)),
        np.float32(min(max(inv[1], -most), most)),
        np.float32(min(max(inv[2], -most), most)),
    )
    near = (
        np.int64(0 if inv[0] >= 0.0 else 3 * WIDE),
        np.int64(WIDE if inv[1] >= 0.0 else 4 * WIDE),
        np.int64(2 * WIDE if inv[2] >= 0.0 else 5 * WIDE),
    )
    high = np.float32(min(end, most))
    stack[0] = 0
    top = np.int64(1)
    while top > 0:
        top -= 1
        key = stack[top]
        child = key & 0xFFFFFFFF
        t = np.float64(np.uint32(key >> 32).view(np.float32))
        if child >= LEAF_BIT:
            continue
        top += push_boxes(surfaces.floats, child * WORDS, near, ray, np.float32(T_MIN), high, stack, top)
        x = cell_index(grid.planes, 0, grid.shape[0], nearest(o[0] + t * d[0], grid.step[0]))
        y = cell_index(grid.planes, 1, grid.shape[1], nearest(o[1] + t * d[1], grid.step[1]))
        z = cell_index(grid.planes, 2, grid.shape[2], nearest(o[2] + t * d[2], grid.step[2]))
        work.done[x + 1, y + 1, z + 1] += weights.box
