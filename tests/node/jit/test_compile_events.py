"""Who is told that functions are compiled."""

from __future__ import annotations

import pytest
from numba import njit

from raygrid.node.jit import always_heard_by, compiling_heard_by


def fresh():
    """Two functions of which the first calls the second, not compiled yet."""

    @njit
    def inner(x):
        return x + 1

    @njit
    def outer(x):
        return inner(x)

    return outer


def test_functions_are_told_as_they_begin_and_end_those_within_others_too():
    told, function = [], fresh()
    with compiling_heard_by(lambda one: told.append(("begins", one.__name__)), lambda one: told.append(one.__name__)):
        function(1)
        function(2)
    assert told == [("begins", "outer"), ("begins", "inner"), "inner", "outer"]
    function(1.0)
    assert len(told) == 4


def test_what_is_raised_as_one_begins_its_caller_gets():
    def refuse(_function):
        raise LookupError("not now")

    function = fresh()
    with compiling_heard_by(begins=refuse), pytest.raises(LookupError, match="not now"):
        function(1)
    assert function(1) == 2


def test_some_hear_for_ever():
    told: list[str] = []
    always_heard_by(lambda _function: None, lambda one: told.append(one.__name__))
    fresh()(1)
    assert told == ["inner", "outer"]
