"""Three laws side by side: each finds what it was made from, scenes are told by the others, few rays are kept apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from raygrid.host.machine_time.law_rivals import RIVALS, errors, fit_rival, has_few_rays, rivals_of
from raygrid.host.machine_time.law_rivals_report import rival_rows, rivals_figure
from raygrid.host.machine_time.scaling_law import Point, law, shape_of


def frames(time_of, scenes=("a", "b", "c"), ns=(1, 2, 4, 8), rays=(2_000, 20_000)):
    """Frames whose imbalance differs by scene and size; time_of(n, rays, imbalance) in seconds."""
    made = []
    for number, scene in enumerate(scenes):
        for n in ns:
            for many in rays:
                imbalance = 1.0 + (number + 1) * 0.3 * np.log2(n)
                seconds = time_of(n, many, imbalance)
                work = 0.01 * many * imbalance / n**2  # of the busiest
                busiest = min(work / seconds, 1.0)
                shape = shape_of("square", n, 2)
                made.append(Point(scene, "square", n, shape, many, 1, seconds, busiest / imbalance, busiest, 0))
    return made


MADE = {
    "1983": lambda n, rays, imbalance: float(law(2, n, rays) @ [0.5, 0.2, 0.03]),
    "imbalance": lambda n, rays, imbalance: 0.5 + 0.2 * n + 0.03 * imbalance * rays / n**2,
    "busiest": lambda n, rays, imbalance: 1.05 * 0.01 * rays * imbalance / n**2 + 0.3 + 0.1 * n,
}
VALUES = {"1983": (0.5, 0.2, 0.03), "imbalance": (0.5, 0.2, 0.03), "busiest": (1.05, 0.3, 0.1)}


@pytest.mark.parametrize("name", RIVALS)
def test_each_law_finds_what_it_was_made_from(name):
    found = fit_rival(name, frames(MADE[name]))
    assert found.values == pytest.approx(VALUES[name], rel=1e-5)
    assert found.r2 == pytest.approx(1.0)
    assert found.outside.worst < 1e-5
    assert found.few is None


def test_laws_without_the_imbalance_miss_frames_that_have_it():
    found = {fit.name: fit for fit in rivals_of(frames(MADE["busiest"]))}
    assert found["busiest"].outside.median < 1e-6 < 0.05 < found["1983"].outside.median
    assert found["busiest"].r2 > found["1983"].r2


def test_a_scene_is_told_by_the_others():
    """A scene with twice the time of the others: they tell half of it, and it is not fitted to itself."""
    points = [replace(p, seconds=2.0 * p.seconds) if p.scene == "a" else p for p in frames(MADE["1983"])]
    found = fit_rival("1983", points)
    told = [t / p.seconds for t, p in zip(found.told, found.frames, strict=True) if p.scene == "a"]
    assert told == pytest.approx([0.5] * len(told), rel=1e-5)
    assert found.inside.worst < found.outside.worst


def test_few_rays_are_kept_apart():
    points = frames(MADE["1983"], ns=(1, 2, 4, 8, 32))
    few = [p for p in points if has_few_rays(p)]
    assert {(p.n, p.rays) for p in few} == {(32, 2_000)}
    slow = [replace(p, seconds=3.0 * p.seconds) if p in few else p for p in points]
    found = fit_rival("1983", slow)
    assert found.few.frames == len(few)
    assert found.few.median == pytest.approx(2.0, rel=1e-4)
    assert found.outside.worst < 1e-5  # the slow ones had no say


def test_a_single_scene_has_nothing_out_of_sample():
    found = fit_rival("busiest", frames(MADE["busiest"], scenes=("a",)))
    assert found.outside is None
    assert "With a single scene there is nothing out of sample" in "\n".join(rival_rows([found], 1))


def test_frames_whose_others_are_too_few_are_not_out_of_sample():
    """Eight frames can be fitted and tell the four of b; those four cannot tell the eight of a."""
    points = frames(MADE["1983"], scenes=("a",)) + frames(MADE["1983"], scenes=("b",), ns=(1, 2))
    few = replace(points[0], rays=1, seconds=1.0)
    found = fit_rival("1983", [*points, few, replace(few, scene="b", seconds=2.0)])
    assert (found.inside.frames, found.outside.frames, found.few.frames) == (12, 4, 1)
    assert [p.scene for p, told in zip(found.frames, found.by_others, strict=True) if told] == ["b"] * 5
    said = "square: 9 of 13 frames are not told out of sample: the other scenes have fewer than the 6 frames"
    assert said in "\n".join(rival_rows(rivals_of([*points, few]), 2))


def test_two_scenes_too_small_to_tell_each_other_have_nothing_out_of_sample():
    points = frames(MADE["1983"], scenes=("a", "b"), ns=(1, 2))
    found = fit_rival("1983", [*points, replace(points[0], rays=1)])
    assert (found.inside.frames, found.outside, found.few) == (8, None, None)


def test_too_few_frames_are_not_fitted():
    assert fit_rival("busiest", frames(MADE["busiest"], scenes=("a",), ns=(1, 2))) is None
    assert "too few frames" in "\n".join(rival_rows([], 2))


def test_errors_are_factors_less_one():
    found = errors(np.log([2.0, 0.5, 1.0, 1.0, 1.0]))
    assert (found.frames, found.median, found.worst) == (5, 0.0, pytest.approx(1.0))
    assert errors(np.zeros(0)) is None


def test_rows_and_plot(tmp_path):
    fits = rivals_of(frames(MADE["busiest"]))
    rows = "\n".join(rival_rows(fits, 3))
    for name, (formula, _) in RIVALS.items():
        assert f"| {name}: {formula}, 2 (square) |" in rows
    assert "square: T = 1.0500 W + 0.3 s + 0.1 s n." in rows
    figure = rivals_figure(fits)
    assert [axis.get_title().split(":")[0] for axis in figure.axes] == list(RIVALS)
