"""Collects surfaces and materials for all readers, and enforces the rules that every scene must meet."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raygrid.host.scene.linear_algebra import lengths
from raygrid.host.scene.polygons import (
    Ints,
    convex_polygons,
    extents,
    flat_polygons,
    flat_triangles,
    planar_polygons,
    select_polygons,
    triangulate,
)
from raygrid.host.scene.smooth_normals import CREASE, MOST_SMOOTHED, crease_for, smooth_normals
from raygrid.node.errors import SceneError
from raygrid.node.geometry import (
    F64,
    MAX_MATERIALS,
    MAX_SURFACES,
    STRIDE,
    AnyKind,
    Batch,
    Kind,
    SurfaceSet,
    merge,
    rounded,
)
from raygrid.node.protocol import MATERIAL_RECORD

Table = NDArray[np.void]

# Glass of diamond has 2.4, germanium 4, gold 0.2. Beyond these bounds nothing is known, and refraction loses its digits:
# the direction is a difference of numbers as large as the index.
LEAST_IOR, MOST_IOR = 0.001, 1000.0
IORS = f"{LEAST_IOR:g} to {MOST_IOR:g}"
# Coordinates beyond this are refused: areas are squared lengths and are squared again, which must not overflow.
MAX_COORDINATE = 1e30
# Of all surfaces together, 2 GiB as they are read: 29 million triangles. One mesh may be placed thousands of times.
MOST_NUMBERS = 1 << 28
# Cutting takes time by the square of the corners, seconds by then; and every ray that comes near looks at all of them.
MOST_CORNERS = 5_000
# Vertices of polygons may leave the plane by this part of half the scene's longest edge, which is 1/2 to 1 in machine
# coordinates. Cells retain what comes within four times this (lattice.SLACK) of them: a polygon bent further could be
# missed in one of them.
MOST_BENT = 2.0**-19
# Of polygons that will move and grow, by this part of their own extent: that may come to 4 in machine coordinates.
MOST_BENT_MOVING = 2.0**-21


def plural(count: int, noun: str) -> str:
    """`1 triangle`, `3 triangles`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def material(
    diffuse: ArrayLike = 0.0,
    highlight: ArrayLike = 0.0,
    shine: float = 0.0,
    specular: ArrayLike = 0.0,
    transmission: ArrayLike = 0.0,
    ior: float = 1.0,
) -> Table:
    """One row of a material table, MATERIAL_RECORD (1,). Weights are linear, a number each or three."""
    row = np.zeros(1, MATERIAL_RECORD)
    row["diffuse"], row["highlight"], row["shine"] = diffuse, highlight, shine
    row["specular"], row["transmission"] = specular, transmission
    # An index that is never used would only keep equal materials apart.
    row["ior"] = ior if row["transmission"].any() else 1.0
    return row


