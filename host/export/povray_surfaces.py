"""Writes surfaces and materials in POV-Ray's language, for `export`.

Triangles become meshes (`mesh2`), everything else the primitive of the same name. POV-Ray decides whether a ray enters
a body or leaves it by remembering the bodies that it is in, so all flat surfaces, cones and meshes of one transparent
material share one interior, and each transparent sphere is a body of its own. In POV-Ray transparent surfaces let
light through; here they do not, so each has an opaque twin that only throws shadows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, Batch, Kind, SurfaceSet

MOST = 0.999  # transmission above which the diffuse part, given by what is left of 1, would lose its precision
MOST_NESTED = 10_000  # transparent spheres that are looked at for which is in which
SKIN = "texture {{ M{0} }}"
CHUNK = 50_000  # rows that are turned into text at a time


def vector(values: Sequence[float] | NDArray[np.floating], scale: float = 1.0, digits: int = 12) -> str:
    """`<x,y,z>`, each number times `scale`."""
    x, y, z = (float(value) * scale for value in values)
    return f"<{x:.{digits}g},{y:.{digits}g},{z:.{digits}g}>"


class MaterialWriter:
    """The materials of a scene as textures M0, M1, ..."""

    def __init__(self, materials: NDArray[np.void], highlights: bool) -> None:
        self._materials, self._highlights = materials, highlights
        self.transparent: NDArray[np.bool_] = np.any(materials["transmission"] > 0.0, axis=1)

    def differences(self, surfaces: SurfaceSet) -> Iterator[str]:
        """Tell what POV-Ray cannot do of the materials that are used."""
        rows = self._materials[self._used(surfaces)]
        mirrors, clear = rows["specular"].any(axis=1), rows["transmission"].any(axis=1)
        if self._highlights and np.any(np.ptp(rows["highlight"], axis=1) > 0.0):
            yield "highlights are grey; those of coloured weight have the mean of the three."
        if np.any(mirrors & clear):
            yield "at total internal reflection, which takes the refracted ray's place, POV-Ray drops the mirror's ray."
        if clear.any():
            yield "a ray enters or leaves a transparent body by what it is in already, not by the side it comes from:"
            yield "  bodies that overlap, single sheets, and what is nested but no sphere in a sphere, bend otherwise."

    def lines(self, surfaces: SurfaceSet) -> Iterator[str]:
        """The declarations of the textures that are used."""
        yield "#declare Clear = texture { pigment { rgbt 1 } finish { diffuse 0 } }"
        yield "#declare Black = texture { pigment { rgb 0 } }"
        for number in self._used(surfaces).tolist():
            yield f"#declare M{number} = {self._texture(self._materials[number])}"

    def iors(self, numbers: NDArray[np.integer]) -> F64:
        """The index of refraction of each of the materials."""
        return np.asarray(self._materials["ior"][numbers], np.float64)

    def _used(self, surfaces: SurfaceSet) -> NDArray[np.uint16]:
        return np.unique(np.concatenate([batch.materials for batch in surfaces]))

    def _texture(self, row: np.void) -> str:
        """POV-Ray takes from the diffuse part what the pigment lets through, so it is made larger by as much."""
        through = float(row["transmission"].max())
        layer = min(through, MOST)
        pigment = f"rgb {vector(row['diffuse'])}" + (f" transmit {layer:.12g}" if through else "")
        finish = f"diffuse {1.0 / (1.0 - layer):.12g}"
        if row["specular"].any():
            finish += f" reflection {{ rgb {vector(row['specular'])} }}"
        shine = float(row["highlight"].mean()) if self._highlights else 0.0
        if shine > 0.0:
            finish += f" phong {shine:.12g} phong_size {row['shine']:.12g}"
        texture = f"texture {{ pigment {{ {pigment} }} finish {{ {finish} }} }}"
        filtered = row["transmission"] / layer if through else row["transmission"]
        if through and np.any(filtered != 1.0):  # what is below filters what the upper layer lets through
            return f"texture {{ pigment {{ rgb {vector(filtered)} filter 1 }} finish {{ diffuse 0 }} }} {texture}"
        return texture


def surface_lines(surfaces: SurfaceSet, materials: MaterialWriter, scale: float) -> Iterator[str]:
    """All surfaces: the opaque ones, then material by material the transparent ones and their opaque twins."""
    for batch in surfaces:
        yield from _some(batch, ~materials.transparent[batch.materials], scale, SKIN, "")
    for number in np.flatnonzero(materials.transparent).tolist():
        yield from _shared(surfaces, number, float(materials.iors(np.array([number]))[0]), scale)
    for batch in surfaces:
        clear = materials.transparent[batch.materials]
        if batch.kind == Kind.SPHERE and clear.any():
            balls = batch.select(clear)
            for k, ior in enumerate(_nested(balls.data.astype(np.float64), materials.iors(balls.materials)).tolist()):
                words = f"interior {{ ior {ior:.12g} }} no_shadow"
                yield from _spheres(balls.select(np.array([k])), scale, SKIN, words)
        yield from _some(batch, clear, scale, "texture {{ Black }}", "no_image no_reflection")


def _shared(surfaces: SurfaceSet, number: int, ior: float, scale: float) -> Iterator[str]:
    """All surfaces of a transparent material but its spheres, with one interior."""
    chosen = [(batch, batch.materials == number) for batch in surfaces if batch.kind != Kind.SPHERE]
    objects = sum(np.count_nonzero(rows) if batch.kind in WRITERS else int(rows.any()) for batch, rows in chosen)
    interior = f"interior {{ ior {ior:.12g} }}"
    if objects > 1:
        yield "union {"
    for batch, rows in chosen:
        yield from _some(batch, rows, scale, SKIN, "no_shadow" if objects > 1 else f"{interior} no_shadow")
    if objects > 1:
        yield f"  {interior} split_union on }}"


def _nested(balls: F64, iors: F64) -> F64:
    """Indices of refraction of spheres (n, 4) as POV-Ray has them: against vacuum, not against the sphere around."""
    total = iors.copy()
    if len(balls) <= MOST_NESTED:
        for ball, ior in zip(balls, iors, strict=True):
            reach = np.linalg.norm(balls[:, :3] - ball[:3], axis=1) + np.abs(balls[:, 3])
            total[(reach <= abs(ball[3])) & np.any(balls != ball, axis=1)] *= ior
    return total


def _some(batch: Batch, rows: NDArray[np.bool_], scale: float, texture: str, words: str) -> Iterator[str]:
    """The chosen surfaces. `texture`: a format of the material's number; `words` go into each surface."""
    if rows.any():
        if not isinstance(batch.kind, Kind):
            raise SceneError("surfaces of a program came, wanted a scene without them: POV-Ray does not know them")
        yield from WRITERS.get(batch.kind, _mesh)(batch.select(rows), scale, texture, words)


