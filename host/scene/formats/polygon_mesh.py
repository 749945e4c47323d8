"""Holds a mesh of polygons as arrays, adds it to a builder, and writes it as a PLY file that reads as the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.builder import SceneBuilder
from raygrid.host.scene.formats.mtl import GREY, WHITE
from raygrid.host.scene.polygons import Ints
from raygrid.host.scene.textures import Bytes, bake
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, Kind


@dataclass(frozen=True)
class PolygonMesh:
    """A mesh whose polygons may have any number of corners each.

    points    float64 (p, 3)
    corners   rows of the points, of all polygons one after the other, int64 (c,)
    starts    where each polygon begins in the corners, and where the last one ends, int64 (n + 1,)
    normals   of the points, float64 (p, 3); None: smooth by a crease
    colours   of the points, sRGB bytes (p, 3); of_faces: of the polygons, (n, 3); None: grey
    uv        texture coordinates of the points, float64 (p, 2); kept for when textures are more than baked
    """

    points: F64
    corners: Ints
    starts: Ints
    normals: F64 | None = None
    colours: Bytes | None = None
    of_faces: Bytes | None = None
    uv: F64 | None = None

    def add_to(self, builder: SceneBuilder) -> None:
        """Add the polygons as triangles. Raises SceneError for a corner that is no point."""
        points, corners = self.points, self.corners
        if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
            wrong = corners[(corners < 0) | (corners >= len(points))][0]
            wanted = f"numbers from 0 to {len(points) - 1}" if len(points) else "vertices"
            raise SceneError(f"{builder.where}: a face has the vertex {int(wrong)}, wanted {wanted}")
        with np.errstate(all="ignore"):  # numbers that are not finite are refused by name, where they are taken
            rows, owner = builder.triangulate(points[corners], self.starts)
        used = corners[rows]
        materials = self._materials(builder, used, owner)
        data = points[used].reshape(-1, 9)
        if self.normals is None:
            builder.add_facets(data, materials)
        else:
            normals = self.normals[used].reshape(-1, 9)
            builder.add(Kind.SMOOTH, np.concatenate((data, normals), axis=1), materials)

    def _materials(self, builder: SceneBuilder, used: Ints, faces: Ints) -> Ints:
        """The material of each triangle: by the colour of its face, else by those of its points, else grey."""
        if self.of_faces is not None:
            tints = self.of_faces[faces]
        elif self.colours is not None:
            tints = np.round(self.colours[used].mean(axis=1)).astype(np.uint8)
        else:
            return np.full(len(used), builder.add_materials(GREY))
        rows, index = bake(WHITE, tints)
        return builder.add_materials(rows, baked=True) + index

    def write_ply(self, file: BinaryIO) -> None:
        """Write a binary PLY file, with all digits."""
        columns: list[tuple[str, str, NDArray[np.generic]]] = [
            (n, "<f8", self.points[:, k]) for k, n in enumerate("xyz")
        ]
        if self.normals is not None:
            columns += [(f"n{n}", "<f8", self.normals[:, k]) for k, n in enumerate("xyz")]
        if self.uv is not None:
            columns += [(n, "<f8", self.uv[:, k]) for k, n in enumerate("st")]
        vertices = _with_colours(columns, self.colours, len(self.points))
        sizes = np.diff(self.starts)
        same = bool(len(sizes) and (sizes == sizes[0]).all())
        head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(self.points)}"]
        head += [f"property {TYPES[kind[1:]]} {name}" for name, kind in _fields(vertices)]
        head += [f"element face {len(sizes)}", "property list uint int vertex_indices"]
        head += [f"property uchar {name}" for name in RGB] if self.of_faces is not None else []
        file.write("\n".join([*head, "end_header", ""]).encode())
        file.write(vertices.tobytes())
        for first, end in [(0, len(sizes))] if same else [(k, k + 1) for k in range(len(sizes))]:
            file.write(self._faces(first, end).tobytes())

    def _faces(self, first: int, end: int) -> NDArray[np.void]:
        """Faces of one length as a PLY file has them."""
        size = int(self.starts[first + 1] - self.starts[first])
        layout: list[tuple[str, str] | tuple[str, str, tuple[int]]] = [("size", "<u4"), ("corners", "<i4", (size,))]
        layout += [(name, "u1") for name in RGB] if self.of_faces is not None else []
        table = np.zeros(end - first, np.dtype(layout))
        table["size"], table["corners"] = size, self.corners[self.starts[first] : self.starts[end]].reshape(-1, size)
        for k, name in enumerate(RGB if self.of_faces is not None else ()):
            assert self.of_faces is not None
            table[name] = self.of_faces[first:end, k]
        return table


RGB = ("red", "green", "blue")
TYPES = {"f8": "double", "u1": "uchar"}


def _with_colours(
    columns: list[tuple[str, str, NDArray[np.generic]]], colours: Bytes | None, rows: int
) -> NDArray[np.void]:
    if colours is not None:
        columns = columns + [(name, "|u1", colours[:, k]) for k, name in enumerate(RGB)]
    table = np.zeros(rows, np.dtype([(name, kind) for name, kind, _ in columns]))
    for name, _, values in columns:
        table[name] = values
    return table


def _fields(table: NDArray[np.void]) -> list[tuple[str, str]]:
    return [(name, table.dtype[name].str) for name in table.dtype.names or ()]
