"""Shades a hit: normals, light, reflection and refraction, from which rays are spawned (DESIGN section 5).

With N the unit normal turned against the incoming unit direction D, L the unit vector to a light of
intensity I, and w the weight of the incoming ray:

    shadow ray     to each light with N.L > 0, weight w * I * (diffuse N.L + highlight max(0, R.L)^shine)
    reflected ray  R = D - 2 (D.N) N, weight w * specular
    refracted ray  Snell's law, weight w * transmission; at total internal reflection R with weight w
"""

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.intersect import CONE_AXIS, CONE_BASE, CONE_SLOPE, PLANE_NORMAL
from raygrid.node.geometry.lattice import coordinate
from raygrid.node.geometry.surface_tables import KIND_SHIFT, SLOT_MASK
from raygrid.node.jit.decorators import part
from raygrid.node.jit.formula import formula
from raygrid.node.jit.lanes import F64, VECTOR, Lanes, Three, dot
from raygrid.node.protocol.frame_tables import (
    COS_DISC,
    COS_INNER,
    COS_OUTER,
    DISC,
    LIGHT_AXIS,
    LIGHT_FALLOFF,
    LIGHT_INTENSITY,
    LIGHT_KIND,
    LIGHT_PLACE,
    LIGHT_SPOT,
)
from raygrid.node.protocol.packing import SHORTEST


@part
def unit(x, y, z):
    """The unit vector along (x, y, z); of what is too short to have a direction, zero."""
    squared = x * x + y * y + z * z
    scale = 1.0 / np.sqrt(squared) if squared >= SHORTEST * SHORTEST else 0.0
    return x * scale, y * scale, z * scale


@part
def _cross_of_edges(data, row):
    """The normal of a triangle on the side from which its vertices run counter-clockwise, not normalised."""
    ax, ay, az = np.float64(data[row, 0]), np.float64(data[row, 1]), np.float64(data[row, 2])
    e1x, e1y, e1z = data[row, 3] - ax, data[row, 4] - ay, data[row, 5] - az
    e2x, e2y, e2z = data[row, 6] - ax, data[row, 7] - ay, data[row, 8] - az
    return e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x


@part
def normals(surfaces, item, p, u, v):
    """((outward geometric normal), (shading normal)), unit vectors, of an item at point p."""
    word = np.int64(surfaces.items[item])
    kind, row = word >> KIND_SHIFT, word & SLOT_MASK
    if kind == 0:
        x, y, z = _cross_of_edges(surfaces.triangles, row)
    elif kind == 1:
        x, y, z = _cross_of_edges(surfaces.smooth, row)
    elif kind == 2:
        x, y, z = (
            surfaces.planes[row, PLANE_NORMAL],
            surfaces.planes[row, PLANE_NORMAL + 1],
            surfaces.planes[row, PLANE_NORMAL + 2],
        )
    elif kind == 3:
        x, y, z = p[0] - surfaces.spheres[row, 0], p[1] - surfaces.spheres[row, 1], p[2] - surfaces.spheres[row, 2]
    else:
        x, y, z = _cone_normal(surfaces.cones, row, p)
    outward = unit(x, y, z)
    if kind != 1:
        return outward, outward
    s, w = surfaces.smooth, 1.0 - u - v
    shading = unit(
        w * s[row, 9] + u * s[row, 12] + v * s[row, 15],
        w * s[row, 10] + u * s[row, 13] + v * s[row, 16],
        w * s[row, 11] + u * s[row, 14] + v * s[row, 17],
    )
    if shading[0] == 0.0 and shading[1] == 0.0 and shading[2] == 0.0:
        return outward, outward
    return outward, shading


@part
def _cone_normal(cones, row, p):
    """Gradient of |X - base|^2 - y^2 - r(y)^2: away from the axis, tilted against the slope."""
    x, y, z = p[0] - cones[row, CONE_BASE], p[1] - cones[row, CONE_BASE + 1], p[2] - cones[row, CONE_BASE + 2]
    ax, ay, az = cones[row, CONE_AXIS], cones[row, CONE_AXIS + 1], cones[row, CONE_AXIS + 2]
    along = x * ax + y * ay + z * az
    x, y, z = unit(x - along * ax, y - along * ay, z - along * az)
    slope = cones[row, CONE_SLOPE]
    return x - slope * ax, y - slope * ay, z - slope * az


