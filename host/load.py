"""From a file to a scene, by the file's suffix."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from raygrid.host.misuse import ArrayMisuse, SceneMisuse
from raygrid.node.errors import ArrayError, SceneError

if TYPE_CHECKING:
    from raygrid.host.scene import Scene

# Suffix: module and function. Imported when needed: the readers of some formats bring in large libraries.
READERS = {
    ".nff": ("nff", "load_nff"),
    ".obj": ("meshes", "load_obj"),
    ".ply": ("meshes", "load_ply"),
    ".stl": ("meshes", "load_stl"),
    ".glb": ("gltf", "load_gltf"),
    ".gltf": ("gltf", "load_gltf"),
    ".toml": ("scenefile", "load_scenefile"),
}


def check_name(path: str | Path) -> None:
    """Raise SceneMisuse for what cannot be the name of a scene, whatever is there."""
    if not str(path) or "\0" in str(path):
        raise SceneMisuse(f"a scene came as {str(path)!r}, wanted the name of a file")
    suffix = Path(path).suffix
    if suffix.lower() not in READERS and not os.path.isdir(path):
        came = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise SceneMisuse(f"{path}: the file has {came}, wanted one of: {' '.join(READERS)}")


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


def load_scene(path: str | Path) -> Scene:
    """Read a scene, of any format known.

    Raises SceneError for an unknown suffix, a missing or unreadable file, and whatever its reader refuses.
    """
    check_name(path)
    path = Path(path)
    if os.path.isdir(path):
        raise SceneError(f"{path}: the scene is a directory, wanted a file of one of: {' '.join(READERS)}")
    module, function = READERS[path.suffix.lower()]
    scene: Scene = getattr(import_module(f"raygrid.host.{module}"), function)(path)
    return scene
