"""The ray tree of one sample by the oracle's equations, in plain Python, to compare the machine's with."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from oracle import OracleScene, kernels

EYE = 0.0  # an eye ray sees what is at its start


@dataclass
class Branch:
    """One ray: kind and light as the machine names them, weight, surface met (-1: none), its distance, children."""

    kind: str
    depth: int
    weight: tuple[float, float, float]
    surface: int
    distance: float
    light: int | None = None
    inside: bool = False
    children: list[Branch] = field(default_factory=list)


def oracle_tree(scene: OracleScene, i: float, j: float) -> Branch:
    """The tree of the ray through image point (i, j)."""
    eye, eye_du, eye_dv, base, du, dv = scene.camera
    start = kernels.add(eye, kernels.add(kernels.times(i, eye_du), kernels.times(j, eye_dv)))
    way = kernels.unit(kernels.add(base, kernels.add(kernels.times(i, du), kernels.times(j, dv))))
    return _branch(scene, "primary", 1, start, way, EYE, (1.0, 1.0, 1.0))


def _branch(scene, kind, depth, start, way, t_min, weight, inside=False):
    world = scene.world()
    t, s = kernels.first_hit(world.surfaces, start, way, t_min, math.inf)
    branch = Branch(kind, depth, weight, int(s), t, inside=inside)
    if s < 0:
        return branch
    point = kernels.add(start, kernels.times(t, way))
    m = world.surfaces.material[s]
    normal = kernels.shading_normal(world.surfaces, s, point, way)
    mirror = kernels.reflect(way, normal)
    branch.children += _shadows(world, m, depth, point, normal, mirror, weight)
    if depth >= world.max_depth:
        return branch
    specular, transmission = kernels.row(world.materials.specular, m), kernels.row(world.materials.transmission, m)
    onward = kernels.tint(weight, specular)
    if max(onward) > world.min_weight:
        branch.children.append(_branch(scene, "reflected", depth + 1, point, mirror, world.epsilon, onward))
    if max(transmission) > 0.0:
        entering = kernels.dot(way, kernels.outward_normal(world.surfaces, s, point)) < 0.0
        ior = world.materials.ior[m]
        through, passes = kernels.refract(way, normal, 1.0 / ior if entering else ior)
        onward = kernels.tint(weight, transmission) if passes else weight
        if max(onward) > world.min_weight:
            born, way_on = ("refracted", through) if passes else ("reflected", mirror)
            branch.children.append(
                _branch(scene, born, depth + 1, point, way_on, world.epsilon, onward, inside=not passes)
            )
    return branch


def _shadows(world, m, depth, point, normal, mirror, weight):
    materials, lights = world.materials, world.lights
    branches = []
    for i in range(len(lights.kind)):
        towards, distance = kernels.to_light(lights, i, point)
        cosine = kernels.dot(normal, towards)
        if cosine <= 0.0:
            continue
        phong = max(0.0, kernels.dot(mirror, towards)) ** materials.shine[m]
        sent_on = kernels.add(
            kernels.times(cosine, kernels.row(materials.diffuse, m)),
            kernels.times(phong, kernels.row(materials.highlight, m)),
        )
        adds = kernels.tint(weight, kernels.tint(kernels.light_colour(lights, i, towards, distance), sent_on))
        t, s = kernels.first_hit(world.surfaces, point, towards, world.epsilon, distance - world.epsilon)
        branches.append(Branch("shadow", depth, adds, int(s), t, light=i))
    return branches
