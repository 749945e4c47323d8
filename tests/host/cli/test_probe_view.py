"""Probes on a terminal: maps on a scale that stays, a table of the busiest, and all of it in a small one."""

from __future__ import annotations

import math
import re

import pytest
from support.probes import filled, made, text_of

from raygrid.host.cli.probe_view import MOST_ROWS, SHADES, heat_maps, level, scale, view
from raygrid.host.probes.sums import Gauges


def test_the_view_has_a_row_a_node_and_a_map_a_layer():
    gauges = Gauges((3, 2, 2))
    for time, cpu in ((1.0, 0.0), (2.0, 1.0)):
        for z in range(2):
            for y in range(2):
                for x in range(3):
                    if (x, y, z) != (2, 1, 1):
                        gauges.take(made(node=(x, y, z), time=time, cpu=cpu * x / 2))
    shown = text_of(view(gauges))
    assert "3x2x2: 11 of 12 nodes, trace; busy 5.00 processors" in shown
    assert "1,0,1 trace 0.50" in " ".join(shown.split())
    maps, told = heat_maps(gauges)
    assert [line.plain.rstrip() for line in maps] == [
        "z=0         z=1",
        " 1|  ##@@    1|  ##??",
        " 0|  ##@@    0|  ##@@",
        " x 0 1 2     x 0 1 2",
    ]
    assert told == "x to the right, y upwards"


@pytest.mark.parametrize(("width", "height"), [(80, 24), (60, 20), (80, 23), (60, 19), (120, 50), (60, 16)])
@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 2, 2), (3, 3, 3), (4, 4, 4), (10, 10, 1), (16, 16, 16), (40, 1, 40)])
def test_the_view_fits_into_the_terminal(shape, width, height):
    """All of it: the summary, maps with their axes, the scale, and the busiest nodes."""
    shown = text_of(view(filled(shape, lambda x, y, z: (x + y + z) / sum(shape)), width, height), width).rstrip("\n")
    lines = shown.split("\n")
    assert len(lines) <= height, shown
    assert max(map(len, lines)) <= width
    assert "z=" in shown
    assert any(line.startswith("busy") and "." in line and "@" in line for line in lines), shown
    assert any(line.lstrip().startswith("x 0") for line in lines)
    table = lines[next(k for k, line in enumerate(lines) if line.startswith("node ")) + 1 :]
    busiest = [float(line.split()[2 if width >= 80 else 1]) for line in table if line[:1].isdigit()]
    assert len(busiest) >= min(3, math.prod(shape))
    assert busiest == sorted(busiest, reverse=True)
    if shape == (3, 3, 3):
        assert {"z=0", "z=1", "z=2"} <= set(shown.split())
        assert sum(line.count("|") for line in lines) == 9


def test_an_idle_array_is_blank():
    idle, at_work = filled((3, 3, 3), lambda *_: 0.01), filled((3, 3, 3), lambda *_: 0.07)
    for gauges, shade in ((idle, "  "), (at_work, "--")):
        maps, _ = heat_maps(gauges)
        rows = [line.plain for line in maps if "|" in line.plain]
        assert all(row.count(f"|{shade * 3}") == 3 for row in rows), rows


def test_the_shades_are_shares_of_a_processor():
    assert [level(busy) for busy in (0.0, 0.0199, 0.02, 0.05, 0.5, 0.8, 1.0)] == [0, 0, 1, 2, 7, 9, 9]
    for width in (80, 60):
        words = scale(width)
        assert len(words) <= width
        assert all(shade in words for shade in SHADES)
        assert ".02" in words


def test_maps_of_a_large_array_show_the_busiest_of_several_nodes():
    maps, told = heat_maps(filled((20, 20, 9), lambda x, y, z: float((x, y, z) in ((7, 3, 4), (0, 0, 8)))), 40, 12)
    text = "\n".join(line.plain for line in maps)
    assert text.count("@") == 2
    assert {"z=4", "z=8"} <= set(text.split())
    assert re.fullmatch(r"x right, y up; busiest of (\d+)x\1 nodes; \d busiest of 9 layers", told)


def test_a_large_array_shows_its_busiest_nodes():
    gauges = Gauges((10, 10, 1))
    for time in (1.0, 2.0):
        for k in range(100):
            gauges.take(made(node=(k % 10, k // 10, 0), time=time, cpu=(time - 1) * k / 100))
    shown = text_of(view(gauges))
    assert f"the {MOST_ROWS} busiest of 100 nodes" in shown
    assert "9,9,0 trace 0.99 1 1 2 3 5 5 1MB 8,9,0 trace 0.98" in " ".join(shown.split()).replace(
        " 0 1 2 3", " 1 1 2 3"
    )
    assert "0,0,0" not in shown
