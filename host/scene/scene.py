"""Defines a scene: everything that a file says about what is to be rendered, checked and in one form.

Readers (`host.scene.formats`) make scenes, `load.load_scene` picks the reader. Nothing here knows
about arrays of processors: coordinates are the scene's own, and data is float64.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.cameras import Camera, NamedCamera, Vector
from raygrid.host.scene.pose import Animation
from raygrid.node.geometry import SURFACE_KINDS, SurfaceSet
from raygrid.node.protocol import DIRECTIONAL

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Scene:
    """Describes what is to be rendered.

    name        the file's name, for messages
    surfaces    scene coordinates, float64; ids are 0 to n - 1 in the order of the file
    materials   MATERIAL (m,), no two alike, in the order in which the file gives them
    lights      LIGHT (l,)
    camera      the file's, or one that shows everything
    background  linear RGB, what rays see that leave the scene
    size        width and height in pixels that the file asks for, or None
    samples     samples per pixel that the file asks for, or None
    depth       greatest depth of the ray tree that the file asks for, or None
    min_weight  least weight of a ray that the file asks for, or None
    highlights  whether the materials' highlights are to be used
    remarks     one line each on what was dropped or invented
    rules       numbers of materials for a program, float64 (m, tables.RULE_COLUMNS), None if none has any
    shot        the animation, what changes from frame to frame, None if nothing does; surfaces are at rest then
    up          what points up in the world: as the file says, else as its format has it
    front       to the side that is seen from the front, None: as usual (`cameras.usual_front`)
    cameras     all that the file has, `camera` among them; none if it was invented, and may be none if it has one alone
    camera_invented, lights_invented  whether the file had none
    material_names  of each material in the file, "" for none; equal ones are one with all their names; () if there are none
    """

    name: str
    surfaces: SurfaceSet
    materials: NDArray[np.void]
    lights: NDArray[np.void]
    camera: Camera
    background: Colour = (0.0, 0.0, 0.0)
    size: tuple[int, int] | None = None
    samples: int | None = None
    depth: int | None = None
    min_weight: float | None = None
    highlights: bool = False
    remarks: tuple[str, ...] = ()
    rules: NDArray[np.float64] | None = None
    shot: Animation | None = None
    up: Vector = (0.0, 1.0, 0.0)
    front: Vector | None = None
    cameras: tuple[NamedCamera, ...] = ()
    camera_invented: bool = False
    lights_invented: bool = False
    material_names: tuple[str, ...] = ()


class SceneSource(ABC):
    """What a scene can be made of, in memory."""

    @abstractmethod
    def read(self) -> Scene:
        """Make the scene. Raises SceneError for what cannot be one."""


def describe(scene: Scene) -> dict[str, object]:
    """Return the facts of a scene as plain lists, numbers and strings, ready for JSON."""
    counts = {kind.name.lower(): scene.surfaces.count(kind) for kind in SURFACE_KINDS}
    return {
        "name": scene.name,
        "surfaces": {kind: count for kind, count in counts.items() if count},
        "surfaces_total": len(scene.surfaces),
        "box": scene.surfaces.bounds().tolist(),
        "materials": len(scene.materials),
        "mirrors": int(np.count_nonzero(scene.materials["specular"].any(axis=1))),
        "transparent": int(np.count_nonzero(scene.materials["transmission"].any(axis=1))),
        "lights": [_light(row) for row in scene.lights],
        "camera": _camera(scene.camera),
        "cameras": [camera.name or str(number) for number, camera in enumerate(scene.cameras, 1)],
        "background": list(scene.background),
        "size": None if scene.size is None else list(scene.size),
        "samples": scene.samples,
        "depth": scene.depth,
        "min_weight": scene.min_weight,
        "highlights": scene.highlights,
        "frames": None if scene.shot is None else scene.shot.frames,
        "groups": [] if scene.shot is None else list(scene.shot.names),
        "remarks": list(scene.remarks),
    }


def light_kind(row: np.void) -> str:
    """Name the kind of a light: directional, spot or point."""
    return "directional" if row["kind"] == DIRECTIONAL else "spot" if row["spot"] else "point"


def _light(row: np.void) -> dict[str, object]:
    kind = light_kind(row)
    return {
        "kind": kind,
        "towards" if kind == "directional" else "position": row["place"].tolist(),
        "intensity": row["intensity"].tolist(),
        "falloff": bool(row["falloff"]),
    }


def _camera(camera: Camera) -> dict[str, object]:
    view = {"height": 2.0 * camera.half}
    if not camera.orthographic:
        view = {"angle": float(np.degrees(2.0 * np.arctan(camera.half)))}
    return {
        "kind": "orthographic" if camera.orthographic else "perspective",
        "eye": list(camera.eye),
        "forward": list(camera.forward),
        "up": list(camera.up),
        "span": camera.span.value,
        **view,
    }
