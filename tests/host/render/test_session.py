"""Frames one after the other on one array: what is loaded, what is moved, and what the array holds already."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.render import SCENES

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.render.animation_jobs import jobs_of
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.render.session import RenderSession
from raygrid.host.scene.load import load_scene

SHAPE = (2, 1, 1)
SETTINGS = Settings(size=(24, 18), samples=1, split="uniform")


@cache
def still(load_key: str = "") -> Job:
    return replace(make_job(load_scene(SCENES / "tiny.nff"), SHAPE, SETTINGS), load_key=load_key)


@cache
def moving() -> tuple[Job, ...]:
    jobs = jobs_of(load_scene(SCENES / "mobile.toml"), SHAPE, SETTINGS, [3, 4, 9])
    return tuple(replace(job, load_key=f"frame {job.number}") for job in jobs)


@pytest.fixture
def session() -> RenderSession:
    """On an array inside this process, that loses nothing."""
    array = MemoryArray(SHAPE)
    array.driver.ready()
    lent: Any = SimpleNamespace(driver=array.driver, injected=0)
    return RenderSession(lent)


def loads(session: RenderSession, job: Job) -> tuple[int, int]:
    """How many floods and increments a frame costs; its picture is that of an array of its own."""
    before = session.floods, session.increments
    alone = MemoryArray(SHAPE)
    alone.driver.ready()
    lent: Any = SimpleNamespace(driver=alone.driver, injected=0)
    expected = RenderSession(lent).render(job).sums
    assert np.array_equal(session.render(job).sums, expected)
    return session.floods - before[0], session.increments - before[1]


def test_a_scene_without_a_key_is_loaded_for_every_frame(session):
    assert [loads(session, still()) for _ in range(2)] == [(1, 0), (1, 0)]


def test_a_scene_that_is_held_by_its_key_is_not_loaded_again(session):
    assert [loads(session, still("held")) for _ in range(2)] == [(1, 0), (0, 0)]
    assert loads(session, still("another")) == (1, 0)
    assert loads(session, still("held")) == (1, 0)


def test_frames_of_an_animation_follow_each_other_by_increments(session):
    three, four, nine = moving()
    assert [loads(session, job) for job in (three, three, four, nine)] == [(1, 0), (0, 0), (0, 1), (0, 1)]
    assert loads(session, still("held")) == (1, 0)
    assert loads(session, nine) == (1, 0)


def test_what_a_load_that_failed_has_left_is_not_held(session, monkeypatch):
    loads(session, still("held"))
    driver = session.array.driver
    with monkeypatch.context() as patch:
        patch.setattr(driver, "_wait_arrived", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            session.render(still("another"))
    assert driver.held is None
    assert loads(session, still("held")) == (1, 0)
