"""Reads Wavefront OBJ with its MTL files.

Read here and not by trimesh, whose reader (5.2) fits poorly: it drops incomplete lines in silence where a cut file
should be an error with a line number, counts relative indices from the end of the file, cuts concave faces into
overlapping triangles, and gives the faces back in another order.

Used of OBJ: v (with colours), vt, vn, f, usemtl, mtllib; everything else is skipped. Faces of any size become
triangles, SMOOTH if all their corners have normals, else as `smooth_normals` makes them.

Used of MTL: Kd, Ks, Ns, Ni, d or Tr, Tf, illum, map_Kd. How they are mapped to a material stands at `mtl_material`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from raygrid.host.scene.builder import MAX_COORDINATE, SceneBuilder, plural, shown
from raygrid.host.scene.file_access import read_bytes
from raygrid.host.scene.formats.mtl import GREY, WHITE, Mtl, as_text, find_named, read_mtl
from raygrid.host.scene.polygons import Ints
from raygrid.host.scene.textures import Bytes, as_bytes, bake
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, Kind

NO_CORNER = (-(2**40), 0, 0)  # further from the end than any file is long
COMMENT = re.compile(rb"#[^\n]*")


@dataclass
class _Lines:
    """The lines of one keyword: what came after it, and where."""

    rest: list[bytes] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)


class ObjReader:
    """One OBJ file on its way into a builder. Raises SceneError with file and line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.libraries: list[bytes] = []
        self.material_names: dict[bytes, int] = {b"": 0}
        self._lines = {key: _Lines() for key in (b"v", b"vt", b"vn", b"f")}
        self._face_materials: list[int] = []
        self._counts_at: dict[int, tuple[int, int, int]] = {}  # face: how many v, vt, vn came before it, if it matters
        self._split(read_bytes(path))

    def read_into(self, builder: SceneBuilder) -> None:
        """Add all triangles and the materials that they use."""
        if not self._lines[b"f"].rest:
            raise SceneError(f"{self.path}: the file has no faces, wanted at least one")
        points, colours = self._points()
        corners, starts = self._corners(len(points))
        rows, owner = builder.triangulate(points[corners[:, 0]], starts)
        used = corners[rows]  # (t, 3, 3): triangle, corner, indices into v, vt, vn
        data = points[used[..., 0]].reshape(-1, 9)
        materials = self._materials(builder, used, np.array(self._face_materials, np.int64)[owner], colours)
        smooth = (used[..., 2] >= 0).all(axis=1)
        order = np.arange(len(data))
        if smooth.any():
            normals = self._table(b"vn", 3)[used[smooth, :, 2]].reshape(-1, 9)
            both = np.concatenate((data[smooth], normals), axis=1)
            builder.add(Kind.SMOOTH, both, materials[smooth], order[smooth])
        builder.add_facets(data[~smooth], materials[~smooth], order[~smooth])

    def _split(self, text: bytes) -> None:
        text = COMMENT.sub(b"", text.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n"))
        v, vt, vn, faces = (self._lines[key] for key in (b"v", b"vt", b"vn", b"f"))
        current = 0
        # A line ended by a backslash goes on in the next one; the numbers of the lines after it are then too small.
        for number, line in enumerate(text.replace(b"\\\n", b" ").split(b"\n"), 1):
            key, *rest = line.split(None, 1) or (b"",)
            after = rest[0] if rest else b""
            kept = self._lines.get(key)
            if kept is not None:
                kept.rest.append(after)
                kept.numbers.append(number)
                if kept is faces:
                    self._face_materials.append(current)
                    if b"-" in after:
                        self._counts_at[len(faces.rest) - 1] = (len(v.rest), len(vt.rest), len(vn.rest))
            elif key == b"usemtl":
                current = self.material_names.setdefault(after.strip(), len(self.material_names))
            elif key == b"mtllib":
                self.libraries.append(after.strip())

    def _table(self, key: bytes, width: int) -> F64:
        """The first `width` numbers of every line of a keyword, (n, width)."""
        lines = self._lines[key]
        rows = [rest.split()[:width] for rest in lines.rest]
        for k, row in enumerate(rows):
            if len(row) < width:
                came = f"came {key.decode()} with {plural(len(row), 'number')}"
                raise self._error(lines.numbers[k], f"{came}, wanted {width}")
        numbers = self._floats(chain.from_iterable(rows), len(rows) * width)
        if numbers is None or not _fit(numbers):
            k = next(k for k, row in enumerate(rows) if not _fit(self._floats(row, width)))
            came = shown(lines.rest[k].decode("latin-1").strip())
            raise self._error(lines.numbers[k], f"came {came}, wanted finite numbers of at most 1e30")
        return numbers.reshape(-1, width)

    def _floats(self, words: Iterable[bytes], count: int) -> F64 | None:
        try:
            return np.fromiter(map(float, words), np.float64, count)
        except ValueError:
            return None

    def _points(self) -> tuple[F64, Bytes | None]:
        """Vertices, (n, 3), and their colours as sRGB bytes if all have some."""
        lines = self._lines[b"v"]
        if lines.rest and all(len(rest.split()) >= 6 for rest in lines.rest):
            table = self._table(b"v", 6)
            return table[:, :3], as_bytes(table[:, 3:])
        return self._table(b"v", 3), None

    def _corners(self, points: int) -> tuple[Ints, Ints]:
        """Each corner's rows of v, vt and vn, (c, 3), -1 where it has none, and where each face begins."""
        faces = self._lines[b"f"]
        words = [rest.split() for rest in faces.rest]
        sizes = np.fromiter(map(len, words), np.int64, len(words))
        if (sizes < 3).any():
            k = int(np.argmax(sizes < 3))
            raise self._error(
                faces.numbers[k], f"came a face with {plural(int(sizes[k]), 'corner')}, wanted at least 3"
            )
        starts = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        # Most corners occur several times: read each once.
        known: dict[bytes, int] = {}
        index = np.fromiter((known.setdefault(word, len(known)) for word in chain(*words)), np.int64, int(starts[-1]))
        corners = np.array([self._corner(word) for word in known], np.int64)[index]
        for k, counts in self._counts_at.items():
            face = corners[starts[k] : starts[k + 1]]
            np.add(face, np.array(counts) + 1, out=face, where=face < 0)
        limits = (points, len(self._lines[b"vt"].rest), len(self._lines[b"vn"].rest))
        wrong = (corners < 0) | (corners > limits) | (corners[:, :1] == 0)
        if wrong.any():
            c = int(np.argmax(wrong.any(axis=1)))
            k = int(np.searchsorted(starts, c, side="right")) - 1
            wanted = f"the file has {points} v, {limits[1]} vt and {limits[2]} vn"
            came = shown(words[k][c - starts[k]].decode("latin-1"))
            raise self._error(faces.numbers[k], f"came the corner {came}, but {wanted}")
        return corners - 1, starts

    def _corner(self, word: bytes) -> tuple[int, int, int]:
        """The numbers of `v`, `v/vt`, `v//vn` or `v/vt/vn`; 0 where there is none, NO_CORNER for what is no number."""
        parts = word.split(b"/")
        try:
            v, vt, vn = (*(int(part) if part else 0 for part in parts), 0, 0)[:3]
        except ValueError:
            return NO_CORNER
        return (v, vt, vn) if len(parts) <= 3 and max(map(abs, (v, vt, vn))) < 2**40 else NO_CORNER

    def _materials(self, builder: SceneBuilder, used: Ints, names: Ints, colours: Bytes | None) -> Ints:
        """The material of every triangle. names: (t,), numbers of `material_names`."""
        library = self._library(builder)
        numbers = np.zeros(len(used), np.int64)
        missing = []
        for name, k in self.material_names.items():
            mine = np.flatnonzero(names == k)
            if not len(mine):
                continue
            mtl = library.get(name)
            if mtl is None and name:
                missing.append(as_text(name))
            tints = self._tints(mtl, used[mine], colours)
            row = mtl.row if mtl is not None else GREY if tints is None else WHITE
            rows, index = (row, np.zeros(1, np.int64)) if tints is None else bake(row, tints)
            called = as_text(name)
            numbers[mine] = builder.add_materials(rows, baked=tints is not None, names=called) + index
        if missing and library:
            builder.remarks.append(f"grey used for unknown materials: {', '.join(missing[:5])}")
        return numbers

    def _tints(self, mtl: Mtl | None, used: Ints, colours: Bytes | None) -> Bytes | None:
        """Colours of triangles by texture, else by their vertices, else None."""
        if mtl is not None and mtl.texture is not None and self._lines[b"vt"].rest:
            table = np.concatenate((self._table(b"vt", 2), ((0.0, 0.0),)))  # -1, no coordinate, takes the last row
            u, v = np.moveaxis(table[used[..., 1]], 2, 0)
            return mtl.texture.under(np.stack((u, 1.0 - v), axis=2))  # OBJ has (0, 0) at the lower left
        if mtl is None and colours is not None:
            return np.asarray(np.round(colours[used[..., 0]].mean(axis=1)), np.uint8)
        return None

    def _library(self, builder: SceneBuilder) -> dict[bytes, Mtl]:
        library: dict[bytes, Mtl] = {}
        for names in self.libraries:
            several = names.split()
            files = [names] if len(several) < 2 else [names, *several]  # a name with blanks, else several names
            for name in files if names else ():
                file, data = find_named(self.path, name)
                if data is not None:
                    library.update(read_mtl(file, data, builder.remarks))
                    if name is names:
                        break
                elif name is not names or len(files) == 1:
                    builder.remarks.append(f"the material file {file.name} is missing: grey used")
        return library

    def _error(self, line: int, message: str) -> SceneError:
        return SceneError(f"{self.path}, line {line}: {message}")


def _fit(numbers: F64 | None) -> bool:
    return numbers is not None and bool((np.abs(numbers) <= MAX_COORDINATE).all())