class SceneBuilder:
    """Collects surfaces and materials, and makes the tables of a scene from them.

    Surfaces come with an order number each, by default a running one; ids follow the order numbers, and among equal
    ones the sequence of the calls. Triangles and polygons without area are dropped and counted.
    """

    def __init__(self, where: str) -> None:
        """`where` begins every message: the file's path."""
        self.where = where
        self.remarks: list[str] = []
        self._batches: list[tuple[AnyKind, F64, Ints, Ints, Ints]] = []  # kind, data, materials, order, starts
        self._materials: list[Table] = []
        self._baked: list[bool] = []
        self._apart: list[bool] = []
        self._names: list[str] = []  # of each material given, "" for none
        self._moving: list[tuple[int, int]] = []  # order numbers, first and end
        self.orders: Ints = np.zeros(0, np.int64)  # of each id, once finished
        # of each material given its row of the table, -1: not used, once finished
        self.share: Ints = np.zeros(0, np.int64)
        self._next = 0
        self._numbers = 0
        self._dropped = {"triangle": 0, "polygon": 0}
        self._bent = 0  # polygons that were not planar
        self._crossing = 0  # polygons that could be cut into triangles only by guess

    def add_materials(
        self, rows: Table, baked: bool = False, apart: bool = False, names: str | Sequence[str] = ""
    ) -> int:
        """Take materials, MATERIAL_RECORD (m,); returns the number of the first. `baked`: from a texture's colours, so that
        they may be rounded if there are too many. `apart`: they change, and are never one with equal ones. `names`: of each
        in the file, or one of all; "" for none."""
        if not all(np.isfinite(rows[name]).all() and (rows[name] >= 0.0).all() for name in MATERIAL_RECORD.names or ()):
            raise SceneError(f"{self.where}: a material has a number that is not finite or below 0")
        wild = rows["transmission"].any(axis=1) & ((rows["ior"] < LEAST_IOR) | (rows["ior"] > MOST_IOR))
        if wild.any():
            came = f"{rows['ior'][np.argmax(wild)]:g}"
            raise SceneError(f"{self.where}: a material has the index of refraction {came}, wanted {IORS}")
        first = sum(len(part) for part in self._materials)
        self._materials.append(rows)
        self._baked.append(baked)
        self._apart.append(apart)
        self._names += [names] * len(rows) if isinstance(names, str) else names
        return first

    def let_move(self, first: int, end: int) -> None:
        """Say that surfaces of order numbers first <= n < end move: their polygons must be flatter than others."""
        self._moving.append((first, end))

    def add(self, kind: AnyKind, data: F64, materials: ArrayLike, order: Ints | None = None) -> None:
        """Take surfaces of any kind but polygons: data (n, STRIDE[kind]), materials (n,) or one number for all."""
        if kind in (Kind.TRIANGLE, Kind.SMOOTH):
            keep = ~flat_triangles(self._checked(data)[:, :9].reshape(-1, 3, 3))
            if not keep.all():
                self._dropped["triangle"] += int(np.count_nonzero(~keep))
                data, order = data[keep], None if order is None else order[keep]
                materials = np.broadcast_to(materials, keep.shape)[keep]
        if kind == Kind.SMOOTH:
            data = _with_unit_normals(data)
        self._take(kind, data, materials, order, len(data), np.zeros(0, np.int64))

    def add_facets(self, data: F64, materials: ArrayLike, order: Ints | None = None, crease: float = CREASE) -> None:
        """Take the triangles of a mesh without normals, (n, 9), smooth across edges that bend by no more degrees than the
        crease, or than the one that is asked for (`smooth_normals.crease_for`). Of too many all stay flat, with a remark."""
        order = np.arange(self.next_order, self.next_order + len(data)) if order is None else order
        every, angle = np.broadcast_to(materials, order.shape), crease_for(crease)
        if angle > 0.0 and len(data) > MOST_SMOOTHED:
            self.remarks.append(
                f"{len(data):,} triangles stay flat: only up to {MOST_SMOOTHED:,} of a mesh are made smooth"
            )
            angle = 0.0
        normals, bent = smooth_normals(self._checked(data).reshape(-1, 3, 3), angle)
        self.add(Kind.TRIANGLE, data[~bent], every[~bent], order[~bent])
        if bent.any():
            both = np.concatenate((data[bent], normals[bent].reshape(-1, 9)), axis=1)
            self.add(Kind.SMOOTH, both, every[bent], order[bent])

    def add_polygons(self, points: F64, starts: Ints, materials: ArrayLike, order: Ints | None = None) -> None:
        """Take polygons: points (p, 3), starts (n + 1,) as in a Batch, materials (n,) or one number for all.

        Triangles become TRIANGLE. What is not planar is cut into triangles along its own vertices and remarked:
        refusing it would lose scenes that other programs show, keeping it would lose hits beside its plane.
        """
        self._checked(points)
        sizes = np.diff(starts)
        every = np.broadcast_to(materials, sizes.shape)
        order = np.arange(self.next_order, self.next_order + len(sizes)) if order is None else order
        three, flat = sizes == 3, flat_polygons(points, starts)
        kept = ~three & ~flat
        self._dropped["polygon"] += int(np.count_nonzero(flat & ~three))
        corners = points[np.repeat(three, sizes)].reshape(-1, 9)
        self.add(Kind.TRIANGLE, corners, every[three], order[three])
        self._check_corners(sizes[kept], "that is not cut into triangles")
        chosen, begins = select_polygons(points, starts, kept)
        self._take(Kind.POLYGON, chosen, every[kept], order[kept], len(begins) - 1, begins)

    def triangulate(self, points: F64, starts: Ints) -> tuple[Ints, Ints]:
        """`polygons.triangulate`, with a remark on what could be cut only by guess; raises SceneError for what is
        not convex and has more corners than can be cut in reasonable time."""
        self._check_corners(np.diff(starts)[~convex_polygons(points, starts)], "that is not convex")
        rows, owner, crossing = triangulate(points, starts)
        self._crossing += crossing
        return rows, owner

    def _check_corners(self, sizes: Ints, which: str) -> None:
        if sizes.max(initial=0) > MOST_CORNERS:
            came = f"a polygon {which} has {int(sizes.max()):,} corners"
            raise SceneError(f"{self.where}: {came}, wanted at most {MOST_CORNERS:,}")

    @property
    def next_order(self) -> int:
        """An order number after all that were used."""
        return self._next

    def finish(self) -> tuple[SurfaceSet, Table, tuple[str, ...]]:
        """Surfaces, materials and remarks. Raises SceneError without surfaces, or with too many of anything."""
        self._cut_bent()
        remarks = self._counted()
        order = np.concatenate([batch[3] for batch in self._batches] or [np.zeros(0, np.int64)])
        if not len(order):
            dropped = sum(self._dropped.values())
            came = f"only {plural(dropped, 'surface')} without area" if dropped else "no surfaces"
            raise SceneError(f"{self.where}: the file has {came}, wanted at least one surface")
        if len(order) > MAX_SURFACES:
            raise SceneError(f"{self.where}: the file has {len(order)} surfaces, wanted at most {MAX_SURFACES}")
        ids = np.empty(len(order), np.uint32)
        ids[np.argsort(order, kind="stable")] = np.arange(len(order), dtype=np.uint32)
        table, share = self._shared_materials(remarks)
        self.orders = np.sort(order, kind="stable")
        made, begin = [], 0
        for kind, data, materials, _, starts in self._batches:
            end = begin + (len(starts) - 1 if kind == Kind.POLYGON else len(data))
            made.append(Batch(kind, ids[begin:end], share[materials].astype(np.uint16), data, starts))
            begin = end
        return SurfaceSet(tuple(_in_order(batch) for batch in merge(made))), table, (*self.remarks, *remarks)

    def material_names(self, many: int) -> tuple[str, ...]:
        """What each of the `many` rows of the table is called in the file, once finished: those that were equal and became
        one have all names, in order; "" for none."""
        found: list[dict[str, None]] = [{} for _ in range(many)]
        for name, row in zip(self._names, self.share.tolist(), strict=True):
            if name and row >= 0:
                found[row][name] = None
        return tuple(", ".join(names) for names in found)

    def _cut_bent(self) -> None:
        """Cut the polygons that are not planar into triangles; only now is it known how large the scene is."""
        batches, self._batches = self._batches, []
        polygons = [batch for batch in batches if batch[0] == Kind.POLYGON]
        self._batches = [batch for batch in batches if batch[0] != Kind.POLYGON]
        most = MOST_BENT * _half_extent(batches) if polygons else 0.0
        for kind, points, materials, order, starts in polygons:
            limit = np.full(len(order), most)
            for first, end in self._moving:
                mine = (order >= first) & (order < end)
                limit[mine] = np.minimum(limit, MOST_BENT_MOVING * extents(points, starts))[mine]
            bent = ~planar_polygons(points, starts, limit)
            if not bent.any():
                self._batches.append((kind, points, materials, order, starts))
                continue
            chosen, begins = select_polygons(points, starts, ~bent)
            self._take(kind, chosen, materials[~bent], order[~bent], len(begins) - 1, begins)
            chosen, begins = select_polygons(points, starts, bent)
            rows, owner = self.triangulate(chosen, begins)
            self.add(Kind.TRIANGLE, chosen[rows].reshape(-1, 9), materials[bent][owner], order[bent][owner])
            self._bent += len(begins) - 1

    def _counted(self) -> list[str]:
        """Remarks on what was counted."""
        remarks = [f"{plural(n, noun)} without area dropped" for noun, n in self._dropped.items() if n]
        if self._bent:
            remarks.append(f"{plural(self._bent, 'polygon')} cut into triangles, being not planar")
        if self._crossing:
            remarks.append(f"{plural(self._crossing, 'polygon')} cut into triangles by guess, crossing its own edges")
        return remarks

    def _take(self, kind: AnyKind, data: F64, materials: ArrayLike, order: Ints | None, n: int, starts: Ints) -> None:
        if order is None:
            order = np.arange(self._next, self._next + n)
        if n:
            self._next = max(self._next, int(order.max()) + 1)
            self._numbers += data.size
            if self._numbers > MOST_NUMBERS:
                raise SceneError(f"{self.where}: the surfaces have more than {MOST_NUMBERS:,} numbers together")
            every = np.ascontiguousarray(np.broadcast_to(materials, (n,)), np.int64)
            self._batches.append((kind, self._checked(data).reshape(-1, STRIDE[kind]), every, order, starts))

    def _checked(self, data: F64) -> F64:
        if not np.isfinite(data).all():
            raise SceneError(f"{self.where}: a surface has a number that is not finite")
        if np.abs(data).max(initial=0.0) > MAX_COORDINATE:
            raise SceneError(f"{self.where}: a surface has the number {np.abs(data).max():g}, wanted at most 1e30")
        return data

    def _shared_materials(self, remarks: list[str]) -> tuple[Table, Ints]:
        """The distinct materials that are used, and for each number given out by `add_materials` its row."""
        rows = np.concatenate(self._materials)
        baked = np.repeat(self._baked, [len(part) for part in self._materials])
        used = np.zeros(len(rows), np.bool_)
        for batch in self._batches:
            used[batch[2]] = True
        apart = np.repeat(self._apart, [len(part) for part in self._materials]).astype(np.int64)
        apart *= np.arange(1, len(rows) + 1)
        table, share = _distinct(rows, used, apart)
        levels = 16
        while len(table) > MAX_MATERIALS and levels >= 2 and baked.any():
            rows["diffuse"][baked] = _rounded(rows["diffuse"][baked], levels)
            table, share = _distinct(rows, used, apart)
            remarks.append(f"too many colours in textures: rounded to {levels} levels of each primary")
            levels //= 2
        if len(table) > MAX_MATERIALS:
            raise SceneError(f"{self.where}: the file has {len(table)} materials, wanted at most {MAX_MATERIALS}")
        self.share = np.where(used, share, -1)
        return table, share


