"""Cameras, materials, lights and frames for the tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from raygrid.node.protocol.frame import DIRECTIONAL, LIGHT_RECORD, MATERIAL_RECORD, POINT
from raygrid.node.protocol.frame_tables import Frame, light_table, material_table
from support.surfaces import F64

Vector = Sequence[float] | F64


def _axes(forward: Vector, up: Vector) -> tuple[F64, F64, F64]:
    f = np.array(forward, float)
    f /= np.linalg.norm(f)
    right = np.cross(f, np.array(up, float))
    right /= np.linalg.norm(right)
    return f, right, np.cross(right, f)


def perspective(eye: Vector, forward: Vector, angle: float, size: tuple[int, int], up: Vector = (0.1, 1.0, 0.2)) -> F64:
    """Camera table of an eye that sees `angle` degrees from the top row to the bottom row."""
    f, right, up = _axes(forward, up)
    width, height = size
    half = math.tan(math.radians(angle) / 2.0)
    pitch = 2.0 * half / max(height - 1, 1)
    camera = np.zeros((6, 3))
    camera[0] = eye
    camera[3] = f - pitch * (width - 1) / 2.0 * right + pitch * (height - 1) / 2.0 * up
    camera[4], camera[5] = pitch * right, -pitch * up
    return camera


def orthographic(eye: Vector, forward: Vector, half: float, size: tuple[int, int], up: Vector = (0.1, 1.0, 0.2)) -> F64:
    """Camera table of parallel rays; `half` spans from the picture's middle to the middle of its top row."""
    f, right, up = _axes(forward, up)
    width, height = size
    pitch = 2.0 * half / max(height - 1, 1)
    camera = np.zeros((6, 3))
    camera[0] = np.array(eye) - pitch * (width - 1) / 2.0 * right + pitch * (height - 1) / 2.0 * up
    camera[1], camera[2], camera[3] = pitch * right, -pitch * up, f
    return camera


def material(**fields: Any) -> np.ndarray:
    """One MATERIAL_RECORD record; what is not named is 0, the index of refraction 1."""
    record = np.zeros(1, MATERIAL_RECORD)
    record["ior"], record["shine"] = 1.0, 1.0
    for name, value in fields.items():
        record[name] = value
    return record


def point_light(place: Vector, intensity: float | Vector = 1.0, **fields: Any) -> np.ndarray:
    """A LIGHT_RECORD record: a point light, or a spot if `axis` is given."""
    record = np.zeros(1, LIGHT_RECORD)
    record["kind"], record["place"], record["intensity"], record["cos_disc"] = POINT, place, intensity, 2.0
    for name, value in fields.items():
        record[name] = value
    return record


def directional_light(towards: Vector, intensity: float | Vector = 1.0, **fields: Any) -> np.ndarray:
    """A LIGHT_RECORD record at infinity, invisible unless `cos_disc` and `disc` are given."""
    record = np.zeros(1, LIGHT_RECORD)
    record["kind"], record["intensity"], record["cos_disc"] = DIRECTIONAL, intensity, 2.0
    record["place"] = np.array(towards, float) / np.linalg.norm(towards)
    for name, value in fields.items():
        record[name] = value
    return record


def make_frame(
    camera: F64,
    size: tuple[int, int],
    *,
    samples: int = 1,
    depth: int = 5,
    materials: Sequence[np.ndarray] = (),
    lights: Sequence[np.ndarray] = (),
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    min_weight: float = 0.0,
) -> Frame:
    """The facts of a frame."""
    table = np.concatenate([*lights, np.zeros(0, LIGHT_RECORD)])
    return Frame(
        camera,
        material_table(np.concatenate(materials) if materials else material(diffuse=1.0)),
        light_table(table),
        len(table),
        background,
        *size,
        samples,
        depth,
        min_weight,
        bool((table["cos_disc"] < 2.0).any()),
    )
