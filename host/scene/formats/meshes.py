"""Reads meshes: OBJ with MTL (`obj`), PLY (`ply`) and STL (by trimesh), with a camera and lights that show them.

Axes: OBJ and PLY files have y up, STL files z up. Coordinates stay as they are; the invented camera knows.

Shading: triangles are SMOOTH if the file has normals of vertices; if it has none, edges that bend little are taken to be
meant as smooth (`smooth_normals`). STL's normals are those of its faces, which their corners give anyway, and are not used.

STL files are checked for being whole before trimesh reads them: it returns what it can of one that was cut, or nothing.
"""

from __future__ import annotations

import io
import logging
from pathlib import Path

import numpy as np

from raygrid.host.scene.builder import SceneBuilder, shown
from raygrid.host.scene.file_access import read_bytes
from raygrid.host.scene.finish import Y_UP, Z_UP, finish_scene
from raygrid.host.scene.formats.mtl import GREY
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64

STL_HEADER, STL_FACET = 84, 50  # bytes of a binary STL
UNHEARD = logging.NullHandler()  # of what trimesh has to say: it is checked here; a logger takes a handler once


def load_obj(path: Path) -> Scene:
    """Read a Wavefront OBJ file with its MTL files and textures. Raises SceneError with file and line."""
    from raygrid.host.scene.formats.obj import ObjReader

    builder = SceneBuilder(str(path))
    ObjReader(path).read_into(builder)
    return finish_scene(builder, path, up=Y_UP, find_front=True)


def load_ply(path: Path) -> Scene:
    """Read a PLY file, text or binary, with colours of vertices or faces. Raises SceneError with the file."""
    from raygrid.host.scene.formats.ply import PlyReader

    builder = SceneBuilder(str(path))
    PlyReader(path, read_bytes(path), builder).read_into()
    return finish_scene(builder, path, up=Y_UP, find_front=True)


def load_stl(path: Path) -> Scene:
    """Read an STL file, text or binary. Raises SceneError with the file."""
    import trimesh  # takes 0.3 s, which scenes of other formats need not pay

    data = read_bytes(path)
    _check_stl(path, data)
    logging.getLogger("trimesh").addHandler(UNHEARD)
    try:
        # As a scene: a file with several solids keeps them all.
        geometry = trimesh.load_scene(io.BytesIO(data), file_type="stl", process=False).geometry.values()
    except Exception as error:  # damaged files raise nearly anything in there
        raise SceneError(f"{path}: the STL file cannot be read ({shown(str(error))})") from None
    builder = SceneBuilder(str(path))
    grey = builder.add_materials(GREY)
    for mesh in geometry:
        if len(getattr(mesh, "faces", ())):
            points: F64 = np.asarray(mesh.vertices, np.float64)
            builder.add_facets(points[np.asarray(mesh.faces, np.int64)].reshape(-1, 9), grey)
    return finish_scene(builder, path, up=Z_UP, find_front=True)


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
