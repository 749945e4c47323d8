"""Completes scenes whose files lack a camera or lights: invents what is missing, and says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.builder import SceneBuilder
from raygrid.host.scene.cameras import Camera, Vector, look_at_everything
from raygrid.host.scene.lights import INVENTED_BACKGROUND, invented_lights
from raygrid.host.scene.scene import Colour, Scene
from raygrid.host.text.standard_streams import shown_name

# Remarks, here by name because a scene file leaves them out for the files that it takes surfaces from.
NO_CAMERA = "no camera in the file: one that looks at everything invented"
NO_LIGHT = "no light in the file: a key and a fill light invented"
UNLIT = "no light in the file: only the background and its reflections will show"

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
) -> Scene:
    """The scene of what a builder has collected.

    `up` is the axis that points up. Without a camera one looks at everything; without lights (None, or a table
    without rows) a key and a fill light shine from behind that camera; without a background it is a dark grey.
    Raises SceneError as SceneBuilder.finish does.
    """
    surfaces, materials, remarks = builder.finish()
    invented = []
    if camera is None:
        camera = look_at_everything(surfaces.bounds(), up)
        invented.append(NO_CAMERA)
    if lights is None or not len(lights):
        lights = invented_lights(camera)
        invented.append(NO_LIGHT)
    return Scene(
        name=shown_name(path.name),
        surfaces=surfaces,
        materials=materials,
        lights=lights,
        camera=camera,
        background=INVENTED_BACKGROUND if background is None else background,
        remarks=(*remarks, *invented),
        up=up,
        highlights=highlights,
    )
