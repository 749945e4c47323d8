"""A scene for the oracle, the cameras, and a builder that takes one surface, material or light after the other."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .tables import (
    CONE,
    DIRECTIONAL_LIGHT,
    POINT_LIGHT,
    POLYGON,
    SMOOTH_TRIANGLE,
    SPHERE,
    TRIANGLE,
    Lights,
    Materials,
    Surfaces,
    World,
)

Vector = Sequence[float] | np.ndarray
Triple = tuple[float, float, float]
Row = tuple[Any, ...]  # of a table

EPSILON_PER_EXTENT = 1e-7  # 1e-6 in a scene ten units wide
BOUND_MARGIN = 1.000001  # far above the rounding of the bound test, so that a bound never hides its surface


class Camera(NamedTuple):
    """The ray of pixel coordinate (i, j), (0, 0) in the middle of the top left pixel, starts at
    eye + i eye_du + j eye_dv and goes in direction base + i du + j dv (of any length)."""

    eye: Triple
    eye_du: Triple
    eye_dv: Triple
    base: Triple
    du: Triple
    dv: Triple

    def ray(self, i: float, j: float) -> tuple[np.ndarray, np.ndarray]:
        """Origin and unit direction."""
        eye, eye_du, eye_dv, base, du, dv = (np.array(v) for v in self)
        return eye + i * eye_du + j * eye_dv, _unit(base + i * du + j * dv)


@dataclass
class OracleScene:
    """What to render. All arrays are float64 but for kinds, indices and flags, see tables.py."""

    camera: Camera
    surfaces: Surfaces
    materials: Materials
    lights: Lights
    background: Triple
    max_depth: int = 5
    min_weight: float = 0.0
    epsilon: float = 0.0  # 0: from the scene's extent

    def world(self) -> World:
        epsilon = self.epsilon if self.epsilon > 0.0 else EPSILON_PER_EXTENT * extent(self.surfaces)
        return World(
            self.surfaces, self.materials, self.lights, self.background, self.max_depth, float(self.min_weight), epsilon
        )


def extent(surfaces: Surfaces) -> float:
    """Longest edge of the box around the surfaces' bounds; 1 if there are none."""
    if len(surfaces.kind) == 0:
        return 1.0
    radius = surfaces.bound_radius[:, None]
    low, high = (surfaces.bound_centre - radius).min(axis=0), (surfaces.bound_centre + radius).max(axis=0)
    return float((high - low).max())


# ---- cameras ----


def _unit(v: np.ndarray) -> np.ndarray:
    length = math.sqrt(float(v @ v))
    return v / length if length > 0.0 else v


def triple(v: Vector) -> Triple:
    x, y, z = (float(c) for c in v)
    return x, y, z


