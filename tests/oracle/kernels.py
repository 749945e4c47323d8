"""The oracle's compiled functions: one per equation, plain float64, no fastmath.

Everything that numba compiles is in this one file: its cache looks only at the file of the function that is called,
so a helper in another file could be edited and the old one still be run. Not cached are trace, which calls itself,
and its caller: from its cache a recursive function crashes (numba issue 6061, seen with 0.68.1).

Points, directions and colours are tuples of three floats. `O + t D` is the ray; D is a unit vector wherever a t is
compared with a length (everywhere except in the functions named ..._roots). NaN stands for "no root": every
comparison with it is false, so an absent root is never in any interval.
"""
# ruff: noqa: E741  (O is the ray's origin in every equation)
# mypy: allow-untyped-defs, allow-untyped-calls

import math

from numba import njit

from . import tables

NO_ROOTS = (math.nan, math.nan)
BLACK = (0.0, 0.0, 0.0)
EDGE = 1e-12  # a triangle's edge belongs to both neighbours, so no ray slips between two of them by rounding


# ---- vectors ----


@njit(cache=True)
def row(array, i):
    return (array[i, 0], array[i, 1], array[i, 2])


@njit(cache=True)
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@njit(cache=True)
def add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@njit(cache=True)
def sub(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@njit(cache=True)
def times(s, a):
    return (s * a[0], s * a[1], s * a[2])


@njit(cache=True)
def tint(a, b):
    """Colour times colour, channel by channel."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@njit(cache=True)
def unit(a):
    """`a` with length 1; the zero vector stays as it is."""
    length = math.sqrt(dot(a, a))
    return times(1.0 / length, a) if length > 0.0 else a


# ---- where a ray meets a surface ----


@njit(cache=True)
def quadratic_roots(a, b, c):
    """Both t of a t^2 + 2 b t + c = 0, in any order; also if a is 0 or nearly so.

    With q = -(b + sign(b) sqrt(b^2 - a c)) the roots are q/a and c/q, and nothing of like size is subtracted
    (their product is c/a; Numerical Recipes, section 5.6).
    """
    discriminant = b * b - a * c
    if discriminant < 0.0:
        return NO_ROOTS
    q = -(b + math.copysign(math.sqrt(discriminant), b))
    t0 = q / a if a != 0.0 else math.nan
    t1 = c / q if q != 0.0 else math.nan  # q = 0 means b = a c = 0: the root 0 twice (t0), or none
    return t0, t1


@njit(cache=True)
def plane_root(normal, point, O, D):
    """N.(O + t D - P) = 0; a ray in or along the plane does not meet it."""
    slope = dot(normal, D)
    return dot(normal, sub(point, O)) / slope if slope != 0.0 else math.nan


@njit(cache=True)
def barycentric(surfaces, s, P):
    """Weights of the three vertices at P: the areas of the triangles that P makes with the opposite edges, by the
    whole area. N.((B - A) x (C - A)) is twice the area with the sign of the turning sense."""
    first = surfaces.first[s]
    N = row(surfaces.plane_normal, s)
    A, B, C = row(surfaces.points, first), row(surfaces.points, first + 1), row(surfaces.points, first + 2)
    whole = dot(N, cross(sub(B, A), sub(C, A)))
    at_A = dot(N, cross(sub(C, B), sub(P, B))) / whole
    at_B = dot(N, cross(sub(A, C), sub(P, C))) / whole
    at_C = dot(N, cross(sub(B, A), sub(P, A))) / whole
    return at_A, at_B, at_C


@njit(cache=True)
def inside_triangle(surfaces, s, P):
    at_A, at_B, at_C = barycentric(surfaces, s, P)
    return at_A >= -EDGE and at_B >= -EDGE and at_C >= -EDGE


@njit(cache=True)
def inside_polygon(surfaces, s, P):
    """Crossing number: a half line from P crosses the outline an odd number of times if P is inside.

    Seen along the axis in which the plane's normal is longest, so the outline keeps its shape. Of each edge the end
    with the smaller v belongs to it and the other not, so a half line through a vertex counts it once or twice, as
    the outline goes on or turns back.
    """
    nx, ny, nz = abs(surfaces.plane_normal[s, 0]), abs(surfaces.plane_normal[s, 1]), abs(surfaces.plane_normal[s, 2])
    dropped = 0 if nx >= ny and nx >= nz else (1 if ny >= nz else 2)
    u, v = (dropped + 1) % 3, (dropped + 2) % 3
    points = surfaces.points
    last = surfaces.first[s] + surfaces.point_count[s] - 1
    inside = False
    for k in range(surfaces.first[s], last + 1):
        before = k - 1 if k > surfaces.first[s] else last
        if (points[k, v] > P[v]) != (points[before, v] > P[v]):
            along = (P[v] - points[k, v]) / (points[before, v] - points[k, v])
            if P[u] < points[k, u] + along * (points[before, u] - points[k, u]):
                inside = not inside
    return inside


@njit(cache=True)
def flat_roots(surfaces, s, O, D):
    t = plane_root(row(surfaces.plane_normal, s), row(surfaces.points, surfaces.first[s]), O, D)
    if math.isnan(t):
        return NO_ROOTS
    P = add(O, times(t, D))
    inside = inside_polygon(surfaces, s, P) if surfaces.kind[s] == tables.POLYGON else inside_triangle(surfaces, s, P)
    return (t, math.nan) if inside else NO_ROOTS


@njit(cache=True)
def sphere_roots(surfaces, s, O, D):
    """|O + t D - C|^2 = r^2."""
    radius = surfaces.radii[s, 0]
    from_centre = sub(O, row(surfaces.points, surfaces.first[s]))
    return quadratic_roots(dot(D, D), dot(from_centre, D), dot(from_centre, from_centre) - radius * radius)


@njit(cache=True)
def cone_frame(surfaces, s):
    """Base point, unit axis towards the apex, height, radius at the base, growth of the radius per unit of height."""
    base, apex = row(surfaces.points, surfaces.first[s]), row(surfaces.points, surfaces.first[s] + 1)
    to_apex = sub(apex, base)
    height = math.sqrt(dot(to_apex, to_apex))
    r_base, r_apex = abs(surfaces.radii[s, 0]), abs(surfaces.radii[s, 1])
    return base, times(1.0 / height, to_apex), height, r_base, (r_apex - r_base) / height


@njit(cache=True)
def cone_roots(surfaces, s, O, D):
    """|p|^2 = r^2 with p the part of (O + t D - base) across the axis, h its part along it, r = r_base + growth h,
    and 0 <= h <= height. No caps. Between the ends r is not negative, so the other half of the double cone is out."""
    base, axis, height, r_base, growth = cone_frame(surfaces, s)
    from_base = sub(O, base)
    h0, h1 = dot(from_base, axis), dot(D, axis)  # h = h0 + t h1
    p0, p1 = sub(from_base, times(h0, axis)), sub(D, times(h1, axis))  # p = p0 + t p1
    r0, r1 = r_base + growth * h0, growth * h1  # r = r0 + t r1
    t0, t1 = quadratic_roots(dot(p1, p1) - r1 * r1, dot(p0, p1) - r0 * r1, dot(p0, p0) - r0 * r0)
    t0 = t0 if 0.0 <= h0 + t0 * h1 <= height else math.nan
    t1 = t1 if 0.0 <= h0 + t1 * h1 <= height else math.nan
    return t0, t1


@njit(cache=True)
def from_inside(surfaces, s, O, D, t):
    """Does the ray leave the body at t? (False if there is no t.)"""
    return not math.isnan(t) and dot(outward_normal(surfaces, s, add(O, times(t, D))), D) > 0.0


@njit(cache=True)
def surface_roots(surfaces, s, O, D):
    """Every t at which the line O + t D meets surface s, in any order, those behind O included."""
    kind = surfaces.kind[s]
    if kind != tables.SPHERE and kind != tables.CONE:
        return flat_roots(surfaces, s, O, D)
    t0, t1 = sphere_roots(surfaces, s, O, D) if kind == tables.SPHERE else cone_roots(surfaces, s, O, D)
    if surfaces.radii[s, 0] < 0.0 or surfaces.radii[s, 1] < 0.0:  # only the inside shows
        t0 = t0 if from_inside(surfaces, s, O, D, t0) else math.nan
        t1 = t1 if from_inside(surfaces, s, O, D, t1) else math.nan
    return t0, t1


@njit(cache=True)
def misses_bound(surfaces, s, O, D):
    """Does the whole line pass by the sphere around the surface? Its distance from the centre C is the length of
    (C - O) without the part along D; D must be a unit vector. The sphere was made a little too large.
    (Asked in the loops themselves and not by nearest_root, a call of which for every surface costs ten times this.)"""
    to_centre = sub(row(surfaces.bound_centre, s), O)
    across = sub(to_centre, times(dot(to_centre, D), D))
    return dot(across, across) > surfaces.bound_radius[s] * surfaces.bound_radius[s]


@njit(cache=True)
def nearest_root(surfaces, s, O, D, t_min, t_max):
    """Smallest t of surface s with t_min < t < t_max; infinity if there is none."""
    t0, t1 = surface_roots(surfaces, s, O, D)
    nearest = math.inf
    if t_min < t0 < t_max:
        nearest = t0
    if t_min < t1 < t_max and t1 < nearest:
        nearest = t1
    return nearest


@njit(cache=True)
def first_hit(surfaces, O, D, t_min, t_max):
    """(t, surface) of the nearest hit with t_min < t < t_max, the smaller index if two are equal; (infinity, -1)."""
    nearest, hit = math.inf, -1
    for s in range(len(surfaces.kind)):
        if misses_bound(surfaces, s, O, D):
            continue
        t = nearest_root(surfaces, s, O, D, t_min, t_max)
        if t < nearest:
            nearest, hit = t, s
    return nearest, hit


@njit(cache=True)
def blocked(surfaces, O, D, t_min, t_max):
    """Is there anything at all, transparent or not, with t_min < t < t_max?"""
    for s in range(len(surfaces.kind)):
        if misses_bound(surfaces, s, O, D):
            continue
        if nearest_root(surfaces, s, O, D, t_min, t_max) < math.inf:
            return True
    return False


# ---- normals ----


@njit(cache=True)
def outward_normal(surfaces, s, P):
    """G: the plane's normal, or away from the sphere's centre, or away from the cone's axis."""
    kind = surfaces.kind[s]
    if kind == tables.SPHERE:
        return unit(sub(P, row(surfaces.points, surfaces.first[s])))
    if kind == tables.CONE:  # half the gradient of |p|^2 - r^2 by the point: p - r growth axis, see cone_roots
        base, axis, _, r_base, growth = cone_frame(surfaces, s)
        from_base = sub(P, base)
        h = dot(from_base, axis)
        p = sub(from_base, times(h, axis))
        return unit(sub(p, times((r_base + growth * h) * growth, axis)))
    return row(surfaces.plane_normal, s)


@njit(cache=True)
def shading_normal(surfaces, s, P, D):
    """N: the outward normal, or for a smooth triangle the vertices' normals weighted by the barycentric coordinates;
    unit, turned so that N.D <= 0."""
    N = outward_normal(surfaces, s, P)
    if surfaces.kind[s] == tables.SMOOTH_TRIANGLE:
        at_A, at_B, at_C = barycentric(surfaces, s, P)
        A, B, C = surfaces.first[s], surfaces.first[s] + 1, surfaces.first[s] + 2
        normals = surfaces.vertex_normals
        N = add(times(at_A, row(normals, A)), add(times(at_B, row(normals, B)), times(at_C, row(normals, C))))
        N = unit(N)
    return N if dot(D, N) <= 0.0 else times(-1.0, N)


# ---- light ----


@njit(cache=True)
def to_light(lights, i, P):
    """Unit vector from P to light i, and the distance."""
    if lights.kind[i] == tables.DIRECTIONAL_LIGHT:
        return row(lights.vector, i), math.inf
    way = sub(row(lights.vector, i), P)
    return unit(way), math.sqrt(dot(way, way))


@njit(cache=True)
def light_colour(lights, i, L, distance):
    """Intensity of light i at a place from which it lies in direction L at that distance.

    Spot: glTF's KHR_lights_punctual, clamp((cos a - cos outer) / (cos inner - cos outer), 0, 1)^2 with a the angle
    between the spot's axis and the way from the light.
    """
    strength = 1.0
    if lights.inverse_square[i]:
        strength /= distance * distance
    if lights.spot[i]:
        cos_a = -dot(L, row(lights.axis, i))
        part = (cos_a - lights.cos_outer[i]) / (lights.cos_inner[i] - lights.cos_outer[i])
        strength *= min(1.0, max(0.0, part)) ** 2
    return times(strength, row(lights.colour, i))


@njit(cache=True)
def direct_light(world, material, P, N, R, counts):
    """Sum over the lights with N.L > 0 of V I (diffuse N.L + highlight max(0, R.L)^shine)."""
    materials, lights = world.materials, world.lights
    diffuse, highlight = row(materials.diffuse, material), row(materials.highlight, material)
    total = BLACK
    for i in range(len(lights.kind)):
        L, distance = to_light(lights, i, P)
        cosine = dot(N, L)
        if cosine <= 0.0:
            continue
        counts[tables.SHADOW] += 1
        if blocked(world.surfaces, P, L, world.epsilon, distance - world.epsilon):
            continue
        phong = max(0.0, dot(R, L)) ** materials.shine[material]
        sent_on = add(times(cosine, diffuse), times(phong, highlight))
        total = add(total, tint(light_colour(lights, i, L, distance), sent_on))
    return total


# ---- rays that a hit spawns ----


@njit(cache=True)
def reflect(D, N):
    """R = D - 2 (D.N) N."""
    return sub(D, times(2.0 * dot(D, N), N))


@njit(cache=True)
def refract(D, N, eta):
    """Snell's law for unit D and N with N.D <= 0; eta is the index on D's side by that on the other.

    Returns (direction, True) or, on total internal reflection, (zero, False). The part of D along the surface is
    multiplied by eta (sin r = eta sin i); what is lacking to length 1 goes along -N.
    """
    cos_i = -dot(D, N)
    cos_r_squared = 1.0 - eta * eta * (1.0 - cos_i * cos_i)
    if cos_r_squared < 0.0:
        return BLACK, False
    return add(times(eta, D), times(eta * cos_i - math.sqrt(cos_r_squared), N)), True


@njit  # no cache, see above
def trace(world, O, D, t_min, depth, weight, counts):
    """Linear RGB seen along the ray; weight is what a unit of it adds to the pixel, for the cut-off alone."""
    t, s = first_hit(world.surfaces, O, D, t_min, math.inf)
    if s < 0:
        return world.background
    P = add(O, times(t, D))
    m = world.surfaces.material[s]
    N = shading_normal(world.surfaces, s, P, D)
    R = reflect(D, N)
    colour = direct_light(world, m, P, N, R, counts)
    if depth >= world.max_depth:
        return colour
    specular, transmission = row(world.materials.specular, m), row(world.materials.transmission, m)
    if max(tint(weight, specular)) > world.min_weight:
        counts[tables.REFLECTED] += 1
        seen = trace(world, P, R, world.epsilon, depth + 1, tint(weight, specular), counts)
        colour = add(colour, tint(specular, seen))
    if max(transmission) > 0.0:
        entering = dot(D, outward_normal(world.surfaces, s, P)) < 0.0
        ior = world.materials.ior[m]
        way, passes = refract(D, N, 1.0 / ior if entering else ior)
        if not passes:  # total internal reflection: a reflected ray in its place, with weight 1 and not T
            counts[tables.INTERNAL] += 1
            way, transmission = R, (1.0, 1.0, 1.0)
        if max(tint(weight, transmission)) > world.min_weight:
            counts[tables.REFRACTED] += 1
            seen = trace(world, P, way, world.epsilon, depth + 1, tint(weight, transmission), counts)
            colour = add(colour, tint(transmission, seen))
    return colour


@njit  # no cache, see above
def render(world, camera, offsets, image, counts):
    """Mean over the samples of each pixel; camera is (eye, eye_du, eye_dv, base, du, dv), see scene.Camera."""
    eye, eye_du, eye_dv, base, du, dv = camera
    height, width, samples, _ = offsets.shape
    for y in range(height):
        for x in range(width):
            total = BLACK
            for k in range(samples):
                i, j = x + offsets[y, x, k, 0], y + offsets[y, x, k, 1]
                O = add(eye, add(times(i, eye_du), times(j, eye_dv)))
                D = unit(add(base, add(times(i, du), times(j, dv))))
                counts[tables.PRIMARY] += 1
                total = add(total, trace(world, O, D, 0.0, 1, (1.0, 1.0, 1.0), counts))
            for channel in range(3):
                image[y, x, channel] = total[channel] / samples
