"""From a file to a scene, by the file's suffix."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

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
    """Raise SceneError for what cannot be the name of a file."""
    if not str(path) or "\0" in str(path):
        raise SceneError(f"a scene came as {str(path)!r}, wanted the name of a file")


def check_allowed(path: str | None, allowed: bool) -> None:
    """Raise ArrayError for a program that nobody has allowed."""
    if path is not None and not allowed:
        raise ArrayError(
            f"{path}: a program is code that runs with your rights, wanted --allow-programs to launch an array that takes it"
        )


def load_scene(path: str | Path) -> Scene:
    """Read a scene, of any format known.

    Raises SceneError for an unknown suffix, a missing or unreadable file, and whatever its reader refuses.
    """
    check_name(path)
    path = Path(path)
    if os.path.isdir(path):
        raise SceneError(f"{path}: the scene is a directory, wanted a file of one of: {' '.join(READERS)}")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        came = f"the suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise SceneError(f"{path}: the file has {came}, wanted one of: {' '.join(READERS)}")
    module, function = reader
    scene: Scene = getattr(import_module(f"raygrid.host.{module}"), function)(path)
    return scene
