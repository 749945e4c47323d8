"""Scenes that stay in memory between frames, made ready for one array, and read anew only if their files have changed."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from importlib.metadata import version

from raygrid.host.job import Job, Settings, make_job, samples_expected
from raygrid.host.load import load_scene
from raygrid.host.scene import Scene
from raygrid.host.shot_jobs import ShotJobs
from raygrid.host.sources import Sources, recorded

MOST_KEPT = 4  # scenes and settings

Shape = tuple[int, int, int]


@dataclass(frozen=True)
class Ready:
    """A frame that is ready for the array.

    loaded    a digest of what the array must hold: the planes between cells, and the surfaces
    contents  a digest of the scene's files
    expected  primary rays that there will be, about
    """

    job: Job
    loaded: str
    contents: str
    expected: int

    def digest(self, frame: int | None, transfer: str) -> str:
        """A digest of all that the picture depends on: contents, settings, frame, transfer, and this program.

        The split is not part of it, for the picture does not depend on it.
        """
        settings = astuple(replace(self.job.settings, split=""))
        words = repr((_version(), self.contents, settings, frame, transfer))
        return hashlib.sha256(words.encode()).hexdigest()


@lru_cache
def _version() -> str:
    return version("raygrid")


class SceneStore:
    """The scenes used last, for an array of one shape. For use by one thread."""

    def __init__(self, shape: Shape) -> None:
        self._shape = shape
        self._scenes: OrderedDict[str, tuple[Sources, Scene]] = OrderedDict()
        self._ready: OrderedDict[tuple[str, Settings], tuple[Scene, Ready]] = OrderedDict()
        self._shots: OrderedDict[tuple[str, Settings], tuple[Scene, ShotJobs]] = OrderedDict()

    def scene(self, path: str) -> tuple[Sources, Scene]:
        """The scene of a file as it is now, and what it was read from. Raises SceneError."""
        kept = self._scenes.pop(path, None)
        if kept is None or kept[0].changed():
            with recorded() as sources:
                scene = load_scene(path)
            kept = sources, scene
        self._scenes[path] = kept
        while len(self._scenes) > MOST_KEPT:
            self._scenes.popitem(last=False)
        return kept

    def frame(self, path: str, settings: Settings, frame: int) -> Ready:
        """A frame of the scene as its files are now. Raises SceneError."""
        sources, scene = self.scene(path)
        key = path, settings
        if scene.shot is not None:
            return self._shot_frame(scene, sources, key, frame)
        kept = self._ready.pop(key, None)
        if kept is None or kept[0] is not scene:
            job = make_job(scene, self._shape, settings)
            kept = scene, Ready(job, _digest_of_load(job), sources.digest(), samples_expected(job))
        self._ready[key] = kept
        while len(self._ready) > MOST_KEPT:
            self._ready.popitem(last=False)
        return kept[1]

    def _shot_frame(self, scene: Scene, sources: Sources, key: tuple[str, Settings], frame: int) -> Ready:
        """A frame of a scene that moves: its jobs share what an array needs to go from one to the next by increments."""
        assert scene.shot is not None
        kept = self._shots.pop(key, None)
        if kept is None or kept[0] is not scene:
            kept = scene, ShotJobs(scene, self._shape, key[1], (scene.shot.frames + 1) // 2)
        self._shots[key] = kept
        while len(self._shots) > MOST_KEPT:
            self._shots.popitem(last=False)
        job = kept[1].job(frame)
        # never the same as before: whether the array holds it is for the driver to know (`Driver.held`)
        return Ready(job, f"{_digest_of_load(job)} frame {frame}", sources.digest(), samples_expected(job))


def _digest_of_load(job: Job) -> str:
    """A digest of what is flooded for a job."""
    digest = hashlib.sha256(repr((job.space.step, job.space.planes.shape)).encode())
    digest.update(job.space.planes.tobytes())
    for batch in job.surfaces:
        digest.update(repr((batch.kind, len(batch), batch.data.dtype.str)).encode())
        for part in (batch.ids, batch.materials, batch.data, batch.starts):
            digest.update(part.tobytes())
    return digest.hexdigest()
