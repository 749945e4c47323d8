"""Small scenes built in a line or two, for pictures whose answers are known by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raygrid.host.scene.builder import SceneBuilder, material
from raygrid.host.scene.cameras import Camera, orthographic_camera
from raygrid.host.scene.lights import light_table
from raygrid.host.scene.scene import Colour, Scene
from raygrid.node.geometry.surfaces import Kind

F64 = NDArray[np.float64]
UP = (0.0, 0.0, 1.0)


class Stage:
    """Collects surfaces and lights. The corners of flat surfaces run counter-clockwise seen from the front."""

    def __init__(self, *lights: NDArray[np.void]) -> None:
        self._builder = SceneBuilder("stage")
        self._lights = light_table(list(lights))

    def material(self, **parts: Any) -> int:
        """The number of a new material; parts as of `scene_builder.material`."""
        return self._builder.add_materials(material(**parts))

    def sphere(self, centre: ArrayLike, radius: float, of: int) -> None:
        """A ball; with a negative radius a hollow one of which only the inside shows."""
        self._builder.add(Kind.SPHERE, np.array([[*np.asarray(centre, float), radius]]), of)

    def polygon(self, corners: ArrayLike, of: int) -> None:
        """A flat polygon; a triangle if it has three corners."""
        points = np.asarray(corners, np.float64)
        self._builder.add_polygons(points, np.array([0, len(points)]), of)

    def level(self, x: tuple[float, float], y: tuple[float, float], z: float, of: int) -> None:
        """A level rectangle whose front is above."""
        self.polygon([(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)], of)

    def scene(self, camera: Camera, background: Colour = (0.0, 0.0, 0.0), **more: Any) -> Scene:
        """All of it, as raygrid's own."""
        surfaces, materials, remarks = self._builder.finish()
        assert remarks == ()
        return Scene("stage", surfaces, materials, self._lights, camera, background, **more)


def line_camera(eye: ArrayLike, ahead: ArrayLike, up: ArrayLike, pitch: float) -> Camera:
    """Parallel rays `pitch` apart, for pictures of one row."""
    return orthographic_camera(eye, np.add(eye, ahead), up, pitch)


def places(count: int, pitch: float) -> F64:
    """Where the pixels of such a row lie, seen from its middle."""
    return (np.arange(count) - (count - 1) / 2.0) * pitch


def edge(row: F64, at: F64) -> float:
    """Where a row (n, 3) of two colours changes from one to the other, half-way between two pixels."""
    steps = np.flatnonzero(np.abs(np.diff(row[:, 0])) > 0.5 * np.ptp(row[:, 0]))
    assert len(steps) == 1, f"the row changes {len(steps)} times"
    return float((at[steps[0]] + at[steps[0] + 1]) / 2.0)
