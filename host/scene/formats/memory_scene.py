"""Builds scenes in memory, `raygrid.Scene`: what a scene file can say, said by calls, with meshes as arrays.

Left to files are what is taken from other files, triangles by themselves, and what programs need. Every call is checked by
the models of the scene file (`toml_schema`) as it is made, and the whole is read by the reader of scene files. So `save`
writes a scene file of which the same bits come.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raygrid.host.image.outputs import check_path, write_whole
from raygrid.host.scene.builder import MAX_COORDINATE
from raygrid.host.scene.formats.polygon_mesh import PolygonMesh
from raygrid.host.scene.formats.toml import TomlReader
from raygrid.host.scene.formats.toml_errors import check_item, checked
from raygrid.host.scene.formats.toml_writer import toml_text
from raygrid.host.scene.scene import Scene, SceneSource
from raygrid.host.scene.textures import Bytes
from raygrid.host.text.misuse import OutputMisuse
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64

WHERE = "raygrid.Scene"
ONE_OF = {"meshes": "mesh"}  # a word that has more than an s in the plural

Vector3 = Sequence[float] | NDArray[np.floating[Any]] | NDArray[np.integer[Any]]
Weight = float | Vector3
Key = Mapping[str, Any]
Table = dict[str, Any]


class MemoryScene(SceneSource):
    """A scene in memory, to which surfaces, materials, lights and a camera are added. Taken wherever a path is.

        scene = raygrid.Scene(background=(0.3, 0.45, 0.7))
        scene.material("glass", diffuse=0, specular=0.08, transmission=0.9, ior=1.5)
        scene.sphere((0, 1, 0), 1, material="glass")
        scene.mesh(vertices, faces, colours=colours)
        scene.camera((0, 2, 8), (0, 1, 0), fov=35)
        picture = array.render(scene)

    Coordinates are float64 in any unit, y pointing up unless the camera says otherwise; colours of materials and lights are
    linear. Keys are maps with a `frame` from 1 and the values there (docs/animation.md). Without lights two are invented,
    without a camera one. Each method raises SceneError in one sentence for what cannot be.
    """

    def __init__(
        self,
        *,
        background: Vector3 | None = None,
        highlights: bool | None = None,
        size: tuple[int, int] | None = None,
        samples: int | None = None,
        depth: int | None = None,
        min_weight: float | None = None,
    ) -> None:
        """Begin an empty scene.

        background  linear red, green and blue, black if None
        highlights  whether materials' highlights are used; None: they are
        size, samples, depth, min_weight  what is asked of a render, as `Machine.render` has them
        """
        width, height = (None, None) if size is None else (size[0], size[1])
        image = _given(width=width, height=height, samples=samples, depth=depth, min_weight=min_weight)
        self._head: Table = _given(background=background, highlights=highlights) | _given(image=image or None)
        self._lists: dict[str, list[Table]] = {"lights": [], "surfaces": [], "meshes": []}
        self._named: dict[str, dict[str, Table]] = {"materials": {}, "groups": {}}
        self._meshes: dict[str, PolygonMesh] = {}
        check_item(WHERE, self._head)

    def __repr__(self) -> str:
        rows = (*self._lists.items(), *self._named.items())
        parts = [f"{len(row)} {ONE_OF.get(name, name[:-1]) if len(row) == 1 else name}" for name, row in rows if row]
        return f"<raygrid.Scene of {', '.join(parts) or 'nothing'}>"

    def material(
        self,
        name: str,
        *,
        colour: Vector3 = (1.0, 1.0, 1.0),
        diffuse: Weight = 1.0,
        highlight: Weight = 0.0,
        shine: float = 50.0,
        specular: Weight = 0.0,
        transmission: Weight = 0.0,
        ior: float = 1.5,
        keys: Sequence[Key] = (),
    ) -> str:
        """Name a material, and give the name back. Weights are linear, a number or red, green and blue (docs/scenes.md).

        colour   multiplies diffuse; shine: exponent of the highlight; ior: index of refraction inside the body
        """
        table = _given(colour=colour, diffuse=diffuse, highlight=highlight, shine=shine, specular=specular)
        return self._name("materials", name, table | _given(transmission=transmission, ior=ior, keys=keys or None))

    def group(
        self,
        name: str,
        *,
        parent: str | None = None,
        pivot: Vector3 = (0.0, 0.0, 0.0),
        interpolation: Literal["linear", "smooth"] | None = None,
        keys: Sequence[Key] = (),
    ) -> str:
        """Name a group of surfaces that move together, and give the name back.

        keys   of translate, rotate (degrees about x, y, z) and scale, about the pivot; then the parent's motion follows
        """
        table = _given(parent=parent, pivot=pivot, interpolation=interpolation, keys=keys or None)
        return self._name("groups", name, table)

    def shot(
        self, frames: int | None = None, *, fps: float = 24.0, interpolation: Literal["linear", "smooth"] = "linear"
    ) -> None:
        """Say how many frames there are, None: to the last key; and how values go from key to key."""
        self._set("shot", _given(frames=frames, fps=fps, interpolation=interpolation))

    def mesh(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        normals: ArrayLike | None = None,
        colours: ArrayLike | None = None,
        face_colours: ArrayLike | None = None,
        uv: ArrayLike | None = None,
        material: str | None = None,
        group: str | None = None,
        crease: float | None = None,
    ) -> None:
        """Add a mesh. The arrays are copied.

        vertices      (p, 3), finite numbers of at most 1e30 in size
        faces         (n, 3), or (n, k) for polygons of k corners: whole numbers, rows of the vertices, fronts counter-clockwise
        normals       (p, 3), of the vertices; None: smooth by `crease`
        colours       (p, 3) or (p, 4), sRGB, uint8 or floats from 0 to 1; face_colours: the same of faces, (n, 3) or (n, 4)
        uv            (p, 2): checked and saved, and not yet used
        material      instead of colours; grey if there is neither
        crease        degrees: without normals smooth across edges that bend by no more, None: 40; 0: facets
        """
        number = len(self._lists["meshes"])
        where = f"{WHERE}: meshes[{number}]"
        points = _rows(vertices, 3, f"{where}.vertices")
        corners = _faces(faces, f"{where}.faces", len(points))
        if material is not None and (colours is not None or face_colours is not None):
            raise SceneError(f"{where} has colours and the material {material!r}, wanted one of them")
        made = PolygonMesh(
            points,
            corners.reshape(-1),
            np.arange(len(corners) + 1) * corners.shape[1],
            _rows(normals, 3, f"{where}.normals", len(points)) if normals is not None else None,
            _colours(colours, f"{where}.colours", len(points)) if colours is not None else None,
            _colours(face_colours, f"{where}.face_colours", len(corners)) if face_colours is not None else None,
            _rows(uv, 2, f"{where}.uv", len(points)) if uv is not None else None,
        )
        name = f"mesh {number + 1}"
        self._add("meshes", _given(file=name, material=material, group=group, crease=crease))
        self._meshes[name] = made

    def sphere(self, centre: Vector3, radius: float, *, material: str | None = None, group: str | None = None) -> None:
        """Add a sphere; with a radius below 0 only its inside shows."""
        self._surface("sphere", material, group, centre=centre, radius=radius)

    def cylinder(
        self, base: Vector3, top: Vector3, radius: float, *, material: str | None = None, group: str | None = None
    ) -> None:
        """Add a cylinder, open at both ends."""
        self._surface("cylinder", material, group, base=base, top=top, radius=radius)

    def cone(
        self,
        base: Vector3,
        base_radius: float,
        apex: Vector3,
        apex_radius: float = 0.0,
        *,
        material: str | None = None,
        group: str | None = None,
    ) -> None:
        """Add a cone, open at both ends; a frustum if it has two radii."""
        ends = {"base": base, "base_radius": base_radius, "apex": apex, "apex_radius": apex_radius}
        self._surface("cone", material, group, **ends)

    def polygon(self, points: ArrayLike, *, material: str | None = None, group: str | None = None) -> None:
        """Add a polygon, (n, 3), n at least 3, counter-clockwise seen from the front; it may be concave."""
        self._surface("polygon", material, group, points=points)

    def box(self, low: Vector3, high: Vector3, *, material: str | None = None, group: str | None = None) -> None:
        """Add a box along the axes: six polygons, fronts outside."""
        self._surface("box", material, group, low=low, high=high)

    def point_light(
        self,
        position: Vector3,
        *,
        intensity: float = 1.0,
        colour: Vector3 = (1.0, 1.0, 1.0),
        falloff: bool = False,
        keys: Sequence[Key] = (),
    ) -> None:
        """Add a light that shines from a point; with falloff: intensity / distance^2."""
        self._light("point", intensity, colour, keys, position=position, falloff=falloff)

    def spot_light(
        self,
        position: Vector3,
        at: Vector3,
        *,
        outer_degrees: float = 30.0,
        inner_degrees: float | None = None,
        intensity: float = 1.0,
        colour: Vector3 = (1.0, 1.0, 1.0),
        falloff: bool = False,
        keys: Sequence[Key] = (),
    ) -> None:
        """Add a light with a cone: none outside the outer angle from its axis, all within the inner (0.8 of the outer)."""
        angles = _given(outer_degrees=outer_degrees, inner_degrees=inner_degrees)
        self._light("spot", intensity, colour, keys, position=position, at=at, falloff=falloff, **angles)

    def directional_light(
        self,
        towards: Vector3,
        *,
        intensity: float = 1.0,
        colour: Vector3 = (1.0, 1.0, 1.0),
        disc_degrees: float | None = None,
        disc_colour: Vector3 | None = None,
        keys: Sequence[Key] = (),
    ) -> None:
        """Add a light at infinity in the direction `towards`; with a disc (degrees from middle to rim) rays see it."""
        disc = _given(disc_degrees=disc_degrees, disc_colour=disc_colour)
        self._light("directional", intensity, colour, keys, towards=towards, **disc)

    def camera(
        self,
        eye: Vector3,
        at: Vector3,
        *,
        up: Vector3 = (0.0, 1.0, 0.0),
        fov: float | None = None,
        orthographic: float | None = None,
        keys: Sequence[Key] = (),
    ) -> None:
        """Set the camera: at `eye`, looking to `at`; fov: vertical angle in degrees (40), or the height of parallel rays."""
        view = _given(up=up, fov=fov, orthographic=orthographic, keys=keys or None)
        table = {"from": _plain(eye), "at": _plain(at)} | view
        made = check_item(WHERE, {"camera": table}).camera
        try:
            TomlReader.camera_of(made) if made else None
        except SceneError as error:
            raise SceneError(f"{WHERE}: camera shows nothing: {error}") from None
        self._head["camera"] = table

    def read(self) -> Scene:
        """Make what is rendered of it (`raygrid.load_scene` does). Raises SceneError, as for the first surface."""
        file = checked(Path(WHERE), "", self._document(lambda name: name))
        return TomlReader(Path(WHERE), "", file, dict(self._meshes)).scene()

    def save(self, path: str | Path) -> tuple[str, ...]:
        """Write a scene file, and beside it a PLY file for each mesh, `NAME_mesh_1.ply`; returns all their paths.

        What is read from them has the same bits. Raises OutputError for a path that is none of a .toml or cannot be written,
        SceneError for a scene that cannot be.
        """
        target = Path(path)
        if target.suffix.lower() != ".toml":
            raise OutputMisuse(f"{target}: the file has the suffix {target.suffix!r}, wanted .toml")
        check_path(str(target))
        self.read()
        names = {name: f"{target.stem}_mesh_{number}.ply" for number, name in enumerate(self._meshes, 1)}
        try:
            text = toml_text(self._document(lambda name: names[name])).encode()
        except UnicodeEncodeError:
            raise OutputMisuse(f"{target}: the name is no UTF-8, wanted one that a scene file can refer to") from None
        written = []
        for name, mesh in self._meshes.items():
            beside = str(target.with_name(names[name]))
            write_whole(beside, mesh.write_ply)
            written.append(beside)
        write_whole(str(target), lambda file: file.write(text))
        return str(target), *written

    def _document(self, file_of: Any) -> Table:
        """The tables of a scene file."""
        lists = {name: [dict(row) for row in rows] for name, rows in self._lists.items() if rows}
        for row in lists.get("meshes", ()):
            row["file"] = file_of(row["file"])
        return {**self._head, **{name: dict(rows) for name, rows in self._named.items() if rows}, **lists}

    def _surface(self, kind: str, material: str | None, group: str | None, **values: Any) -> None:
        self._add("surfaces", {"kind": kind} | _given(**values, material=material, group=group))

    def _light(self, kind: str, intensity: float, colour: Vector3, keys: Sequence[Key], **values: Any) -> None:
        light = _given(intensity=intensity, colour=colour, keys=keys or None)
        self._add("lights", {"kind": kind} | _given(**values) | light)

    def _add(self, name: str, table: Table) -> None:
        rows = self._lists[name]
        check_item(WHERE, {name: [table]}, len(rows))
        rows.append(table)

    def _name(self, kind: str, name: str, table: Table) -> str:
        if not isinstance(name, str) or not name:
            raise SceneError(f"{WHERE}: a name of {kind} is {name!r}, wanted text")
        if name in self._named[kind]:
            raise SceneError(f"{WHERE}: {kind}.{name} came twice, wanted it once")
        check_item(WHERE, {kind: {name: table}})
        self._named[kind][name] = table
        return name

    def _set(self, name: str, table: Table) -> None:
        check_item(WHERE, {name: table})
        self._head[name] = table


# Users know it by this name; the tables that are rendered are a Scene to everybody else.
MemoryScene.__name__ = MemoryScene.__qualname__ = "Scene"
MemoryScene.__module__ = "raygrid"


def _given(**values: Any) -> Table:
    """What was given, as plain lists and numbers."""
    return {name: _plain(value) for name, value in values.items() if value is not None}


def _plain(value: Any) -> Any:
    """A value as a scene file has it: numpy's arrays and numbers, and sequences, as lists and numbers."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {{"eye": "from"}.get(key, key): _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, Iterable) and not isinstance(value, str | bytes):
        return [_plain(item) for item in value]
    return value


