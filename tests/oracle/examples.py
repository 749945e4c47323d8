"""Small scenes whose answers are known by hand."""

import numpy as np

from .scene import OracleScene, SceneBuilder, nff_camera

AHEAD = nff_camera((0, 0, 5), (0, 0, 0), (0, 1, 0), 45, 3, 3)


def square(half: float, z: float) -> list[tuple[float, float, float]]:
    """Counter-clockwise seen from +z."""
    return [(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)]


def mirror_room(with_mirror: bool) -> OracleScene:
    """A sphere in light from +x, over the plane z = 0 that is a mirror or is not there."""
    builder = SceneBuilder()
    builder.sphere((0, 0, 3), 1.0, builder.material(diffuse=(1.0, 0.5, 0.2)))
    if with_mirror:
        builder.polygon(square(10, 0), builder.material(specular=(0.9, 0.8, 0.7)))
    builder.directional_light((1, 0, 0))
    return builder.build(AHEAD, (0.3, 0.6, 0.9))


U_SHAPE = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]  # counter-clockwise, the notch at the top

HAND = [  # name in the zoo, origin, direction, every t
    ("sphere of radius 2", (5, 0, 0), (-1, 0, 0), [3, 7]),
    ("sphere of radius 2", (5, 0, 0), (-2, 0, 0), [1.5, 3.5]),
    ("sphere of radius 2", (0, 0, 0), (0, 0, 1), [-2, 2]),
    ("sphere of radius 2", (2, 0, -5), (0, 0, 1), [5]),  # tangent
    ("sphere of radius 2", (2.001, 0, -5), (0, 0, 1), []),
    ("sphere from inside only", (5, 0, 0), (-1, 0, 0), [7]),
    ("cylinder", (3, 0, 1), (-1, 0, 0), [2, 4]),
    ("cylinder", (3, 0, 2.01), (-1, 0, 0), []),
    ("cylinder", (0.5, 0, 5), (0, 0, -1), []),  # along the axis: in by one open end and out by the other
    ("cylinder", (0, 0, 3), (1, 0, -2), [1]),  # in by the open end
    ("cylinder from inside only", (3, 0, 1), (-1, 0, 0), [4]),
    ("cone", (3, 0, 1), (-1, 0, 0), [2, 4]),
    ("cone", (3, 0, 2.5), (-1, 0, 0), []),  # the other half of the double cone
    ("cone", (0, 0.5, -1), (0, 0, 1), [2.5]),
    ("cone", (1, 0, 0), (-1, 0, 1), [1.5]),  # parallel to a generator: 2 - t = t - 1 and no second root
    ("frustum", (5, 0, 1), (-1, 0, 0), [3.5, 6.5]),
    ("frustum", (1.5, 0, -1), (0, 0, 1), [2]),
    ("triangle", (0.25, 0.25, 3), (0, 0, -1), [3]),
    ("triangle", (0.5, 0.5, 3), (0, 0, -2), [1.5]),  # on the edge, which belongs to it
    ("triangle", (0.5, 0.51, 3), (0, 0, -1), []),
    ("triangle", (-1, 0.25, 0), (1, 0, 0), []),  # in the plane
]


def zoo() -> tuple[OracleScene, dict[str, int]]:
    """The surfaces that HAND names, and their indices."""
    builder = SceneBuilder()
    m = builder.material()
    index = {
        "sphere of radius 2": builder.sphere((0, 0, 0), 2, m),
        "sphere from inside only": builder.sphere((0, 0, 0), -2, m),
        "cylinder": builder.cone((0, 0, 0), 1, (0, 0, 2), 1, m),
        "cylinder from inside only": builder.cone((0, 0, 0), -1, (0, 0, 2), -1, m),
        "cone": builder.cone((0, 0, 0), 2, (0, 0, 2), 0, m),
        "frustum": builder.cone((0, 0, 0), 2, (0, 0, 2), 1, m),
        "triangle": builder.triangle([(0, 0, 0), (1, 0, 0), (0, 1, 0)], m),
    }
    return builder.build(AHEAD), index


def crowd(rng: np.random.Generator) -> OracleScene:
    """Ten of each kind at random."""
    builder = SceneBuilder()
    m = builder.material()
    for _ in range(10):
        a, b, c, d = rng.uniform(-3, 3, (4, 3))
        builder.sphere(a, rng.uniform(-1, 1), m)
        builder.cone(b, rng.uniform(0, 1), c, rng.uniform(0, 1), m)
        builder.triangle([a, b, c], m)
        builder.smooth_triangle([b, c, d], [(0, 0, 1)] * 3, m)
        builder.polygon([a, (a + c) / 2, c, d + (c - a) / 3, d], m)
    return builder.build(AHEAD)


TEXT = """# a comment
b 0.1 .2 3e-1
v from 0 0 5 at 0 0 0 up 0 1 0 angle 45 hither 1
resolution 7 5
l 0 0 9  1 0.5 0.25 l 4 4 4 # two on a line, the first with a colour
f 1 .5 0 .8 .5 3 .25 1.5
s 0 0 -4.44089e-16 1
c 0 0 0 1
  0 0 2 .5
p 4 0 0 0  1 0 0  1 1 0  0 1 0
f 0 0 1 1 0 100000 0 0
p 3 0 0 0  1 0 0  0 1 0
pp 3 0 0 0 0 0 1  1 0 0 0 0 1  0 1 0 0 0 1
"""
