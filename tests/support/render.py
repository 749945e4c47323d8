"""Pictures by the array inside one process, and how near two pictures are."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.image.picture import Picture
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.scene.scene import Scene
from support import paths

F64 = NDArray[np.float64]
Shape = tuple[int, int, int]

SCENES = paths.SCENES
SHARED = paths.SHARED / "scenes"
ONE, EIGHT = (1, 1, 1), (2, 2, 2)
NOTICEABLE = 2.0 / 255.0  # a difference in linear radiance that counts as one


def shared(*names: str) -> Path:
    """A file of the scenes that are not kept in this repository; skips the test where they are missing."""
    path = SHARED.joinpath(*names)
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path


def rendered(scene: Scene, shape: Shape = ONE, **settings: Any) -> Picture:
    """The scene by an array inside this process. Settings as of `raygrid.host.render.job.Settings`."""
    array = MemoryArray(shape)
    array.driver.ready()
    return render_job(array.driver, make_job(scene, shape, Settings(**settings)))


def psnr(picture: F64, truth: F64) -> float:
    """Peak signal to noise ratio of linear pictures in decibels, the peak being 1."""
    error = float(np.mean((picture - truth) ** 2))
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


def noticeable(picture: F64, truth: F64) -> float:
    """The part of the pixels of which a channel is off by more than 2/255."""
    return float(np.mean((np.abs(picture - truth) > NOTICEABLE).any(axis=2)))
