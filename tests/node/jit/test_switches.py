"""Variables that turn fast paths off: what they say, and that each is said to people who look for it."""

from __future__ import annotations

import re

import pytest
from support import paths

from raygrid.node.jit import switches
from raygrid.node.jit.switches import FAST_LOAD, SWITCHES, Switch, code_state, why_off

SWITCH = Switch("RAYGRID_NO_SUCH_PATH", changes_code=True)


def never(about, text):
    raise AssertionError(text)


@pytest.mark.parametrize(("value", "off"), [(None, False), ("", False), ("1", False), ("0", True)])
def test_a_path_is_off_by_0_alone(monkeypatch, value, off):
    monkeypatch.delenv(SWITCH.variable, raising=False)
    if value is not None:
        monkeypatch.setenv(SWITCH.variable, value)
    assert why_off(SWITCH, never) == (f"{SWITCH.variable}=0 asks for it" if off else None)


@pytest.mark.parametrize("value", ["off", "no", "00", " 0"])
def test_what_is_neither_is_told_and_leaves_the_path_on(monkeypatch, value):
    monkeypatch.setenv(SWITCH.variable, value)
    told = []
    assert why_off(SWITCH, lambda *words: told.append(words)) is None
    assert told == [(SWITCH.variable, f"{SWITCH.variable} came as {value!r}, wanted 0 or 1: it stays on")]


def test_kernels_are_kept_apart_where_their_code_is_another(monkeypatch):
    monkeypatch.setattr(switches, "SWITCHES", (SWITCH, FAST_LOAD))
    monkeypatch.setenv(FAST_LOAD.variable, "0")
    monkeypatch.delenv(SWITCH.variable, raising=False)
    assert code_state() == ()
    monkeypatch.setenv(SWITCH.variable, "0")
    assert code_state() == (SWITCH.variable,)


@pytest.mark.parametrize("place", ["docs/doctor.md", "Makefile"])
def test_every_switch_is_written_down(place):
    """In the document, and in the target that runs the tests with each of them."""
    named = set(re.findall(r"RAYGRID_[A-Z_]+", (paths.ROOT / place).read_text()))
    assert {switch.variable for switch in SWITCHES} <= named
