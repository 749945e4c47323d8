"""Reads a scene with the reader of its file's suffix, or takes one that a program has in memory."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from raygrid.host.scene.view import VIEW, GivenView, view_of
from raygrid.host.text.clean_text import printable
from raygrid.host.text.misuse import ArrayMisuse, SceneMisuse
from raygrid.node.errors import ArrayError, SceneError

if TYPE_CHECKING:
    import trimesh

    from raygrid.host.scene.scene import Scene, SceneSource

    SceneLike = str | os.PathLike[str] | Scene | SceneSource | trimesh.Trimesh | trimesh.Scene

# Suffix: module and function. Imported when needed: the readers of some formats bring in large libraries.
READERS = {
    ".nff": ("nff", "load_nff"),
    ".obj": ("meshes", "load_obj"),
    ".ply": ("meshes", "load_ply"),
    ".stl": ("meshes", "load_stl"),
    ".glb": ("gltf", "load_gltf"),
    ".gltf": ("gltf", "load_gltf"),
    ".toml": ("toml", "load_scenefile"),
}


NO_VIEW = view_of({})
MOST_REMARKS = 100
REMEDY = "--allow-outside (in Python allow_outside=True)"
REMEDY_OF_ARRAY = "raygrid up --allow-outside"  # for scenes that an array that stays reads


def check_name(path: str | Path) -> None:
    """Raise SceneMisuse for what cannot be the name of a scene, whatever is there; SceneError for a directory."""
    if not str(path) or "\0" in str(path):
        raise SceneMisuse(f"a scene came as {str(path)!r}, wanted the name of a file")
    if os.path.isdir(path):
        raise SceneError(
            f"{printable(str(path))}: the scene is a directory, wanted a file of one of: {' '.join(READERS)}"
        )
    suffix = Path(path).suffix
    if suffix.lower() not in READERS:
        came = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise SceneMisuse(f"{printable(str(path))}: the file has {came}, wanted one of: {' '.join(READERS)}")


class WantsProgram(SceneError):
    """A scene has surfaces of a program, and no program came that knows them."""


def check_allowed(path: str | None, allowed: bool) -> None:
    """Raise ArrayMisuse for a program of a command that launches an array, if it was not allowed there."""
    if path is None:
        return
    check_program_name(path)
    if not allowed:
        raise ArrayMisuse(
            f"{path}: a program is code that runs with your rights, wanted --allow-programs to launch an array that takes it"
        )


_allowed: ContextVar[bool] = ContextVar("allowed", default=False)


@contextmanager
def outside_allowed() -> Iterator[None]:
    """Let all scenes that this thread reads in this block refer to files outside their folders."""
    before = _allowed.set(True)
    try:
        yield
    finally:
        _allowed.reset(before)


def check_program_name(path: str | Path) -> None:
    """Raise SceneMisuse for what cannot be the name of a program."""
    suffix = Path(path).suffix
    if suffix.lower() != ".py":
        raise SceneMisuse(f"{path}: the program has the suffix {suffix!r}, wanted .py")


def check_taken(path: str | None, taken: bool) -> None:
    """Raise ArrayError for a program of a job, if the array that stays takes none."""
    if path is not None and not taken:
        raise ArrayError(
            f"{path}: a program is code that runs with your rights, wanted an array of raygrid up --allow-programs"
        )


def load_scene(scene: SceneLike, allow_outside: bool = False, remedy: str = REMEDY, **view: Unpack[GivenView]) -> Scene:
    """Read a scene, of any format known, or take one of memory: a raygrid.Scene, a trimesh.Trimesh or a trimesh.Scene; one
    that was read is given back as it is.

    allow_outside  whether it may refer to files outside its folder; of a scene within another the other's was asked
    remedy         what the error says that allows it
    view           from where and in which light it is to be seen: `raygrid.host.scene.view.GivenView`
    Raises SceneError for an unknown suffix, a missing or unreadable file, and whatever its reader refuses. What the file
    says comes back fit to be shown, in errors and remarks. Raises SceneMisuse for a view that cannot be, TypeError for
    another keyword.
    """
    unknown = set(view) - set(VIEW)
    if unknown:
        raise TypeError(f"load_scene came with {sorted(unknown)}, wanted some of {', '.join(VIEW)}")
    asked = view_of(view)
    read = (
        _read(scene, allow_outside, remedy)
        if asked.crease is None
        else _creased(scene, allow_outside, remedy, asked.crease)
    )
    if asked == NO_VIEW:
        return read
    from raygrid.host.scene.viewpoint import seen

    return seen(read, asked)


def _creased(scene: SceneLike, allow_outside: bool, remedy: str, crease: float) -> Scene:
    """Read a scene whose meshes get another crease than they would have."""
    from raygrid.host.scene.scene import Scene
    from raygrid.host.scene.smooth_normals import crease_asked

    if isinstance(scene, Scene):
        raise SceneMisuse(f"{scene.name}: a crease came for a scene that was read already, wanted it for load_scene")
    with crease_asked(crease):
        return _read(scene, allow_outside, remedy)


def _read(scene: SceneLike, allow_outside: bool, remedy: str) -> Scene:
    if not isinstance(scene, str | os.PathLike):
        return _taken(scene)
    from raygrid.host.scene.file_access import reading

    path = Path(scene)
    check_name(scene if isinstance(scene, str) else path)
    module, function = READERS[path.suffix.lower()]
    with reading(path, allow_outside or _allowed.get(), remedy) as whole:
        try:
            read: Scene = getattr(import_module(f"raygrid.host.scene.formats.{module}"), function)(path)
        except SceneError as error:
            error.args = (printable(str(error)),)
            raise
    return _shown(read) if whole else read


def _taken(given: Scene | SceneSource | trimesh.Trimesh | trimesh.Scene) -> Scene:
    """The scene of an object in memory. Raises SceneMisuse for one that is none."""
    from raygrid.host.scene.scene import Scene, SceneSource

    if isinstance(given, Scene):
        return given
    try:
        return _shown(given.read() if isinstance(given, SceneSource) else _of_trimesh(given))
    except SceneError as error:
        error.args = (printable(str(error)),)
        raise


def _of_trimesh(given: trimesh.Trimesh | trimesh.Scene) -> Scene:
    known = sys.modules.get("trimesh")  # who has such an object has imported it
    if not isinstance(given, tuple(getattr(known, name) for name in ("Trimesh", "Scene") if hasattr(known, name))):
        kind = type(given)
        name = kind.__name__ if kind.__module__ == "builtins" else f"{kind.__module__}.{kind.__name__}"
        came = "None" if given is None else f"an object of {printable(name)}"
        wanted = "the path of a file, a raygrid.Scene, a trimesh.Trimesh or a trimesh.Scene"
        raise SceneMisuse(f"a scene came as {came}, wanted {wanted}")
    from raygrid.host.scene.formats.trimesh_scene import scene_of_trimesh

    return scene_of_trimesh(given)


def _shown(scene: Scene) -> Scene:
    """The scene with its name and its remarks fit to be shown, each remark once, and not too many."""
    remarks = list(dict.fromkeys(map(printable, scene.remarks)))
    if len(remarks) > MOST_REMARKS:
        remarks[MOST_REMARKS:] = [f"and {len(remarks) - MOST_REMARKS} remarks more"]
    return replace(scene, name=printable(scene.name), remarks=tuple(remarks))
