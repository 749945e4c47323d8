"""The hierarchy against Embree 4, one core: closest hits a second on the same triangles and the same rays.

    python benchmarks/kernel_embree.py [scene.nff ...]

Meshes: the triangles and smooth patches of the NFF scenes that are named, and a terrain of 100,352 triangles. Rays:
`eye` (a grid of rays from a point outside: neighbours in the batch take like paths) and `bounce` (from the points
that these hit, in random directions: they do not). Both programs take one ray at a time and give t and the triangle.
Runs alternate A B A B; the figures are medians, with the fastest and slowest in brackets.

Embree is bound by `embreex`, whose loop round it is compiled; "empty" is its time for a mesh that no ray meets. Its
boxes and triangle test are binary32, ours are binary32 and binary64. Wall-clock figures of this computer.
"""

from __future__ import annotations

import importlib.util
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.formats.nff import load_nff
from raygrid.node.geometry.bvh import DEPTH
from raygrid.node.geometry.grid_walk import inverse
from raygrid.node.geometry.lattice import LATTICE, T_MIN, make_cell, make_space, world_around
from raygrid.node.geometry.surfaces import Batch, Kind, SurfaceSet
from raygrid.node.jit.decorators import lean
from raygrid.node.protocol.counters import COUNTS
from raygrid.node.tracing.local_geometry import build_surfaces
from raygrid.node.tracing.traverse import closest

F32 = NDArray[np.float32]
REPEATS = 9
SIDE = 512  # rays an axis of the grid
FAR_AWAY = 10.0  # beyond any machine coordinate


@lean
def _trace(surfaces, origins, directions, stack, times, found, counts):  # type: ignore[no-untyped-def]
    """Closest hits of all rays: t to `times`, the surface's number to `found` (-1: none)."""
    for k in range(len(origins)):
        o = (np.float64(origins[k, 0]), np.float64(origins[k, 1]), np.float64(origins[k, 2]))
        d = (np.float64(directions[k, 0]), np.float64(directions[k, 1]), np.float64(directions[k, 2]))
        inv = (inverse(d[0]), inverse(d[1]), inverse(d[2]))
        t, item, _, _ = closest(surfaces, stack, o, d, inv, T_MIN, FAR_AWAY, counts)
        times[k], found[k] = t, np.int64(surfaces.ids[item]) if item >= 0 else -1


