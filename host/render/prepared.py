"""Holds a frame that is ready for an array, with what it was read from, and digests all that its picture depends on."""

from __future__ import annotations

import hashlib
from dataclasses import astuple, dataclass, replace
from functools import lru_cache

from raygrid.host.image.frames import Ends, Turntable
from raygrid.host.render.machine_job import Job
from raygrid.host.scene.scene import Scene
from raygrid.host.scene.sources import Sources
from raygrid.host.scene.view import View


@dataclass(frozen=True)
class PreparedFrame:
    """A frame that is ready for the array.

    job       whose `load_key` tells of the planes between cells, the surfaces, where they are, and the program
    contents  a digest of the scene's files, of the turntable it stands on, and of the view that is asked for
    remarks   on the scene
    files     that the scene is made of
    """

    job: Job
    contents: str
    remarks: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture in pixels."""
        return self.job.frame.width, self.job.frame.height

    def digest(self, frame: int | Ends | None, transfer: str) -> str:
        """A digest of all that a picture depends on: contents, settings, program, frame, transfer, and this version.

        frame  its number; of a file that plays the first and the last
        Split and layers are not part of it, for the picture does not depend on them.
        """
        settings = self.job.settings
        program = None if settings.program is None else settings.program.digest
        words = astuple(replace(settings, split="", program=None, layers=()))
        return hashlib.sha256(repr((_version(), self.contents, words, program, frame, transfer)).encode()).hexdigest()


def turned(scene: Scene, turn: Turntable | None) -> Scene:
    """The scene on its turntable, if there is one. Raises SceneError for one that moves by itself."""
    if turn is None:
        return scene
    from raygrid.host.scene.animation.turntable import turntable

    return turntable(scene, turn.frames, turn.turn_scene)


def contents_of_still(sources: Sources, view: View) -> str:
    """A digest of the files of a scene, and of the view that is asked for."""
    return sources.digest() if view == View() else f"{sources.digest()} {view}"


def contents_of_shot(sources: Sources, turn: Turntable | None, view: View) -> str:
    """A digest of the files of a scene that moves, of the turntable it stands on, and of the view that is asked for."""
    return f"{contents_of_still(sources, view)} {turn}"


def remarks_on(scene: Scene, frame: int | None) -> tuple[str, ...]:
    """What is to be said of a scene, and of an animation of which no frame was asked for (None)."""
    remarks = tuple(scene.remarks)
    if frame is None and scene.shot is not None and scene.shot.frames > 1:
        remarks += (f"frame 1 of {scene.shot.frames}; --frames 1-{scene.shot.frames} renders all",)
    return remarks


@lru_cache
def _version() -> str:
    from importlib.metadata import version

    return version("raygrid")
