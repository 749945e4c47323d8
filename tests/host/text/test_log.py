"""The log: what is said has its time, and a disk that takes no log stops nothing of what is done."""

import re
import sys

import pytest

from raygrid.host.journal.journal import Journal
from raygrid.host.service.events import Options
from raygrid.host.service.jobs import Jobs
from raygrid.host.service.listener import _packed
from raygrid.host.service.state import ServiceState
from raygrid.host.text.error_text import told
from raygrid.host.text.log import log


@pytest.fixture(params=["full", "closed"])
def no_log(request, monkeypatch):
    """Standard error that takes nothing: /dev/full is a device without room."""
    with open("/dev/full", "w", buffering=1) as stream:
        if request.param == "closed":
            stream.close()
        monkeypatch.setattr(sys, "stderr", stream)
        yield


def test_a_line_has_its_time(capfd):
    log("fault: a node is lost")
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d fault: a node is lost\n", capfd.readouterr().err)


def test_what_cannot_be_logged_stops_nothing(no_log):
    log("fault: a node is lost")
    log("x" * 1_000_000)


def test_a_bug_is_told_without_a_log(no_log):
    try:
        raise KeyError("depth")
    except KeyError as error:
        assert told(error) == "a bug: KeyError: 'depth' (the array's log has more)"


def test_a_fault_is_noted_without_a_log(no_log, tmp_path):
    state = ServiceState("test", Options((1, 1, 1), journal=tmp_path / "journal.sqlite"))
    state.note_fault("a node is lost", None)
    assert [fault["what"] for fault in state.faults] == ["a node is lost"]


def test_the_journal_is_remarked_on_without_a_log(no_log, tmp_path):
    jobs = Jobs(Journal(tmp_path / "journal.sqlite"), ["it was mended"])
    assert list(jobs.remarks) == ["it was mended"]
    jobs.close()


def test_an_answer_that_cannot_be_sent_becomes_an_error_without_a_log(no_log):
    assert b"the answer cannot be sent" in _packed({"is": "jobs", "jobs": 1 << 99})