@formula(takes=(VECTOR, F64, VECTOR), gives=(VECTOR, F64))
def towards_light(light: Three, kind: Lanes, p: Three) -> tuple[list[Lanes], Lanes]:
    """((unit vector from p to a light), distance); the distance of a directional light, of kind 0, is infinite.

    light  its place, or the unit vector towards a directional one
    """
    x, y, z = (light[axis] - p[axis] for axis in range(3))
    distance = dot((x, y, z), (x, y, z)).root()
    scale = (distance <= 0.0).choose(0.0, 1.0 / distance)
    endless = kind.equals(0.0)
    towards = [endless.choose(light[axis], one * scale) for axis, one in enumerate((x, y, z))]
    return towards, endless.choose(float("inf"), distance)


@part
def light_direction(lights, light, p):
    """((unit vector from p to a light), distance); the distance of a directional light is infinite."""
    at = (lights[light, LIGHT_PLACE], lights[light, LIGHT_PLACE + 1], lights[light, LIGHT_PLACE + 2])
    return towards_light(at, lights[light, LIGHT_KIND], p)


@part
def light_intensity(lights, light, direction, distance):
    """Linear RGB that a light sends along -direction over this distance (spots as in KHR_lights_punctual)."""
    factor = 1.0
    if lights[light, LIGHT_FALLOFF] != 0.0:
        factor = 1.0 / (distance * distance) if distance > 0.0 else 0.0
    if lights[light, LIGHT_SPOT] != 0.0:
        cosine = -(
            direction[0] * lights[light, LIGHT_AXIS]
            + direction[1] * lights[light, LIGHT_AXIS + 1]
            + direction[2] * lights[light, LIGHT_AXIS + 2]
        )
        inner, outer = lights[light, COS_INNER], lights[light, COS_OUTER]
        fade = (cosine - outer) / (inner - outer) if inner > outer else (1.0 if cosine >= outer else 0.0)
        fade = min(max(fade, 0.0), 1.0)
        factor *= fade * fade
    return (
        factor * lights[light, LIGHT_INTENSITY],
        factor * lights[light, LIGHT_INTENSITY + 1],
        factor * lights[light, LIGHT_INTENSITY + 2],
    )


@part
def refract(d, n, cosine, ratio):
    """(whether there is a refracted ray, its direction). cosine = -d.n > 0, ratio of indices outside / inside."""
    k = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    if k < 0.0:
        return False, d
    along = ratio * cosine - np.sqrt(k)
    x, y, z = ratio * d[0] + along * n[0], ratio * d[1] + along * n[1], ratio * d[2] + along * n[2]
    squared = x * x + y * y + z * z
    if (
        not squared >= SHORTEST * SHORTEST
    ):  # a ratio so large that the sum cancels, as it does seen head on: straight on
        return True, d
    scale = 1.0 / np.sqrt(squared)
    return True, (x * scale, y * scale, z * scale)


@part
def light_discs(frame, d, red, green, blue):
    """Colour of a ray that leaves the scene in direction d before this background: its own, or that of a light's disc."""
    if frame.discs:
        lights = frame.lights
        for light in range(frame.n_lights):
            x, y, z = lights[light, LIGHT_PLACE], lights[light, LIGHT_PLACE + 1], lights[light, LIGHT_PLACE + 2]
            if lights[light, LIGHT_KIND] == 0.0 and x * d[0] + y * d[1] + z * d[2] >= lights[light, COS_DISC]:
                red, green, blue = lights[light, DISC], lights[light, DISC + 1], lights[light, DISC + 2]
    return red, green, blue


@part
def place(origin, step):
    """The numbers that lattice coordinates stand for."""
    return coordinate(origin[0], step[0]), coordinate(origin[1], step[1]), coordinate(origin[2], step[2])


@part
def edge_colour(frame, d):
    """Colour of a ray that leaves the scene in direction d: the background, or the disc of a light."""
    red, green, blue = frame.background
    return light_discs(frame, d, red, green, blue)
