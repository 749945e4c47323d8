"""Poses the animated parts of a scene file (groups, camera, lights, materials) by their keyframes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from raygrid.host.scene.animation.keyframes import Keyframes, make_keyframes
from raygrid.host.scene.animation.motions import about, after, motion
from raygrid.host.scene.cameras import Camera
from raygrid.host.scene.formats import toml_schema as schema
from raygrid.host.scene.lights import Table, light_table
from raygrid.host.scene.pose import Pose
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, at_rest, quaternion_of_angles

Model = TypeVar("Model", bound=schema.FileTable)


@dataclass(frozen=True)
class Keyed(Generic[Model]):
    """A table of the file, and the keyframes of those of its keys that change."""

    table: Model
    keyframes: dict[str, Keyframes]

    def at(self, frame: int) -> Model:
        """The table as it is in a frame."""
        if not self.keyframes:
            return self.table
        values: dict[str, Any] = {}
        for name, one in self.keyframes.items():
            value = one.at(frame).tolist()
            values[name] = value[0] if len(value) == 1 else tuple(value)
        return self.table.model_copy(update=values)


def keyed(table: Model, keys: Sequence[schema.Key], way: str) -> Keyed[Model]:
    """Make keyframes of a table's keys; a value that no key names stays as the table has it."""
    keyframes = {}
    for name in type(keys[0]).model_fields if keys else ():
        rows = [(key.frame, getattr(key, name)) for key in keys if getattr(key, name) is not None]
        if name != "frame" and rows:
            keyframes[name] = make_keyframes([row[0] for row in rows], [row[1] for row in rows], way)
    return Keyed(table, keyframes)


@dataclass(frozen=True)
class SceneAnimation:
    """Animates everything that moves.

    groups     in the order of their names
    parents    of each group, its number or -1
    camera     None: the scene's own, which stays
    lights     those that the file names, after `first_lights` that stay
    materials  those that change, by their rows of the scene's table
    """

    scene: Scene
    groups: tuple[Keyed[schema.Motion], ...]
    pivots: tuple[tuple[float, float, float], ...]
    parents: tuple[int, ...]
    camera: Keyed[schema.CameraTable] | None
    first_lights: Table
    lights: tuple[Keyed[Any], ...]
    materials: tuple[tuple[int, Keyed[schema.Material]], ...]
    make_camera: Callable[[schema.CameraTable], Camera]
    make_light: Callable[[Any], Table]
    make_material: Callable[[schema.Material], Table]

    def pose(self, frame: int) -> Pose:
        """Pose everything. Raises SceneError for a camera or light that cannot be."""
        known: dict[int, F64] = {}
        motions = [self._motion(group, frame, known) for group in range(len(self.groups))]
        scene = self.scene
        camera = scene.camera if self.camera is None else self.make_camera(self.camera.at(frame))
        lights, materials = scene.lights, scene.materials
        if any(light.keyframes for light in self.lights):
            lights = light_table([self.first_lights, *(self._light(light, frame) for light in self.lights)])
        if self.materials:
            materials = materials.copy()
            for row, material in self.materials:
                materials[row : row + 1] = self.make_material(material.at(frame))
        return Pose(np.stack(motions) if motions else at_rest(0), camera, lights, materials)

    def _motion(self, group: int, frame: int, known: dict[int, F64]) -> F64:
        """A group's whole motion: its own, then its parent's."""
        found = known.get(group)
        if found is None:
            m = self.groups[group].at(frame)
            own = about(self.pivots[group], quaternion_of_angles(m.rotate), m.scale)
            found = after(motion(shift=m.translate), own)
            if self.parents[group] >= 0:
                found = after(self._motion(self.parents[group], frame, known), found)
            known[group] = found
        return found

    def _light(self, light: Keyed[Any], frame: int) -> Table:
        try:
            return self.make_light(light.at(frame))
        except (ValueError, SceneError) as error:
            raise SceneError(f"a light of the kind {light.table.kind} shines nowhere: {error}") from None
