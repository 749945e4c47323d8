"""The law of predictions by cases that are made by hand: shares, latencies that shrink, the jackknife, stated errors."""

from __future__ import annotations

import numpy as np
import pytest

from raygrid.host.machine_time.prediction_law import (
    LEAST_ERROR,
    LEAST_ERROR_FEW,
    LIKELY,
    MOST_POWER,
    WorkShare,
    extrapolated,
    jackknifed,
    share_of,
    shrunk_latency,
)


def test_two_pictures_tell_share_and_latency():
    assert share_of((100.0, 130.0), (400.0, 460.0)) == pytest.approx((1.1, 20.0))


def test_a_share_below_one_is_one():
    """The time of single rays hardly grows with the work: what is left is latency."""
    assert share_of((100.0, 500.0), (400.0, 520.0)) == WorkShare(1.0, 120.0)


def test_a_latency_below_zero_is_zero():
    assert share_of((100.0, 110.0), (400.0, 480.0)) == WorkShare(1.2, 0.0)


def test_pictures_of_equal_work_have_the_least_share():
    assert share_of((100.0, 104.0), (100.0, 105.0)) == WorkShare(1.0, 5.0)


def test_without_work_there_is_only_latency():
    assert share_of((0.0, 0.0), (0.0, 7.0)) == WorkShare(1.0, 7.0)


def test_read_outs_have_any_share():
    assert share_of((10.0, 35.0), (30.0, 45.0), 0.0) == WorkShare(0.5, 30.0)


@pytest.mark.parametrize("power", [1.2, 2.0, 4.0])
def test_a_latency_shrinks_by_the_power_that_it_shows(power):
    def latency(work):
        return (work**power + 50.0**power) ** (1.0 / power) - work

    assert shrunk_latency(latency(40.0), 50.0, 40.0, 400.0) == pytest.approx(latency(400.0), rel=1e-6)


@pytest.mark.parametrize(
    ("latency", "longest", "seen", "work"),
    [(0.0, 50.0, 40.0, 400.0), (60.0, 50.0, 40.0, 400.0), (9.0, 0.0, 40.0, 400.0), (9.0, 50.0, 40.0, 40.0)],
)
def test_a_latency_stays_where_nothing_says_that_it_shrinks(latency, longest, seen, work):
    assert shrunk_latency(latency, longest, seen, work) == latency


def test_a_sharp_bend_leaves_next_to_nothing():
    assert shrunk_latency(1e-9, 50.0, 49.0, 400.0) <= 400.0 * ((1 + (50 / 400) ** MOST_POWER) ** (1 / MOST_POWER) - 1)


def test_equal_groups_are_sure():
    most, error = jackknifed(np.array([[5.0, 5.0, 5.0, 5.0], [1.0, 1.0, 1.0, 1.0]]))
    assert (most, error) == (20.0, pytest.approx(0.0))


def test_the_error_of_one_cell_is_that_of_a_mean():
    """By hand: groups 1, 2, 3, 4 have a mean of 2.5, a variance of 5/3, and the mean one of 5/12."""
    most, error = jackknifed(np.array([[1.0, 2.0, 3.0, 4.0]]))
    assert most == 10.0
    assert error == pytest.approx(np.sqrt(5.0 / 12.0) / 2.5)


def test_another_cell_may_be_the_busiest_of_some_groups():
    alone = jackknifed(np.array([[4.0, 4.0, 4.0, 4.0]]))[1]
    assert jackknifed(np.array([[4.0, 4.0, 4.0, 4.0], [0.0, 5.0, 5.0, 5.0]]))[1] > alone


def test_nothing_done_is_no_error():
    assert jackknifed(np.zeros((3, 4))) == (0.0, 0.0)


def test_with_much_work_only_the_sampling_is_in_doubt():
    found = extrapolated(WorkShare(1.0, 0.0), (1000.0, 1000.0), 1.0, (9000.0, 0.02), False)
    assert found.time == 9000.0
    assert found.error == pytest.approx(np.hypot(LIKELY * 0.02, LEAST_ERROR))


def test_few_rays_widen_the_error():
    many, few = (extrapolated(WorkShare(1.0, 9.0), (10.0, 19.0), 18.0, (100.0, 0.0), few) for few in (False, True))
    assert many.time == few.time
    assert few.error > max(many.error, LEAST_ERROR_FEW)


def test_no_time_at_all():
    assert extrapolated(WorkShare(1.0, 0.0), (0.0, 0.0), 0.0, (0.0, 0.0), True) == (0.0, 0.0, 0.0)
