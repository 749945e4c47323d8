"""Records: what Python writes compiled code reads, and the other way round."""

from __future__ import annotations

import numpy as np
import pytest

from raygrid.node.jit.decorators import lean
from raygrid.node.jit.records import Record, record


@record
class Counters(Record):
    """Three numbers."""

    sent: int
    received: int
    credit: int


@lean
def swap(rows, k):
    """Swap two fields of a record, and count in the third."""
    row = rows[k]
    row.sent, row.received = row.received, row.sent
    row.credit += 1


def test_fields_are_int64_in_their_order():
    assert Counters.dtype.names == ("sent", "received", "credit")
    assert {Counters.dtype[name] for name in Counters.dtype.names} == {np.dtype(np.int64)}
    assert Counters.rows(3).dtype is Counters.dtype  # numba tells arrays apart by this object


@pytest.mark.parametrize("row", [0, 2])
def test_python_and_compiled_code_see_the_same_memory(row):
    rows = Counters.rows(3)
    seen = Counters.view(rows, row)
    seen.sent, seen.received, seen.credit = 2**62, -5, 7
    swap(rows, row)
    assert seen.numbers() == [-5, 2**62, 8]
    assert [int(number) for number in rows[row]] == [-5, 2**62, 8]
    assert not any(int(number) for k in range(3) if k != row for number in rows[k])


def test_numbers_are_taken_over_once_and_not_shared():
    one, two = Counters(1, 2, 3), Counters()
    two.take(one)
    one.sent = 9
    assert (two.numbers(), one.numbers()) == ([1, 2, 3], [9, 2, 3])


def test_a_view_keeps_its_memory():
    seen = Counters.view(Counters.rows())
    seen.credit = 4
    assert seen.numbers() == [0, 0, 4]
