"""The journal: what was recorded is there after the process is gone, and a disk that is full is one clear error."""

import contextlib
import os
import re
import sqlite3
import stat
import subprocess
import sys

import pytest
from support.journals import damage

from raygrid.host.journal import journal as journal_module
from raygrid.host.journal.journal import Journal
from raygrid.host.journal.repair import open_journal
from raygrid.node.errors import OutputError

REQUEST = {"do": "submit", "scene": "/s.nff", "outputs": ["/o_%d.png"], "frames": [1, 3]}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.sqlite"


@pytest.fixture
def journal(path):
    made = Journal(path)
    yield made
    made.close()


def test_a_job_comes_back_without_the_frames_that_are_done(path, journal):
    job = journal.add("me", REQUEST)
    journal.set_state(job, "running")
    journal.frame_done(job, 2, True, 0.5, {})
    journal.close()
    again = Journal(path)
    (row,) = again.unfinished()
    assert (row.job, row.client, row.request, row.state, row.done, row.skipped) == (job, "me", REQUEST, "running", 1, 1)
    assert again.frames_done(job) == {2}
    again.set_state(job, "done")
    assert again.unfinished() == []
    assert [row.state for row in again.ended(5)] == ["done"]
    again.close()


def test_what_was_recorded_survives_a_kill(path):
    script = (
        "import os, sys, pathlib\nfrom raygrid.host.journal.journal import Journal\n"
        "journal = Journal(pathlib.Path(sys.argv[1]))\n"
        "job = journal.add('me', {'do': 'submit'})\njournal.frame_done(job, 7, False, 1.0, {})\n"
        "os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", script, path], timeout=60).returncode == -9
    journal = Journal(path)
    (row,) = journal.unfinished()
    assert journal.frames_done(row.job) == {7}
    journal.close()


def test_numbers_are_never_used_twice(journal, monkeypatch):
    monkeypatch.setattr(journal_module, "KEPT", 0)
    first = journal.add("me", REQUEST)
    journal.set_state(first, "cancelled")
    second = journal.add("me", REQUEST)
    assert journal.find(first) is None
    assert second > first


def test_old_jobs_are_forgotten_and_those_that_have_not_ended_are_not(journal, monkeypatch):
    monkeypatch.setattr(journal_module, "KEPT", 2)
    waiting = journal.add("me", REQUEST)
    ended = [journal.add("me", REQUEST) for _ in range(5)]
    for job in ended:
        journal.frame_done(job, 1, False, 0.0, {})
        journal.set_state(job, "done")
    journal.add("me", REQUEST)
    assert [row.job for row in journal.ended(100)] == ended[-2:]
    assert journal.unfinished()[0].job == waiting
    assert journal.frames_done(ended[0]) == set()


def test_a_file_is_vouched_for_until_somebody_touches_it(journal, tmp_path):
    file = tmp_path / "f.jpg"
    file.write_bytes(b"picture")
    job = journal.add("me", REQUEST)
    journal.frame_done(job, 1, False, 0.0, {str(file): "digest"})
    assert journal.is_recorded(str(file), "digest")
    assert not journal.is_recorded(str(file), "another")
    assert not journal.is_recorded(str(tmp_path / "g.jpg"), "digest")
    os.utime(file, ns=(1, 1))
    assert not journal.is_recorded(str(file), "digest")


def test_it_is_for_us_alone(path, journal):
    journal.add("me", REQUEST)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_file_that_is_no_journal_is_refused(path):
    path.write_bytes(b"something else " * 100)
    with pytest.raises(OutputError, match=r"journal\.sqlite: the journal cannot be kept \(file is not a database\)"):
        Journal(path)


def cut(path):
    os.truncate(path, 4096)


def overwrite(path):
    path.write_bytes(b"something else " * 100)


def drop_a_column(path):
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.execute("alter table jobs drop column error")


def harm_one_row(path):
    """The page on which only the second half of the jobs is."""
    with contextlib.closing(sqlite3.connect(path)) as base:
        (page,) = base.execute("select max(pageno) from dbstat where name = 'jobs' and pagetype = 'leaf'").fetchone()
    with open(path, "r+b") as file:
        file.seek((page - 1) * 4096)
        file.write(bytes(4096))


@pytest.mark.parametrize(
    ("harm", "saved"), [(damage, 0), (cut, 0), (overwrite, 0), (drop_a_column, 0), (harm_one_row, 1)]
)
def test_a_damaged_file_is_set_aside_and_what_can_be_read_goes_on(path, journal, harm, saved):
    for number in range(40):
        job = journal.add("me", REQUEST | {"scene": f"/{number}" + "x" * 400})
        journal.frame_done(job, 1, False, 0.1, {})
    journal.close()
    if harm is harm_one_row and not has_dbstat():
        pytest.skip("this SQLite cannot say what is on which page")
    harm(path)
    before = path.read_bytes()
    again, remarks = open_journal(path)
    (kept,) = [file for file in path.parent.iterdir() if re.fullmatch(r"journal\.sqlite\.damaged-[\d-]+", file.name)]
    assert kept.read_bytes() == before
    (remark,) = remarks
    rows = again.unfinished()
    assert re.search(
        rf"journal\.sqlite: .*: it is kept as {kept.name}, and the {len(rows)} jobs? that could be read", remark
    )
    assert (len(rows) > 0) == (saved > 0)
    assert all(again.frames_done(row.job) == {1} for row in rows)
    assert again.add("me", REQUEST) > max((row.job for row in rows), default=0)
    again.close()
    assert open_journal(path)[1] == []


def has_dbstat():
    with contextlib.closing(sqlite3.connect(":memory:")) as base:
        try:
            base.execute("select * from dbstat")
        except sqlite3.Error:
            return False
    return True


def test_a_journal_of_the_first_version_is_taken_over(path, journal):
    job = journal.add("me", REQUEST)
    journal.close()
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.execute("alter table jobs drop column begun")
        base.execute("drop table set_aside")
        base.execute("pragma user_version = 1")
    again = Journal(path)
    assert (again.find(job).submitted > 0, again.find(job).begun) == (True, None)
    again.set_state(job, "running")
    begun = again.find(job).begun
    assert begun is not None
    again.set_state(job, "done")
    assert again.find(job).begun == begun <= again.find(job).ended
    again.close()


def test_a_journal_of_a_later_version_is_refused(path):
    base = sqlite3.connect(path)
    base.execute("pragma user_version = 99")
    base.close()
    with pytest.raises(OutputError, match="version 99, wanted at most"):
        Journal(path)


def test_a_link_in_its_place_is_refused(path, tmp_path):
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="the journal cannot be kept"):
        Journal(path)


def test_a_change_that_fails_leaves_nothing(journal):
    """The foreign key: frames of a job that is not there."""
    with pytest.raises(OutputError, match="the journal cannot be kept"):
        journal.frame_done(12, 1, False, 0.0, {})
    job = journal.add("me", REQUEST)
    assert journal.frames_done(job) == set()