def _half_extent(batches: list[tuple[AnyKind, F64, Ints, Ints, Ints]]) -> float:
    """Half of the longest edge of the box of all surfaces."""
    boxes = []
    for kind, data, _, order, starts in batches:
        batch = Batch(kind, np.zeros(len(order), np.uint32), np.zeros(len(order), np.uint16), data, starts)
        boxes.append(batch.bounds())
    every = np.concatenate(boxes)
    return float((every[:, 1].max(0) - every[:, 0].min(0)).max()) / 2.0


def _in_order(batch: Batch) -> Batch:
    return batch if (batch.ids[:-1] < batch.ids[1:]).all() else batch.select(np.argsort(batch.ids))


def _distinct(rows: Table, used: NDArray[np.bool_], apart: Ints) -> tuple[Table, Ints]:
    """The distinct rows among the used ones in order of first appearance, and where each row went (unused ones: 0).

    Rows are equal only if their numbers in `apart` are, too.
    """
    parts = [
        np.ascontiguousarray(rows[used]).view((np.uint8, MATERIAL_RECORD.itemsize)),
        apart[used].view((np.uint8, 8)),
    ]
    joined = np.concatenate([part.reshape(int(used.sum()), -1) for part in parts], axis=1)
    keys = np.ascontiguousarray(joined).view(np.dtype((np.void, joined.shape[1]))).reshape(-1)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    place = np.empty(len(first), np.int64)
    place[np.argsort(first)] = np.arange(len(first))
    share = np.zeros(len(rows), np.int64)
    share[used] = place[inverse]
    return rows[used][np.sort(first)], share