def _table(values: ArrayLike, what: str, wanted: str) -> NDArray[Any]:
    """An array of numbers of two axes. Raises SceneError for anything else."""
    try:
        table = np.asarray(values)
    except (ValueError, TypeError, OverflowError):
        raise SceneError(f"{what} came with rows of different lengths, wanted {wanted}") from None
    if table.dtype.kind not in "iuf":
        raise SceneError(f"{what} came with the dtype {table.dtype}, wanted {wanted}")
    if table.ndim != 2:
        raise SceneError(f"{what} have the shape {table.shape}, wanted {wanted}")
    return table


def _rows(values: ArrayLike, width: int, what: str, rows: int | None = None) -> F64:
    """A copy as float64 (n, width), of finite numbers. Raises SceneError for anything else."""
    wanted = f"numbers of the shape ({'n' if rows is None else rows}, {width})"
    table = _table(values, what, wanted)
    if table.shape[1] != width or rows not in (None, len(table)):
        raise SceneError(f"{what} have the shape {table.shape}, wanted {wanted}")
    copy = np.array(table, np.float64)
    sound = np.abs(copy) <= MAX_COORDINATE
    if not sound.all():
        row = int(np.argmax(~sound.all(axis=1)))
        raise SceneError(f"{what}[{row}] is {copy[row].tolist()}, wanted finite numbers of at most 1e30")
    return copy


