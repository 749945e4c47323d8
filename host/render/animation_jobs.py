"""Makes the jobs of an animation, one a frame, in which everything but what changes is one and the same.

The world box is that of the whole shot, and the planes between cells are chosen once, so that an array which holds one
frame can be told the next by increments. A frame's picture does not depend on which frames are rendered before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from raygrid.emulator.partition.split import split
from raygrid.host.render.machine_job import Job, Settings, check_settings, make_frame, make_still_job
from raygrid.host.scene.animation.motions import moved_point
from raygrid.host.scene.animation.scene_frames import animation_bounds, moving_batches
from raygrid.host.scene.pose import Animation
from raygrid.host.scene.scene import Scene
from raygrid.node import geometry
from raygrid.node.errors import SceneError

Shape = tuple[int, int, int]


def jobs_of(
    scene: Scene,
    shape: Shape,
    settings: Settings,
    frames: Iterable[int] | None = None,
    wait: Callable[[], None] | None = None,
) -> Iterator[Job]:
    """The jobs of frames of a scene, in the order asked for; a scene that does not change has one, without a number.

    frames  numbers from 1; None: all of the shot
    wait    as of `raygrid.emulator.partition.split.split`
    Raises SceneError for frames that the shot has not, settings that cannot be, and poses that cannot be; before the
    first job is given out for all but the last of these.
    """
    if scene.shot is None:
        numbers = [1] if frames is None else list(frames)
        if numbers != [1]:
            raise SceneError(f"{scene.name}: frames {numbers[:8]} came for a scene that does not change, wanted [1]")
        yield make_still_job(scene, shape, settings, wait)
        return
    numbers = list(range(1, scene.shot.frames + 1)) if frames is None else list(frames)
    wrong = [number for number in numbers if not 1 <= number <= scene.shot.frames]
    if wrong or not numbers:
        came = f"frame {wrong[0]}" if wrong else "no frame"
        raise SceneError(f"{scene.name}: {came} came, wanted frames 1 to {scene.shot.frames}")
    jobs = AnimationJobs(scene, shape, settings, numbers[len(numbers) // 2], wait)
    for number in numbers:
        yield jobs.job(number)


def still_job(scene: Scene, shape: Shape, settings: Settings, frame: int | None = None) -> Job:
    """The job of one frame with all surfaces where that frame has them, for what knows of no motions: the same picture.

    frame   of a shot, None for its first
    Raises SceneError as `jobs_of` does.
    """
    if scene.shot is None and frame not in (None, 1):
        raise SceneError(f"{scene.name}: frame {frame} came for a scene that does not change, wanted 1")
    (job,) = jobs_of(scene, shape, settings, [1 if frame is None else frame])
    surfaces = geometry.SurfaceSet(tuple(geometry.placed(batch, job.moves) for batch in job.surfaces))
    return replace(job, surfaces=surfaces, moves=None)


class AnimationJobs:
    """The jobs of one shot, which share world, planes between cells, and surfaces at rest.

    middle  the frame from which the planes are chosen
    wait    as of `raygrid.emulator.partition.split.split`
    like    jobs of the same scene with other settings: the surfaces are shared, so that an array goes on by increments
            from theirs to these where the planes are the same
    Raises SceneError as `jobs_of` does.
    """

    def __init__(
        self,
        scene: Scene,
        shape: Shape,
        settings: Settings,
        middle: int,
        wait: Callable[[], None] | None = None,
        like: AnimationJobs | None = None,
    ) -> None:
        check_settings(scene, settings)
        assert scene.shot is not None
        self._settings = settings
        self._shot: _AnimationMachine = _AnimationMachine(scene, scene.shot) if like is None else like._shot
        shot, moves = self._shot, self._shot.moves(middle)
        there = geometry.SurfaceSet(tuple(geometry.placed(batch, moves) for batch in shot.surfaces))
        frame = make_frame(shot.scene_at(middle), shot.world, settings)
        self._space = split(settings.split, shape, shot.world, there, frame, wait)

    @property
    def scene(self) -> Scene:
        """What they were made of; that of `like`, if they were made like others."""
        return self._shot.scene

    def job(self, number: int) -> Job:
        """The job of a frame."""
        shot, settings = self._shot, self._settings
        still = shot.scene_at(number)
        frame = make_frame(still, shot.world, settings)
        return Job(still, shot.world, self._space, shot.surfaces, frame, settings, shot.moves(number), number)


class _AnimationMachine:
    """A shot in machine coordinates."""

    def __init__(self, scene: Scene, shot: Animation) -> None:
        self.scene, self.shot = scene, shot
        try:
            self.world = geometry.world_around(animation_bounds(scene))
        except SceneError as error:
            raise SceneError(f"{scene.name}: {error}") from None
        self._rests = _rests(scene, shot, self.world)
        self.surfaces = geometry.SurfaceSet(tuple(self._at_rest(batch) for batch in scene.surfaces))

    def _at_rest(self, batch: geometry.Batch) -> geometry.Batch:
        """Surfaces that stay in machine coordinates, groups each in coordinates of their own.

        In those a group at rest is about as large as the world, round the origin: however small a group or far off it
        was described, binary32 vertices are exact to the same part of its size.
        """
        (result,) = self.world.surfaces(geometry.SurfaceSet((batch,))).batches
        number = self.shot.groups.of(batch.ids)
        owner = np.repeat(number, np.diff(batch.starts)) if batch.kind == geometry.Kind.POLYGON else number
        data = result.data.copy()
        for group in np.unique(number[number >= 0]).tolist():
            (own,) = self._rests[group].surfaces(geometry.SurfaceSet((batch.select(number == group),))).batches
            data[owner == group] = own.data
        return geometry.Batch(batch.kind, batch.ids, batch.materials, data, batch.starts)

    def moves(self, number: int) -> geometry.Moves:
        """Where the groups are in a frame."""
        motions = self.shot.at(number).motions
        machine = motions.copy()
        for group, rest in self._rests.items():
            machine[group, geometry.MOTION_SCALE] = motions[group, geometry.MOTION_SCALE] * (
                self.world.scale / rest.scale
            )
            machine[group, geometry.MOTION_SHIFT :] = self.world.points(moved_point(motions[group], rest.centre))
        fault = geometry.fault_of(machine)
        if fault:
            raise SceneError(f"{self.scene.name}: in frame {number}, in machine coordinates, {fault}")
        return geometry.Moves(self.shot.groups, machine)

    def scene_at(self, number: int) -> Scene:
        """The scene with the camera, lights and materials of a frame."""
        pose = self.shot.at(number)
        return replace(self.scene, camera=pose.camera, lights=pose.lights, materials=pose.materials)


def _rests(scene: Scene, shot: Animation, world: geometry.World) -> dict[int, geometry.World]:
    """How each group's surfaces at rest become coordinates of their own, by group; groups without surfaces have none."""
    boxes: dict[int, list[geometry.F64]] = {}
    for batch, number in moving_batches(scene):
        bounds = batch.bounds()
        for group in np.unique(number).tolist():
            mine = bounds[number == group]
            boxes.setdefault(group, []).append(np.stack((mine[:, 0].min(0), mine[:, 1].max(0))))
    found = {}
    for group, parts in boxes.items():
        box = np.stack((np.min(parts, axis=0)[0], np.max(parts, axis=0)[1]))
        longest = float((box[1] - box[0]).max()) / 2.0
        part, exponent = math.frexp(longest)  # exact on every computer; a logarithm need not be
        scale = math.ldexp(1.0, (part == 0.5) - exponent) if longest > 0.0 else world.scale
        found[group] = geometry.World(box.mean(axis=0), scale, world.step)
    return found