def _skin(texture: str, number: int, inside_only: bool) -> str:
    """The texture of a round surface; one of negative radius shows on its inside only."""
    named = texture.format(number)
    return f"texture {{ Clear }} interior_{named}" if inside_only else named


def _spheres(batch: Batch, scale: float, texture: str, words: str) -> Iterator[str]:
    for row, number in zip(batch.data.tolist(), batch.materials.tolist(), strict=True):
        radius = abs(row[3]) * scale
        yield f"sphere {{ {vector(row[:3], scale)}, {radius:.12g} {_skin(texture, number, row[3] < 0.0)} {words} }}"


def _cones(batch: Batch, scale: float, texture: str, words: str) -> Iterator[str]:
    for row, number in zip(batch.data.tolist(), batch.materials.tolist(), strict=True):
        base, apex, low, high = vector(row[:3], scale), vector(row[4:7], scale), abs(row[3]), abs(row[7])
        skin = _skin(texture, number, min(row[3], row[7]) < 0.0)
        if batch.kind == Kind.CYLINDER:
            yield f"cylinder {{ {base}, {apex}, {low * scale:.12g} open {skin} {words} }}"
        else:
            yield f"cone {{ {base}, {low * scale:.12g}, {apex}, {high * scale:.12g} open {skin} {words} }}"


def _polygons(batch: Batch, scale: float, texture: str, words: str) -> Iterator[str]:
    """POV-Ray wants polygons closed: the first point comes again."""
    for k, number in enumerate(batch.materials.tolist()):
        points = batch.data[batch.starts[k] : batch.starts[k + 1]] * scale
        closed = ",".join(_rows(np.vstack((points, points[:1]))))
        yield f"polygon {{ {len(points) + 1}, {closed} {texture.format(number)} {words} }}"


WRITERS = {Kind.SPHERE: _spheres, Kind.CYLINDER: _cones, Kind.CONE: _cones, Kind.POLYGON: _polygons}


def _mesh(batch: Batch, scale: float, texture: str, words: str) -> Iterator[str]:
    """All triangles in one mesh; equal vertices are written once."""
    used, skins = np.unique(batch.materials, return_inverse=True)
    points, faces = _distinct(batch.data[:, :9].astype(np.float64) * scale)
    yield "mesh2 {"
    yield from _list("vertex_vectors", _rows(points))
    if batch.kind == Kind.SMOOTH:
        normals, turned = _distinct(batch.data[:, 9:].astype(np.float64))
        yield from _list("normal_vectors", _rows(normals))
    yield from _list("texture_list", [texture.format(number) for number in used.tolist()], " ")
    yield from _list("face_indices", _rows(np.column_stack((faces, skins)), "<%d,%d,%d>,%d"))
    if batch.kind == Kind.SMOOTH:
        yield from _list("normal_indices", _rows(turned, "<%d,%d,%d>"))
    yield f"  {words} }}"


def _distinct(rows: F64) -> tuple[F64, NDArray[np.intp]]:
    """Distinct points of triangles (n, 9), and for each triangle which three of them it has, (n, 3)."""
    points, which = np.unique(rows.reshape(-1, 3), axis=0, return_inverse=True)
    return points, which.reshape(-1, 3)


def _rows(table: NDArray[np.generic], form: str = "<%.12g,%.12g,%.12g>") -> list[str]:
    """Each row of a table as text. All rows of a chunk are formatted at once, which is five times as fast."""
    texts: list[str] = []
    for first in range(0, len(table), CHUNK):
        chunk = table[first : first + CHUNK]
        texts += ("\n".join([form] * len(chunk)) % tuple(chunk.ravel().tolist())).split("\n")
    return texts


def _list(name: str, items: list[str], between: str = ",") -> Iterator[str]:
    """`name { count, item, item, ... }`, eight items a line."""
    yield f"  {name} {{ {len(items)},"
    for first in range(0, len(items), 8):
        end = between if first + 8 < len(items) else ""
        yield "   " + between.join(items[first : first + 8]) + end
    yield "  }"