def _faces(values: ArrayLike, what: str, points: int) -> NDArray[np.int64]:
    wanted = "whole numbers of the shape (n, 3), or (n, k) for polygons of k corners"
    table = _table(values, what, wanted)
    if table.dtype.kind not in "iu":
        raise SceneError(f"{what} came with the dtype {table.dtype}, wanted {wanted}")
    if table.shape[1] < 3 or not len(table):
        raise SceneError(f"{what} have the shape {table.shape}, wanted {wanted}")
    wrong = (table < 0) | (table >= points)
    if wrong.any():
        row = int(np.argmax(wrong.any(axis=1)))
        raise SceneError(f"{what}[{row}] is {table[row].tolist()}, wanted numbers from 0 to {points - 1}")
    return table.astype(np.int64)


def _colours(values: ArrayLike, what: str, rows: int) -> Bytes:
    """sRGB bytes, (rows, 3)."""
    wanted = f"uint8, or floats from 0 to 1, of the shape ({rows}, 3) or ({rows}, 4)"
    table = _table(values, what, wanted)
    if table.shape not in ((rows, 3), (rows, 4)):
        raise SceneError(f"{what} have the shape {table.shape}, wanted {wanted}")
    table = table[:, :3]
    whole = table.dtype == np.uint8
    if table.dtype.kind != "f" and not whole:
        raise SceneError(f"{what} came with the dtype {table.dtype}, wanted {wanted}")
    sound = (table >= 0) & (table <= (255 if whole else 1.0))
    if not sound.all():
        row = int(np.argmax(~sound.all(axis=1)))
        raise SceneError(f"{what}[{row}] is {table[row].tolist()}, wanted {wanted}")
    return np.array(table) if whole else np.round(table.astype(np.float64) * 255.0).astype(np.uint8)
