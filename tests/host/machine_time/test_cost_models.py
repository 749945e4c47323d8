"""Cost models: the built-in ones, and what is said of bad ones."""

from __future__ import annotations

import importlib.util
import itertools
import re
from pathlib import Path

import pytest
from support import paths
from support.timed import folder

from raygrid.host.machine_time.cost_models import LEVELS, built_in, load_cost_model
from raygrid.node.errors import CostError
from raygrid.node.protocol.counters import BOXES, SENT, TESTS, WALKS

ROOT = paths.ROOT


def test_built_in_files_are_what_the_script_works_out():
    spec = importlib.util.spec_from_file_location("make_costs", ROOT / "benchmarks" / "make_costs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert {f"{name}.toml" for name in built_in()} == set(module.files())
    for name, text in module.files().items():
        assert (folder() / name).read_text() == text, name


@pytest.mark.parametrize("name", ["8086", "8086-soft", "t800", "unit", "modern"])
def test_built_in_models_have_ascending_prices(name):
    model = load_cost_model(name)
    prices = [model.prices(level, "tree") for level in LEVELS]
    for low, high in itertools.pairwise(prices):
        assert (low.counts <= high.counts).all()
        assert low.packet <= high.packet
        assert low.latency <= high.latency
    assert all(price.packet >= 1 and price.latency >= 1 and price.transmit >= 1 for price in prices)


def test_a_list_has_no_price_for_boxes_and_tests_but_for_each_surface_held():
    model = load_cost_model("8086")
    listed, tree = model.prices("middle", "list"), model.prices("middle", "tree")
    assert listed.counts[BOXES] == 0
    assert not listed.counts[TESTS : TESTS + 6].any()
    assert (tree.counts[TESTS : TESTS + 6] == model.tests("middle")).all()
    assert tree.counts[BOXES] > 0
    assert listed.counts[WALKS] == tree.counts[WALKS] > 0
    assert listed.counts[SENT] == tree.counts[SENT] > 0


def test_unit_costs_one_tick():
    prices = load_cost_model("unit").prices("middle", "list")
    assert (prices.packet, prices.transmit, prices.latency, prices.lookahead) == (1, 1, 1, 4)


@pytest.mark.parametrize(
    ("before", "after", "pattern"),
    [
        (
            "latency = [5",
            "latency = [0",
            r"x\.toml, line \d+: link\.latency\[0\] is 0, wanted greater than or equal to 1",
        ),
        ("packet = [", "packet = 0 # [", r"x\.toml, line \d+: ticks\.packet\[0\] is 0, wanted .* 1"),
        ("\nwalk = ", "\nwlk = ", r"x\.toml, line \d+: the key ticks\.wlk is unknown, wanted one of: packet, walk, .*"),
        ("walk = [", "walk = [-", r"x\.toml, line \d+: ticks\.walk\[0\] is -\d+, wanted greater than or equal to 0"),
        ("\nwalk = ", "\nwalk = [9, 8, 10] #", r"x\.toml, line \d+: .* wanted low, middle and high in this order"),
        ("\nwalk = ", "\nwalk = [1, 2] #", r"x\.toml, line \d+: ticks\.walk is \[1, 2\], wanted .* three: low, .*"),
        ("\nwalk = ", "\nwalk = 1.5 #", r"x\.toml, line \d+: ticks\.walk is 1\.5, wanted a whole number or three: .*"),
        ("\nwalk = ", "\n#", r"x\.toml.*: ticks\.walk is missing"),
        ('"processor"', '"nobody"', r"x\.toml, line \d+: link\.moves is 'nobody', wanted 'processor' or 'link'"),
        ("bytes_per_second = ", "bytes_per_second = 0 #", r"x\.toml, line \d+: link\.bytes_per_second is 0, wanted .*"),
        ("[ticks]", "[ticks", r"x\.toml: the TOML cannot be read \(.*\)"),
    ],
)
def test_bad_models_are_named_in_one_sentence(before, after, pattern, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (folder() / "8086.toml").read_text()
    assert before in text
    Path("x.toml").write_text(text.replace(before, after, 1))
    with pytest.raises(CostError, match=f"^{pattern}$"):
        load_cost_model("x.toml")


def test_unknown_names_and_files_are_refused(tmp_path):
    with pytest.raises(CostError, match="a cost model came as '68000', wanted one of 8086, "):
        load_cost_model("68000")
    with pytest.raises(CostError, match=r"no\.toml: the cost model cannot be read \(No such file or directory\)"):
        load_cost_model(str(tmp_path / "no.toml"))
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(CostError, match=r"b\.toml: the TOML cannot be read"):
        load_cost_model(str(tmp_path / "b.toml"))


def test_a_whole_number_is_one_however_it_is_written(tmp_path):
    text = (folder() / "8086.toml").read_text()
    hertz = load_cost_model("8086").file.hertz
    plain = re.sub(r"(?m)^hertz = .*$", f"hertz = {hertz:e}", text)
    (tmp_path / "e.toml").write_text(re.sub(r"(?m)^(latency) = .*$", r"\1 = 5e1", plain))
    model = load_cost_model(str(tmp_path / "e.toml"))
    assert (model.file.hertz, model.file.link.latency) == (hertz, (50, 50, 50))
    (tmp_path / "half.toml").write_text(re.sub(r"(?m)^hertz = .*$", "hertz = 5.5", text))
    with pytest.raises(CostError, match=r"hertz is 5\.5, wanted a valid integer"):
        load_cost_model(str(tmp_path / "half.toml"))