def terrain(side: int) -> F32:
    """Triangles (2 * side * side, 3, 3) of a rough height field."""
    rng = np.random.default_rng(5)
    x = np.linspace(-1.0, 1.0, side + 1)
    height = np.zeros((side + 1, side + 1))
    for octave in range(1, 7):
        phase, turn = rng.uniform(0, 2 * np.pi, 2), rng.uniform(0, np.pi)
        along, across = x[:, None] * np.cos(turn) + x * np.sin(turn), x[:, None] * np.sin(turn) - x * np.cos(turn)
        height += 0.4 / 2**octave * np.sin(2**octave * along + phase[0]) * np.cos(2**octave * across + phase[1])
    height += rng.normal(0.0, 0.2 / side, height.shape)
    points = np.stack((*np.meshgrid(x, x, indexing="ij"), height), axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.concatenate((np.stack((a, b, c), 2).reshape(-1, 3, 3), np.stack((a, c, d), 2).reshape(-1, 3, 3))).astype(
        np.float32
    )


def triangles_of(path: Path) -> F32:
    """The triangles of a scene, smooth patches among them, in machine coordinates."""
    surfaces = load_nff(path).surfaces
    flat = [batch.data[:, :9] for batch in surfaces if batch.kind in (Kind.TRIANGLE, Kind.SMOOTH)]
    return np.concatenate(flat).reshape(-1, 3, 3).astype(np.float32)


def eye_rays(corners: F32) -> tuple[F32, F32]:
    """A grid of rays through the ball round a mesh, from 2.5 radii away."""
    middle = (corners.min((0, 1)) + corners.max((0, 1))) / 2
    radius = float(np.sqrt(((corners - middle) ** 2).sum(-1)).max())
    forward = np.array((-0.55, -0.65, -0.52))
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    x = np.linspace(-0.4, 0.4, SIDE)
    directions = forward + x[None, :, None] * right + x[:, None, None] * up
    directions = directions.reshape(-1, 3) / np.linalg.norm(directions, axis=-1).reshape(-1, 1)
    origins = np.tile(middle - 2.5 * radius * forward, (len(directions), 1))
    return origins.astype(np.float32), directions.astype(np.float32)


def bounce_rays(origins: F32, directions: F32, times: NDArray[np.float64]) -> tuple[F32, F32]:
    """Rays from a little before each hit, in directions spread evenly over the sphere."""
    hit = np.flatnonzero(np.isfinite(times) & (times < FAR_AWAY))
    rng = np.random.default_rng(6)
    hit = rng.choice(hit, SIDE * SIDE)
    out = rng.normal(size=(len(hit), 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    starts = origins[hit] + directions[hit] * (times[hit, None] - 1e-4)
    return starts.astype(np.float32), out.astype(np.float32)


def ours(corners: F32) -> Callable[[F32, F32], tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """A function that traces rays with the kernels of a node that holds the whole mesh."""
    n = len(corners)
    batch = Batch(Kind.TRIANGLE, np.arange(n, dtype=np.uint32), np.zeros(n, np.uint16), corners.reshape(n, 9))
    world = world_around(SurfaceSet((batch,)).bounds())
    space = make_space(world.step, [[0, LATTICE]] * 3)
    surfaces = build_surfaces(SurfaceSet((batch,)), make_cell(space, (0, 0, 0)))
    stack, counts = np.zeros(DEPTH, np.int64), np.zeros(COUNTS, np.int64)

    def trace(origins: F32, directions: F32) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        times, found = np.empty(len(origins)), np.empty(len(origins), np.int64)
        _trace(surfaces, origins, directions, stack, times, found, counts)
        return times, found

    return trace


def embree(corners: F32) -> Callable[[F32, F32], tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """The same with Embree."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene: Any = EmbreeScene()
    TriangleMesh(scene, corners)

    def trace(origins: F32, directions: F32) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        answer = scene.run(origins, directions, output=1)
        return answer["tfar"], answer["primID"]

    return trace


def _figure(seconds: list[float]) -> str:
    each = [SIDE * SIDE / s / 1e6 for s in seconds]
    return f"{statistics.median(each):6.2f} ({min(each):.2f} - {max(each):.2f})"


def compare(name: str, corners: F32) -> None:
    """One line a kind of rays: million rays a second of both, and what is ours over Embree's."""
    corners = np.ascontiguousarray(corners)
    middle = (corners.min((0, 1)) + corners.max((0, 1))) / 2
    corners = (corners - middle) / np.float32(1.01 * np.abs(corners - middle).max())
    mine, theirs, empty = ours(corners), embree(corners), embree(corners[:1] + np.float32(1e6))
    rays = eye_rays(corners)
    for kind in ("eye", "bounce"):
        if kind == "bounce":
            rays = bounce_rays(*rays, mine(*rays)[0])
        same = float(np.mean(mine(*rays)[1] == theirs(*rays)[1]))
        spent: list[list[float]] = [[], [], []]
        for _ in range(REPEATS):
            for trace, record in zip((mine, theirs, empty), spent, strict=True):
                start = time.perf_counter()
                trace(*rays)
                record.append(time.perf_counter() - start)
        ratio = statistics.median(spent[1]) / statistics.median(spent[0])
        print(
            f"{name:12} {len(corners):7} {kind:7} {_figure(spent[0]):24} {_figure(spent[1]):24} "
            f"{_figure(spent[2]):24} {ratio:6.2f} {100 * same:9.3f}",
            flush=True,
        )


def main() -> None:
    """Print the table."""
    if importlib.util.find_spec("embreex") is None:
        sys.exit("skipped: embreex is not installed (pip install embreex), so there is nothing to compare with")
    print(f"closest hits, million rays a second; {SIDE * SIDE} rays, {REPEATS} runs, medians")
    print(f"{'mesh':12} {'tri':>7} {'rays':7} {'raygrid':24} {'Embree 4':24} {'Embree, empty':24}  ratio same hit %")
    for name in sys.argv[1:]:
        compare(Path(name).stem, triangles_of(Path(name)))
    compare("terrain", terrain(224))


if __name__ == "__main__":
    main()
