"""The measuring suite: what it makes of figures, how it runs commands, and one quick run of it. No test of speed."""

import math
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from support import paths

from raygrid.host.scene.load import load_scene

ROOT = paths.ROOT
sys.path.insert(0, str(ROOT / "benchmarks"))

import bench  # noqa: E402
import bench_arrays  # noqa: E402
import bench_embree  # noqa: E402
import bench_povray  # noqa: E402
import bench_run  # noqa: E402
from bench_run import BenchError  # noqa: E402
from bench_tables import (  # noqa: E402
    MARK,
    Section,
    Table,
    document,
    geometric_mean,
    number,
    ratio,
    spread,
    with_head_kept,
)
from big_mesh import write_ring  # noqa: E402

NAN = math.nan

# --- figures -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (1, "1.00"), (12.345, "12.3"), (123.456, "123"), (98765.4, "98765"), (0.01234, "0.0123"), (NAN, "-")],
)
def test_numbers_have_three_digits_and_no_exponent(value, text):
    assert number(value) == text


def test_spreads_show_the_median_and_what_it_lies_between():
    assert str(spread([3.0, 1.0, 2.0])) == "2.00 (1.00 - 3.00)"
    assert str(spread([0.25])) == "0.250"
    with pytest.raises(ValueError, match="no measurements"):
        spread([])


def test_ratios_are_of_medians():
    assert ratio(spread([1, 9, 2]), spread([4, 0.1, 8])) == 0.5
    assert math.isnan(ratio(spread([1]), spread([0])))


def test_geometric_mean():
    assert geometric_mean([1.0, 4.0]) == pytest.approx(2.0)
    assert geometric_mean([8.0]) == pytest.approx(8.0)
    assert math.isnan(geometric_mean([]))


# --- Markdown ------------------------------------------------------------------------------------


def test_tables():
    table = Table(("a", "b"))
    table.add("x | y", spread([1.5]))
    assert table.lines() == ["| a | b |", "| --- | --- |", "| x \\| y | 1.50 |"]
    with pytest.raises(ValueError, match=r"a row has 1 cells, wanted 2 \(a, b\)"):
        table.add(1)


def test_targets_are_met_or_not_and_left_out_without_a_figure():
    section = Section("x")
    section.expect("fast", 0.5, 1.0, at_most=True, unit=" s")
    section.expect("as fast as that", 1.0, 1.0, at_most=False)
    section.expect("slow", 1.5, 1.0, at_most=True)
    section.expect("unknown", NAN, 1.0, at_most=True)
    assert [(t.what, t.wanted, t.came, t.met) for t in section.targets] == [
        ("fast", "at most 1.00 s", "0.500 s", True),
        ("as fast as that", "at least 1.00", "1.00", True),
        ("slow", "at most 1.00", "1.50", False),
    ]


def test_documents_begin_with_the_targets_and_keep_what_was_written_above_them():
    section = Section("Part")
    section.say("Words.")
    section.table("k").add("v")
    section.expect("it", 2.0, 1.0, at_most=True)
    text = document(["## Head"], [section])
    assert text.startswith(MARK)
    lines = [line for line in text.splitlines() if line]
    assert lines[1:3] == ["## Head", "## Targets"]
    assert "| it | at most 1.00 | 2.00 | NO |" in lines
    assert lines[-5:] == ["## Part", "Words.", "| k |", "| --- |", "| v |"]
    assert with_head_kept("By hand.\n\n" + document([], []), text) == "By hand.\n\n" + text
    assert with_head_kept("something else", text) == "# Performance\n\n" + text


# --- running -------------------------------------------------------------------------------------

BURN = "import time\nwhile time.process_time() < 0.2: pass\n"


def test_a_run_counts_the_cpu_of_processes_that_its_processes_started():
    nested = f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', {BURN!r}])\n"
    deeper = f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', {nested!r}])\n"
    done = bench_run.run([sys.executable, "-c", deeper])
    assert done.cpu >= 0.2
    assert done.wall > 0.0


def test_a_run_keeps_what_was_said_and_sees_the_memory_of_all():
    inner = "held = b'y' * 50_000_000\n" + BURN.replace("0.2", "1.0")
    program = "import subprocess, sys\nheld = b'x' * 50_000_000\nprint('said')\n"
    program += f"subprocess.run([sys.executable, '-c', {inner!r}])\n"
    done = bench_run.run([sys.executable, "-c", program], watch_memory=True)
    assert done.output == "said\n"
    assert done.memory > 90_000_000


def test_a_command_that_fails_is_one_sentence():
    with pytest.raises(BenchError, match=r"failed with 3: last words$"):
        bench_run.run([sys.executable, "-c", "import sys; print('first'); print('last words'); sys.exit(3)"])
    with pytest.raises(BenchError, match=r"^no-such-program cannot be started \(No such file or directory\)$"):
        bench_run.run(["no-such-program"])


def test_runs_alternate(capsys):
    order = []
    turns = {name: (lambda name=name: order.append(name) or len(order)) for name in "AB"}
    assert bench_run.alternating(3, turns) == {"A": [1, 3, 5], "B": [2, 4, 6]}
    assert order == list("ABABAB")
    assert "B, run 3 of 3" in capsys.readouterr().err


