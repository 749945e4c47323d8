"""Jobs in memory and on disk, kept in step."""

import contextlib
import shutil
import sqlite3

import pytest
from support.journals import damage

from raygrid.host.client.protocol import LONGEST, pack
from raygrid.host.client.requests import read_request
from raygrid.host.journal.journal import Journal
from raygrid.host.service import jobs as service_jobs
from raygrid.host.service.job_facts import first_page
from raygrid.host.service.jobs import Jobs
from raygrid.host.service.schedule import JobState
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
    assert [row["job"] for row in again.list(10)] == [bad, good]
    again.close()


@pytest.mark.parametrize(
    "harm",
    [
        "request = 'no JSON'",
        "request = '[1, 2]'",
        'request = \'{"frames": [1, 1e999], "outputs": 7, "scene": [], "priority": "x"}\'',
        "request = x'00ff80'",
        "request = cast(x'7bff7d' as text)",
        "request = replace(hex(zeroblob(100000)), '00', '[')",
        "client = cast(x'ff' as text)",
        "submitted = 'yesterday'",
        "submitted = 9e999",
        "submitted = 1e300",
        "state = cast(x'ff' as text)",
        "error = 7, state = 'done'",
        "error = cast(zeroblob(9000000) as text), state = 'failed'",
    ],
)
def test_one_bad_row_stops_nothing(path, jobs, harm):
    """Neither the start nor the list; it is set aside and that is said, or the job is listed as failed."""
    bad, good = (jobs.submit(request(1, 3)).job for _ in range(2))
    take(jobs, 2)
    jobs.close()
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.execute(f"update jobs set {harm} where job = {bad}")
        base.commit()
    again = Jobs(Journal(path))
    assert list(again.schedule.entries) == [good]
    rows = {row["job"]: row for row in again.list(10)}
    pack({"is": "jobs", "jobs": list(rows.values())})
    assert rows[good]["done"] == 1
    with contextlib.closing(sqlite3.connect(path)) as base:
        kept = base.execute("select job from set_aside").fetchall()
    assert (bad in rows) != (kept == [(bad,)])
    assert len(again.remarks) == len(kept)
    assert again.submit(request(1, 1)).job == 3
    again.close()


def test_facts_are_the_same_in_memory_and_on_disk(jobs):
    entry = jobs.submit(request(1, 2))
    take(jobs, 2)
    ended = jobs.facts(entry.job)
    times = {name: ended.pop(name) for name in ("submitted", "begun", "ended")}
    assert times["submitted"] <= times["begun"] <= times["ended"]
    assert ended == {
        "job": 1, "state": "done", "client": "me", "scene": "/s.nff", "outputs": ["/o_%d.png"],
        "first": 1, "last": 2, "frames": 2, "done": 2, "skipped": 0, "error": "", "priority": 0,
    }  # fmt: skip
    waiting = jobs.submit(request(1, 2, priority=-3))
    now = {"job": 2, "state": "queued", "done": 0, "priority": -3, "begun": None, "ended": None}
    assert jobs.facts(waiting.job) == ended | now | {"submitted": waiting.submitted}
    assert jobs.facts(99) is None


def test_a_journal_that_cannot_be_written_catches_up(jobs, monkeypatch):
    entry = jobs.submit(request(1, 2))
    whole = jobs.journal.frame_done

    def full(*_):
        raise OutputError("the disk is full")

    monkeypatch.setattr(jobs.journal, "frame_done", full)
    take(jobs, 2)
    assert entry.state is JobState.DONE
    assert jobs.trouble == "the disk is full"
    assert jobs.journal.find(entry.job).state == "running"
    told = jobs.facts(entry.job)
    assert (told["state"], told["done"], told["error"]) == ("done", 2, "")
    assert jobs.list(10) == [told]
    assert jobs.counts() == {"done": 1}
    monkeypatch.setattr(jobs.journal, "frame_done", whole)
    jobs.submit(request(1, 1))
    assert jobs.trouble == ""
    assert jobs.facts(entry.job) == told
    assert jobs.counts() == {"done": 1, "queued": 1}
    assert jobs.journal.frames_done(entry.job) == {1, 2}
    assert jobs.journal.find(entry.job).state == "done"


def test_a_job_that_ends_while_the_journal_is_gone_is_told_of(jobs):
    """A journal that is made anew holds those that have not ended."""
    ended, waiting = jobs.submit(request(1, 2)), jobs.submit(request(1, 1))
    take(jobs, 1)
    for suffix in ("", "-wal", "-shm"):
        jobs.journal.path.with_name(jobs.journal.path.name + suffix).unlink(missing_ok=True)
    jobs.cancel(ended)
    assert jobs.trouble == ""
    assert jobs.journal.find(ended.job) is None
    told = jobs.facts(ended.job)
    assert (told["state"], told["done"]) == ("cancelled", 1)
    assert jobs.list(10) == [told, jobs.facts(waiting.job)]
    assert jobs.counts() == {"cancelled": 1, "queued": 1}


