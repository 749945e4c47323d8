"""Completes scenes whose files lack a camera or lights: invents what is missing, and says so."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.builder import SceneBuilder
from raygrid.host.scene.cameras import Camera, Vector, look_at_everything, usual_front
from raygrid.host.scene.lights import INVENTED_BACKGROUND, invented_lights
from raygrid.host.scene.linear_algebra import dot
from raygrid.host.scene.scene import Colour, Scene
from raygrid.host.text.standard_streams import shown_name
from raygrid.node.geometry import Kind, SurfaceSet

# Remarks, here by name because a scene file leaves them out for the files that it takes surfaces from.
ELSE = "--fit, or --from and --at (in Python fit=, eye= and at=)"
NO_CAMERA = f"no camera in the file: one that looks at everything invented; {ELSE} for another"
MANY_CAMERAS = "cameras used; --camera (in Python camera=) chooses another:"  # within a remark
NO_LIGHT = "no light in the file: a key and a fill light invented"
UNLIT = "no light in the file: only the background and its reflections will show"

OF_ITS_OWN = (NO_CAMERA, MANY_CAMERAS, NO_LIGHT, UNLIT)  # of no use in a scene that takes surfaces only

FACETS = (Kind.TRIANGLE, Kind.SMOOTH)
ENOUGH = 100  # triangles: of fewer it is chance how many lie where
CLEARLY = 1.1  # times as many: a body that is as detailed on both sides shows the usual one

Y_UP: Vector = (0.0, 1.0, 0.0)
Z_UP: Vector = (0.0, 0.0, 1.0)


def finish_scene(
    builder: SceneBuilder,
    path: Path,
    *,
    camera: Camera | None = None,
    lights: NDArray[np.void] | None = None,
    background: Colour | None = None,
    up: Vector = Y_UP,
    highlights: bool = True,
    find_front: bool = False,
) -> Scene:
    """The scene of what a builder has collected.

    `up` is the axis that points up; `find_front`: which side is the front nobody knows. Without a camera one looks at
    everything; without lights (None, or a table without rows) a key and a fill light shine from behind that camera;
    without a background it is a dark grey.
    Raises SceneError as SceneBuilder.finish does.
    """
    surfaces, materials, remarks = builder.finish()
    invented = []
    front = found_front(surfaces, up) if find_front else usual_front(up)
    camera_invented, lights_invented = camera is None, lights is None or not len(lights)
    if camera is None:
        camera = look_at_everything(surfaces.bounds(), up, front)
        invented.append(NO_CAMERA)
    if lights is None or lights_invented:
        lights = invented_lights(camera)
        invented.append(NO_LIGHT)
    return Scene(
        name=shown_name(path.name),
        surfaces=surfaces,
        materials=materials,
        material_names=builder.material_names(len(materials)),
        lights=lights,
        camera=camera,
        background=INVENTED_BACKGROUND if background is None else background,
        remarks=(*remarks, *invented),
        up=up,
        highlights=highlights,
        front=front,
        camera_invented=camera_invented,
        lights_invented=lights_invented,
    )


def without(remarks: Iterable[str], *gone: str) -> tuple[str, ...]:
    """The remarks in which none of these occurs."""
    return tuple(remark for remark in remarks if not any(known in remark for known in gone))


def found_front(surfaces: SurfaceSet, up: Vector) -> Vector:
    """The side that is most likely the front of a mesh whose file does not say: the usual one, or the one opposite, if in
    the half on that side lie clearly more triangles. Where a body has its face it has most detail."""
    usual = np.array(usual_front(up))
    deep = [dot(batch.data[:, :9].reshape(-1, 3, 3).mean(axis=1), usual) for batch in surfaces if batch.kind in FACETS]
    if sum(map(len, deep)) < ENOUGH:
        return usual_front(up)
    depths, bounds = np.concatenate(deep), surfaces.bounds()
    middle = float(dot(bounds.mean(axis=0), usual))
    before, behind = int(np.count_nonzero(depths > middle)), int(np.count_nonzero(depths < middle))
    x, y, z = (-usual if behind > CLEARLY * before else usual).tolist()
    return x, y, z
