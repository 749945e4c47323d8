"""Shows a scene from where, and in which light, somebody else than its file wants it (`view.View`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.animation.scene_frames import animation_bounds
from raygrid.host.scene.builder import shown
from raygrid.host.scene.cameras import DEFAULT_FOV, Camera, NamedCamera, fitted_camera, redirected_camera
from raygrid.host.scene.finish import MANY_CAMERAS, NO_CAMERA, NO_LIGHT, UNLIT, without
from raygrid.host.scene.lights import invented_lights, light_table, point_light
from raygrid.host.scene.pose import Animation, Pose
from raygrid.host.scene.scene import Scene
from raygrid.host.scene.view import View
from raygrid.host.text.misuse import SceneMisuse
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64

Lights = NDArray[np.void]


def seen(scene: Scene, view: View) -> Scene:
    """The scene as a view shows it. What is not asked for stays; lights that were invented go with the camera.

    In a shot the camera stays where the view puts it, one of the scene's own moves as the scene has it; lights of the view
    stay. Raises SceneMisuse for a camera that the scene has not, and for one that shows nothing.
    """
    made = replace(scene, up=scene.up if view.up is None else view.up)
    if view.background is not None:
        made = replace(made, background=view.background)
    camera_of: Callable[[int], Camera] | None = None
    if view.moves_camera:
        try:
            camera, camera_of = _camera(scene, view)
        except SceneMisuse:
            raise
        except SceneError as error:
            raise SceneMisuse(f"{scene.name}: {error}") from None
        made = replace(
            made, camera=camera, camera_invented=False, remarks=without(made.remarks, NO_CAMERA, MANY_CAMERAS)
        )
    lights = _lights(view)
    if lights is not None:
        kept = without(made.remarks, NO_LIGHT, UNLIT)
        made = replace(made, lights=lights, lights_invented=False, remarks=kept)
    elif made.lights_invented:
        lights = invented_lights(made.camera)
        made = replace(made, lights=lights)
    if made.shot is not None and (view.moves_camera or lights is not None):
        fixed = made.camera if view.moves_camera else None
        made = replace(made, shot=_posed(made.shot, camera_of, fixed, lights))
    return made


@dataclass(frozen=True)
class _ViewedMotion:
    """Poses of a shot with another camera or other lights; None: the shot's own."""

    pose: Callable[[int], Pose]
    camera_of: Callable[[int], Camera] | None
    camera: Camera | None
    lights: Lights | None

    def __call__(self, frame: int) -> Pose:
        pose = self.pose(frame)
        if self.camera_of is not None:
            pose = pose._replace(camera=self.camera_of(frame))
        elif self.camera is not None:
            pose = pose._replace(camera=self.camera)
        return pose if self.lights is None else pose._replace(lights=self.lights)


def _posed(
    shot: Animation, camera_of: Callable[[int], Camera] | None, camera: Camera | None, lights: Lights | None
) -> Animation:
    return replace(shot, pose=_ViewedMotion(shot.pose, camera_of, camera, lights))


def _camera(scene: Scene, view: View) -> tuple[Camera, Callable[[int], Camera] | None]:
    """The camera of a view, and what moves it in a shot, if anything does. Raises SceneError."""
    base, moves = scene.camera, None
    if view.camera is not None:
        chosen = _chosen(scene, view.camera)
        base, moves = chosen.camera, chosen.pose
    angle, up = view.fov, view.up
    fit = view.fit
    if fit is None and view.camera is None and scene.camera_invented and view.eye is None and view.at is None:
        fit = "three-quarter"  # such a camera has nothing of its own: a wider one need not stand as far away
    if fit is not None:
        made = fitted_camera(_bounds(scene), up or scene.up, scene.front, fit, DEFAULT_FOV if angle is None else angle)
        return made, None
    if (view.eye, view.at, up, angle) == (None, None, None, None):
        return base, moves
    at = view.at
    if view.eye is not None and at is None:
        middle: F64 = _bounds(scene).mean(axis=0)
        at = float(middle[0]), float(middle[1]), float(middle[2])
    if up is None and view.eye is not None:
        up = scene.up  # that of a tilted camera would tilt another one, too
    return redirected_camera(base, view.eye, at, up, angle), None


def _chosen(scene: Scene, asked: str | int) -> NamedCamera:
    """One of the scene's cameras, by its name, else by its number. Raises SceneMisuse with those that there are."""
    shot = scene.shot
    own = NamedCamera("", scene.camera, None if shot is None else lambda frame: shot.pose(frame).camera)
    cameras = scene.cameras or (own,)
    for camera in cameras:
        if asked == camera.name:
            return camera
    number = int(asked) if isinstance(asked, int) or (asked.isascii() and asked.isdigit() and len(asked) < 9) else 0
    if 1 <= number <= len(cameras) and (scene.cameras or not scene.camera_invented):
        return cameras[number - 1]
    known = ", ".join(f"{k} {shown(c.name)}" if c.name else str(k) for k, c in enumerate(cameras, 1))
    if scene.camera_invented:
        raise SceneMisuse(
            f"{scene.name}: camera came as {shown(asked)}, but the scene has none; wanted --fit or --from"
        )
    raise SceneMisuse(f"{scene.name}: camera came as {shown(asked)}, wanted one of: {known}")


def _bounds(scene: Scene) -> F64:
    """The box of all surfaces, of all frames."""
    return scene.surfaces.bounds() if scene.shot is None else animation_bounds(scene)


def _lights(view: View) -> Lights | None:
    if not view.lights:
        return None
    return light_table([point_light(row[:3], row[3:] or 1.0) for row in view.lights])
