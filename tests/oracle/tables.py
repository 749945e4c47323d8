"""The tables on which the oracle's compiled functions work: flat float64 arrays, one row per thing.

numba's cache does not look at this file: whoever reorders the fields of a table here must also touch kernels.py.
"""

from typing import NamedTuple

import numpy as np

TRIANGLE, SMOOTH_TRIANGLE, POLYGON, SPHERE, CONE = range(5)
POINT_LIGHT, DIRECTIONAL_LIGHT = range(2)
PRIMARY, REFLECTED, REFRACTED, SHADOW, INTERNAL = range(5)  # places in the array of ray counts
# INTERNAL is a part of REFRACTED: those that total internal reflection turned back


class Surfaces(NamedTuple):
    """One row per surface, in the order of the file."""

    kind: np.ndarray  # (n,) int64, one of the five kinds above
    material: np.ndarray  # (n,) int64, row in Materials
    first: np.ndarray  # (n,) int64, first row in `points`
    point_count: np.ndarray  # (n,) int64, rows in `points`: 3, 3, number of vertices, 1 (centre), 2 (base, apex)
    radii: np.ndarray  # (n, 2): sphere (radius, 0), cone (at the base, at the apex), else 0; negative: inside only
    points: np.ndarray  # (m, 3)
    vertex_normals: np.ndarray  # (m, 3), unit, of smooth triangles; else 0
    plane_normal: np.ndarray  # (n, 3), unit, on the side where the vertices run counter-clockwise; else 0
    bound_centre: np.ndarray  # (n, 3) a sphere that holds the whole surface
    bound_radius: np.ndarray  # (n,)


class Materials(NamedTuple):
    """One row per material; every colour is linear RGB."""

    diffuse: np.ndarray  # (k, 3) Kd times the surface's colour
    specular: np.ndarray  # (k, 3) Ks, weight of the reflected ray
    shine: np.ndarray  # (k,) Phong exponent
    transmission: np.ndarray  # (k, 3) T, weight of the refracted ray
    ior: np.ndarray  # (k,) index of refraction; used only where T > 0
    highlight: np.ndarray  # (k, 3) Ks again if highlights are on, else 0


class Lights(NamedTuple):
    """One row per light."""

    kind: np.ndarray  # (l,) int64
    vector: np.ndarray  # (l, 3) position of a point light; unit vector towards a directional light
    colour: np.ndarray  # (l, 3) intensity
    inverse_square: np.ndarray  # (l,) int64, 1: intensity / distance**2
    spot: np.ndarray  # (l,) int64, 1: limited to the cone below
    axis: np.ndarray  # (l, 3) unit vector in which a spot shines
    cos_inner: np.ndarray  # (l,)
    cos_outer: np.ndarray  # (l,)


class World(NamedTuple):
    """All that a ray can meet."""

    surfaces: Surfaces
    materials: Materials
    lights: Lights
    background: tuple[float, float, float]
    max_depth: int  # the eye ray has depth 1; a hit at this depth spawns nothing but shadow rays
    min_weight: float  # a reflected or refracted ray is spawned if its weight, the largest of RGB, is above this
    epsilon: float  # a secondary ray sees nothing nearer than this to its start
