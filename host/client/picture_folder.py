"""Takes pictures back from an array that stays: in a folder of its own, where the service leaves the exact sums and the statistics.

A scene of memory goes there, too: a raygrid.Scene as its scene file, which has the same bits, an object of trimesh as the file
that trimesh writes of it.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from raygrid.host.image.frames import Ends, path_of, pattern_of
from raygrid.node.errors import ArrayError

if TYPE_CHECKING:
    from raygrid.host.image.picture import Picture
    from raygrid.host.scene.load import SceneLike

PREFIX = "pictures-of-raygrid-"
ATTEMPTS = 8  # to remove a folder
RETRY_SECONDS = 0.1  # before the next


class PictureFolder:
    """A folder that only this user can look into. Use as a context manager; it is removed at the end.

    scene   path of the scene's file
    title   its name, for people
    output, stats  where the service is to leave a frame; with %04d if there are `several`
    """

    def __init__(self, scene: SceneLike, several: bool) -> None:
        """Make the folder. Raises ArrayError if that is impossible, or for a scene that was read already; SceneError for what
        is no scene."""
        try:
            self._folder = tempfile.TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True)
        except OSError as error:
            raise ArrayError(f"no folder for pictures can be made ({error.strerror or error}): set TMPDIR") from None
        try:
            self.scene = _path_of_scene(scene, Path(self._folder.name))
        except BaseException:
            self.close()
            raise
        self.title = Path(self.scene).name
        name = os.path.join(pattern_of(self._folder.name), "frame_%04d" if several else "frame")
        self.output, self.stats = f"{name}.npy", f"{name}.json"

    def take(self, frame: int | None) -> Picture:
        """The picture of a frame that is done; its files go. Raises ArrayError if they are not there."""
        import numpy as np

        from raygrid.host.image.picture import Picture

        sums, facts = (Path(path_of(pattern, frame)) for pattern in (self.output, self.stats))
        try:
            stats = json.loads(facts.read_bytes())
            picture = Picture(np.load(sums, allow_pickle=False), stats["samples"], stats)
            sums.unlink()
            facts.unlink()
        except (OSError, ValueError, KeyError) as error:
            raise ArrayError(f"{sums}: the picture is not as the service left it ({error})") from None
        return picture

    def close(self) -> None:
        """Remove the folder. Never raises OSError: what is left of one that cannot be removed stays.

        An array may still write there for a moment when it has said that a job is cancelled.
        """
        for attempt in range(ATTEMPTS):
            self._folder.cleanup()
            if not os.path.lexists(self._folder.name):
                return
            if attempt < ATTEMPTS - 1:
                time.sleep(RETRY_SECONDS)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _path_of_scene(scene: SceneLike, folder: Path) -> str:
    """The path of a scene; one of memory is written into the folder."""
    if isinstance(scene, str | os.PathLike):
        return os.fspath(scene)
    from raygrid.host.scene.formats.memory_scene import MemoryScene
    from raygrid.host.scene.load import load_scene
    from raygrid.host.scene.scene import Scene

    if isinstance(scene, MemoryScene):
        return scene.save(folder / "scene.toml")[0]
    if isinstance(scene, Scene):
        raise ArrayError(
            f"{scene.name}: a scene that was read already came, wanted its path, a raygrid.Scene or an object of trimesh: "
            "an array that stays reads its scenes itself"
        )
    load_scene(scene)  # says what is wrong with it
    given: Any = scene
    plain = not isinstance(given, sys.modules["trimesh"].Scene) and getattr(given.visual, "material", None) is None
    path = folder / ("mesh.ply" if plain else "scene.glb")
    given.export(path)
    return str(path)


def runs_of(frames: Iterable[int]) -> list[Ends]:
    """Numbers as firsts and lasts of what follows one another, in the order given: a job has no gaps."""
    numbers = list(frames)
    breaks = [k for k, (one, other) in enumerate(pairwise(numbers), 1) if other != one + 1]
    return [
        (numbers[first], numbers[end - 1])
        for first, end in zip([0, *breaks], [*breaks, len(numbers)], strict=True)
        if end > first
    ]


def all_frames(scene: str, outside: bool) -> list[Ends]:
    """The run of all frames that a scene has.

    outside  whether the array lets scenes refer to files outside their folders
    Raises SceneError for a scene that cannot be read.
    """
    from raygrid.host.scene.load import REMEDY_OF_ARRAY, load_scene

    shot = load_scene(scene, outside, REMEDY_OF_ARRAY).shot
    return [(1, 1 if shot is None else shot.frames)]
