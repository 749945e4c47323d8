"""Meshes: OBJ with MTL (`scene_obj`), PLY and STL (by trimesh), with a camera and lights that show them.

Axes: OBJ and PLY files have y up, STL files z up. Coordinates stay as they are; the invented camera knows.

Shading: triangles are SMOOTH if the file has normals of vertices and flat if it has none. Nothing is smoothed by the
angle between faces: which edges are meant to be sharp the file does not say. STL's normals are those of its faces,
which their corners give anyway, and are not used.

Files are checked for being whole before trimesh reads them: it returns what it can of a file that was cut, or nothing.
"""

from __future__ import annotations

import io
import logging
import re
from pathlib import Path
from typing import Any

import numpy as np

from raygrid.host.scene import Scene
from raygrid.host.scene_builder import SceneBuilder, shown
from raygrid.host.scene_files import read_bytes
from raygrid.host.scene_finish import Y_UP, Z_UP, finish_scene
from raygrid.host.scene_mtl import GREY, WHITE
from raygrid.host.textures import bake
from raygrid.node.errors import SceneError
from raygrid.node.surfaces import F64, Kind

NORMALS = re.compile(rb"property\s+\w+\s+nx\s")
STL_HEADER, STL_FACET = 84, 50  # bytes of a binary STL


def load_obj(path: Path) -> Scene:
    """Read a Wavefront OBJ file with its MTL files and textures. Raises SceneError with file and line."""
    from raygrid.host.scene_obj import ObjReader

    builder = SceneBuilder(str(path))
    ObjReader(path).read_into(builder)
    return finish_scene(builder, path, up=Y_UP, highlights=True)


def load_ply(path: Path) -> Scene:
    """Read a PLY file, text or binary, with colours of vertices or faces. Raises SceneError with the file."""
    data = read_bytes(path)
    _check_ply(path, data)
    return _load_by_trimesh(path, data, "ply")


def load_stl(path: Path) -> Scene:
    """Read an STL file, text or binary. Raises SceneError with the file."""
    data = read_bytes(path)
    _check_stl(path, data)
    return _load_by_trimesh(path, data, "stl")


def _load_by_trimesh(path: Path, data: bytes, kind: str) -> Scene:
    import trimesh  # takes 0.3 s, which scenes of other formats need not pay

    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # what it has to say is checked here
    try:
        # As a scene: a file with several solids or materials keeps them all.
        geometry = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False).geometry.values()
    except Exception as error:  # damaged files raise nearly anything in there
        raise SceneError(f"{path}: the {kind.upper()} file cannot be read ({shown(str(error))})") from None
    builder = SceneBuilder(str(path))
    # Asked for normals that the file has not, trimesh makes some up: look for the property itself.
    smooth = kind == "ply" and NORMALS.search(data.partition(b"end_header")[0]) is not None
    for mesh in geometry:
        if len(getattr(mesh, "faces", ())):
            _add_mesh(builder, mesh, smooth)
    return finish_scene(builder, path, up=Z_UP if kind == "stl" else Y_UP, highlights=True)


def _add_mesh(builder: SceneBuilder, mesh: Any, smooth: bool) -> None:
    faces = np.asarray(mesh.faces, np.int64)
    points: F64 = np.asarray(mesh.vertices, np.float64)
    if faces.min() < 0 or faces.max() >= len(points):
        wanted = f"numbers from 0 to {len(points) - 1}"
        raise SceneError(f"{builder.where}: a face has the vertex {int(faces.max())}, wanted {wanted}")
    rows, index = GREY, np.zeros(len(faces), np.int64)
    if mesh.visual.kind == "face":
        rows, index = bake(WHITE, np.asarray(mesh.visual.face_colors)[:, :3])
    elif mesh.visual.kind == "vertex":
        colours = np.asarray(mesh.visual.vertex_colors)[:, :3][faces]
        rows, index = bake(WHITE, np.round(colours.mean(axis=1)).astype(np.uint8))
    materials = builder.add_materials(rows, baked=rows is not GREY) + index
    data = points[faces].reshape(-1, 9)
    if smooth:
        normals = np.asarray(mesh.vertex_normals, np.float64)[faces].reshape(-1, 9)
        builder.add(Kind.SMOOTH, np.concatenate((data, normals), axis=1), materials)
    else:
        builder.add(Kind.TRIANGLE, data, materials)


def _check_ply(path: Path, data: bytes) -> None:
    """Raise SceneError unless this is a PLY file with a header, faces, and in text form all of its lines."""
    head, found, body = data.partition(b"end_header")
    if not data.startswith(b"ply") or not found:
        raise SceneError(f"{path}: this is no PLY file, wanted a header from 'ply' to 'end_header'")
    counts: dict[bytes, int] = {}
    for words in (line.split() for line in head.splitlines()):
        if len(words) == 3 and words[0] == b"element" and words[2].isdigit():
            counts[words[1]] = int(words[2])
    if not counts.get(b"face"):
        raise SceneError(f"{path}: the file has no faces, wanted at least one")
    if b"format ascii" not in head:
        return  # trimesh compares the length of binary ones
    lines = [line for line in body.splitlines() if line.strip()]
    wanted = sum(counts.values())
    if len(lines) < wanted:
        raise SceneError(f"{path}: the file ends after {len(lines)} lines of data, wanted {wanted}")
    last = lines[wanted - 1].split()
    if list(counts)[-1] == b"face" and last[0].isdigit() and len(last) <= int(last[0]):
        raise SceneError(
            f"{path}: the file ends inside its last face, after {len(last) - 1} vertices of {int(last[0])}"
        )


def _check_stl(path: Path, data: bytes) -> None:
    """Raise SceneError unless this is a whole STL file of either form with at least one facet."""
    # Binary files may begin with "solid" too: only their length tells.
    count = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    if len(data) >= STL_HEADER and len(data) == STL_HEADER + STL_FACET * count:
        if count == 0:
            raise SceneError(f"{path}: the file has no facets, wanted at least one")
        return
    if not data.lstrip().startswith(b"solid"):
        if len(data) < STL_HEADER:
            raise SceneError(f"{path}: the file has {len(data)} bytes, wanted an STL file of at least {STL_HEADER}")
        wanted = f"{STL_HEADER + STL_FACET * count} for its {count} facets"
        raise SceneError(f"{path}: the file has {len(data)} bytes, wanted {wanted}")
    lower = data.lower()
    begun, ended = len(lower.split(b"facet normal")) - 1, lower.count(b"endfacet")
    if not begun:
        raise SceneError(f"{path}: the file has no facets, wanted at least one")
    if begun != ended or b"endsolid" not in lower:
        raise SceneError(f"{path}: the file ends inside facet {begun}, wanted all of them and 'endsolid'")