def _frame(from_: Vector, at: Vector, up: Vector) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward, right and up', right-handed: right = unit(forward x up), up' = right x forward."""
    forward = _unit(np.array(at, float) - np.array(from_, float))
    right = _unit(np.cross(forward, np.array(up, float)))
    return forward, right, np.cross(right, forward)


def _pitch(half: float, w: int, h: int) -> float:
    """Size of the square pixels if `half` spans from the picture's middle to the middle of the outermost pixel row
    (or column, if there is one row)."""
    return 2.0 * half / max(1, (h if h > 1 else w) - 1)


def nff_camera(from_: Vector, at: Vector, up: Vector, angle: float, w: int, h: int) -> Camera:
    """forward + t (2 i / (w-1) - 1) (w-1)/(h-1) right + t (1 - 2 j / (h-1)) up', t = tan(angle / 2), in degrees.

    An axis of one pixel looks straight ahead. (With p = 2 t / (h-1) this is forward + p (i - (w-1)/2) right
    + p ((h-1)/2 - j) up'.)
    """
    forward, right, up = _frame(from_, at, up)
    p = _pitch(math.tan(math.radians(angle) / 2.0), w, h)
    base = forward - p * (w - 1) / 2.0 * right + p * (h - 1) / 2.0 * up
    zero = (0.0, 0.0, 0.0)
    return Camera(triple(from_), zero, zero, triple(base), triple(p * right), triple(-p * up))


def orthographic_camera(from_: Vector, at: Vector, up: Vector, half_height: float, w: int, h: int) -> Camera:
    """Parallel rays; half_height spans from the picture's middle to the middle of its top row; square pixels."""
    forward, right, up = _frame(from_, at, up)
    p = _pitch(half_height, w, h)
    eye = np.array(from_, float) - p * (w - 1) / 2.0 * right + p * (h - 1) / 2.0 * up
    zero = (0.0, 0.0, 0.0)
    return Camera(triple(eye), triple(p * right), triple(-p * up), triple(forward), zero, zero)


# ---- building a scene ----


def newell_normal(vertices: np.ndarray) -> np.ndarray:
    """Unit normal of a plane polygon, convex or not: its area is half the sum of the cross products of neighbours.
    Zero for a polygon without area, which no ray then meets."""
    from_first = vertices - vertices[0]
    return _unit(np.cross(from_first, np.roll(from_first, -1, axis=0)).sum(axis=0))


def _rgb(colour: float | Vector) -> np.ndarray:
    """A number stands for a grey."""
    rgb = np.broadcast_to(np.array(colour, float), (3,)).copy()
    if not np.all(rgb >= 0.0):
        raise ValueError(f"oracle: a colour is three numbers >= 0, not {colour!r}")
    return rgb


class SceneBuilder:
    """Collects rows; materials and surfaces return or take indices; build() makes the arrays."""

    def __init__(self) -> None:
        self._surfaces: list[Row] = []  # kind, material, first, count, (r0, r1), normal, centre, radius
        self._points: list[np.ndarray] = []
        self._vertex_normals: list[np.ndarray] = []
        self._materials: list[Row] = []
        self._lights: list[Row] = []

    def material(
        self,
        diffuse: float | Vector = 0.0,
        specular: float | Vector = 0.0,
        shine: float = 1.0,
        transmission: float | Vector = 0.0,
        ior: float = 1.0,
        highlight: float | Vector = 0.0,
    ) -> int:
        """Index of a new material. Colours are RGB or one number for a grey."""
        if max(_rgb(transmission)) > 0.0 and not ior > 0.0:
            raise ValueError(f"oracle: a transparent material has ior > 0, not {ior}")
        if not shine >= 0.0:
            raise ValueError(f"oracle: shine is >= 0, not {shine}")
        self._materials.append(
            (_rgb(diffuse), _rgb(specular), float(shine), _rgb(transmission), float(ior), _rgb(highlight))
        )
        return len(self._materials) - 1

    def triangle(self, vertices: Sequence[Vector] | np.ndarray, material: int) -> int:
        return self._flat(TRIANGLE, np.array(vertices, float).reshape(3, 3), material)

    def smooth_triangle(
        self, vertices: Sequence[Vector] | np.ndarray, normals: Sequence[Vector] | np.ndarray, material: int
    ) -> int:
        """The normals are weighted as given; only their weighted sum is made a unit vector."""
        return self._flat(
            SMOOTH_TRIANGLE, np.array(vertices, float).reshape(3, 3), material, np.array(normals, float).reshape(3, 3)
        )

    def polygon(self, vertices: Sequence[Vector] | np.ndarray, material: int) -> int:
        """A plane polygon of any shape that does not cross itself."""
        return self._flat(POLYGON, np.array(vertices, float).reshape(-1, 3), material)

    def sphere(self, centre: Vector, radius: float, material: int) -> int:
        middle = np.array(centre, float)
        return self._add(SPHERE, material, middle[None], (radius, 0.0), np.zeros(3), middle, abs(radius))

    def cone(self, base: Vector, r_base: float, apex: Vector, r_apex: float, material: int) -> int:
        """Cone, frustum or (equal radii) cylinder without caps; negative radii: only the inside shows."""
        ends = np.array([base, apex], float)
        half = float(np.linalg.norm(ends[1] - ends[0])) / 2.0
        if half == 0.0 or r_base * r_apex < 0.0:
            raise ValueError(f"oracle: a cone has two ends, and radii of one sign; not {base} {r_base} {apex} {r_apex}")
        around = math.hypot(half, max(abs(r_base), abs(r_apex)))
        return self._add(CONE, material, ends, (r_base, r_apex), np.zeros(3), ends.mean(axis=0), around)

    def point_light(
        self,
        position: Vector,
        colour: float | Vector = 1.0,
        *,
        inverse_square: bool = False,
        spot: tuple[Vector, float, float] | None = None,
    ) -> int:
        """`spot`: direction in which it shines, cosine of the inner angle, cosine of the outer angle."""
        axis, cos_inner, cos_outer = spot if spot is not None else ((0.0, 0.0, 0.0), 1.0, 0.0)
        if not cos_inner > cos_outer:
            raise ValueError(f"oracle: a spot's inner angle is the smaller one; cosines {cos_inner} and {cos_outer}")
        self._lights.append(
            (
                POINT_LIGHT,
                np.array(position, float),
                _rgb(colour),
                int(inverse_square),
                int(spot is not None),
                _unit(np.array(axis, float)),
                float(cos_inner),
                float(cos_outer),
            )
        )
        return len(self._lights) - 1

    def directional_light(self, towards: Vector, colour: float | Vector = 1.0) -> int:
        """A light at infinity in direction `towards`, as seen from the scene."""
        self._lights.append(
            (DIRECTIONAL_LIGHT, _unit(np.array(towards, float)), _rgb(colour), 0, 0, np.zeros(3), 1.0, 0.0)
        )
        return len(self._lights) - 1

    def build(
        self,
        camera: Camera,
        background: float | Vector = 0.0,
        *,
        max_depth: int = 5,
        min_weight: float = 0.0,
        epsilon: float = 0.0,
    ) -> OracleScene:
        for row in self._surfaces:
            if not 0 <= row[1] < len(self._materials):
                raise ValueError(f"oracle: surface of material {row[1]}, and there are {len(self._materials)}")
        kind, material, first, count, radii, normal, centre, radius = _columns(self._surfaces, 8)
        surfaces = Surfaces(
            _ints(kind),
            _ints(material),
            _ints(first),
            _ints(count),
            _floats(radii, 2),
            _rows(self._points),
            _rows(self._vertex_normals),
            _floats(normal, 3),
            _floats(centre, 3),
            _floats(radius),
        )
        diffuse, specular, shine, transmission, ior, highlight = _columns(self._materials, 6)
        materials = Materials(
            _floats(diffuse, 3),
            _floats(specular, 3),
            _floats(shine),
            _floats(transmission, 3),
            _floats(ior),
            _floats(highlight, 3),
        )
        kind, vector, colour, inverse_square, spot, axis, cos_inner, cos_outer = _columns(self._lights, 8)
        lights = Lights(
            _ints(kind),
            _floats(vector, 3),
            _floats(colour, 3),
            _ints(inverse_square),
            _ints(spot),
            _floats(axis, 3),
            _floats(cos_inner),
            _floats(cos_outer),
        )
        return OracleScene(
            camera, surfaces, materials, lights, triple(_rgb(background)), max_depth, min_weight, epsilon
        )

    def _flat(self, kind: int, vertices: np.ndarray, material: int, normals: np.ndarray | None = None) -> int:
        if len(vertices) < 3:
            raise ValueError(f"oracle: a polygon has at least 3 vertices, not {len(vertices)}")
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
        around = float(np.linalg.norm(vertices - middle, axis=1).max())
        return self._add(kind, material, vertices, (0.0, 0.0), newell_normal(vertices), middle, around, normals)

    def _add(
        self,
        kind: int,
        material: int,
        points: np.ndarray,
        radii: tuple[float, float],
        normal: np.ndarray,
        centre: np.ndarray,
        around: float,
        vertex_normals: np.ndarray | None = None,
    ) -> int:
        first = self._surfaces[-1][2] + self._surfaces[-1][3] if self._surfaces else 0  # after the one before
        self._surfaces.append((kind, material, first, len(points), radii, normal, centre, BOUND_MARGIN * around))
        self._points.append(points)
        self._vertex_normals.append(np.zeros_like(points) if vertex_normals is None else vertex_normals)
        return len(self._surfaces) - 1


def _columns(rows: list[Row], count: int) -> list[list[Any]]:
    return [[row[k] for row in rows] for k in range(count)]


def _ints(values: list[Any]) -> np.ndarray:
    return np.array(values, dtype=np.int64).reshape(len(values))


def _floats(values: list[Any], *shape: int) -> np.ndarray:
    return np.array(values, dtype=np.float64).reshape(len(values), *shape)


def _rows(blocks: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(blocks) if blocks else np.zeros((0, 3))