def test_scenes_that_are_missing_are_named(monkeypatch, tmp_path):
    monkeypatch.setattr(bench_run, "SHARED", tmp_path)
    first, second = bench_arrays.scenes(("tiny.nff", "balls_3"))
    assert first == ROOT / "scenes" / "tiny.nff"
    assert str(second).startswith("skipped: balls_3.nff is not in $RAYGRID_SHARED")
    section = bench_arrays.measure_overhead(1, ("balls_3",), ("1x1x1",), 64)
    assert "| skipped: balls_3.nff is not in" in "\n".join(section.lines())


def test_paths_are_shown_as_a_reader_can_use_them():
    assert bench_run.shown(ROOT / "scenes" / "tiny.nff") == "scenes/tiny.nff"
    assert bench_run.shown(bench_run.SHARED / "scenes" / "spd" / "x.nff") == "$RAYGRID_SHARED/scenes/spd/x.nff"


# --- other programs ------------------------------------------------------------------------------


def test_without_povray_the_part_says_so(monkeypatch):
    monkeypatch.setattr(bench_povray.shutil, "which", lambda name: None)
    assert bench_povray.povray_version() == "not installed"
    with pytest.raises(BenchError, match=r"^skipped: povray is not installed$"):
        bench_povray.measure(1, ("tetra_6",))


def test_the_log_of_povray():
    log = "Parser Time\n  Parse Time:       0 hours  0 minutes  0 seconds (0.052 seconds)\n"
    log += "              using 1 thread(s) with 0.050 CPU-seconds total\n  Photon Time:      No photons\n"
    log += "  Trace Time:       0 hours  1 minutes  2 seconds (62.968 seconds)\n"
    log += "              using 2 thread(s) with 120.5 CPU-seconds total\n"
    found = bench_povray.seconds_in(log)
    assert found == {"parse": 0.052, "parse cpu": 0.05, "trace": 62.968, "trace cpu": 120.5}
    with pytest.raises(BenchError, match="without its trace time"):
        bench_povray.seconds_in("Render failed")


def test_pixels_that_differ(tmp_path):
    pixels = np.zeros((2, 4, 3), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    pixels[0, 0, 1], pixels[1, 2, 0] = 2, 3
    Image.fromarray(pixels).save(tmp_path / "b.png")
    assert bench_povray.part_off(tmp_path / "a.png", tmp_path / "b.png") == 1 / 8


def test_the_table_of_the_embree_script():
    head = "closest hits, million rays a second; 262144 rays, 9 runs, medians\nmesh tri rays raygrid\n"
    line = "tetra_6       4096 eye      10.43 (8.61 - 11.27)     12.10 (11.58 - 12.31)   29 (2 - 3)   0.86   100.000\n"
    assert bench_embree.ratios_in(head + line) == [("tetra_6", "eye", 0.86)]
    assert bench_embree.ratios_in("skipped: embreex is not installed, so nothing\n") == []


def test_the_large_mesh_is_one_closed_surface(tmp_path):
    count = write_ring(tmp_path / "ring.ply", 2000)
    batch = load_scene(tmp_path / "ring.ply").surfaces.batches[0]
    assert 1900 <= count == len(batch) <= 2000
    corners = np.round(batch.data[:, :9].reshape(-1, 3, 3), 6)  # what follows are normals
    _, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = numbers.reshape(-1, 3)
    ways = np.concatenate([faces[:, (k, (k + 1) % 3)] for k in range(3)])
    there = {tuple(edge) for edge in ways.tolist()}
    assert len(there) == len(ways)  # each edge is walked once in each direction
    assert {(b, a) for a, b in there} == there


# --- the program ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--only", "c,x"], "--only x came, wanted letters of a b c d e f"),
        (["--only", ","], "--only nothing came"),
        (["--runs", "0"], "--runs 0 came, wanted 1 or more"),
        (["--write", "/no/such/place.md"], "there is no directory /no/such"),
    ],
)
def test_wrong_options_end_with_a_line(arguments, words, capsys):
    with pytest.raises(SystemExit, match="2"):
        bench.parse(arguments)
    assert words in capsys.readouterr().err


@pytest.mark.timeout(300)  # a first run compiles
def test_a_quick_run(tmp_path, no_leftovers):
    (tmp_path / "out.md").write_text(f"By hand.\n{MARK}\nold figures\n")
    command = [sys.executable, str(ROOT / "benchmarks" / "bench.py"), "--quick", "--only", "c", "--write", "out.md"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "out.md").read_text()
    assert text.startswith(f"By hand.\n{MARK}\n\n## The suite\n")
    assert text.endswith(done.stdout)
    assert "old figures" not in text
    for row in (
        "`raygrid --help`, whole",
        "a tiny scene, from shell to picture, whole",
        "2x2x2 ready after the warm-up",
    ):
        line = next(line for line in text.splitlines() if line.startswith(f"| {row} |"))
        seconds, command = (cell.strip() for cell in line.split("|")[2:4])
        assert float(seconds) > 0.0
        assert command.startswith("`")
