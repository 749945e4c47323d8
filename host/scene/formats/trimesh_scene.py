"""Takes scenes from memory: a trimesh.Trimesh, or a trimesh.Scene with its graph and its camera.

A mesh becomes what the files become that trimesh writes of it. Triangles are SMOOTH if trimesh would write normals of
vertices with them: if it was given some, or has computed them because somebody asked; if not, as a file without
normals. Colours of vertices and faces count
as in a PLY file, sRGB; a SimpleMaterial as the MTL, and a PBRMaterial as the glTF material of its numbers; textures of the
base colour are baked. Of materials trimesh keeps colours as bytes. The y axis points up.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from raygrid.host.scene.builder import MAX_COORDINATE, SceneBuilder, Table, plural, shown
from raygrid.host.scene.cameras import Camera, perspective_camera
from raygrid.host.scene.file_access import take_texels
from raygrid.host.scene.finish import finish_scene
from raygrid.host.scene.formats.gltf_materials import TINTED, GltfNumbers
from raygrid.host.scene.formats.mtl import GREY, STATEMENTS, WHITE, mtl_material
from raygrid.host.scene.polygons import Ints
from raygrid.host.scene.scene import Scene
from raygrid.host.scene.smooth_normals import CREASE
from raygrid.host.scene.textures import MOST_TEXELS, Bytes, Texture, bake
from raygrid.host.scene.transform import placed_faces
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64

if TYPE_CHECKING:
    import trimesh

PLAINLY_TINTED: tuple[str, ...] = ("diffuse",)  # what a colour tints but for materials of glTF


def scene_of_trimesh(given: trimesh.Trimesh | trimesh.Scene) -> Scene:
    """The scene of a mesh or of all meshes in a graph. Raises SceneError with the object and the mesh in it."""
    import trimesh

    name = "trimesh.Scene" if isinstance(given, trimesh.Scene) else "trimesh.Trimesh"
    builder = SceneBuilder(name)
    reader = _TrimeshReader(builder)
    camera = None
    # Wild numbers may overflow on their way; what has become of them is checked where it is used.
    with np.errstate(all="ignore"):
        try:
            if isinstance(given, trimesh.Scene):
                camera = reader.read_graph(given)
            else:
                if not len(given.faces):
                    raise SceneError(f"{name}: the mesh has no faces, wanted at least one")
                reader.physical = _is_physical(given)
                reader.read_mesh(given, np.eye(4), name)
        except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
            # Attributes of these objects may be anything; whatever has the wrong type or is missing ends here.
            came = f"{type(error).__name__}: {error}"
            raise SceneError(f"{name}: the object cannot be read ({shown(came)})") from error
        return finish_scene(builder, Path(name), camera=camera, find_front=not reader.physical)


class _TrimeshReader:
    """Meshes on their way into a builder."""

    def __init__(self, builder: SceneBuilder) -> None:
        self.builder = builder
        self.physical = False  # whether any mesh has a material of glTF: the whole would be written so
        self._pictures: dict[int, Texture] = {}  # by id of an image: meshes share them

    def read_graph(self, scene: trimesh.Scene) -> Camera | None:
        """Add the meshes of all nodes, as the nodes place them; returns the scene's camera, if it has one."""
        import trimesh

        left_out, placed = 0, scene.graph.nodes_geometry
        self.physical = any(_is_physical(scene.geometry[scene.graph[node][1]]) for node in placed)
        for node in placed:
            matrix, geometry = scene.graph[node]
            mesh, where = scene.geometry[geometry], f"{self.builder.where}, node {shown(node)}"
            if isinstance(mesh, trimesh.Trimesh):
                self.read_mesh(mesh, _checked_matrix(matrix, where), where)
            else:
                left_out += 1
        if left_out:
            self.builder.remarks.append(f"{plural(left_out, 'node')} of points or lines left out")
        return self._camera(scene) if scene.has_camera else None

    def _camera(self, scene: trimesh.Scene) -> Camera:
        """A camera looks down its node's -z, its picture's up is +y; its vertical angle counts."""
        where = f"{self.builder.where}, the camera"
        matrix = _checked_matrix(scene.camera_transform, where)
        eye, forward, up = matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1]
        try:
            return perspective_camera(eye, eye + forward, up, float(scene.camera.fov[1]))
        except SceneError as error:
            raise SceneError(f"{where}: {error}") from None

    def read_mesh(self, mesh: trimesh.Trimesh, matrix: F64, where: str) -> None:
        """Add the triangles of a mesh, whose matrix to the world is (4, 4)."""
        points = _table(mesh.vertices, 3, f"{where}: the vertices")
        faces = _table(mesh.faces, 3, f"{where}: the faces").astype(np.int64)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(points)):
            wrong = int(faces[(faces < 0) | (faces >= len(points))][0])
            raise SceneError(f"{where}: a face has the vertex {wrong}, wanted numbers from 0 to {len(points) - 1}")
        normals = None
        if "vertex_normals" in mesh._cache:  # there is no public way to ask without having them computed
            normals = _table(mesh.vertex_normals, 3, f"{where}: the normals", len(points))
        kind, data, faces = placed_faces(matrix, points, faces, normals)
        materials = self._materials(mesh, faces, where)
        if normals is None:
            # What would be written as glTF is flat, as that format says.
            self.builder.add_facets(data, materials, crease=0.0 if self.physical else CREASE)
        else:
            self.builder.add(kind, data, materials)

    def _materials(self, mesh: trimesh.Trimesh, faces: Ints, where: str) -> Ints:
        """The material of each triangle: by its texture or the colours of faces or vertices, else one for all."""
        visual: Any = mesh.visual
        row, tinted, tints, name = GREY, PLAINLY_TINTED, None, ""
        if visual.kind == "face":
            row, tints = WHITE, _colours(visual.face_colors, len(faces), f"{where}: the colours of faces")
        elif visual.kind == "vertex":
            colours = _colours(visual.vertex_colors, len(mesh.vertices), f"{where}: the colours of vertices")
            row, tints = WHITE, np.round(colours[faces].mean(axis=1)).astype(np.uint8)
        elif getattr(visual, "material", None) is not None:
            row, tinted, picture = self._material(visual.material, where)
            name = str(getattr(visual.material, "name", None) or "")
            if picture is not None and visual.uv is not None and len(visual.uv):
                uv = _table(visual.uv, 2, f"{where}: the texture coordinates", len(mesh.vertices))[faces]
                texture = self._texture(picture, where)
                tints = texture.under(np.stack((uv[..., 0], 1.0 - uv[..., 1]), axis=2))  # (0, 0) is at the lower left
        if tints is None:
            return np.full(len(faces), self.builder.add_materials(row, names=name))
        rows, index = bake(row, tints, tinted)
        return self.builder.add_materials(rows, baked=True, names=name) + index

    def _material(self, material: Any, where: str) -> tuple[Table, tuple[str, ...], Any]:
        """A row, which of its fields a texture tints, and the picture of that, None if there is none."""
        from trimesh.visual.material import PBRMaterial, SimpleMaterial

        if isinstance(material, SimpleMaterial):
            return _simple(material), PLAINLY_TINTED, material.image
        if isinstance(material, PBRMaterial):
            return self._physical(material, where), TINTED, material.baseColorTexture
        self.builder.remarks.append(f"grey used for a material of the kind {type(material).__name__}")
        return GREY, PLAINLY_TINTED, None

    def _physical(self, material: Any, where: str) -> Table:
        """The row of the glTF material of these numbers; what is not given has the value that it has there."""
        base = np.ones(4)
        if material.baseColorFactor is not None:
            base = np.asarray(material.baseColorFactor, np.float64) / 255.0
        metal = 1.0 if material.metallicFactor is None else float(material.metallicFactor)
        rough = 1.0 if material.roughnessFactor is None else float(material.roughnessFactor)
        picture = material.metallicRoughnessTexture
        mixed = None if picture is None else self._texture(picture, where)
        glows = material.emissiveFactor is not None and bool(np.any(material.emissiveFactor))
        numbers = GltfNumbers(base, metal, rough, mixed, material.alphaMode == "BLEND")
        return numbers.row(f"material {material.name}", glows, self.builder.remarks, {})

    def _texture(self, picture: Any, where: str) -> Texture:
        if id(picture) not in self._pictures:
            take_texels(picture.width * picture.height, MOST_TEXELS, where)
            self._pictures[id(picture)] = Texture(np.asarray(picture.convert("RGB")))
        return self._pictures[id(picture)]


