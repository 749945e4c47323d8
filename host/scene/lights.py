"""Makes rows of the light table, lights for files that have none, and the exposure of files with photometric ones."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raygrid.host.scene.cameras import Camera
from raygrid.host.scene.linear_algebra import dot, lengths, product
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, rounded
from raygrid.node.protocol import DIRECTIONAL, LIGHT_RECORD, POINT

Table = NDArray[np.void]

NO_DISC = 2.0  # a cosine that no angle has: no ray sees the light

# A light for a mesh without any comes from the viewer's upper left, one a third as strong from the right: shapes
# are told apart by the first, and what it leaves dark stays readable by the second.
KEY, KEY_TOWARDS = 0.9, (-0.55, 0.75, -0.65)
FILL, FILL_TOWARDS = 0.3, (0.85, 0.1, -0.5)
INVENTED_BACKGROUND = (0.18, 0.20, 0.24)  # a mirror or a glass ball before plain black would look like a hole


def point_light(position: ArrayLike, intensity: ArrayLike, falloff: bool = False) -> Table:
    """A light that shines from a point on all sides, LIGHT_RECORD (1,). With falloff: intensity / distance^2."""
    row = np.zeros(1, LIGHT_RECORD)
    row["kind"], row["place"], row["intensity"], row["falloff"] = POINT, position, intensity, falloff
    row["axis"], row["cos_disc"] = (0.0, 0.0, -1.0), NO_DISC
    row["cos_inner"] = row["cos_outer"] = -1.0
    return row


def spot_light(
    position: ArrayLike,
    axis: ArrayLike,
    intensity: ArrayLike,
    inner: float,
    outer: float,
    falloff: bool = False,
) -> Table:
    """A point light that shines along `axis` only: fully within `inner` radians of it, not at all outside `outer`."""
    row = point_light(position, intensity, falloff)
    row["spot"], row["axis"] = 1, _unit(axis)
    row["cos_inner"], row["cos_outer"] = rounded.cos(inner), rounded.cos(outer)
    return row


def directional_light(
    towards: ArrayLike, intensity: ArrayLike, disc_radius: float | None = None, disc: ArrayLike = 0.0
) -> Table:
    """A light at infinity in the direction `towards`, LIGHT_RECORD (1,).

    Rays that leave the scene within `disc_radius` radians of that direction see the colour `disc`; None: none does.
    """
    row = point_light((0.0, 0.0, 0.0), intensity)
    row["kind"], row["place"] = DIRECTIONAL, _unit(towards)
    if disc_radius is not None:
        row["cos_disc"], row["disc"] = rounded.cos(disc_radius), disc
    return row


def light_table(rows: list[Table]) -> Table:
    """One table, LIGHT_RECORD (l,), of many."""
    return np.concatenate(rows) if rows else np.zeros(0, LIGHT_RECORD)


def invented_lights(camera: Camera) -> Table:
    """A key and a fill light, both directional, placed as seen by the camera."""
    axes = np.array((camera.right, camera.up, camera.forward))
    return light_table(
        [
            directional_light(product(np.array(KEY_TOWARDS), axes), KEY),
            directional_light(product(np.array(FILL_TOWARDS), axes), FILL),
        ]
    )


def exposure_point(camera: Camera, bounds: F64) -> F64:
    """What the camera looks at: the point of its axis nearest to the middle of the scene's box, (3,).

    If that is behind the camera, the middle itself.
    """
    middle, eye, forward = bounds.mean(axis=0), np.array(camera.eye), np.array(camera.forward)
    distance = float(dot(middle - eye, forward))
    return eye + distance * forward if distance > 0.0 else middle


def exposed(lights: Table, point: F64, closest: float) -> Table:
    """The lights divided by one number, so that the brightest gives irradiance 1 at `point` when it faces the light.

    Photometric files (candela and lux) leave the exposure to the viewer. One common factor keeps the proportions of the
    lights and their fall with distance. A light nearer than `closest` counts as being that far away. Cones of spot
    lights are not looked at: a spot that misses the point is meant to be as bright as one that hits it.
    """
    squared = np.maximum(np.sum((lights["place"] - point) ** 2, axis=1), closest * closest)
    strength = lights["intensity"].max(axis=1, initial=0.0)
    irradiance = np.where(lights["falloff"] == 1, strength / squared, strength)
    brightest = irradiance.max(initial=0.0)
    scaled = lights.copy()
    if brightest > 0.0:
        scaled["intensity"] /= brightest
    return scaled


def _unit(vector: ArrayLike) -> F64:
    v = np.asarray(vector, np.float64)
    largest = float(np.abs(v).max())
    if not (math.isfinite(largest) and largest > 0.0):
        raise SceneError(f"a light's direction is {v.tolist()}, wanted one with a length")
    if not 1e-100 < largest < 1e100:
        # its square may be no number: made about 1 by a power of two, which changes no digit
        v = np.ldexp(v, -math.frexp(largest)[1])
    return np.asarray(v / float(lengths(v)))
