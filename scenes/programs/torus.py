"""A torus round the z axis: numbers[0] is the radius of the ring, numbers[1] that of the tube.

In its own coordinates the box should have half edges (ring + tube, ring + tube, tube).
"""

import math


def surface_hits(origin, direction, numbers):
    """The roots of a quartic along the ray: looked for in steps inside the ball round the torus, then halved.

    A ray that enters and leaves the tube within one step, a grazing one, does not meet it.
    """
    ring, tube = numbers[0], numbers[1]
    ox, oy, oz = origin
    dx, dy, dz = direction
    # with k = |o|^2 - R^2 - r^2 the quartic is t^4 + a t^3 + b t^2 + c t + e
    od = ox * dx + oy * dy + oz * dz
    k = ox * ox + oy * oy + oz * oz - ring * ring - tube * tube
    a = 4.0 * od
    b = 4.0 * od * od + 2.0 * k + 4.0 * ring * ring * dz * dz
    c = 4.0 * od * k + 8.0 * ring * ring * oz * dz
    e = k * k + 4.0 * ring * ring * (oz * oz - tube * tube)
    # all roots lie where the ray is in the ball round the torus
    reach = ring + tube
    inside = od * od - (ox * ox + oy * oy + oz * oz - reach * reach)
    if inside <= 0.0:
        return math.inf, math.inf, math.inf, math.inf
    half = math.sqrt(inside)
    low, high = -od - half * 1.000001, -od + half * 1.000001
    found = 0
    first, second, third, fourth = math.inf, math.inf, math.inf, math.inf
    steps = 64
    before = low
    value = (((before + a) * before + b) * before + c) * before + e
    for step in range(1, steps + 1):
        here = low + (high - low) * step / steps
        there = (((here + a) * here + b) * here + c) * here + e
        if (value > 0.0) != (there > 0.0):
            one, other, sign = before, here, value > 0.0
            for _ in range(60):
                middle = 0.5 * (one + other)
                if ((((middle + a) * middle + b) * middle + c) * middle + e > 0.0) == sign:
                    one = middle
                else:
                    other = middle
            root = 0.5 * (one + other)
            if found == 0:
                first = root
            elif found == 1:
                second = root
            elif found == 2:
                third = root
            else:
                fourth = root
            found += 1
        before, value = here, there
    return first, second, third, fourth


def surface_normal(point, numbers):
    """Away from the ring."""
    x, y, z = point
    out = math.sqrt(x * x + y * y)
    part = 1.0 - numbers[0] / out if out > 0.0 else 1.0
    return x * part, y * part, z