def _is_physical(mesh: Any) -> bool:
    from trimesh.visual.material import PBRMaterial

    return isinstance(getattr(getattr(mesh, "visual", None), "material", None), PBRMaterial)


def _simple(material: Any) -> Table:
    """The row of the MTL that trimesh would write; what it read of an MTL and has no name for is in `kwargs`."""
    values = {b"kd": material.diffuse[:3] / 255.0, b"ks": material.specular[:3] / 255.0}
    if material.glossiness is not None:
        values[b"ns"] = np.array([material.glossiness], np.float64)
    for name, value in material.kwargs.items():
        key = str(name).lower().encode()
        if key in STATEMENTS and key not in values:
            values[key] = np.array(value, np.float64).reshape(-1)
    return mtl_material(values)


def _table(values: Any, width: int, what: str, rows: int | None = None) -> F64:
    """Values as float64 (n, width), or (rows, width). Raises SceneError for another shape."""
    table = np.asarray(values, np.float64)
    if table.ndim != 2 or table.shape[1] != width or rows not in (None, len(table)):
        wanted = f"({'n' if rows is None else rows}, {width})"
        raise SceneError(f"{what} have the shape {table.shape}, wanted {wanted}")
    return table


def _colours(values: Any, rows: int, what: str) -> Bytes:
    """RGBA bytes as sRGB bytes, (rows, 3)."""
    return _table(values, 4, what, rows)[:, :3].astype(np.uint8)


def _checked_matrix(matrix: Any, where: str) -> F64:
    checked = _table(matrix, 4, f"{where}: its transform's rows", 4)
    if not (np.abs(checked) <= MAX_COORDINATE).all():
        raise SceneError(f"{where} has a transform that is not finite, or beyond 1e30")
    return checked
