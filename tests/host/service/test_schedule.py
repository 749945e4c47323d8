"""Whose frame is next: clients in turn, their jobs in turn, frames in order; none is lost and none comes twice."""

from collections import Counter
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady

from raygrid.host.service.schedule import MOST_YIELDS, PASSES, JobState, Schedule


def take_all(schedule):
    """Render everything; the (job, frame) pairs in their order."""
    order = []
    while (found := schedule.next()) is not None:
        entry, frame = found
        order.append((entry.job, frame))
        schedule.finish(entry)
    return order


def test_clients_take_turns_and_so_do_the_jobs_of_a_client():
    schedule = Schedule()
    schedule.add(1, "a", range(3), 3)
    schedule.add(2, "b", range(2), 2)
    schedule.add(3, "a", range(2), 2)
    assert take_all(schedule) == [(1, 0), (2, 0), (3, 0), (2, 1), (1, 1), (3, 1), (1, 2)]


def test_a_job_that_comes_late_waits_for_one_frame_of_each_other_client():
    schedule = Schedule()
    for job in range(1, 4):
        schedule.add(job, f"client {job}", range(1000), 1000)
    for _ in range(50):
        entry, _ = schedule.next()
        schedule.finish(entry)
    schedule.add(9, "late", [0], 1)
    jobs = [job for job, _ in take_all(schedule)]
    assert jobs.index(9) <= 3


def test_a_frame_that_was_given_up_comes_again_and_first():
    schedule = Schedule()
    schedule.add(1, "a", range(3), 3)
    schedule.add(2, "b", range(3), 3)
    entry, frame = schedule.next()
    schedule.put_back(entry)
    assert (entry.job, frame, entry.running) == (1, 0, None)
    assert take_all(schedule) == [(1, 0), (2, 0), (1, 1), (2, 1), (1, 2), (2, 2)]
    assert entry.state is JobState.DONE
    assert schedule.entries == {}


def test_the_frames_of_a_job_that_ended_do_not_come():
    schedule = Schedule()
    schedule.add(1, "a", range(3), 3)
    schedule.add(2, "a", range(1), 1)
    entry, _ = schedule.next()
    schedule.end(entry, JobState.CANCELLED)
    schedule.put_back(entry)  # of a frame that was under way
    assert take_all(schedule) == [(2, 0)]


def test_a_job_that_comes_back_counts_what_was_done_before():
    schedule = Schedule()
    entry = schedule.add(1, "a", [3, 4], 5)
    assert (entry.done, entry.total) == (3, 5)
    assert [frame for _, frame in take_all(schedule)] == [3, 4]
    assert entry.done == 5


@steady(300)
@given(
    st.lists(st.tuples(st.sampled_from(["add", "next", "back", "finish", "cancel"]), st.integers(0, 3)), max_size=60)
)
def test_every_frame_is_done_once_whatever_happens(steps):
    schedule, jobs, done, cancelled, running = Schedule(), 0, Counter(), set(), None
    for what, number in steps:
        if what == "add":
            jobs += 1
            schedule.add(jobs, "abcd"[number], range(number + 1), number + 1, jobs % 3)
        elif what == "next" and running is None:
            found = schedule.next()
            running = found and (found[0], found[1])
        elif what == "back" and running is not None:
            if not running[0].ended:
                schedule.put_back(running[0])
            running = None
        elif what == "finish" and running is not None:
            if not running[0].ended:
                done[running[0].job, running[1]] += 1
                schedule.finish(running[0])
            running = None
        elif what == "cancel" and schedule.entries:
            entry = sorted(schedule.entries.values(), key=lambda entry: entry.job)[number % len(schedule.entries)]
            cancelled.add(entry.job)
            schedule.end(entry, JobState.CANCELLED)
    if running is not None and not running[0].ended:
        done[running[0].job, running[1]] += 1
        schedule.finish(running[0])
    done.update(take_all(schedule))
    assert set(done.values()) <= {1}
    frames = Counter(job for job, _ in done)
    for job in range(1, jobs + 1):
        if job not in cancelled:
            assert frames[job] >= 1
    assert schedule.entries == {}
    assert schedule.frames_queued == 0


# --- priorities ------------------------------------------------------------------------------------------


def test_higher_priorities_go_first_and_clients_take_turns_within_each():
    schedule = Schedule()
    schedule.add(1, "a", range(2), 2)
    schedule.add(2, "b", range(2), 2, priority=5)
    schedule.add(3, "c", range(1), 1, priority=5)
    schedule.add(4, "d", range(1), 1, priority=-5)
    assert take_all(schedule) == [(2, 0), (3, 0), (2, 1), (1, 0), (1, 1), (4, 0)]


def test_no_priority_waits_for_ever():
    """However many frames of higher ones come, one of nine is of each lower one at least."""
    schedule = Schedule()
    schedule.add(1, "low", range(3), 3, priority=-1)
    schedule.add(2, "middle", range(3), 3)
    schedule.add(3, "high", range(100), 100, priority=1)
    jobs = [job for job, _ in take_all(schedule)]
    for low in (1, 2):
        places = [place for place, job in enumerate(jobs) if job == low]
        assert len(places) == 3
        assert places[0] <= PASSES + 1
        assert max(after - before for before, after in pairwise(places)) <= PASSES + 3


def test_a_running_frame_yields_to_higher_priorities_twice_and_then_no_more():
    schedule = Schedule()
    schedule.add(1, "a", range(1), 1)
    entry, _ = schedule.next()
    schedule.add(2, "a", range(1), 1)
    assert not schedule.should_yield(entry)
    for number in range(MOST_YIELDS):
        schedule.add(10 + number, "b", range(1), 1, priority=1)
        assert schedule.should_yield(entry)
        entry.yields += 1
        schedule.put_back(entry)
        other, _ = schedule.next()
        assert other.priority == 1
        schedule.finish(other)
        assert schedule.next()[0] is entry  # and not job 2: it is first among its own
    schedule.add(20, "b", range(1), 1, priority=1)
    assert not schedule.should_yield(entry)


def test_a_frame_that_was_passed_over_is_not_given_up():
    schedule = Schedule()
    schedule.add(1, "high", range(100), 100, priority=1)
    schedule.add(2, "low", range(1), 1)
    entry, _ = schedule.next()
    while entry.job == 1:
        schedule.finish(entry)
        entry, _ = schedule.next()
    assert not schedule.should_yield(entry)
