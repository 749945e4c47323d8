"""The journal: what was recorded is there after the process is gone, and a disk that is full is one clear error."""

import os
import sqlite3
import stat
import subprocess
import sys

import pytest

from raygrid.host import journal as journal_module
from raygrid.host.journal import Journal
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
        "import os, sys, pathlib\nfrom raygrid.host.journal import Journal\n"
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
