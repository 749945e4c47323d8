"""Defines what changes in a scene from frame to frame: `Animation`, and `Pose`, its state in one frame.

The scene describes everything at rest. Its animation says which surfaces move together, in groups, and where they are
in each frame: turned, scaled evenly and shifted from rest (`node.geometry.rigid_motion`, here in scene coordinates).
Frames are numbered from 1. In files an animation is called a shot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.cameras import Camera
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, MOTION_SCALE, Groups

MAX_FRAMES = 1_000_000
FPS = 24.0


class Pose(NamedTuple):
    """Holds everything that may change, as it is in one frame.

    motions    float64 (groups, MOTION), from rest, scene coordinates
    materials  MATERIAL_RECORD, as many as the scene has; lights LIGHT_RECORD
    """

    motions: F64
    camera: Camera
    lights: NDArray[np.void]
    materials: NDArray[np.void]


@dataclass(frozen=True)
class Animation:
    """Describes what changes in a scene. Raises SceneError for a number of frames, or of them a second, that cannot be.

    frames  how many there are, numbered from 1
    names   of the groups
    groups  which surfaces they are (ids of the scene)
    pose    makes the pose of a frame; asked for frames of the animation only
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
        """Return the pose of a frame. Raises SceneError for a frame that there is not, and for a pose that cannot be."""
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
