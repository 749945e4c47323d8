"""Reads the scene file (TOML), our own format: primitives and meshes, with materials, lights and camera.

`toml_schema` says what may stand in it, this module turns it into a scene. Ids run through the included file,
then [[surfaces]], then [[meshes]]. Errors name the file, the line if it can be found, the key, what came and what was
wanted; only the first is told, since the others are often its consequences.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from raygrid.host.files.toml_reader import read_toml
from raygrid.host.scene.builder import SceneBuilder, material, shown
from raygrid.host.scene.cameras import DEFAULT_FOV, Camera, orthographic_camera, perspective_camera
from raygrid.host.scene.file_access import read_bytes
from raygrid.host.scene.finish import OF_ITS_OWN, finish_scene, without
from raygrid.host.scene.formats import toml_schema as schema
from raygrid.host.scene.formats.mtl import GREY
from raygrid.host.scene.formats.polygon_mesh import PolygonMesh
from raygrid.host.scene.formats.toml_animation import SceneAnimation, keyed
from raygrid.host.scene.formats.toml_errors import Key, checked, located, shown_key
from raygrid.host.scene.lights import Table, directional_light, light_table, point_light, spot_light
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.pose import Animation
from raygrid.host.scene.scene import Scene
from raygrid.host.scene.smooth_normals import crease_of_file
from raygrid.host.scene.transform import moved, placement
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, NUMBERS, AddedKind, Groups, Kind, make_groups, quaternion_of_angles
from raygrid.node.protocol import RULE_COLUMNS

SOFT_EDGE = 0.8  # a spot's full light reaches this part of the way to its rim unless the file says otherwise
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
BOX_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))  # fronts outside


def load_scenefile(path: Path) -> Scene:
    """Read a file. Raises SceneError with file, line, key, what came and what was wanted."""
    data = read_bytes(path)
    try:
        text, tables = read_toml(data)
    except ValueError as error:
        raise SceneError(f"{path}: the TOML cannot be read ({error})") from None
    return TomlReader(path, text, checked(path, text, tables)).scene()


class TomlReader:
    """A scene file that was checked, on its way into a builder.

    meshes  of memory, by the names that they have for files
    """

    def __init__(
        self, path: Path, text: str, file: schema.SceneFile, meshes: Mapping[str, PolygonMesh] = MappingProxyType({})
    ) -> None:
        self.path = path
        self.meshes = meshes
        self.text = text
        self.file = file
        self.builder = SceneBuilder(str(path))
        self.materials = {name: self._add_material(name, m) for name, m in file.materials.items()}
        self.grey: int | None = None
        self.moving: list[tuple[int, int, str]] = []  # order numbers, first and end, and their group

    def scene(self) -> Scene:
        """Make the scene. Raises SceneError with the key."""
        file, base = self.file, self._included()
        for number, surface in enumerate(file.surfaces):
            with self._in_group(surface.group, ("surfaces", number)):
                self._add_surface(surface, ("surfaces", number))
        for number, mesh in enumerate(file.meshes):
            with self._in_group(mesh.group, ("meshes", number)):
                self._add_mesh(mesh, ("meshes", number))
        image = file.image or schema.Image()
        size = base.size if base else None
        if image.width is not None and image.height is not None:
            size = (image.width, image.height)
        background = file.background or (base.background if base else (0.0, 0.0, 0.0))
        first_lights = light_table([base.lights] if base else [])
        scene = finish_scene(
            self.builder,
            self.path,
            camera=self._camera(base),
            lights=light_table([first_lights, *map(_light, file.lights)]),
            background=background,
            highlights=True if file.highlights is None else file.highlights,
        )
        up = file.camera.up if file.camera else base.up if base else scene.up
        return replace(
            scene,
            size=size,
            samples=image.samples,
            depth=image.depth,
            min_weight=image.min_weight,
            rules=self._rules(len(scene.materials)),
            shot=self._animation(scene, first_lights),
            up=up,
            front=None,
        )

    def _rules(self, materials: int) -> F64 | None:
        """The numbers that materials have for a program; None if none has any."""
        if not any(m.rule is not None for m in self.file.materials.values()):
            return None
        rules = np.zeros((materials, RULE_COLUMNS))
        for name, m in self.file.materials.items():
            row = int(self.builder.share[self.materials[name]])
            if m.rule is not None and row >= 0:
                rules[row, 0], rules[row, 1 : 1 + len(m.rule)] = 1.0, m.rule
        return rules

    def _animation(self, scene: Scene, first_lights: Table) -> Animation | None:
        """The animation; None if nothing changes."""
        file, table = self.file, self.file.shot or schema.AnimationTable()
        holders = [
            *file.groups.values(),
            *([file.camera] if file.camera else []),
            *file.lights,
            *file.materials.values(),
        ]
        last = max((key.frame for holder in holders for key in holder.keys), default=0)
        if table.frames is None and last == 0:
            return None
        names, way = tuple(file.groups), table.interpolation
        poses = SceneAnimation(
            scene,
            tuple(keyed(schema.Motion(), g.keys, g.interpolation or way) for g in file.groups.values()),
            tuple(g.pivot for g in file.groups.values()),
            tuple(self._parent(name) for name in names),
            None if file.camera is None else keyed(file.camera, file.camera.keys, way),
            first_lights,
            tuple(keyed(light, light.keys, way) for light in file.lights),
            tuple(
                (int(self.builder.share[self.materials[name]]), keyed(m, m.keys, way))
                for name, m in file.materials.items()
                if m.keys and self.builder.share[self.materials[name]] >= 0
            ),
            self.camera_of,
            _light,
            _material,
        )
        return Animation(table.frames or last, names, self._groups(names), poses.pose, table.fps)

    def _groups(self, names: tuple[str, ...]) -> Groups:
        """Which surfaces are in which group."""
        orders = self.builder.orders
        ids, numbers = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for first, end, name in self.moving:
            ids.append(np.flatnonzero((orders >= first) & (orders < end)))
            numbers.append(np.full(len(ids[-1]), names.index(name)))
        return make_groups(np.concatenate(ids), np.concatenate(numbers), len(names))

    def _parent(self, name: str) -> int:
        """The number of a group's parent, -1 for none. Raises SceneError for an unknown one, and for a circle."""
        groups = self.file.groups
        seen, at = [name], groups[name].parent
        while at is not None:
            if at not in groups:
                raise self._error(("groups", seen[-1], "parent"), f"is {shown(at)}, wanted one of: {', '.join(groups)}")
            if at in seen:
                raise self._error(("groups", name, "parent"), f"leads back to {shown(at)}, wanted no circle of parents")
            seen.append(at)
            at = groups[at].parent
        parent = groups[name].parent
        return -1 if parent is None else list(groups).index(parent)

    @contextlib.contextmanager
    def _in_group(self, name: str | None, key: Key) -> Iterator[None]:
        """What is added within moves with a group."""
        if name is not None and name not in self.file.groups:
            known = ", ".join(self.file.groups) or "none, as the file has no [groups]"
            raise self._error((*key, "group"), f"is {shown(name)}, wanted one of: {known}")
        first = self.builder.next_order
        yield
        if name is not None:
            self.builder.let_move(first, self.builder.next_order)
            self.moving.append((first, self.builder.next_order, name))

    def _error(self, key: Key, message: str) -> SceneError:
        return SceneError(f"{located(self.path, self.text, key)}: {shown_key(key)} {message}")

    def _included(self) -> Scene | None:
        """The scene that this one adds to: NFF only, since other readers invent cameras and lights."""
        if self.file.include is None:
            return None
        path = self.path.parent / self.file.include
        if path.suffix.lower() != ".nff":
            raise self._error(
                ("include",), f"is {shown(self.file.include)}, wanted an .nff file; meshes go under [[meshes]]"
            )
        base = load_scene(path)
        self._add_scene(base, np.eye(3), (0.0, 0.0, 0.0), None)
        return base

    def _add_material(self, name: str, m: schema.Material) -> int:
        return self.builder.add_materials(_material(m), apart=bool(m.keys) or m.rule is not None, names=name)

    def _material(self, name: str | None, key: Key) -> int:
        if name is not None:
            if name not in self.materials:
                known = ", ".join(self.materials) or "none, as the file has no [materials]"
                raise self._error((*key, "material"), f"is {shown(name)}, wanted one of: {known}")
            return self.materials[name]
        if self.grey is None:
            self.grey = self.builder.add_materials(GREY)
        return self.grey

    def _add_surface(self, surface: schema.Surface, key: Key) -> None:
        number = self._material(surface.material, key)
        if isinstance(surface, schema.Polygon | schema.Box):
            polygons = _box(surface) if isinstance(surface, schema.Box) else np.array([surface.points])
            starts = np.arange(len(polygons) + 1, dtype=np.int64) * polygons.shape[1]
            self.builder.add_polygons(polygons.reshape(-1, 3), starts, number)
        elif isinstance(surface, schema.Sphere):
            self.builder.add(Kind.SPHERE, np.array([[*surface.centre, surface.radius]]), number)
        elif isinstance(surface, schema.ProgramSurface):
            numbers = [*surface.numbers, *[0.0] * (NUMBERS - len(surface.numbers))]
            row = [*quaternion_of_angles(surface.rotate), surface.scale, *surface.centre, *surface.half, *numbers]
            self.builder.add(AddedKind.PROGRAMMED, np.array([row]), number)
        elif isinstance(surface, schema.Triangle):
            corners = np.array([*surface.points, *(surface.normals or ())])
            self.builder.add(Kind.SMOOTH if surface.normals else Kind.TRIANGLE, corners.reshape(1, -1), number)
        else:
            self._add_cone(surface, key, number)

    def _add_cone(self, surface: schema.Cylinder | schema.Cone, key: Key, number: int) -> None:
        if isinstance(surface, schema.Cylinder):
            wide, narrow = (*surface.base, surface.radius), (*surface.top, surface.radius)
        else:
            wide, narrow = (*surface.base, surface.base_radius), (*surface.apex, surface.apex_radius)
        if abs(narrow[3]) > abs(wide[3]):
            wide, narrow = narrow, wide
        if wide[:3] == narrow[:3]:
            raise self._error(key, f"has both ends at {list(wide[:3])}, wanted two points")
        if wide[3] * narrow[3] < 0.0 or wide[3] == 0.0:
            raise self._error(key, f"has the radii {wide[3]} and {narrow[3]}, wanted one sign and not both 0")
        kind = Kind.CYLINDER if wide[3] == narrow[3] else Kind.CONE
        self.builder.add(kind, np.array([[*wide, *narrow]]), number)

    def _add_mesh(self, mesh: schema.Mesh, key: Key) -> None:
        if Path(mesh.file).suffix.lower() == ".toml":
            raise self._error((*key, "file"), f"is {shown(mesh.file)}, wanted a file that is no scene file itself")
        override = None if mesh.material is None else self._material(mesh.material, key)
        try:
            with crease_of_file(mesh.crease):
                scene = self._mesh_scene(mesh)
            self._add_scene(scene, placement(mesh.scale, mesh.rotate), mesh.translate, override)
        except SceneError as error:
            raise self._error((*key, "file"), f"cannot be placed: {error}") from None

    def _mesh_scene(self, mesh: schema.Mesh) -> Scene:
        """The scene of another file, or of a mesh of memory."""
        given = self.meshes.get(mesh.file)
        if given is not None:
            builder = SceneBuilder(mesh.file)
            given.add_to(builder)
            return finish_scene(builder, Path(mesh.file))
        return load_scene(self.path.parent / mesh.file)

    def _add_scene(self, scene: Scene, matrix: F64, shift: tuple[float, ...], override: int | None) -> None:
        """Add the surfaces of another file, with its own materials or one for all."""
        names = scene.material_names or ""
        first = 0 if override is not None else self.builder.add_materials(scene.materials, names=names)
        begin = self.builder.next_order
        for batch in scene.surfaces:
            data = moved(batch, matrix, shift)
            rows = batch.materials.astype(np.int64) + first
            materials = rows if override is None else np.full(len(batch), override)
            order = batch.ids.astype(np.int64) + begin
            if batch.kind == Kind.POLYGON:
                self.builder.add_polygons(data, batch.starts, materials, order)
            else:
                self.builder.add(batch.kind, data, materials, order)
        self.builder.remarks += [f"{scene.name}: {remark}" for remark in without(scene.remarks, *OF_ITS_OWN)]

    def _camera(self, base: Scene | None) -> Camera | None:
        c = self.file.camera
        if c is None:
            return base.camera if base else None
        try:
            return self.camera_of(c)
        except SceneError as error:
            raise self._error(("camera",), f"shows nothing: {error}") from None

    @staticmethod
    def camera_of(c: schema.CameraTable) -> Camera:
        """The camera of a table. Raises SceneError for one that shows nothing."""
        if c.orthographic is not None:
            return orthographic_camera(c.eye, c.at, c.up, c.orthographic)
        return perspective_camera(c.eye, c.at, c.up, DEFAULT_FOV if c.fov is None else c.fov)


def _material(m: schema.Material) -> Table:
    return material(np.multiply(m.colour, m.diffuse), m.highlight, m.shine, m.specular, m.transmission, m.ior)


def _light(light: schema.Light) -> Table:
    intensity = light.intensity * np.array(light.colour)
    if isinstance(light, schema.PointLight):
        return point_light(light.position, intensity, light.falloff)
    if isinstance(light, schema.SpotLight):
        outer = math.radians(light.outer_degrees)
        inner = SOFT_EDGE * outer if light.inner_degrees is None else math.radians(light.inner_degrees)
        axis = np.subtract(light.at, light.position)
        return spot_light(light.position, axis, intensity, inner, outer, light.falloff)
    radius = None if light.disc_degrees is None else math.radians(light.disc_degrees)
    return directional_light(light.towards, intensity, radius, light.disc_colour or intensity)


def _box(box: schema.Box) -> NDArray[np.float64]:
    """Six quadrilaterals, (6, 4, 3)."""
    low, high = np.array(box.low), np.array(box.high)
    corners = np.where(CORNERS > 0.0, high, low)
    return np.asarray(corners[np.array(BOX_SIDES)])
