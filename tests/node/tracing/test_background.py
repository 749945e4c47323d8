"""What the host adds for samples that miss the world box, and what it looks at again; against slow definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import paths
from support.cases import steady

from raygrid.host.render import frame
from raygrid.host.render.frame import _some_lacking, add_misses
from raygrid.host.render.job import Settings, make_job, rays_enter
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import Garbled
from raygrid.node.geometry.lattice import HALF

TINY = paths.SCENES / "tiny.nff"


@pytest.fixture(scope="module")
def job():
    return make_job(load_scene(TINY), (1, 1, 1), Settings(size=(40, 30), samples=3))


@steady(100)
@given(st.lists(st.integers(0, 2), max_size=60), st.integers(1, 9), st.integers(1, 7))
def test_pixels_that_lack_samples_are_found_whatever_the_blocks(counts, block, checked):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frame, "BLOCK", block)
        patch.setattr(frame, "CHECKED", checked)
        lacking = [k for k, count in enumerate(counts) if count != 2]
        found = _some_lacking(np.array(counts, np.uint16), 2)
        assert found.tolist() == lacking[:: len(lacking) // checked + 1]


@pytest.mark.parametrize("kind", [np.uint16, np.int64])
@pytest.mark.parametrize("block", [1, 7, 1 << 16])
def test_the_background_is_added_for_every_sample_that_is_missing(job, kind, block, monkeypatch):
    monkeypatch.setattr(frame, "BLOCK", block)
    monkeypatch.setattr(frame, "_check_missing", lambda job, samples: None)
    samples = np.random.default_rng(2).integers(0, 4, job.pixels).astype(kind)
    sums = np.random.default_rng(3).integers(0, 1 << 40, (job.pixels, 3))
    units = np.floor(np.array(job.frame.background) * 2.0**24 + 0.5).astype(np.int64)
    assert units.any()
    wanted = sums + (3 - samples.astype(np.int64))[:, None] * units
    add_misses(job, sums, samples)
    np.testing.assert_array_equal(sums, wanted)


def test_too_many_and_too_few_samples_are_told(job):
    sums, samples = np.zeros((job.pixels, 3), np.int64), np.full(job.pixels, 3, np.uint16)
    middle = job.pixels // 2 + 20
    samples[middle] = 4
    with pytest.raises(Garbled, match=f"^pixel {middle} came with more samples than the 3 it has$"):
        add_misses(job, sums, samples)
    samples[middle] = 2
    with pytest.raises(Garbled, match=f"^pixel {middle} came without all its samples, though its rays enter"):
        add_misses(job, sums, samples)
    assert not sums.any()


def test_rays_enter_as_the_slab_test_of_each_says(job):
    rng = np.random.default_rng(4)
    i, j = rng.uniform(-30, 70, 500), rng.uniform(-30, 60, 500)
    camera, half = job.frame.camera, HALF * np.array(job.space.step)
    for shrink in (0.0, 0.2):
        found = rays_enter(job, i, j, shrink)
        assert 0 < found.sum() < 500
        for k in range(500):
            at = np.array([1.0, i[k], j[k]])
            origin, direction = at @ camera[:3], at @ camera[3:]
            one, two = (-half + shrink - origin) / direction, (half - shrink - origin) / direction
            assert found[k] == (max(np.minimum(one, two).max(), 0.0) <= np.maximum(one, two).min())
