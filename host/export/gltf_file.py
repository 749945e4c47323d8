"""Writes a scene as a binary glTF 2.0 file (.glb) that modelling programs read.

What glTF can say as raygrid has it: triangles, flat and smooth, cameras, directional, spot and falling lights, colours of
matte surfaces, polished metal and clear glass. What it cannot is cut into triangles (`tessellation`) or brought near, and
said: a light without falloff gets that strength which it has where the camera looks.
"""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.host.export.tessellation import ROUND, SEGMENTS, joined, tessellated, upright
from raygrid.host.render.machine_job import DEFAULT_SIZE
from raygrid.host.scene.builder import plural
from raygrid.host.scene.finish import Y_UP
from raygrid.host.scene.formats.gltf_materials import shading
from raygrid.host.scene.lights import exposure_point
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, Kind
from raygrid.node.protocol import DIRECTIONAL

Json = dict[str, Any]
FLOAT, UINT = 5126, 5125  # numbers of glTF
ARRAY, ELEMENTS = 34962, 34963
NEAR = 1e-3  # weights that differ by less are the same to the eye
CHUNKS = (0x4E4F534A, 0x004E4942)  # JSON, BIN
LARGEST = (1 << 32) - 1  # bytes


def glb_bytes(scene: Scene) -> tuple[bytes, list[str]]:
    """The file of a still scene, and one line each on what differs in it. Raises SceneError for what it cannot hold."""
    writer = _GltfWriter(scene)
    return writer.file(), writer.remarks


