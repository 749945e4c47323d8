"""The law of 1983: its fit finds what it was made from, the sweep makes the arrays that were asked for, the report."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace

import numpy as np
import pytest
from support.cli import here, one_line
from support.render import SCENES
from support.timed import job_of, scene_of, simulated

from raygrid.host.machine_time.cost_models import load_cost_model
from raygrid.host.machine_time.plots import check_matplotlib
from raygrid.host.machine_time.scaling_law import KINDS, Point, fit, law, shape_of, sweep, view_axis
from raygrid.node.errors import OutputError


def points_by(kind, values, ns=(1, 2, 3, 4, 6, 8, 12), rays=(100, 1000), power=None, noise=0.0):
    rng = np.random.default_rng(5)
    made = []
    for n in ns:
        for many in rays:
            seconds = float(law(power or KINDS[kind], n, many) @ np.array(values)) * (1.0 + noise * rng.normal())
            made.append(Point("s", kind, n, shape_of(kind, n, 2), many, 1, seconds, 0.5, 0.5, 0))
    return made


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("values", [(0.5, 0.01, 0.03), (0.0, 0.2, 0.001), (3.0, 0.0, 0.2)])
def test_an_exact_law_is_found_again(kind, values):
    found = fit(points_by(kind, values))
    assert found.values == pytest.approx(values, rel=1e-6, abs=1e-9)
    assert found.r2 == pytest.approx(1.0)
    assert np.abs(found.residuals).max() < 1e-6
    assert found.power[0] == pytest.approx(KINDS[kind], abs=0.011)


def test_bounds_hold_the_truth_of_a_noisy_law():
    found = fit(points_by("square", (0.5, 0.02, 0.03), noise=0.03))
    assert (np.abs(found.values - (0.5, 0.02, 0.03)) <= found.bounds).all()
    assert (found.bounds > 0.0).all()
    assert 0.98 < found.r2 < 1.0


def uneven(kind):
    """Frames as of real scenes: another power of n than the law has, and more spread where there are many rays."""
    return points_by(kind, (0.1, 0.004, 0.06), ns=(1, 2, 3, 4, 6, 8, 12, 16), rays=(140, 590, 2400), power=1.3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_fit_lies_through_the_points_and_not_under_them(kind):
    """The geometric mean of T / fit is 1, since the law can be scaled; so half of the points or so lie above it."""
    found = fit(uneven(kind))
    times = np.array([p.seconds for p in found.points])
    fitted = found.time([p.n for p in found.points], [p.rays for p in found.points])
    assert np.exp(np.log(times / fitted).mean()) == pytest.approx(1.0, rel=1e-9)
    assert found.residuals == pytest.approx(np.log(times / fitted))
    assert found.above == np.count_nonzero(times > fitted)
    assert 0.3 * len(times) < found.above < 0.7 * len(times)


@pytest.mark.parametrize("kind", KINDS)
def test_r2_is_that_of_what_was_fitted(kind):
    """On the scale of the fit no law with one value has a smaller sum of squares, so R^2 is never below 0."""
    found = fit(uneven(kind))
    logs = np.log([p.seconds for p in found.points])
    assert found.r2 == pytest.approx(1.0 - np.sum(found.residuals**2) / np.sum((logs - logs.mean()) ** 2))
    flat = fit(points_by(kind, (2.0, 0.0, 0.0), noise=0.2))
    assert -1e-9 < flat.r2 < 0.2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(5))
def test_no_other_values_fit_better(kind, seed):
    """Against scipy's general least squares from many starts."""
    from scipy.optimize import least_squares

    rng = np.random.default_rng(seed)
    points = points_by(kind, rng.lognormal(-3.0, 2.0, 3), power=float(rng.uniform(0.8, 3.2)), noise=0.2)
    logs = np.log([p.seconds for p in points])
    terms = law(KINDS[kind], [p.n for p in points], [p.rays for p in points])

    def off(exponents):
        return logs - np.log(terms @ np.exp(exponents))

    best = min(2.0 * least_squares(off, rng.normal(-3.0, 3.0, 3)).cost for _ in range(20))
    found = fit(points)
    assert np.sum(found.residuals**2) <= best * (1.0 + 1e-6)
    assert (found.values >= 0.0).all()


