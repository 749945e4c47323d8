"""The benchmark of predictions: its table of however many cases, and an end before the first of them."""

import argparse
import sys
from types import SimpleNamespace

import pytest
from support import paths

from raygrid.host.machine_time.predict import Estimate

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

import predict as bench_predict

ASKED = argparse.Namespace(size="8x8", split="uniform", costs=["unit"], arrays=["2x2x2"])


def case(whole, seconds=1.1):
    told = SimpleNamespace(
        whole=whole, few_rays=False, cost="unit", search="list", array=(2, 2, 2), frame=Estimate(seconds, 0.2),
        set_up=Estimate(1.0, 0.0), read_out=Estimate(1.0, 0.0),
    )  # fmt: skip
    return bench_predict.Case(told, "a.nff", 1.0, 1.0, 1.0, 1.0, 0.25, 4.0)


def test_a_table_tells_of_extrapolated_frames_and_of_all():
    rows = bench_predict.table([case(False), case(True, 1.0)], ASKED)
    assert rows[0].startswith("2 frames of 8x8, uniform split: 1 scenes (a.nff)")
    assert "| all | 1 | 10.00% | 10.00% | 10.00% | 100% | 20.0% |" in rows
    assert rows[-3:-1] == ["Read-out: median 0.00%, worst 0.00%.", "Set-up: median 0.00%, worst 0.00%."]
    assert rows[-1].startswith(
        "Processor seconds of a prediction: median 0.25, most 0.25; of the simulation: median 4.00"
    )


def test_ended_before_the_first_extrapolated_frame_it_says_nothing_of_read_outs():
    rows = bench_predict.table([case(True, 1.0)], ASKED)
    assert "| frames that were simulated as they are | 1 | 0.00% | 0.00% | 0.00% | 100% | 20.0% |" in rows
    assert not any(row.startswith("Read-out") for row in rows)
    assert rows[-2] == "Set-up: median 0.00%, worst 0.00%."


def test_ended_before_the_first_case_it_writes_nothing(tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    output = tmp_path / "predict.md"
    output.write_text(f"{bench_predict.BEGIN}\nan older table\n{bench_predict.END}\n")
    monkeypatch.setattr(bench_predict, "predict", lambda *_, **__: [])
    monkeypatch.setattr(bench_predict, "compare", interrupted)
    scene = str(paths.ROOT / "scenes" / "tiny.nff")
    arguments = [scene, "--array", "2x2x2", "--cost", "unit", "-o", str(output), "--csv", str(tmp_path / "cases.csv")]
    monkeypatch.setattr(sys, "argv", ["predict.py", *arguments])
    with pytest.raises(SystemExit, match="ended before the first case was done: nothing is written"):
        bench_predict.main()
    assert output.read_text().splitlines()[1] == "an older table"
    assert not (tmp_path / "cases.csv").exists()
