"""Shades the hit at which a ray dies: spawns its shadow rays, and a reflected and a refracted ray, the secondary rays.

The formulas are in `node.tracing.shading`. What a program may replace, the normals of a surface and what lights it, is
handed in. In a frame that is a layer nothing is spawned: facts of the hit go home as if they were light.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raygrid.node.geometry.power import power
from raygrid.node.jit.closures import made_of_parts
from raygrid.node.jit.decorators import Function, part
from raygrid.node.protocol.counters import DIED, HITS
from raygrid.node.protocol.frame_tables import DIFFUSE, HIGHLIGHT, IOR, LAYER_NONE, SHINE, SPECULAR, TRANSMISSION
from raygrid.node.protocol.packets import REFLECTED, REFRACTED, SHADOW, read_depth, read_u32, read_weight
from raygrid.node.tracing.layer_values import layer_values
from raygrid.node.tracing.output_queues import emit, give_back
from raygrid.node.tracing.shading import light_direction, light_intensity, refract
from raygrid.node.tracing.spawn import RAY_BATCH, SHADOW_BATCH


class Hit(NamedTuple):
    """Where a ray dies, and what it hands on. Compiled code makes it.

    depth, sample     of the ray; weight: three numbers
    material          row of the material table
    point             where it is; outward, normal: geometric normal, and the shading normal against the ray
    mirror            direction of the reflected ray
    """

    depth: Any
    sample: Any
    weight: Any
    material: Any
    point: Any
    outward: Any
    normal: Any
    mirror: Any


@part
def _spawn_ray(tables, hit, kind, d, weight):
    """Spawn a reflected or refracted ray, unless it is too faint."""
    if max(weight[0], weight[1], weight[2]) > tables.frame.min_weight:
        head = kind | ((hit.depth + 1) << 3) | (hit.sample << 8)
        emit(tables, RAY_BATCH, head, 0, hit.point, hit.outward, d, weight)


@part
def _spawn_shadows(tables, hit, weight):
    """Spawn a shadow ray to each light that faces the surface; it carries what it will add."""
    frame, m, material, n = tables.frame, tables.frame.materials, hit.material, hit.normal
    head = SHADOW | (hit.depth << 3) | (hit.sample << 8)
    for light in range(frame.n_lights):
        to_light, distance = light_direction(frame.lights, light, hit.point)
        cosine = n[0] * to_light[0] + n[1] * to_light[1] + n[2] * to_light[2]
        if not cosine > 0.0:
            continue
        intensity = light_intensity(frame.lights, light, to_light, distance)
        shine = 0.0
        if m[material, HIGHLIGHT] > 0.0 or m[material, HIGHLIGHT + 1] > 0.0 or m[material, HIGHLIGHT + 2] > 0.0:
            along = hit.mirror[0] * to_light[0] + hit.mirror[1] * to_light[1] + hit.mirror[2] * to_light[2]
            shine = power(max(along, 0.0), m[material, SHINE])
        adds = (
            weight[0] * intensity[0] * (m[material, DIFFUSE] * cosine + m[material, HIGHLIGHT] * shine),
            weight[1] * intensity[1] * (m[material, DIFFUSE + 1] * cosine + m[material, HIGHLIGHT + 1] * shine),
            weight[2] * intensity[2] * (m[material, DIFFUSE + 2] * cosine + m[material, HIGHLIGHT + 2] * shine),
        )
        emit(tables, SHADOW_BATCH, head, light, hit.point, hit.outward, to_light, adds)


@part
def _spawn_reflected(tables, hit):
    """Spawn the reflected ray of a mirror."""
    m, material, weight = tables.frame.materials, hit.material, hit.weight
    ks = (m[material, SPECULAR], m[material, SPECULAR + 1], m[material, SPECULAR + 2])
    if ks[0] > 0.0 or ks[1] > 0.0 or ks[2] > 0.0:
        reflected = (weight[0] * ks[0], weight[1] * ks[1], weight[2] * ks[2])
        _spawn_ray(tables, hit, REFLECTED, hit.mirror, reflected)


@part
def _spawn_refracted(tables, hit, d, cosine):
    """Spawn the ray that came in direction d as it goes on in a clear body; tell whether all of it is reflected inside."""
    m, material, weight, g = tables.frame.materials, hit.material, hit.weight, hit.outward
    kt = (m[material, TRANSMISSION], m[material, TRANSMISSION + 1], m[material, TRANSMISSION + 2])
    if not (kt[0] > 0.0 or kt[1] > 0.0 or kt[2] > 0.0):
        return False
    entering = d[0] * g[0] + d[1] * g[1] + d[2] * g[2] < 0.0
    ratio = 1.0 / m[material, IOR] if entering else m[material, IOR]
    passes, direction = refract(d, hit.normal, cosine, ratio)
    if passes:
        weight = (weight[0] * kt[0], weight[1] * kt[1], weight[2] * kt[2])
    else:  # total internal reflection: a reflected ray in its place, with the whole weight
        direction = hit.mirror
    _spawn_ray(tables, hit, REFRACTED if passes else REFLECTED, direction, weight)
    return not passes


@made_of_parts
def make_shade(normals: Function, lit: Function) -> Function:
    """Make `shade`, over the normals of a surface, and the weight with which light counts there."""

    @part
    def shade(tables, packets, at, kind, d, met):
        """Shade a hit; tell whether a refracted ray of it is all reflected inside.

        packets, at  the ray's packet, of this kind
        d            its direction
        met          (t, item, u, v, point)
        """
        surfaces, counts = tables.surfaces, tables.counts
        _, item, u, v, p = met
        g, n = normals(surfaces, item, p, u, v)
        material = np.int64(surfaces.materials[item])
        counts[DIED + kind] += 1
        counts[HITS] += 1
        cosine = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
        if cosine < 0.0:
            n, cosine = (-n[0], -n[1], -n[2]), -cosine
        if tables.frame.layer != LAYER_NONE:
            sample = read_u32(packets, at + 1)
            values = layer_values(tables.frame, sample, d, p, n, np.int64(surfaces.ids[item]), material)
            give_back(tables, sample, read_depth(packets, at), values)
            return False
        mirror = (d[0] + 2.0 * cosine * n[0], d[1] + 2.0 * cosine * n[1], d[2] + 2.0 * cosine * n[2])
        weight = read_weight(packets, at)
        hit = Hit(read_depth(packets, at), read_u32(packets, at + 1), weight, material, p, g, n, mirror)
        _spawn_shadows(tables, hit, lit(tables.frame, material, p, n, weight))
        if hit.depth >= tables.frame.depth:
            return False
        _spawn_reflected(tables, hit)
        return _spawn_refracted(tables, hit, d, cosine)

    return shade


@part
def in_full(frame, material, p, n, weight):
    """The weight with which light counts at a point p of normal n: that of the ray."""
    return weight
