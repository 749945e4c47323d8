"""Jobs in memory and on disk, kept in step."""

import pytest

from raygrid.host import service_jobs
from raygrid.host.journal import Journal
from raygrid.host.requests import read_request
from raygrid.host.schedule import State
from raygrid.host.service_jobs import Jobs
from raygrid.node.errors import OutputError, RaygridError


def request(first, last, **more):
    return read_request(
        {"do": "submit", "scene": "/s.nff", "outputs": ["/o_%d.png"], "frames": [first, last], "client": "me"} | more
    )


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.sqlite"


@pytest.fixture
def jobs(path):
    made = Jobs(Journal(path))
    yield made
    made.close()


def take(jobs, count):
    """Render so many frames."""
    for _ in range(count):
        entry, _ = jobs.schedule.next()
        jobs.begun(entry)
        jobs.frame_done(entry, False, 0.1, {})


def test_jobs_go_on_where_they_were(path, jobs):
    jobs.submit(request(1, 3))
    jobs.submit(request(5, 5))
    take(jobs, 2)  # the first frame of each
    jobs.close()
    again = Jobs(Journal(path))
    (entry,) = again.schedule.entries.values()
    assert (entry.job, list(entry.todo), entry.done, entry.total) == (1, [2, 3], 1, 3)
    take(again, 2)
    assert [(row["job"], row["state"], row["done"]) for row in again.list(10)] == [(1, "done", 3), (2, "done", 1)]
    again.close()


def test_a_crash_between_the_last_frame_and_the_end_of_the_job_ends_it(path, jobs):
    job = jobs.submit(request(1, 1)).job
    jobs.journal.frame_done(job, 1, False, 0.1, {})
    jobs.close()
    again = Jobs(Journal(path))
    assert again.schedule.entries == {}
    assert again.facts(job)["state"] == "done"
    again.close()


def test_a_job_of_the_journal_that_cannot_be_read_fails_alone(path, jobs):
    good = jobs.submit(request(1, 1)).job
    bad = jobs.journal.add("me", {"do": "submit", "scene": "relative"})
    jobs.close()
    again = Jobs(Journal(path))
    assert list(again.schedule.entries) == [good]
    assert again.journal.find(bad).state == "failed"
    again.close()


def test_facts_are_the_same_in_memory_and_on_disk(jobs):
    entry = jobs.submit(request(1, 2))
    take(jobs, 2)
    ended = jobs.facts(entry.job)
    assert ended == {
        "job": 1, "state": "done", "client": "me", "scene": "/s.nff", "outputs": ["/o_%d.png"],
        "first": 1, "last": 2, "frames": 2, "done": 2, "skipped": 0, "error": "",
    }  # fmt: skip
    running = jobs.submit(request(1, 2))
    assert jobs.facts(running.job) == ended | {"job": 2, "state": "queued", "done": 0}
    assert jobs.facts(99) is None


def test_a_journal_that_cannot_be_written_catches_up(jobs, monkeypatch):
    entry = jobs.submit(request(1, 2))
    whole = jobs.journal.frame_done

    def full(*_):
        raise OutputError("the disk is full")

    monkeypatch.setattr(jobs.journal, "frame_done", full)
    take(jobs, 2)
    assert entry.state is State.DONE
    assert jobs.trouble == "the disk is full"
    assert jobs.journal.find(entry.job).state == "running"
    monkeypatch.setattr(jobs.journal, "frame_done", whole)
    jobs.submit(request(1, 1))
    assert jobs.trouble == ""
    assert jobs.journal.frames_done(entry.job) == {1, 2}
    assert jobs.journal.find(entry.job).state == "done"


def test_there_is_an_end_to_what_is_queued(jobs, monkeypatch):
    monkeypatch.setattr(service_jobs, "MOST_QUEUED", 10)
    monkeypatch.setattr(service_jobs, "MOST_JOBS", 3)
    jobs.submit(request(1, 8))
    with pytest.raises(RaygridError, match="8 frames are queued already, wanted at most 10"):
        jobs.submit(request(1, 3))
    jobs.submit(request(1, 1))
    jobs.submit(request(1, 1))
    with pytest.raises(RaygridError, match="3 jobs are queued already"):
        jobs.submit(request(1, 1))
    assert len(jobs.journal.unfinished()) == 3
