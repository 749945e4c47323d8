"""Reads glTF 2.0 scenes (.glb and .gltf): geometry, node tree, cameras, lights and materials.

The document is read here and not by trimesh, which (in 5.2) leaves the parents' scale out of cameras, makes up its own
lights and drops transmission.

Axes are glTF's: right-handed, y up. Materials: `gltf_materials`. The first camera in the node tree is used, unless
another is chosen.

Exposure: lights come in candela and lux, which say how bright a scene is but not how it is to be photographed (an
ordinary lamp out of Blender is 32,610 cd). All intensities are divided by one number, so that the brightest light gives
irradiance 1 at the point that the camera looks at: the point of its axis nearest to the middle of the scene's box. So a
white matte surface there, turned to that light, is just white. The fall with the square of the distance stays.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.builder import MAX_COORDINATE, SceneBuilder, plural, shown
from raygrid.host.scene.cameras import (
    Camera,
    NamedCamera,
    look_at_everything,
    orthographic_camera,
    perspective_camera,
)
from raygrid.host.scene.finish import MANY_CAMERAS, finish_scene
from raygrid.host.scene.formats.gltf_animation import GltfAnimation, Part, frames_of, part_names, read_animations
from raygrid.host.scene.formats.gltf_document import Document, JsonObject
from raygrid.host.scene.formats.gltf_materials import TINTED, GltfMaterial, Materials
from raygrid.host.scene.lights import (
    Table,
    directional_light,
    exposed,
    exposure_point,
    light_table,
    point_light,
    spot_light,
)
from raygrid.host.scene.linear_algebra import lengths, product
from raygrid.host.scene.pose import Animation
from raygrid.host.scene.scene import Scene
from raygrid.host.scene.textures import Bytes, as_bytes, bake
from raygrid.host.scene.transform import placed_faces
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, make_groups, rotation_matrices, unit_quaternions

Ints = NDArray[np.int64]

LIGHTS = "KHR_lights_punctual"
KNOWN = {
    LIGHTS,
    "KHR_materials_transmission",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "EXT_texture_webp",
}
TRIANGLES, STRIP, FAN = 4, 5, 6
MOST_DEEP = 200  # nodes below each other; of each the whole path is kept
CLOSEST = 1e-3  # of the box's diagonal: a light at the very point looked at must not make all else black


def load_gltf(path: Path) -> Scene:
    """Read a file. Raises SceneError with the file and the place in it."""
    try:
        # Wild numbers may overflow on their way; what has become of them is checked where it is used.
        with np.errstate(all="ignore"):
            return _GltfReader(Document(path)).scene()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        # The document is free-form JSON: whatever has the wrong type or is missing ends here.
        came = f"{type(error).__name__}: {error}"
        raise SceneError(f"{path}: the file is not valid glTF ({shown(came)})") from error


class _GltfReader:
    def __init__(self, document: Document) -> None:
        self.document = document
        self.builder = SceneBuilder(str(document.path))
        self.materials = Materials(document, self.builder.remarks)
        self.cameras: list[NamedCamera] = []
        self.lights: list[Table] = []
        self.skipped = 0  # primitives that are points or lines
        self._numbers: dict[int, int] = {}  # id of a GltfMaterial: its number in the builder
        self.motions, self._last = read_animations(document)
        self.moving: list[tuple[Part, int, int]] = []  # meshes that move, with their order numbers, first and end
        self.camera_parts: list[Part] = []
        self.light_parts: list[Part] = []

    def scene(self) -> Scene:
        json, remarks = self.document.json, self.builder.remarks
        unknown = [name for name in json.get("extensionsRequired", ()) if name not in KNOWN]
        if unknown:
            raise self.document.error(f"the file requires the extension {unknown[0]}, which is not supported")
        for part, matrix in self._nodes():
            self._add_node(part, matrix)
        if self.skipped:
            remarks.append(f"{plural(self.skipped, 'primitive')} of points or lines left out")
        if json.get("skins"):
            remarks.append("skins left out: meshes are as the file's nodes place them")
        if len(self.cameras) > 1:
            names = ", ".join(shown(c.name) if c.name else str(k) for k, c in enumerate(self.cameras[:5], 1))
            more = ", ..." if len(self.cameras) > 5 else ""
            remarks.append(f"the first of {len(self.cameras)} {MANY_CAMERAS} {names}{more}")
        camera = self.cameras[0].camera if self.cameras else None
        for _, first, end in self.moving:
            self.builder.let_move(first, end)
        lights = self._exposed(camera)
        scene = finish_scene(self.builder, self.document.path, camera=camera, lights=lights)
        scene = replace(scene, cameras=tuple(self.cameras))
        return self._animated(scene) if self.motions else scene

    def _animated(self, scene: Scene) -> Scene:
        """The scene with what its animations change: also for cameras that are not used, but may be."""
        poses, shot = self._animation(scene)
        moving = [part.moves(self.motions) for part in self.camera_parts]
        cameras = tuple(
            replace(camera, pose=partial(poses.camera_at, part)) if moves else camera
            for camera, part, moves in zip(self.cameras, self.camera_parts, moving, strict=True)
        )
        return replace(scene, shot=shot, cameras=cameras)

    def _animation(self, scene: Scene) -> tuple[GltfAnimation, Animation]:
        """What the animations change."""
        orders, parts = self.builder.orders, [part for part, _, _ in self.moving]
        ids, numbers = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for number, (_, first, end) in enumerate(self.moving):
            ids.append(np.flatnonzero((orders >= first) & (orders < end)))
            numbers.append(np.full(len(ids[-1]), number))
        given = max((float(light["intensity"].max()) for light in self.lights), default=0.0)
        shown_as = float(scene.lights["intensity"].max(initial=0.0))
        camera = next((part for part in self.camera_parts[:1] if part.moves(self.motions)), None)
        poses = GltfAnimation(
            scene,
            self.motions,
            node_matrix,
            tuple(parts),
            camera,
            tuple(self.light_parts),
            lambda part, matrix: self._camera(self.document.item("cameras", part.path[-1][1]["camera"]), matrix),
            lambda part, matrix: _light(self._lamp(part.path[-1][1]), matrix),
            shown_as / given if given > 0.0 else 1.0,
        )
        groups = make_groups(np.concatenate(ids), np.concatenate(numbers), len(parts))
        names = tuple(part.name for part in parts)
        return poses, Animation(frames_of(self._last), names, groups, poses.pose)

    def _exposed(self, camera: Camera | None) -> Table | None:
        if not self.lights:
            return None
        bounds = self.builder.finish()[0].bounds()
        camera = camera or look_at_everything(bounds)
        closest = CLOSEST * float(lengths(bounds[1] - bounds[0]))
        self.builder.remarks.append("light intensities scaled: the brightest gives irradiance 1 where the camera looks")
        return exposed(light_table(self.lights), exposure_point(camera, bounds), max(closest, 1e-12))

    def _nodes(self) -> Iterator[tuple[Part, F64]]:
        """The nodes of the scene, parents first, with their matrices to the world, (4, 4)."""
        json = self.document.json
        if json.get("scenes"):
            roots = self.document.item("scenes", json.get("scene", 0)).get("nodes", [])
        else:
            every = range(len(json.get("nodes", ())))
            children = {child for k in every for child in self.document.item("nodes", k).get("children", ())}
            roots = [k for k in every if k not in children]
        above: tuple[tuple[int, JsonObject], ...] = ()
        waiting = [(number, np.eye(4), above) for number in reversed(roots)]
        seen: set[int] = set()
        while waiting:
            number, parent, above = waiting.pop()
            row = self.document.item("nodes", number)
            if number in seen:
                raise self.document.error(f"nodes[{number}] is reached twice, wanted a tree of nodes")
            seen.add(number)
            matrix = product(parent, node_matrix(row))
            if not (np.abs(matrix) <= MAX_COORDINATE).all():
                raise self.document.error(f"nodes[{number}] has a transform that is not finite, or beyond 1e30")
            path = (*above, (number, row))
            if len(path) > MOST_DEEP:
                raise self.document.error(f"nodes[{number}] lies below {MOST_DEEP} others, wanted fewer")
            yield Part(part_names(path), path), matrix
            waiting += [(child, matrix, path) for child in reversed(row.get("children", ()))]

    def _add_node(self, part: Part, matrix: F64) -> None:
        row, first = part.path[-1][1], self.builder.next_order
        if "mesh" in row:
            for primitive in self.document.item("meshes", row["mesh"])["primitives"]:
                self._add_primitive(primitive, matrix)
        if self.builder.next_order > first and part.moves(self.motions):
            self.moving.append((part, first, self.builder.next_order))
        if "camera" in row:
            self.camera_parts.append(part)
            lens = self.document.item("cameras", row["camera"])
            name = str(row.get("name") or lens.get("name") or "")
            self.cameras.append(NamedCamera(name, self._camera(lens, matrix)))
        if row.get("extensions", {}).get(LIGHTS) is not None:
            self.light_parts.append(part)
            self.lights.append(_light(self._lamp(row), matrix))

    def _lamp(self, row: JsonObject) -> JsonObject:
        lamps = self.document.json["extensions"][LIGHTS]["lights"]
        found: JsonObject = lamps[row["extensions"][LIGHTS]["light"]]
        return found

    def _camera(self, row: JsonObject, matrix: F64) -> Camera:
        """A camera looks down its node's -z, its picture's up is +y; the node's scale does not change the angle."""
        eye, forward, up = matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1]
        try:
            if row["type"] == "perspective":
                return perspective_camera(eye, eye + forward, up, math.degrees(row["perspective"]["yfov"]))
            return orthographic_camera(eye, eye + forward, up, 2.0 * float(row["orthographic"]["ymag"]))
        except SceneError as error:
            raise self.document.error(str(error)) from None

    def _add_primitive(self, primitive: JsonObject, matrix: F64) -> None:
        attributes = primitive["attributes"]
        if primitive.get("mode", TRIANGLES) not in (TRIANGLES, STRIP, FAN) or "POSITION" not in attributes:
            self.skipped += 1
            return
        local: F64 = self.document.accessor(attributes["POSITION"]).astype(np.float64)
        faces = self._faces(primitive, len(local))
        normals = None
        if "NORMAL" in attributes:
            normals = self.document.accessor(attributes["NORMAL"]).astype(np.float64)
        kind, data, faces = placed_faces(matrix, local, faces, normals)
        materials = self._face_materials(primitive, faces)
        if normals is None:
            self.builder.add_facets(data, materials, crease=0.0)  # flat, says the format
        else:
            self.builder.add(kind, data, materials)

    def _faces(self, primitive: JsonObject, points: int) -> Ints:
        """The triangles' vertices, (t, 3)."""
        index = np.arange(points)
        if "indices" in primitive:
            index = self.document.accessor(primitive["indices"])[:, 0].astype(np.int64)
            if len(index) and (index.min() < 0 or index.max() >= points):
                raise self.document.error(f"a primitive has the index {int(index.max())}, but {points} vertices")
        mode = primitive.get("mode", TRIANGLES)
        if mode == TRIANGLES:
            if len(index) % 3:
                raise self.document.error(f"a primitive of triangles has {len(index)} indices, wanted a multiple of 3")
            return index.reshape(-1, 3)
        step = np.arange(max(len(index) - 2, 0))
        if mode == FAN:
            return np.stack((index[np.zeros_like(step)], index[step + 1], index[step + 2]), axis=1)
        odd = step % 2  # every other triangle of a strip runs the other way
        return np.stack((index[step], index[step + 1 + odd], index[step + 2 - odd]), axis=1)

    def _face_materials(self, primitive: JsonObject, faces: Ints) -> Ints:
        material = self.materials.get(primitive.get("material"))
        tints = self._tints(primitive["attributes"], material, faces)
        if tints is not None:
            rows, index = bake(material.row, tints, TINTED)
            return self.builder.add_materials(rows, baked=True, names=material.name) + index
        if id(material) not in self._numbers:
            self._numbers[id(material)] = self.builder.add_materials(material.row, names=material.name)
        return np.full(len(faces), self._numbers[id(material)], np.int64)

    def _tints(self, attributes: JsonObject, material: GltfMaterial, faces: Ints) -> Bytes | None:
        """The triangles' colours by texture and by vertex, sRGB, (t, 3); None if they have neither."""
        tints: F64 | None = None
        if material.texture is not None and material.coordinates in attributes:
            uv = self.document.accessor(attributes[material.coordinates]).astype(np.float64)
            tints = material.texture.under(uv[faces]) / 255.0
        if "COLOR_0" in attributes:
            colours = self.document.accessor(attributes["COLOR_0"])[:, :3]
            colours = np.clip(np.nan_to_num(colours.astype(np.float64)), 0.0, 1.0)
            of_vertices = as_bytes(colours[faces].mean(axis=1), is_linear=True) / 255.0
            tints = of_vertices if tints is None else tints * of_vertices
        return None if tints is None else as_bytes(tints)


