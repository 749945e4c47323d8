"""Writes any scene that can be read as a file of another kind: `raygrid export`.

POV-Ray's renders the same picture by the same rules (`povray`), .glb goes to modelling programs (`gltf_file`), and .obj,
.ply and .stl hold the triangles alone, as trimesh writes them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from raygrid.host.export.povray import export_pov
from raygrid.host.files.input_guard import check_outputs, note, noted
from raygrid.host.image.outputs import check_path, write_whole
from raygrid.host.scene.animation.scene_frames import frame_told, still
from raygrid.host.scene.finish import Y_UP, Z_UP
from raygrid.host.scene.load import check_name, load_scene
from raygrid.host.scene.scene import Scene
from raygrid.host.scene.view import GivenView
from raygrid.host.text.misuse import OutputMisuse
from raygrid.node.errors import SceneError

if TYPE_CHECKING:
    from raygrid.host.scene.load import SceneLike

MESHES = (".obj", ".ply", ".stl")
KINDS = (".pov", ".glb", *MESHES)


def export_file(
    scene: SceneLike,
    output: str | Path | None = None,
    depth: int | None = None,
    highlights: bool | None = None,
    frame: int | None = None,
    tell: Callable[[str], None] = lambda _: None,
    **view: Unpack[GivenView],
) -> str:
    """Read a scene and write it as a file of the output's suffix; returns the path written, the scene's name with .pov by
    default. Standard output (-), a pipe or a device gets POV-Ray's words.

    depth       for .pov: greatest depth of the ray tree; None: what the scene asks for, else 5
    highlights  for .pov and .glb: whether materials' highlights are used; None: as the scene has it
    frame       of an animation, None for its first
    tell        is told which frame was taken, and what the file cannot say
    view        from where and in which light it is seen (`raygrid.host.scene.view.GivenView`)
    Raises SceneError and OutputError.
    """
    source = Path(scene) if isinstance(scene, str | os.PathLike) else None
    if source is not None:
        check_name(str(scene))
    path = f"{'scene' if source is None else source.stem}.pov" if output is None else str(output)
    to_pipe = path == "-" or (Path(path).exists() and not Path(path).is_file())
    suffix = ".pov" if to_pipe else Path(path).suffix.lower()
    check_path(path)
    with noted():  # called from Python, too
        if source is not None:
            note(source, "the same file as the scene")
        check_outputs([path])
        if suffix not in KINDS:
            raise OutputMisuse(f"{path}: the file has the suffix {suffix!r}, wanted one of: {' '.join(KINDS)}")
        read = load_scene(scene, **view)
        told = frame_told(read, frame)
        if told is not None:
            tell(told)
        if not len(read.surfaces):
            raise SceneError(f"{read.name}: the scene has no surfaces")
        if highlights is not None:
            read = replace(read, highlights=highlights)
        if suffix == ".pov":
            export_pov(read, path, depth, frame)
        else:
            _export_meshes(still(read, frame or 1), path, suffix, tell)
    return path


def _export_meshes(scene: Scene, path: str, suffix: str, tell: Callable[[str], None]) -> None:
    if suffix == ".glb":
        from raygrid.host.export.gltf_file import glb_bytes

        data, remarks = glb_bytes(scene)
    else:
        data, remarks = _by_trimesh(scene, suffix)
    for remark in remarks:
        tell(f"{scene.name}: {remark}")
    write_whole(path, lambda file: file.write(data))


def _by_trimesh(scene: Scene, suffix: str) -> tuple[bytes, list[str]]:
    """The triangles, in a .ply with their colours, as trimesh writes them, and what is not said there."""
    import trimesh

    from raygrid.host.export.tessellation import joined, tessellated, upright
    from raygrid.host.scene.linear_algebra import product
    from raygrid.host.scene.textures import as_bytes

    parts = list(joined(tessellated(scene.surfaces, scene.name), len(scene.materials)))
    corners = np.concatenate([part for _, part, _ in parts])
    turn = upright(scene, Z_UP if suffix == ".stl" else Y_UP)
    if turn is not None:
        corners = product(corners, turn[0].T)
    colours = None
    lost = "materials, camera and lights are left out: the format has none"
    if suffix == ".ply":
        colours = as_bytes(np.clip(scene.materials["diffuse"], 0.0, 1.0), is_linear=True)
        rows = np.repeat([material for material, _, _ in parts], [len(part) for _, part, _ in parts])
        colours = colours[rows]
        lost = "all of the materials but their matte colour, camera and lights are left out: the format has none"
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    made: Any = trimesh.Trimesh(corners.reshape(-1, 3), faces, face_colors=colours, process=False).export(
        file_type=suffix[1:]
    )
    return made.encode() if isinstance(made, str) else made, [lost, *([turn[1]] if turn is not None else [])]
