"""From raygrid's scenes to the oracle's, surface by surface, and the places of the samples in their pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from oracle import Camera, OracleScene, SceneBuilder, nff_camera, orthographic_camera

from raygrid.host.scene import cameras
from raygrid.host.scene.scene import Scene
from raygrid.node.geometry.surfaces import Batch, Kind
from raygrid.node.jit.decorators import kernel
from raygrid.node.protocol.frame import DIRECTIONAL
from raygrid.node.tracing.camera import image_point

F64 = NDArray[np.float64]


def oracle_scene(
    scene: Scene, width: int, height: int, *, highlights: bool | None = None, depth: int = 5
) -> OracleScene:
    """The same scene for the oracle. Lights that can be seen are not visible there."""
    builder = SceneBuilder()
    shown = scene.highlights if highlights is None else highlights
    for row in scene.materials:
        builder.material(
            diffuse=row["diffuse"],
            specular=row["specular"],
            shine=row["shine"],
            transmission=row["transmission"],
            ior=row["ior"],
            highlight=row["highlight"] if shown else 0.0,
        )
    rows = sorted((item for batch in scene.surfaces for item in _rows(batch)), key=lambda item: item[0])
    for number, kind, data, material in rows:
        added = _add(builder, kind, data, material)
        assert added == number, "ids run from 0 without a gap"
    for row in scene.lights:
        _add_light(builder, row)
    camera = oracle_camera(scene.camera, width, height)
    return builder.build(camera, scene.background, max_depth=depth, min_weight=scene.min_weight or 0.0)


def _rows(batch: Batch) -> Iterator[tuple[int, Kind, F64, int]]:
    for k in range(len(batch)):
        polygon = batch.kind == Kind.POLYGON
        data = batch.data[batch.starts[k] : batch.starts[k + 1]] if polygon else batch.data[k]
        yield int(batch.ids[k]), batch.kind, data, int(batch.materials[k])


def _add(builder: SceneBuilder, kind: Kind, data: F64, material: int) -> int:
    if kind == Kind.TRIANGLE:
        return builder.triangle(data.reshape(3, 3), material)
    if kind == Kind.SMOOTH:
        return builder.smooth_triangle(data[:9].reshape(3, 3), data[9:].reshape(3, 3), material)
    if kind == Kind.POLYGON:
        return builder.polygon(data, material)
    if kind == Kind.SPHERE:
        return builder.sphere(data[:3], float(data[3]), material)
    return builder.cone(data[:3], float(data[3]), data[4:7], float(data[7]), material)


def _add_light(builder: SceneBuilder, row: Any) -> None:
    if row["kind"] == DIRECTIONAL:
        builder.directional_light(row["place"], row["intensity"])
        return
    spot = (row["axis"], float(row["cos_inner"]), float(row["cos_outer"])) if row["spot"] else None
    builder.point_light(row["place"], row["intensity"], inverse_square=bool(row["falloff"]), spot=spot)


def oracle_camera(camera: cameras.Camera, width: int, height: int) -> Camera:
    """The oracle measures across the middles of the outermost rows, raygrid's cameras as their files do."""
    rows = height if height > 1 else width
    across = {
        cameras.Span.MIDDLES: 1.0,
        cameras.Span.EDGES: (rows - 1) / height,
        cameras.Span.NARROW: (rows - 1) / min(width, height),
    }
    half = camera.half * across[camera.span]
    ahead = np.add(camera.eye, camera.forward)
    if camera.orthographic:
        return orthographic_camera(camera.eye, ahead, camera.up, half, width, height)
    return nff_camera(camera.eye, ahead, camera.up, math.degrees(2.0 * math.atan(half)), width, height)


def sample_offsets(width: int, height: int, samples: int) -> F64:
    """Where raygrid puts the samples of each pixel, seen from its middle: (height, width, samples, 2)."""
    offsets = np.zeros((height, width, samples, 2))
    _fill_offsets(offsets)
    return offsets


@kernel
def _fill_offsets(offsets):
    height, width, samples, _ = offsets.shape
    for sample in range(height * width * samples):
        pixel = sample // samples
        x, y = image_point(sample, width, samples)
        offsets[pixel // width, pixel % width, sample % samples, 0] = x - pixel % width
        offsets[pixel // width, pixel % width, sample % samples, 1] = y - pixel // width
