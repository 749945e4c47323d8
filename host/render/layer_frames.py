"""Traces the layers of a picture: frames of one sample a pixel over the surfaces that the array holds already.

In such a frame the nodes spawn nothing where a primary ray ends, and send facts of the hit home as if they were light
(`node.tracing.layer_values`): so layers need no other packets, and no node has to know of more than its own part.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.driver import BUDGET, Driver
from raygrid.host.image.layer_names import checked_layers
from raygrid.host.image.picture import Picture
from raygrid.host.render.frame import Watch, check_samples
from raygrid.host.render.machine_job import Job
from raygrid.host.scene.surface_runs import surface_runs
from raygrid.node.protocol import LAYER_DEPTH, LAYER_NORMAL, LAYER_SURFACE
from raygrid.node.tracing import read_distances, read_normals, read_surfaces

TOLD_BY = {"depth": LAYER_DEPTH, "normal": LAYER_NORMAL, "surface": LAYER_SURFACE, "material": LAYER_SURFACE}


def with_layers(
    driver: Driver,
    job: Job,
    picture: Picture,
    budget: int = BUDGET,
    watch: Watch | None = None,
    prices: dict[str, Any] | None = None,
) -> Picture:
    """Add to a job's picture the layers that its settings ask for; the array must hold the job's surfaces still.

    The picture's sums and what its statistics say of the machine stay; wall_seconds gets "layers", and the statistics
    "layers": `surface_runs` of what is seen, if numbers of surfaces or materials were asked for.
    Raises ArrayError and its kinds.
    """
    wanted = checked_layers(job.settings.layers)
    if not wanted:
        return picture
    if watch is not None:
        watch("layers", None)
    begun = time.perf_counter()
    found: dict[str, NDArray[Any]] = {}
    for number in sorted({TOLD_BY[layer] for layer in wanted}):
        found |= _read(job, number, _trace(driver, job, number, budget, prices))
    picture.stats["wall_seconds"]["layers"] = round(time.perf_counter() - begun, 6)
    if "surface" in found:
        picture.stats["layers"] = surface_runs(job.scene, np.unique(found["surface"]))
    size = job.frame.height, job.frame.width
    layers = {layer: found[layer].reshape(*size, *found[layer].shape[1:]) for layer in wanted}
    return replace(picture, layers=layers)


def _trace(driver: Driver, job: Job, number: int, budget: int, prices: dict[str, Any] | None) -> NDArray[np.int64]:
    """The sums of a layer's frame, int64 (pixels, 3)."""
    frame = job.frame._replace(samples=1, layer=number)
    driver.trace(frame, budget, None, prices)
    sums, samples = driver.collect(job.pixels)
    check_samples(replace(job, frame=frame), samples)
    return sums


def _read(job: Job, number: int, sums: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """The layers that a frame tells, a row a pixel."""
    if number == LAYER_DEPTH:
        return {"depth": (read_distances(sums) / job.world.scale).astype(np.float32)}
    if number == LAYER_NORMAL:
        return {"normal": read_normals(sums)}
    surfaces, materials = read_surfaces(sums)
    return {"surface": surfaces, "material": materials}
