"""Keeps scenes in memory between frames, ready for one array, and reads them anew only if their files have changed."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

from raygrid.host.client.requests import SubmitMessage
from raygrid.host.image.frames import Turntable, frames_of
from raygrid.host.render.animation_jobs import AnimationJobs
from raygrid.host.render.given_settings import parted
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.render.prepared import PreparedFrame, contents_of_shot, contents_of_still, remarks_on, turned
from raygrid.host.scene.load import NO_VIEW, REMEDY_OF_ARRAY, load_scene
from raygrid.host.scene.scene import Scene
from raygrid.host.scene.sources import Sources, recorded
from raygrid.host.scene.view import View, view_of
from raygrid.node.geometry import Moves

MOST_KEPT = 4  # scenes and settings

Shape = tuple[int, int, int]


@dataclass(frozen=True)
class FrameRequest:
    """What a job wants to be made ready.

    path      of the scene's file
    turn      makes a shot of a still scene; None: the scene as it is
    frames    first and last of the job; None: it names none
    view      from where and in which light the scene is seen
    """

    path: str
    settings: Settings
    turn: Turntable | None = None
    frames: tuple[int, int] | None = None
    view: View = NO_VIEW

    def check_frames(self, scene: Scene) -> None:
        """Raise SceneError for frames that the scene has not: before the first of the job, not after many."""
        if self.frames is not None:
            frames_of(scene, self.frames)


def wanted_by(submit: SubmitMessage) -> FrameRequest:
    """What a submission wants to be made ready. Raises SceneError for a program that is none."""
    from raygrid.host.render.program_file import read_program

    program = None if submit.program is None else read_program(submit.program)
    turn = None if submit.turntable is None else Turntable(submit.turntable.frames, submit.turntable.scene)
    frame, view = parted(submit.settings.given())
    settings = Settings(**frame, program=program)
    return FrameRequest(submit.scene, settings, turn, submit.frames, view_of(view))


@dataclass(frozen=True)
class _StoredAnimation:
    """A shot that is kept: the scene as it was read, its jobs, and a digest of what they all share."""

    scene: Scene
    jobs: AnimationJobs
    shared: str


class SceneStore:
    """The scenes used last, for an array of one shape. For use by one thread.

    allow_outside  whether scenes may refer to files outside their folders
    """

    def __init__(self, shape: Shape, allow_outside: bool = False) -> None:
        self._shape, self._allow_outside = shape, allow_outside
        self._scenes: OrderedDict[tuple[str, View], tuple[Sources, Scene]] = OrderedDict()
        self._ready: OrderedDict[FrameRequest, tuple[Scene, PreparedFrame]] = OrderedDict()
        self._shots: OrderedDict[FrameRequest, _StoredAnimation] = OrderedDict()

    def scene(self, path: str, view: View = NO_VIEW) -> tuple[Sources, Scene]:
        """The scene of a file as it is now and a view shows it, and what it was read from. Raises SceneError."""
        kept = self._scenes.pop((path, view), None)
        if kept is None or kept[0].changed():
            with recorded() as sources:
                scene = load_scene(path, self._allow_outside, REMEDY_OF_ARRAY, **view.given())
            kept = sources, scene
        _keep(self._scenes, (path, view), kept)
        return kept

    def frame(self, wanted: FrameRequest, frame: int | None) -> PreparedFrame:
        """A frame of the scene as its files are now; None: a shot's first. Raises SceneError."""
        sources, scene = self.scene(wanted.path, wanted.view)
        if scene.shot is not None or wanted.turn is not None:
            return self._shot_frame(scene, sources, wanted, frame)
        wanted.check_frames(scene)
        key = replace(wanted, frames=None)
        kept = self._ready.pop(key, None)
        if kept is None or kept[0] is not scene:
            job = make_job(scene, self._shape, wanted.settings)
            job = replace(job, load_key=_digest_of_load(job) + _digest_of_program(wanted.settings))
            kept = (
                scene,
                PreparedFrame(
                    job, contents_of_still(sources, wanted.view), remarks_on(scene, frame), tuple(sources.files)
                ),
            )
        _keep(self._ready, key, kept)
        return kept[1]

    def _shot_frame(self, scene: Scene, sources: Sources, wanted: FrameRequest, frame: int | None) -> PreparedFrame:
        """A frame of a scene that moves: its jobs share what an array needs to go from one to the next by increments."""
        kept = self._shot(scene, wanted)
        job = kept.jobs.job(1 if frame is None else frame)
        assert job.moves is not None
        key = kept.shared + _digest_of_moves(job.moves) + _digest_of_program(wanted.settings)
        contents, remarks = contents_of_shot(sources, wanted.turn, wanted.view), remarks_on(scene, frame)
        return PreparedFrame(replace(job, load_key=key), contents, remarks, tuple(sources.files))

    def _shot(self, scene: Scene, wanted: FrameRequest) -> _StoredAnimation:
        key = replace(wanted, frames=None)
        kept = self._shots.pop(key, None)
        if kept is not None and kept.scene is scene:
            wanted.check_frames(kept.jobs.scene)
        else:
            moving = turned(scene, wanted.turn)
            assert moving.shot is not None
            wanted.check_frames(moving)
            like = next((s.jobs for k, s in self._shots.items() if s.scene is scene and k.turn == wanted.turn), None)
            middle = (moving.shot.frames + 1) // 2
            jobs = AnimationJobs(moving, self._shape, wanted.settings, middle, like=like)
            kept = _StoredAnimation(scene, jobs, _digest_of_load(jobs.job(middle)))
        _keep(self._shots, key, kept)
        return kept


def _keep(kept: OrderedDict[Any, Any], key: Hashable, value: object) -> None:
    """Keep it as the one used last, and forget those not used for long."""
    kept[key] = value
    while len(kept) > MOST_KEPT:
        kept.popitem(last=False)


def _digest_of_load(job: Job) -> str:
    """A digest of what is flooded for a job."""
    digest = hashlib.sha256(repr((job.space.step, job.space.planes.shape)).encode())
    digest.update(job.space.planes.tobytes())
    for batch in job.surfaces:
        digest.update(repr((batch.kind, len(batch), batch.data.dtype.str)).encode())
        for part in (batch.ids, batch.materials, batch.data, batch.starts):
            digest.update(part.tobytes())
    return digest.hexdigest()


def _digest_of_moves(moves: Moves) -> str:
    """A digest of which surfaces move together, and where they are: keys may be edited and all else stay."""
    digest = hashlib.sha256(repr(moves.groups.many).encode())
    for part in (moves.groups.firsts, moves.groups.ends, moves.groups.numbers, moves.motions):
        digest.update(repr(part.shape).encode() + part.tobytes())
    return f" {digest.hexdigest()}"


def _digest_of_program(settings: Settings) -> str:
    return "" if settings.program is None else f" {settings.program.digest}"