def test_what_has_ended_is_told_of_while_no_end_can_be_recorded(jobs, monkeypatch):
    """Whoever asks hears of it: who would follow a job that has ended would wait for ever."""
    kept = jobs.submit(request(1, 1))
    take(jobs, 1)
    failed, cancelled, waiting = (jobs.submit(request(1, 3)) for _ in range(3))
    take(jobs, 1)  # a frame of the first that waits

    def full(*_):
        raise OutputError("the disk is full")

    monkeypatch.setattr(Journal, "set_state", full)
    jobs.fail(failed, "no room")
    jobs.cancel(cancelled)
    facts = jobs.facts(failed.job)
    assert (facts["state"], facts["error"], facts["done"], facts["frames"]) == ("failed", "no room", 1, 3)
    assert facts["submitted"] <= facts["begun"] <= facts["ended"]
    states = {kept.job: "done", failed.job: "failed", cancelled.job: "cancelled", waiting.job: "queued"}
    assert {row["job"]: row["state"] for row in jobs.list(10)} == states
    assert [row["job"] for row in jobs.list(2)] == [failed.job, cancelled.job, waiting.job]
    assert [row["job"] for row in jobs.list(0)] == [waiting.job]
    assert jobs.counts() == dict.fromkeys(sorted(states.values()), 1)
    before = jobs.list(10)
    monkeypatch.undo()
    jobs.flush()
    assert jobs.trouble == ""
    assert [row.state for row in jobs.journal.ended(10)] == ["done", "failed", "cancelled"]
    assert jobs.list(10) == before


def test_a_bad_request_is_told_as_failed_while_that_cannot_be_recorded(path, jobs, monkeypatch):
    bad = jobs.journal.add("me", {"do": "submit", "scene": "relative"})
    jobs.close()

    def full(*_):
        raise OutputError("the disk is full")

    monkeypatch.setattr(Journal, "set_state", full)
    again = Jobs(Journal(path))
    assert again.facts(bad)["state"] == "failed"
    assert again.facts(bad)["error"]
    assert [row["job"] for row in again.list(10)] == [bad]
    again.close()


BAD_TEXT = "\ud800 \udcff \x1b[31m" + "x" * 9_000_000


def test_a_text_that_nobody_can_write_or_send_blocks_no_record_and_no_list(path, jobs):
    """Half a character, an escape sequence and 9 MB: what a scene's error may hold."""
    bad, good = jobs.submit(request(1, 1)), jobs.submit(request(1, 2))
    jobs.fail(bad, BAD_TEXT)
    take(jobs, 2)
    assert jobs.trouble == ""
    assert good.state is JobState.DONE
    rows = jobs.list(10)
    assert [row["state"] for row in rows] == ["failed", "done"]
    assert len(pack({"is": "jobs", "jobs": rows})) < 10_000
    assert rows[0]["error"].startswith("\\ud800 \\xff \\x1b[31mxxx")
    jobs.close()
    again = Jobs(Journal(path))
    assert again.schedule.entries == {}
    again.close()


def test_a_record_that_can_never_be_written_is_left_out_and_the_others_are_written(jobs, monkeypatch, capfd):
    bad, good = jobs.submit(request(1, 1)), jobs.submit(request(1, 2))
    whole = Journal.set_state

    def fails_for_one(journal, job, state, error="", at=None):
        if job == bad.job:
            raise ValueError("surrogates not allowed")
        whole(journal, job, state, error, at)

    monkeypatch.setattr(Journal, "set_state", fails_for_one)
    jobs.fail(bad, "why")
    take(jobs, 2)
    assert jobs.submit(request(1, 1)).job == 3
    assert jobs.journal.find(good.job).state == "done"
    assert jobs.trouble == ""
    assert [f"job {bad.job} " in text for text in jobs.remarks] == [True]
    assert "surrogates not allowed" in capfd.readouterr().err
    assert jobs.facts(bad.job)["state"] == "failed", "what the journal never knows is told from memory"


def test_facts_that_are_more_than_a_message_holds_come_in_pages():
    facts = [
        {"job": n, "client": "c", "scene": "/s" * 2000, "outputs": ["/o" * 2000] * 16, "error": ""} for n in range(200)
    ]
    seen = []
    while len(seen) < 200:
        page = first_page(facts[len(seen) :], LONGEST // 2)
        assert page
        pack({"is": "jobs", "jobs": page, "left": 200})
        seen += page
    assert seen == facts
    assert first_page([], 10) == []


@pytest.mark.parametrize("gone", ["file", "directory", "both files", "damaged"])
def test_a_journal_that_goes_away_is_made_anew_with_all_that_is_unfinished(tmp_path, gone):
    path = tmp_path / "state" / "journal.sqlite"
    path.parent.mkdir()
    jobs = Jobs(Journal(path), keep_place=lambda: path.parent.mkdir(exist_ok=True))
    jobs.submit(request(1, 1))
    long = jobs.submit(request(1, 5))
    take(jobs, 3)  # one of the first job, which is done, two of the second
    if gone == "directory":
        shutil.rmtree(path.parent)
    elif gone == "damaged":
        damage(path)
    else:
        for suffix in ("",) if gone == "file" else ("", "-wal"):
            path.with_name(path.name + suffix).unlink()
    take(jobs, 1)
    third = jobs.submit(request(7, 7))
    assert third.job == 3  # no number twice
    assert jobs.trouble == ""
    assert len(jobs.remarks) == 1
    jobs.close()
    again = Jobs(Journal(path))
    assert {job: list(entry.todo) for job, entry in again.schedule.entries.items()} == {long.job: [4, 5], 3: [7]}
    again.close()


def test_there_is_an_end_to_what_is_queued(jobs, monkeypatch):
    monkeypatch.setattr(service_jobs, "MOST_QUEUED", 10)
    monkeypatch.setattr(service_jobs, "MOST_UNFINISHED", 3)
    jobs.submit(request(1, 8))
    with pytest.raises(RaygridError, match="8 frames are queued already, wanted at most 10"):
        jobs.submit(request(1, 3))
    jobs.submit(request(1, 1))
    jobs.submit(request(1, 1))
    with pytest.raises(RaygridError, match="3 jobs are queued already"):
        jobs.submit(request(1, 1))
    assert len(jobs.journal.unfinished()) == 3
