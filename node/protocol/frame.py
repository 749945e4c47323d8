"""Declares the facts of a frame that every node holds beside its own surfaces: camera, lights, materials.

The tables are numpy record arrays, because they are read in compiled kernels and travel as bytes.
Colours and intensities are linear. Positions are in the coordinates of their owner: scene
coordinates in the front end, machine coordinates (`node.geometry.lattice`) in the nodes.
"""

from __future__ import annotations

import numpy as np

MATERIAL_RECORD = np.dtype(
    [
        ("diffuse", "<f8", 3),  # Kd times the surface's colour
        ("highlight", "<f8", 3),  # weight of the Phong highlight, 0 for none
        ("shine", "<f8"),  # Phong exponent
        ("specular", "<f8", 3),  # Ks, weight of the reflected ray, 0 for none
        ("transmission", "<f8", 3),  # T, weight of the refracted ray, 0 for none
        ("ior", "<f8"),  # index of refraction inside the body, used only if transmission > 0
    ]
)

DIRECTIONAL, POINT = 0, 1
LIGHT_RECORD = np.dtype(
    [
        ("kind", "<i8"),  # DIRECTIONAL or POINT
        ("place", "<f8", 3),  # point: position; directional: unit vector towards the light
        ("intensity", "<f8", 3),  # linear RGB; point light with falloff: times 1 / distance^2
        ("falloff", "<i8"),  # 1: inverse square of the distance, 0: none
        ("spot", "<i8"),  # 1: shines in a cone only
        ("axis", "<f8", 3),  # spot: unit vector along which it shines
        ("cos_inner", "<f8"),  # spot: full intensity inside this angle (cosine)
        ("cos_outer", "<f8"),  # spot: none outside this one (cosine)
        ("cos_disc", "<f8"),  # directional: rays this near to it (cosine) that leave the scene see it; 2 = never
        ("disc", "<f8", 3),  # what they see, linear RGB
    ]
)

CAMERA_RECORD = np.dtype(
    [
        # A ray through the image point (i, j), pixel centres at whole numbers, (0, 0) top left, starts at
        # eye + i eye_di + j eye_dj and runs along base + i base_di + j base_dj (perspective: eye_d* = 0).
        ("eye", "<f8", 3),
        ("eye_di", "<f8", 3),
        ("eye_dj", "<f8", 3),
        ("base", "<f8", 3),
        ("base_di", "<f8", 3),
        ("base_dj", "<f8", 3),
    ]
)
