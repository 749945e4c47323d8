"""Animates a still scene as a turntable: the camera goes once round, or the scene turns once, in so many frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from raygrid.host.scene.animation.motions import about, motion, moved_point, turned
from raygrid.host.scene.cameras import Camera, Vector, nearest_axis
from raygrid.host.scene.lights import exposure_point
from raygrid.host.scene.pose import MAX_FRAMES, Animation, Pose
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, at_rest, make_groups, rounded

GROUP = "scene"


def turntable(scene: Scene, frames: int, turn_scene: bool = False) -> Scene:
    """Animate the scene by one turn, frame 1 being as it stands.

    The axis goes through the point that the camera looks at, along that axis of the world (x, y or z) to which what is
    up in the world is nearest, however the camera is tilted. Either the camera turns round it, or all surfaces turn the
    other way, under lights that stay.
    Raises SceneError for a number of frames that cannot be, and for a scene that moves already.
    """
    if not 1 <= frames <= MAX_FRAMES:
        raise SceneError(f"a turntable came with {frames} frames, wanted 1 to {MAX_FRAMES}")
    if scene.shot is not None:
        raise SceneError(f"{scene.name}: the scene moves by itself, wanted a still one for a turntable")
    every = np.concatenate([batch.ids for batch in scene.surfaces])
    chosen = every if turn_scene else every[:0]
    groups = make_groups(chosen, np.zeros(len(chosen), np.int64), int(turn_scene))
    table = _TurntableMotion(
        scene, frames, turn_scene, nearest_axis(scene.up), exposure_point(scene.camera, scene.surfaces.bounds())
    )
    return replace(scene, shot=Animation(frames, (GROUP,) * int(turn_scene), groups, table.pose))


@dataclass(frozen=True)
class _TurntableMotion:
    scene: Scene
    frames: int
    turn_scene: bool
    axis: F64
    middle: F64

    def pose(self, frame: int) -> Pose:
        angle = 2.0 * np.pi * (frame - 1) / self.frames * (-1.0 if self.turn_scene else 1.0)
        turn = np.concatenate(([rounded.cos(angle / 2.0)], rounded.sin(angle / 2.0) * self.axis))
        by = about(self.middle, turn, 1.0) if frame > 1 else motion()
        scene = self.scene
        if self.turn_scene:
            return Pose(by[None], scene.camera, scene.lights, scene.materials)
        return Pose(at_rest(0), moved_camera(scene.camera, by), scene.lights, scene.materials)


def moved_camera(camera: Camera, by: F64) -> Camera:
    """Move a camera by a motion; its view stays as wide."""
    forward, right, up = (_triple(turned(by, axis)) for axis in (camera.forward, camera.right, camera.up))
    return replace(camera, eye=_triple(moved_point(by, camera.eye)), forward=forward, right=right, up=up)


def _triple(vector: F64) -> Vector:
    return float(vector[0]), float(vector[1]), float(vector[2])
