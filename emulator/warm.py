"""Make every kernel ready before the first node needs it: loaded from the cache on disk, or compiled once.

A tiny in-memory array renders a tiny scene that has every kind of surface, light and ray, so every kernel is
called with exactly the argument types that nodes use.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from raygrid.node.lattice import make_space
from raygrid.node.packets import LATTICE
from raygrid.node.surfaces import STORED_AS, Batch, Kind, SurfaceSet
from raygrid.node.tables import LIGHT_COLUMNS, MATERIAL_COLUMNS, Frame

from .memory_array import MemoryArray

Report = Callable[[int, int, str], None]


def warm(report: Report) -> None:
    """Call every kernel once. `report(done, total, what)` is called before each stage and at the end."""
    array = MemoryArray((2, 1, 1))
    half = LATTICE // 2
    space = make_space((2.0**-24, 2.0**-24, 2.0**-24), [[0, half, LATTICE], [0, LATTICE], [0, LATTICE]])
    stages: list[tuple[str, Callable[[], object]]] = [
        ("links and waves", array.driver.ready),
        ("surfaces and hierarchy", lambda: array.driver.load(space, _one_of_each())),
        ("ray step", lambda: array.driver.trace(_frame())),
        ("pixels", lambda: array.driver.collect(64)),
    ]
    for number, (what, stage) in enumerate(stages):
        report(number, len(stages), what)
        stage()
    report(len(stages), len(stages), "ready")


def _one_of_each() -> SurfaceSet:
    """One surface of each kind, across the border between the two cells."""
    flat = [[-0.3, -0.3, 0.0], [0.3, -0.3, 0.01], [0.0, 0.3, 0.02]]
    rows = {
        Kind.TRIANGLE: np.array(flat).reshape(1, 9),
        Kind.SMOOTH: np.concatenate((np.array(flat).ravel() + 0.02, np.tile([0.0, 0.0, 1.0], 3))).reshape(1, 18),
        Kind.POLYGON: np.array(flat + [[-0.3, 0.3, 0.01]]) + 0.05,
        Kind.SPHERE: np.array([[0.0, 0.0, -0.2, 0.1]]),
        Kind.CYLINDER: np.array([[-0.2, 0.0, 0.2, 0.05, 0.2, 0.0, 0.2, 0.05]]),
        Kind.CONE: np.array([[-0.2, 0.2, 0.2, 0.1, 0.2, 0.2, 0.2, 0.02]]),
    }
    batches = []
    for number, (kind, data) in enumerate(rows.items()):
        starts = np.array([0, 4]) if kind == Kind.POLYGON else np.zeros(0, np.int64)
        ids, materials = np.array([number], np.uint32), np.zeros(1, np.uint16)
        batches.append(Batch(kind, ids, materials, data.astype(STORED_AS[kind]), starts))
    return SurfaceSet(tuple(batches))


def _frame() -> Frame:
    camera = np.array([[0.0, 0.0, 2.0], [0, 0, 0], [0, 0, 0], [-0.2, 0.2, -1], [0.05, 0, 0], [0, -0.05, 0]])
    materials, lights = np.full((1, MATERIAL_COLUMNS), 0.5), np.zeros((2, LIGHT_COLUMNS))
    lights[:, :7] = [[0, 0, 0, 1, 1, 1, 1], [1, 0.3, 0.3, 0.6, 1, 1, 1]]
    return Frame(camera, materials, lights, 2, (0.1, 0.1, 0.1), 8, 8, 1, 3, 0.0, False)