def test_frames_that_take_no_time_are_refused():
    with pytest.raises(OutputError, match="frames that take no time, wanted scenes that rays meet"):
        fit([replace(point, seconds=0.0) for point in points_by("cubic", (1.0, 0.1, 0.1))])


def test_another_power_is_seen():
    found = fit(points_by("square", (0.0, 0.0, 0.03), power=1.4))
    assert found.power[0] == pytest.approx(1.4, abs=0.011)
    assert found.power[1] - 0.011 <= 1.4 <= found.power[2] + 0.011


@pytest.mark.parametrize("kind", KINDS)
def test_the_best_size_is_where_the_law_is_least(kind):
    found = fit(points_by(kind, (0.1, 0.03, 0.05)))
    ns = np.linspace(0.5, 40.0, 100_000)
    assert found.best(1000) == pytest.approx(ns[np.argmin(found.time(ns, 1000))], abs=0.01)


def test_without_growth_there_is_no_best_size():
    assert fit(points_by("square", (0.1, 0.0, 0.05))).best(100) == np.inf


def test_too_few_frames_are_refused():
    with pytest.raises(OutputError, match=r"came with 4 frames of 2 sizes, wanted 4 or more of 3 sizes"):
        fit(points_by("square", (1.0, 1.0, 1.0), ns=(1, 2)))


def test_shapes_and_the_axis_of_view():
    assert [shape_of("square", 4, axis) for axis in range(3)] == [(1, 4, 4), (4, 1, 4), (4, 4, 1)]
    assert shape_of("cubic", 3, 0) == (3, 3, 3)
    camera = scene_of("tiny.nff").camera.table(3, 3)[0]
    middle = camera["base"] + camera["base_di"] + camera["base_dj"]
    assert view_axis(scene_of("tiny.nff")) == int(np.abs(middle).argmax())


def test_the_sweep_simulates_what_it_says():
    cost = load_cost_model("unit")
    points = sweep(scene_of("tiny.nff"), cost, {"square": (1, 2), "cubic": (2,)}, [(12, 10)], along=2)
    assert [(p.kind, p.shape, p.processors) for p in points] == [
        ("square", (1, 1, 1), 1),
        ("square", (2, 2, 1), 4),
        ("cubic", (2, 2, 2), 8),
    ]
    for point in points:
        assert point.ticks == simulated(job_of("tiny.nff", point.shape, (12, 10)), cost).ticks


def test_command(tmp_path):
    arguments = ["--square", "1,2,3", "--cubic", "1,2,3", "--size", "10x8", "--size", "16x12", "--cost", "unit"]
    done = here("law", str(SCENES / "tiny.nff"), *arguments, "-o", str(tmp_path / "law"))
    assert done.code == 0, done.err
    names = ["law.csv", "law.md", "law_tiny.png"]
    assert done.out.split() == [str(tmp_path / "law" / name) for name in names]
    rows = list(csv.DictReader((tmp_path / "law" / "law.csv").read_text().splitlines()))
    assert len(rows) == 12
    assert {row["kind"] for row in rows} == {"square", "cubic"}
    text = (tmp_path / "law" / "law.md").read_text()
    assert "A + B n + C R / n^2" in text
    assert "| tiny.nff | square |" in text
    assert (tmp_path / "law" / "law_tiny.png").read_bytes().startswith(b"\x89PNG")


def test_without_matplotlib_the_law_names_all_that_it_wants(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(OutputError, match=r"pip install matplotlib scipy$"):
        check_matplotlib("scipy")
    with pytest.raises(OutputError, match=r"pip install matplotlib$"):
        check_matplotlib()


def test_bad_edges_and_folders_are_one_line(tmp_path):
    scene = str(SCENES / "tiny.nff")
    one_line(
        here("law", scene, "--square", "1,x"), 2, r"raygrid law: --square: '1,x' came, wanted edges of 1 to 1024 .*"
    )
    one_line(here("law", scene, "-o", str(tmp_path / "a" / "b")), 1, r"raygrid: .*: there is no directory .*")
