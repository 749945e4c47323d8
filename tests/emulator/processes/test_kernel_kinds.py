"""What is said of kernels that are compiled, and that the time it takes is no part of what is measured."""

from __future__ import annotations

import time

import pytest
from numba import njit

from raygrid.emulator.processes import compile_clock, kernel_kinds
from raygrid.emulator.processes.kernel_kinds import KINDS, NOTE, compiling, kind_of
from raygrid.emulator.processes.warm import told_of
from raygrid.host.cli.progress import ProgressReporter
from raygrid.node import remarks


@pytest.fixture
def said(capsys):
    return lambda: capsys.readouterr().err


def test_each_kind_of_kernels_is_named_once_and_how_many_there_are(said):
    with ProgressReporter(False) as reporter:
        reporter.warming(0, 338, "loading kernels")
        assert said() == ""
        for kind in (kernel_kinds.NODES, kernel_kinds.SIMULATOR, kernel_kinds.NODES):
            for done in (1, 2):
                reporter.warming(done, 338, compiling("triangle", kind))
    assert said().splitlines() == [
        "compiling the kernels of nodes (kind 1 of 4), once on this computer: a minute",
        "compiling the kernels of the simulator (kind 3 of 4), once on this computer: a minute",
    ]


def test_remarks_on_kernels_are_notes(said):
    with ProgressReporter(False) as reporter:
        reporter.warming(3, 338, NOTE + "compiled kernels cannot be kept")
    assert said() == "note: compiled kernels cannot be kept\n"


@pytest.mark.parametrize("kind", KINDS)
def test_words_of_a_kind(kind):
    assert kind_of(compiling("closest below", kind)) == kind
    assert kind_of("loading kernels") is kind_of("ready") is kind_of(f"{NOTE}it is for nodes") is None


def test_the_clock_stands_still_while_a_function_is_compiled():
    told = []
    began, clock = time.perf_counter(), compile_clock.now()
    with told_of(lambda *report: told.append(report), KINDS[2], 5):
        assert njit(lambda x: x + 1.0)(2.0) == 3.0
        remarks.remark(f"a test of {began}", "so")
    passed, counted = time.perf_counter() - began, compile_clock.now() - clock
    assert 0.0 <= counted < passed
    assert told[0] == (1, 5, "compiling parts of numba for the simulator")
    assert told[-1][2] == "note: so"
