"""The oracle: a slow ray tracer written from the equations and the format's text, to test the machine against.

It shares no code with the machine: float64, plain recursion over rays, every ray against every surface. Tests import
it as `oracle`, the folder of the tests being on the path; a numba cache made under one name fails under a second one.
"""

from .nff import NffError, parse_nff, read_nff
from .render import first_hit, intersect_one, radiance, render
from .scene import Camera, OracleScene, SceneBuilder, nff_camera, orthographic_camera

__all__ = [
    "Camera",
    "NffError",
    "OracleScene",
    "SceneBuilder",
    "first_hit",
    "intersect_one",
    "nff_camera",
    "orthographic_camera",
    "parse_nff",
    "radiance",
    "read_nff",
    "render",
]
