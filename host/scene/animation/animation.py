"""A shot: a scene whose surfaces, camera, lights and materials change from frame to frame.

The scene describes everything at rest. Its `shot` says which surfaces move together, in groups, and where they are in
each frame: turned, scaled evenly and shifted from rest (`node.geometry.rigid_motion`, here in scene coordinates). Frames are
numbered from 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raygrid.host.scene.cameras import Camera
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import (
    F64,
    MOTION_SCALE,
    MOTION_SHIFT,
    NO_MOTION,
    Batch,
    Groups,
    Kind,
    SurfaceSet,
    moved_rows,
)

MAX_FRAMES = 1_000_000
FPS = 24.0


class Pose(NamedTuple):
    """Everything that may change, in one frame.

    motions    float64 (groups, MOTION), from rest, scene coordinates
    materials  MATERIAL, as many as the scene has; lights LIGHT
    """

    motions: F64
    camera: Camera
    lights: NDArray[np.void]
    materials: NDArray[np.void]


@dataclass(frozen=True)
class Animation:
    """What changes in a scene.

    frames  how many there are, numbered from 1
    names   of the groups
    groups  which surfaces they are (ids of the scene)
    pose    what is where in a frame; asked for frames of the shot only
    fps     frames a second, for files that play
    """

    frames: int
    names: tuple[str, ...]
    groups: Groups
    pose: Callable[[int], Pose] = field(repr=False)
    fps: float = FPS

    def __post_init__(self) -> None:
        if not 1 <= self.frames <= MAX_FRAMES:
            raise SceneError(f"a shot came with {self.frames} frames, wanted 1 to {MAX_FRAMES}")
        if not 0.0 < self.fps <= 1000.0:
            raise SceneError(f"a shot came with {self.fps:g} frames a second, wanted more than 0 and at most 1000")

    def at(self, frame: int) -> Pose:
        """Where everything is. Raises SceneError for a frame that the shot has not, and for a pose that cannot be."""
        if not 1 <= frame <= self.frames:
            raise SceneError(f"frame {frame} came, wanted one of the shot's frames 1 to {self.frames}")
        try:
            pose = self.pose(frame)
        except SceneError as error:
            raise SceneError(f"frame {frame}: {error}") from None
        bad = ~(np.isfinite(pose.motions).all(axis=1) & (pose.motions[:, MOTION_SCALE] > 0.0))
        if bad.any():
            group = int(np.argmax(bad))
            raise SceneError(
                f"frame {frame}: the motion of the group {self.names[group]!r} is {pose.motions[group].tolist()}, "
                "wanted finite numbers and a scale above 0"
            )
        return pose


# --- motions ---------------------------------------------------------------------------------------------


def motion(turn: ArrayLike = (1.0, 0.0, 0.0, 0.0), scale: float = 1.0, shift: ArrayLike = (0.0, 0.0, 0.0)) -> F64:
    """A motion: turned by a unit quaternion, scaled, shifted."""
    return np.concatenate((np.asarray(turn, np.float64), [scale], np.asarray(shift, np.float64)))


def quaternion(degrees: Sequence[float] | F64) -> F64:
    """Turned about x, then y, then z, by degrees."""
    turn = np.array(NO_MOTION[:4])
    for axis, angle in enumerate(degrees):
        half = math.radians(float(angle)) / 2.0
        about = np.zeros(4)
        about[0], about[1 + axis] = math.cos(half), math.sin(half)
        turn = _product(about, turn)
    return turn


def _product(a: F64, b: F64) -> F64:
    """The quaternion that turns by b, then by a; kept at length 1."""
    product = np.array(
        (
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        )
    )
    return np.asarray(product / math.sqrt(float(np.sum(product * product))))


def moved_point(by: F64, point: ArrayLike) -> F64:
    """Where a motion takes a point, (3,)."""
    row = np.array([*np.asarray(point, np.float64), 0.0])[None]
    return moved_rows(Kind.SPHERE, row, by[None])[0, :3]


def turned(by: F64, direction: ArrayLike) -> F64:
    """A direction turned by a motion, (3,)."""
    return moved_point(motion(by[:4]), direction)


def after(second: F64, first: F64) -> F64:
    """The motion that does `first`, then `second`."""
    return motion(
        _product(second[:4], first[:4]),
        float(second[MOTION_SCALE] * first[MOTION_SCALE]),
        moved_point(second, first[MOTION_SHIFT:]),
    )


def about(pivot: ArrayLike, turn: F64, scale: float) -> F64:
    """Turned and scaled about a point that stays."""
    here = motion(turn, scale)
    here[MOTION_SHIFT:] = np.asarray(pivot, np.float64) - moved_point(here, pivot)
    return here


def still(scene: Scene, frame: int) -> Scene:
    """The scene as a frame of its shot has it, a still one. Raises SceneError for a frame that it has not."""
    shot = scene.shot
    if shot is None:
        if frame != 1:
            raise SceneError(f"{scene.name}: frame {frame} came for a scene that does not change, wanted 1")
        return scene
    if not 1 <= frame <= shot.frames:
        raise SceneError(f"{scene.name}: frame {frame} came, wanted frames 1 to {shot.frames}")
    pose = shot.at(frame)
    batches = []
    for batch in scene.surfaces:
        number = shot.groups.of(batch.ids)
        owner = np.repeat(number, np.diff(batch.starts)) if batch.kind == Kind.POLYGON else number
        data, rows = batch.data.astype(np.float64), np.flatnonzero(owner >= 0)
        if len(rows):
            data[rows] = moved_rows(batch.kind, data[rows], pose.motions[owner[rows]])
        batches.append(Batch(batch.kind, batch.ids, batch.materials, data, batch.starts))
    surfaces = SurfaceSet(tuple(batches))
    return replace(
        scene, surfaces=surfaces, camera=pose.camera, lights=pose.lights, materials=pose.materials, shot=None
    )


def frame_told(scene: Scene, frame: int | None, choice: bool = True) -> str | None:
    """Which frame of a shot a command takes that takes one, in words; None for a still scene. choice: whether it has --frame."""
    if scene.shot is None or (frame or 1) > scene.shot.frames:
        return None
    another = ", as --frame names no other" if choice and frame is None and scene.shot.frames > 1 else ""
    return f"{scene.name}: frame {frame or 1} of {scene.shot.frames}{another}"


# --- boxes -----------------------------------------------------------------------------------------------


def moving_batches(scene: Scene) -> list[tuple[Batch, NDArray[np.int64]]]:
    """The surfaces that are in groups, and of each the group: (n,)."""
    if scene.shot is None:
        return []
    found = []
    for batch in scene.surfaces:
        number = scene.shot.groups.of(batch.ids)
        if (number >= 0).any():
            found.append((batch.select(number >= 0), number[number >= 0]))
    return found


def animation_bounds(scene: Scene) -> F64:
    """The box of all surfaces in all frames, float64 (2, 3): the union of each frame's own.

    Raises SceneError for a pose that cannot be, and numbers that are not finite.
    """
    shot = scene.shot
    assert shot is not None
    boxes = [batch.select(shot.groups.of(batch.ids) < 0).bounds() for batch in scene.surfaces]
    moving = moving_batches(scene)
    before: F64 | None = None
    for frame in range(1, shot.frames + 1):
        motions = shot.at(frame).motions
        changed = np.ones(len(motions), np.bool_) if before is None else (motions != before).any(axis=1)
        before = motions
        for batch, number in moving:
            rows = np.flatnonzero(changed[number])
            if len(rows):
                box = _bounds_of(batch.select(rows), motions[number[rows]])
                if not np.isfinite(box).all():
                    raise SceneError(f"{scene.name}: frame {frame} takes surfaces to where numbers are not finite")
                boxes.append(box[None])
    every = np.concatenate(boxes)
    return np.stack((every[:, 0].min(0), every[:, 1].max(0)))


def _bounds_of(batch: Batch, motions: F64) -> F64:
    """The box of surfaces after a motion each, (2, 3)."""
    if batch.kind == Kind.POLYGON:
        motions = np.repeat(motions, np.diff(batch.starts), axis=0)
    data = moved_rows(batch.kind, batch.data.astype(np.float64), motions)
    boxes = Batch(batch.kind, batch.ids, batch.materials, data, batch.starts).bounds()
    return np.stack((boxes[:, 0].min(0), boxes[:, 1].max(0)))
