"""Reads PLY, Stanford polygons: text and binary of both byte orders, by plyfile; polygons are cut as those of all formats.

Used of an element vertex: x y z, nx ny nz, red green blue; of face: vertex_indices (or vertex_index), red green blue. Other
elements, and textures, are left out with a remark. What a header says is there is compared with the length of the file
before anything is made for it.
"""

from __future__ import annotations

import io
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.builder import SceneBuilder, plural, shown
from raygrid.host.scene.formats.polygon_mesh import PolygonMesh
from raygrid.host.scene.polygons import Ints
from raygrid.host.scene.textures import Bytes, as_bytes
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64

LISTS = ("vertex_indices", "vertex_index")
RGB, NORMAL = ("red", "green", "blue"), ("nx", "ny", "nz")
END = re.compile(rb"^end_header[ \t]*(\r\n|\n|\r)?", re.MULTILINE)
SIZES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8}
SIZES |= {"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float32": 4, "float64": 8}


class PlyReader:
    """One PLY file on its way into a builder. Raises SceneError with the file."""

    def __init__(self, path: Path, data: bytes, builder: SceneBuilder) -> None:
        self.path, self.builder = path, builder
        self.comments: list[str] = []
        self.elements = self._elements(self._checked(data))

    def read_into(self) -> None:
        """Add all faces as triangles, with the materials that they use."""
        points = self._columns("vertex", ("x", "y", "z"))
        if points is None:
            raise self._error("the vertices have no x, y and z, wanted them")
        corners, starts, faces = self._faces()
        of_faces = self._colours("face")
        PolygonMesh(
            points,
            corners,
            starts,
            self._columns("vertex", NORMAL),
            self._colours("vertex") if of_faces is None else None,
            None if of_faces is None else of_faces[faces],
        ).add_to(self.builder)
        self._remark()

    def _faces(self) -> tuple[Ints, Ints, Ints]:
        """The vertices of all faces, where each face begins, and its number in the file."""
        face = self.elements["face"]
        name = next((name for name in LISTS if name in (face.dtype.names or ())), None)
        if name is None:
            raise self._error(f"the faces have no list {LISTS[0]}, wanted one")
        lists = face[name]
        if lists.dtype != object:  # all of one length
            sizes, flat = np.full(len(lists), lists.shape[1]), np.asarray(lists).reshape(-1)
        else:
            sizes, flat = np.fromiter(map(len, lists), np.int64, len(lists)), np.concatenate(lists)
        kept = sizes >= 3
        if not kept.all():
            self.builder.remarks.append(f"{plural(int((~kept).sum()), 'face')} of fewer than 3 vertices left out")
        corners = flat.astype(np.int64)[np.repeat(kept, sizes)]
        return corners, np.concatenate(([0], np.cumsum(sizes[kept]))).astype(np.int64), np.flatnonzero(kept)

    def _colours(self, element: str) -> Bytes | None:
        """sRGB bytes, (n, 3); None if there are none. Whole numbers fill their type, others go from 0 to 1."""
        columns = self._columns(element, RGB)
        if columns is None:
            return None
        kind = self.elements[element].dtype[RGB[0]]
        full = (
            float(np.iinfo(kind).max)
            if kind.kind in "iu" and kind.itemsize < 4
            else 255.0
            if kind.kind in "iu"
            else 1.0
        )
        return as_bytes(np.nan_to_num(columns) / full)

    def _columns(self, element: str, names: tuple[str, str, str]) -> F64 | None:
        table = self.elements[element]
        if not all(name in (table.dtype.names or ()) and table.dtype[name].kind in "iuf" for name in names):
            return None
        with np.errstate(all="ignore"):
            return np.stack([np.asarray(table[name], np.float64) for name in names], axis=1)

    def _remark(self) -> None:
        remarks = self.builder.remarks
        others = [name for name, table in self.elements.items() if name not in ("vertex", "face") and len(table)]
        if others:
            remarks.append(f"elements left out: {', '.join(others[:5])}" + (" and more" if len(others) > 5 else ""))
        for comment in self.comments:
            key, _, name = comment.strip().partition(" ")
            if key.lower() == "texturefile":
                remarks.append(
                    f"the texture {shown(name.strip())} left out: colours of PLY files are those of vertices and faces"
                )

    # --- the file as tables

    def _checked(self, data: bytes) -> bytes:
        """The file, blank lines left out; raises SceneError unless there may be in it what its header says."""
        found = END.search(data)
        if not re.match(rb"ply\s", data) or found is None:
            raise self._error("this is no PLY file, wanted a header from 'ply' to 'end_header'")
        head, body = data[: found.end()], data[found.end() :]
        counts = self._counts(head)
        if not dict(counts).get("face"):
            raise self._error("the file has no faces, wanted at least one")
        if not re.search(rb"^format\s+ascii\b", head, re.MULTILINE):
            return data
        lines = [line for line in body.replace(b"\r", b"\n").split(b"\n") if line.strip()]
        wanted = sum(count for _, count in counts)
        if len(lines) < wanted:
            raise self._error(f"the file ends after {len(lines)} lines of data, wanted {wanted}")
        last = lines[wanted - 1].split()
        if counts[-1][0] == "face" and self._list_first and last[0].isdigit() and len(last) <= int(last[0][:18]):
            raise self._error(
                f"the file ends inside its last face, after {len(last) - 1} vertices of {int(last[0][:18])}"
            )
        head = b"".join(line.rstrip() + b"\n" for line in head.splitlines())
        return head + b"\n".join(lines) + b"\n"

    def _counts(self, head: bytes) -> list[tuple[str, int]]:
        """The elements, and how many there are of each; raises SceneError for more than the bytes that follow."""
        counts, least = [], []
        for words in (line.split() for line in head.decode("latin-1").splitlines()):
            if len(words) == 3 and words[0] == "element" and words[2].isdigit() and len(words[2]) < 18:
                counts.append((words[1], int(words[2])))
                self._list_first = False
                least.append(0)
            elif words[:1] == ["property"] and counts and len(words) > 2:
                self._list_first = self._list_first or (words[1] == "list" and not least[-1])
                least[-1] += SIZES.get(words[2] if words[1] == "list" else words[1], 1)
        for (name, count), size in zip(counts, least, strict=True):
            if count and not size:
                raise self._error(f"the element {shown(name)} has no properties, wanted at least one")
        self._least = sum(count * size for (_, count), size in zip(counts, least, strict=True))
        return counts

    def _elements(self, data: bytes) -> dict[str, NDArray[Any]]:
        """The tables of all elements by name."""
        from plyfile import PlyData

        found = END.search(data)
        assert found is not None
        text = re.search(rb"^format\s+ascii\b", data[: found.end()], re.MULTILINE) is not None
        if not text and len(data) - found.end() < self._least:
            came = f"{len(data) - found.end()} bytes of data"
            raise self._error(f"the PLY file cannot be read (it has {came}, wanted {self._least} or more)")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # of lists without values, which are no fault
                ply = PlyData.read(io.BytesIO(data)) if text else self._binary(data)
            self.comments = [*ply.comments, *ply.obj_info, *(word for element in ply for word in element.comments)]
            tables = {element.name: element.data for element in ply}
        except Exception as error:  # damaged files raise nearly anything in there
            raise self._error(f"the PLY file cannot be read ({shown(str(error))})") from None
        if not {"vertex", "face"} <= set(tables):
            raise self._error("the file lacks vertices or faces, wanted the elements vertex and face")
        return tables

    def _binary(self, data: bytes) -> Any:
        """Faces of one length are read at once, which needs a file that can be mapped; all others one by one."""
        from plyfile import PlyData, PlyElementParseError

        with os.fdopen(os.memfd_create("ply", os.MFD_CLOEXEC), "w+b") as file:
            file.write(data)
            for length in (3, 4):
                file.seek(0)
                try:
                    ply = PlyData.read(file, known_list_len={"face": dict.fromkeys(LISTS, length)})
                    return PlyData(
                        [_kept(element) for element in ply], ply.text, ply.byte_order, ply.comments, ply.obj_info
                    )
                except PlyElementParseError:
                    continue
        return PlyData.read(_Measured(data))

    def _error(self, message: str) -> SceneError:
        return SceneError(f"{self.path}: {message}")


class _Measured(io.BytesIO):
    """A file of which so many bytes are read: a list whose length is below 0 would take all that is left."""

    def read(self, size: int | None = -1) -> bytes:
        if size is None or size < 0:
            raise ValueError(f"{size} bytes were asked for")
        return super().read(size)


def _kept(element: Any) -> Any:
    """The element out of the mapped file, which is closed afterwards."""
    element.data = np.array(element.data)
    return element
