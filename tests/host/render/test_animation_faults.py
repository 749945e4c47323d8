"""A fault amid a shot: a node is killed between and during increments; all frames have the right bits."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from support.processes import no_leftovers
from support.render import SCENES

from raygrid.emulator.driver.driver import Driver
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.host.render.animation_jobs import jobs_of
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings
from raygrid.host.render.session import RenderSession
from raygrid.host.scene.load import load_scene

__all__ = ["no_leftovers"]
pytestmark = [pytest.mark.timeout(180), pytest.mark.usefixtures("quick_records")]
SHAPE, FRAMES = (2, 2, 1), (10, 11, 12)
SETTINGS = Settings(size=(48, 36), samples=1)


@cache
def truth() -> list[np.ndarray]:
    array = MemoryArray((1, 1, 1))
    array.driver.patience = 60.0
    array.driver.ready()
    scene = load_scene(SCENES / "mobile.toml")
    return [render_job(array.driver, job).sums for job in jobs_of(scene, (1, 1, 1), SETTINGS, FRAMES)]


@pytest.fixture(scope="module")
def array() -> Iterator[Array]:
    with Array.launch(SHAPE, patience=60.0) as launched:
        yield launched


def kill(array: Array, node: int) -> None:
    os.kill(array.pids[node], signal.SIGKILL)


@pytest.mark.parametrize("order", ["between", "move", "hand", "loaded", "build"])
def test_a_node_killed_between_and_during_increments(array, monkeypatch, order):
    """Before the named order of the second frame's increment, node 3 is killed."""
    scene = load_scene(SCENES / "mobile.toml")
    wave, killed, orders = Driver.wave, [], []

    def listening(self, told):
        orders.append(told["do"] if isinstance(told, dict) else "trace")
        if orders[-1] == order and orders.count("collect") >= 1 and not killed:
            killed.append(order)
            kill(array, 3)
        return wave(self, told)

    monkeypatch.setattr(Driver, "wave", listening)
    pictures = []
    for job in jobs_of(scene, SHAPE, SETTINGS, FRAMES):
        if order == "between" and job.number == FRAMES[1]:
            killed.append(order)
            kill(array, 3)
        pictures.append(RenderSession(array).render(job))
    assert killed == [order]
    assert all(np.array_equal(picture.sums, sums) for picture, sums in zip(pictures, truth(), strict=True))
    assert [len(picture.stats["faults"]) for picture in pictures] == [0, 1, 0]
    # after the fault the present frame was loaded whole, and the next one was an increment again
    after = orders[len(orders) - 1 - orders[::-1].index("space") :]
    assert "move" in after
    assert after.index("move") > after.index("collect")
