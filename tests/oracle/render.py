"""The oracle's calls: a picture, the radiance of one ray, the first hit, all hits of one surface."""

import math

import numpy as np

from . import kernels
from .scene import OracleScene, Triple, Vector, triple
from .tables import PRIMARY, REFLECTED, REFRACTED, SHADOW

Counts = dict[str, int]


def render(scene: OracleScene, width: int, height: int, offsets: np.ndarray | None = None) -> tuple[np.ndarray, Counts]:
    """Linear radiance (height, width, 3), and how many rays of each kind were traced.

    `offsets` (height, width, samples, 2) is added to the pixel coordinates (i, j), one ray each, and a pixel is the
    mean of its samples; without it one ray goes through the middle of each pixel. The scene's camera must be one
    for width x height.
    """
    if offsets is None:
        offsets = np.zeros((height, width, 1, 2))
    offsets = np.ascontiguousarray(offsets, dtype=np.float64)
    if offsets.ndim != 4 or offsets.shape[:2] != (height, width) or offsets.shape[2] < 1 or offsets.shape[3] != 2:
        raise ValueError(f"oracle: offsets have the shape ({height}, {width}, samples, 2), not {offsets.shape}")
    image = np.zeros((height, width, 3))
    counts = np.zeros(5, dtype=np.int64)
    kernels.render(scene.world(), tuple(scene.camera), offsets, image, counts)
    return image, _named(counts)


def radiance(scene: OracleScene, origin: Vector, direction: Vector) -> tuple[np.ndarray, Counts]:
    """Linear RGB seen from `origin` in that direction (of any length), and the rays traced, this one included."""
    counts = np.zeros(5, dtype=np.int64)
    counts[PRIMARY] = 1
    way, _ = _unit_and_length(direction)
    colour = kernels.trace(scene.world(), triple(origin), way, 0.0, 1, (1.0, 1.0, 1.0), counts)
    return np.array(colour), _named(counts)


def first_hit(
    scene: OracleScene, origin: Vector, direction: Vector, t_min: float = 0.0, t_max: float = math.inf
) -> tuple[float, int]:
    """(t, surface) of the first hit with t_min < t < t_max, t in lengths of `direction`; (inf, -1) if there is none.
    Of equal hits the surface of the smallest index."""
    way, length = _unit_and_length(direction)
    t, surface = kernels.first_hit(scene.surfaces, triple(origin), way, t_min * length, t_max * length)
    return t / length, surface


def intersect_one(scene: OracleScene, surface: int, origin: Vector, direction: Vector) -> list[float]:
    """Every t at which the line origin + t direction meets that surface, those behind the origin included, ascending;
    a tangent's once. t in lengths of `direction`; no bound is tested."""
    if not 0 <= surface < len(scene.surfaces.kind):
        raise IndexError(f"oracle: no surface {surface}, there are {len(scene.surfaces.kind)}")
    roots = kernels.surface_roots(scene.surfaces, surface, triple(origin), triple(direction))
    return sorted({t for t in roots if not math.isnan(t)})


def _unit_and_length(direction: Vector) -> tuple[Triple, float]:
    length = math.sqrt(sum(float(c) ** 2 for c in direction))
    if not 0.0 < length < math.inf:
        raise ValueError(f"oracle: a direction has a length above 0, not {tuple(direction)}")
    x, y, z = triple(direction)
    return (x / length, y / length, z / length), length


def _named(counts: np.ndarray) -> Counts:
    return {
        "primary": int(counts[PRIMARY]),
        "reflected": int(counts[REFLECTED]),
        "refracted": int(counts[REFRACTED]),
        "shadow": int(counts[SHADOW]),
    }
