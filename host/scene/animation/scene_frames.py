"""Makes still scenes of the frames of an animated one, and bounds all its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, Batch, Kind, SurfaceSet, moved_rows


def still(scene: Scene, frame: int) -> Scene:
    """Return the scene as it is in a frame, without its animation. Raises SceneError for a frame that it has not."""
    animation = scene.shot
    if animation is None:
        if frame != 1:
            raise SceneError(f"{scene.name}: frame {frame} came for a scene that does not change, wanted 1")
        return scene
    if not 1 <= frame <= animation.frames:
        raise SceneError(f"{scene.name}: frame {frame} came, wanted frames 1 to {animation.frames}")
    pose = animation.at(frame)
    batches = []
    for batch in scene.surfaces:
        number = animation.groups.of(batch.ids)
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
    """Name the frame that a command takes of an animated scene, for people; None for a still scene.

    frame   that was asked for, None if none was; choice: whether the command has --frame
    """
    if scene.shot is None or (frame or 1) > scene.shot.frames:
        return None
    another = ", as --frame names no other" if choice and frame is None and scene.shot.frames > 1 else ""
    return f"{scene.name}: frame {frame or 1} of {scene.shot.frames}{another}"


def moving_batches(scene: Scene) -> list[tuple[Batch, NDArray[np.int64]]]:
    """Select the surfaces that are in groups, and of each its group, int64 (n,)."""
    if scene.shot is None:
        return []
    found = []
    for batch in scene.surfaces:
        number = scene.shot.groups.of(batch.ids)
        if (number >= 0).any():
            found.append((batch.select(number >= 0), number[number >= 0]))
    return found


def animation_bounds(scene: Scene) -> F64:
    """Return the box of all surfaces in all frames, float64 (2, 3): the union of each frame's own.

    Raises SceneError for a pose that cannot be, and numbers that are not finite.
    """
    animation = scene.shot
    assert animation is not None
    boxes = [batch.select(animation.groups.of(batch.ids) < 0).bounds() for batch in scene.surfaces]
    moving = moving_batches(scene)
    before: F64 | None = None
    for frame in range(1, animation.frames + 1):
        motions = animation.at(frame).motions
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