def _rounded(colours: F64, levels: int) -> F64:
    """Linear colours rounded to so many levels a primary, evenly to the eye."""
    shades = np.arange(levels) / (levels - 1)
    rounds = np.array([rounded.power(shade, 2.2) for shade in (shades[1:] + shades[:-1]) / 2.0])  # up from here
    return np.asarray([rounded.power(shade, 2.2) for shade in shades])[np.searchsorted(rounds, colours, "right")]


def _with_unit_normals(data: F64) -> F64:
    """SMOOTH data with its normals made unit vectors; where one has no length the triangle's own takes its place."""
    corners, normals = data[:, :9].reshape(-1, 3, 3), data[:, 9:].reshape(-1, 3, 3)
    length = lengths(normals)[..., None]
    lost = length[..., 0] < 1e-12
    units = normals / np.where(lost[..., None], 1.0, length)
    if lost.any():
        faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        faces /= lengths(faces)[:, None]
        units = np.where(lost[..., None], faces[:, None], units)
    return np.concatenate((data[:, :9], units.reshape(-1, 9)), axis=1)


def shown(value: object) -> str:
    """A value out of a file for a message, shortened."""
    try:
        text = SHORT.repr(value)
    except ValueError:  # numbers of thousands of digits have no decimal form
        text = "a number too long to be shown"
    return text if len(text) <= 60 else text[:57] + "..."


SHORT = reprlib.Repr()
SHORT.maxlist = SHORT.maxtuple = SHORT.maxdict = 20
SHORT.maxstring = SHORT.maxlong = SHORT.maxother = 400


def colour(values: Sequence[float]) -> tuple[float, float, float]:
    """Three numbers as a colour."""
    return float(values[0]), float(values[1]), float(values[2])
