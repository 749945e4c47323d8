"""Makes the job of one frame, of whatever kind of scene; gives out what else there is to know of jobs."""

from __future__ import annotations

from collections.abc import Callable

from raygrid.host.render.machine_job import Job, Settings, make_still_job, rays_enter, samples_expected
from raygrid.host.scene.scene import Scene

__all__ = ["Job", "Settings", "make_job", "rays_enter", "samples_expected"]


def make_job(
    scene: Scene, shape: tuple[int, int, int], settings: Settings, wait: Callable[[], None] | None = None
) -> Job:
    """The job of a scene, of an animation's first frame. Raises SceneError for settings that cannot be.

    `wait`: as of `raygrid.emulator.partition.split.split`.
    """
    if scene.shot is None:
        return make_still_job(scene, shape, settings, wait)
    from raygrid.host.render.animation_jobs import jobs_of

    return next(jobs_of(scene, shape, settings, [1], wait))