def node_matrix(row: JsonObject) -> F64:
    """A node's own matrix, (4, 4): `matrix`, or translation x rotation x scale."""
    if "matrix" in row:
        matrix = np.array(row["matrix"], np.float64).reshape(4, 4).T
    else:
        x, y, z, w = np.array(row.get("rotation", (0, 0, 0, 1)), np.float64).tolist()
        x, y, z, w = unit_quaternions(np.array((x, y, z, w)))
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrices(np.array([(w, x, y, z)]))[0] * np.array(
            row.get("scale", (1, 1, 1)), np.float64
        )
        matrix[:3, 3] = row.get("translation", (0, 0, 0))
    return matrix


def _light(row: JsonObject, matrix: F64) -> Table:
    """A light shines down its node's -z."""
    strength = float(row.get("intensity", 1.0)) * np.array(row.get("color", (1.0, 1.0, 1.0)), np.float64)
    if not np.isfinite(strength).all() or strength.min() < 0.0 or len(strength) != 3:
        raise ValueError(f"a light has the intensity {strength.tolist()}")
    place, axis = matrix[:3, 3], -matrix[:3, 2]
    if row["type"] == "directional":
        return directional_light(-axis, strength)
    if row["type"] == "point":
        return point_light(place, strength, falloff=True)
    if row["type"] != "spot":
        raise ValueError(f"a light is of the type {row['type']}")
    cone = row.get("spot", {})
    inner, outer = float(cone.get("innerConeAngle", 0.0)), float(cone.get("outerConeAngle", math.pi / 4.0))
    return spot_light(place, axis, strength, inner, outer, falloff=True)