class _GltfWriter:
    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.remarks: list[str] = []
        self.json: Json = {
            "asset": {"version": "2.0", "generator": "raygrid"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "accessors": [],
            "bufferViews": [],
        }
        self._extensions: set[str] = set()
        self._parts: list[bytes] = []
        self._length = 0

    def file(self) -> bytes:
        """All of it."""
        self._add_meshes()
        self._add_camera()
        self._add_lights()
        if any(self.scene.background):
            self.remarks.append("the background is left out: the format has none")
        if self._extensions:
            self.json["extensionsUsed"] = sorted(self._extensions)
        self._stand_upright()
        self.json["buffers"] = [{"byteLength": self._length}]
        text = json.dumps(self.json, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        binary = b"".join(self._parts)
        size = 12 + 8 + len(text) + 8 + len(binary)
        if size > LARGEST:
            raise SceneError(f"{self.scene.name}: the file would have {size:,} bytes, wanted at most {LARGEST:,}")
        head = struct.pack("<4sII", b"glTF", 2, size)
        parts = (struct.pack("<II", len(text), CHUNKS[0]), text, struct.pack("<II", len(binary), CHUNKS[1]), binary)
        return b"".join((head, *parts))

    def _node(self, **values: Any) -> None:
        self.json["scenes"][0]["nodes"].append(len(self.json["nodes"]))
        self.json["nodes"].append(values)

    def _stand_upright(self) -> None:
        """Put all nodes below one that turns them, unless y points up in the scene, as it does in the format."""
        turn = upright(self.scene, Y_UP)
        if turn is None:
            return
        root, nodes = self.json["scenes"][0], self.json["nodes"]
        x, y, z = turn[0].T
        nodes.append({"matrix": _matrix(x, y, -z, (0.0, 0.0, 0.0)), "children": root["nodes"]})
        root["nodes"] = [len(nodes) - 1]
        self.remarks.append(turn[1])

    # --- surfaces

    def _add_meshes(self) -> None:
        scene = self.scene
        parts = tessellated(scene.surfaces, scene.name)
        rounded = sum(scene.surfaces.count(kind) for kind in ROUND)
        if rounded:
            self.remarks.append(f"{plural(rounded, 'round surface')} cut into triangles, {SEGMENTS} round the axis")
        if scene.surfaces.count(Kind.POLYGON):
            self.remarks.append(f"{plural(scene.surfaces.count(Kind.POLYGON), 'polygon')} cut into triangles")
        primitives = [
            {**self._primitive(corners, normals), "material": material}
            for material, corners, normals in joined(parts, len(scene.materials))
        ]
        self.json["meshes"] = [{"primitives": primitives}]
        rows = scene.materials.copy()
        if not scene.highlights:
            rows["highlight"] = 0.0
        made = [self._material(rows[k : k + 1]) for k in range(len(rows))]
        self.json["materials"] = [material for material, _ in made]
        approximate = sum(1 for _, exact in made if not exact)
        if approximate:
            self.remarks.append(f"{plural(approximate, 'material')} brought near: the format has no such weights")
        if scene.rules is not None:
            self.remarks.append("rules of a program are left out: materials are as they are without one")
        self._node(mesh=0)

    def _primitive(self, corners: F64, normals: F64 | None) -> Json:
        """Triangles with each vertex once."""
        columns = [corners.reshape(-1, 3)] + ([] if normals is None else [normals.reshape(-1, 3)])
        with np.errstate(over="ignore"):
            table = np.ascontiguousarray(np.concatenate(columns, axis=1) + 0.0, np.float32)
        if not np.isfinite(table).all():
            raise SceneError(f"{self.scene.name}: a coordinate is too large for a .glb, wanted at most 3.4e38")
        keys = table.view(np.dtype((np.void, table.itemsize * table.shape[1]))).reshape(-1)
        _, first, index = np.unique(keys, return_index=True, return_inverse=True)
        vertices = table[first]
        attributes = {"POSITION": self._accessor(vertices[:, :3], "VEC3", ARRAY)}
        if normals is not None:
            unit = vertices[:, 3:] / np.linalg.norm(vertices[:, 3:], axis=1, keepdims=True)
            attributes["NORMAL"] = self._accessor(unit.astype(np.float32), "VEC3", ARRAY)
        return {
            "attributes": attributes,
            "indices": self._accessor(index.reshape(-1, 1).astype(np.uint32), "SCALAR", ELEMENTS),
        }

    def _accessor(self, table: NDArray[Any], kind: str, target: int) -> int:
        data = np.ascontiguousarray(table).tobytes()
        self.json["bufferViews"].append(
            {"buffer": 0, "byteOffset": self._length, "byteLength": len(data), "target": target}
        )
        self._parts.append(data)
        self._length += len(data)  # all are of four bytes
        ends = {"min": table.min(axis=0).tolist(), "max": table.max(axis=0).tolist()} if target == ARRAY else {}
        row = {"bufferView": len(self.json["bufferViews"]) - 1, "count": len(table), "type": kind, **ends}
        self.json["accessors"].append({**row, "componentType": FLOAT if target == ARRAY else UINT})
        return len(self.json["accessors"]) - 1

    def _material(self, row: NDArray[np.void]) -> tuple[Json, bool]:
        """The material nearest to a row of the table, and whether it reads as the same."""
        diffuse, specular, passing = (row[name][0] for name in ("diffuse", "specular", "transmission"))
        whole = diffuse + specular + passing
        colour = np.clip(whole, 0.0, 1.0)
        strongest = float(whole.max())
        metal = rough = through = 0.0
        if strongest > 0.0:
            metal = min(float(specular.max()) / strongest, 1.0)
            rest = float((diffuse + passing).max())
            through = float(passing.max()) / rest if rest > 0.0 else 0.0
        if metal == 0.0 and through == 0.0:
            rough = 1.0
        if row["highlight"].any():
            rough = float((2.0 / (4.0 * max(float(row["shine"][0]), 1.0) + 2.0)) ** 0.25)
        elif metal > 0.0 and not passing.any():
            total = float((specular + diffuse).max())
            metal, rough = (1.0, float(diffuse.max()) / total) if total > 0.0 else (1.0, 0.0)
        ior = float(row["ior"][0]) if through else 1.5
        # Without a highlight of its own, none is to be made up from roughness.
        plain = {} if row["highlight"].any() else {"specularFactor": 0.0}
        made = shading(colour, metal, rough, through, ior, plain)
        names = ("diffuse", "specular", "transmission", "highlight")
        exact = all(np.abs(made[name] - row[name]).max() <= NEAR for name in names)
        extensions = {"KHR_materials_specular": plain} if plain else {}
        if through:
            extensions |= {
                "KHR_materials_transmission": {"transmissionFactor": through},
                "KHR_materials_ior": {"ior": ior},
            }
        self._extensions |= set(extensions)
        physical = {"baseColorFactor": [*colour.tolist(), 1.0], "metallicFactor": metal, "roughnessFactor": rough}
        material: Json = {"pbrMetallicRoughness": physical, "doubleSided": True}
        return material | ({"extensions": extensions} if extensions else {}), exact

    # --- camera and lights

    def _add_camera(self) -> None:
        camera, (width, height) = self.scene.camera, self.scene.size or DEFAULT_SIZE
        half = camera.pitch(width, height) * height / 2.0
        far = 10.0 * float(np.abs(self.scene.surfaces.bounds() - np.array(camera.eye)).max()) or 1.0
        if camera.orthographic:
            size = {"xmag": half * width / height, "ymag": half}
            lens: Json = {"type": "orthographic", "orthographic": {**size, "znear": 0.0, "zfar": far}}
        else:
            angle = {"yfov": 2.0 * math.atan(half), "aspectRatio": width / height, "znear": far * 1e-5}
            lens = {"type": "perspective", "perspective": angle}
        self.json["cameras"] = [lens]
        self._node(camera=0, matrix=_matrix(camera.right, camera.up, camera.forward, camera.eye))

    def _add_lights(self) -> None:
        lights = self.scene.lights
        if not len(lights):
            return
        looked_at = exposure_point(self.scene.camera, self.scene.surfaces.bounds())
        made = [self._light(light, looked_at) for light in lights]
        self.json["extensions"] = {"KHR_lights_punctual": {"lights": made}}
        self._extensions.add("KHR_lights_punctual")
        for number, light in enumerate(lights):
            axis = -light["place"] if light["kind"] == DIRECTIONAL else light["axis"]
            place = (0.0, 0.0, 0.0) if light["kind"] == DIRECTIONAL else light["place"]
            matrix = _matrix(*_across(axis), axis, place)
            self._node(matrix=matrix, extensions={"KHR_lights_punctual": {"light": number}})
        level = sum(1 for light in lights if light["kind"] != DIRECTIONAL and not light["falloff"])
        if level:
            self.remarks.append(
                f"{plural(level, 'light')} without falloff: as strong where the camera looks, and falls"
            )
        if (lights["cos_disc"] <= 1.0).any():
            self.remarks.append("discs of lights are left out: the format has none")
        self.remarks.append("readers choose an exposure: only how bright lights are beside each other is said")

    def _light(self, light: np.void, looked_at: F64) -> Json:
        strength: F64 = light["intensity"].astype(np.float64)
        if light["kind"] != DIRECTIONAL and not light["falloff"]:
            strength = strength * float(np.sum((light["place"] - looked_at) ** 2))
        brightest = float(strength.max())
        row: Json = {
            "type": "directional" if light["kind"] == DIRECTIONAL else "spot" if light["spot"] else "point",
            "color": (strength / brightest).tolist() if brightest > 0.0 else [1.0, 1.0, 1.0],
            "intensity": brightest,
        }
        if light["spot"]:
            outer = min(math.acos(float(np.clip(light["cos_outer"], -1.0, 1.0))), math.pi / 2.0)
            inner = min(math.acos(float(np.clip(light["cos_inner"], -1.0, 1.0))), outer * (1.0 - 1e-6))
            row["spot"] = {"innerConeAngle": inner, "outerConeAngle": outer}
        return row


def _across(axis: F64) -> tuple[F64, F64]:
    """Two directions that make a right-handed frame with a light's axis as -z."""
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    aside /= np.linalg.norm(aside)
    return aside, np.cross(aside, axis)


def _matrix(right: Any, up: Any, forward: Any, place: Any) -> list[float]:
    """A node's matrix, column by column: glTF looks down -z."""
    columns = (right, up, -np.asarray(forward, np.float64), place)
    return [float(v) for column, last in zip(columns, (0, 0, 0, 1), strict=True) for v in (*column, last)]
