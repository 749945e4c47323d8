"""The law of 1983: its fit finds what it was made from, the sweep makes the arrays that were asked for, the report."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from support_cli import here, one_line
from support_render import SCENES
from support_timed import job_of, scene_of, simulated

from raygrid.host.cost_models import load_cost_model
from raygrid.host.law import KINDS, Point, fit, law, shape_of, sweep, view_axis
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


def test_bad_edges_and_folders_are_one_line(tmp_path):
    scene = str(SCENES / "tiny.nff")
    one_line(
        here("law", scene, "--square", "1,x"), 2, r"raygrid law: --square: '1,x' came, wanted edges of 1 to 1024 .*"
    )
    one_line(here("law", scene, "-o", str(tmp_path / "a" / "b")), 1, r"raygrid: .*: there is no directory .*")
