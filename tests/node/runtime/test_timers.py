"""Timers in compiled code: they count processor time where they are on, and nothing else."""

from __future__ import annotations

import time

import numpy as np
import pytest

from raygrid.node.jit.decorators import lean
from raygrid.node.links import zmq_c_api
from raygrid.node.runtime.timers import NO_PLACE, PLACES, SENDING, TRACING, count_time, make_timers


@lean
def spend(timers, turns):
    """Count a loop for TRACING, and what follows it for SENDING."""
    since, used = count_time(timers, NO_PLACE, np.int64(0)), np.uint64(1)
    for k in range(turns):
        used ^= used << np.uint64(13)
        used ^= used >> np.uint64(7)
        used += np.uint64(k)
    since = count_time(timers, TRACING, since)
    return count_time(timers, SENDING, since), used


def test_what_is_spent_is_counted_where_it_belongs():
    timers = make_timers(True)
    begun = time.thread_time_ns()
    spend(timers, 1_000_000)
    spent = timers.spent.copy()
    assert 0 < spent[TRACING] <= time.thread_time_ns() - begun
    assert spent[TRACING] > spent[SENDING] >= 0
    assert [place for place in PLACES if spent[place]] in ([TRACING], [TRACING, SENDING])
    spend(timers, 1_000_000)
    assert timers.spent[TRACING] > spent[TRACING]


def test_without_being_asked_nothing_is_counted():
    timers = make_timers(False)
    assert spend(timers, 1000)[0] == 0
    assert not timers.spent.any()
    assert not timers.timespec.any()


@pytest.mark.parametrize(("name", "found"), [("clock_gettime", True), ("no_such_clock", False)])
def test_a_computer_without_such_a_clock_counts_nothing(monkeypatch, name, found):
    monkeypatch.setattr(zmq_c_api, "_CLOCK", name)
    assert (make_timers(True).clock != 0) == found
