"""What the commands show of arrays that stay: all that are up, how one is, its jobs when it is down, its figures."""

import json
import os
import re
import signal
import sqlite3
import subprocess
import urllib.request
from pathlib import Path

import pytest
from support.cli import RAYGRID, TIMEOUT, TINY, here, one_line, warm_kernels
from support.processes import wait_dead
from support.service import SIZE, array, end, name, on, shot_of, state_directory, up, watch_until
from support.terminal import Terminal

import raygrid
from raygrid.host.cli.commands.array import JOB_COLUMNS, job_lines
from raygrid.host.client.service_files import JOURNAL, find
from raygrid.host.journal.facts import journal_facts
from raygrid.host.journal.journal import Journal
from raygrid.host.probes.service_probe import subscribe
from raygrid.node.errors import OutputError

__all__ = ["array", "name", "warm_kernels"]

SMALL = ("--size", f"{SIZE[0]}x{SIZE[1]}")
LONG = {"size": (3000, 3000), "samples": 64}  # minutes: no test waits for its end


@pytest.fixture
def journal(tmp_path, monkeypatch):
    """The journal of an array named `film` that is not up: a job that is done, one half done, one that failed."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    folder = state_directory("film")
    folder.mkdir(parents=True, mode=0o700)
    kept = Journal(folder / JOURNAL)
    asked = {"scene": "/s/a.nff", "outputs": ["/o/%d.png"], "frames": [1, 3]}
    for state, error, frames in (("done", "", 3), ("running", "", 2), ("failed", "frame 1: no light", 0)):
        job = kept.add("session 7", asked)
        for frame in range(1, frames + 1):
            kept.frame_done(job, frame, frame == 1, 0.5, {})
        kept.set_state(job, state, error)
    kept.close()
    return folder / JOURNAL


# ---- list ----


def test_arrays_that_are_up_are_listed_with_their_jobs(name, array, tmp_path):
    job = array.submit(shot_of(Path(TINY), 3), output=tmp_path / "a_%d.npy", frames=(1, 3), **LONG)
    watch_until(array, job.job, "progress", phase="trace")
    (facts,) = json.loads(here("list", "--json").out)
    record = find(name)
    assert facts == {
        "name": name, "array": [2, 1, 1], "state": "ready", "pid": record.pid, "started": record.started,
        "jobs": 1, "frames": 2, "running": job.job, "why": "",
    }  # fmt: skip
    lines = here("list").out.splitlines()
    assert lines[0].split() == ["name", "array", "state", "up", "for", "jobs", "service"]
    assert re.fullmatch(rf"{name} +2x1x1 +ready +[\dminsh ]+ +1 job, 2 frames not begun +{record.pid}", lines[1])


def test_an_array_that_does_not_answer_is_listed_as_such(name, monkeypatch):
    monkeypatch.setattr("raygrid.host.cli.commands.list.ANSWER_SECONDS", 0.3)
    pid = find(name).pid
    os.kill(pid, signal.SIGSTOP)
    try:
        (facts,) = json.loads(here("list", "--json").out)
        assert (facts["state"], facts["jobs"], facts["pid"]) == ("does not answer", None, pid)
        assert re.search(rf"^{name} +2x1x1 +does not answer .* - +{pid}$", here("list").out, re.M)
    finally:
        os.kill(pid, signal.SIGCONT)


def test_where_no_array_is_up_the_list_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert here("list") == (0, "no array is up\n", "")
    assert json.loads(here("list", "--json").out) == []


# ---- status --watch ----


def test_status_is_watched_until_control_c(name, tmp_path):
    with Terminal([RAYGRID, "status", "--name", name, "--watch", "--every", "0.1"], tmp_path) as terminal:
        for _ in range(3):
            seen = len(terminal.text)
            terminal.wait_for(rf"{name}: 2x1x1 ready")
            assert terminal.text[seen:].count(f"{name}: 2x1x1 ready") <= 2
        terminal.press("\x03")
        assert terminal.wait_end() == 130


def test_a_watched_status_is_whole_on_a_narrow_terminal(name, tmp_path):
    with Terminal([RAYGRID, "status", "--name", name, "--watch"], tmp_path, size=(60, 24)) as terminal:
        terminal.wait_for(r"moved on by\s+increments\s+\d+\s+times")  # the end of a line of 90 columns
        terminal.wait_for(r"memory\s+\(PSS\)")
        terminal.press("\x03")
        assert terminal.wait_end() == 130


def test_a_watched_array_that_ends_ends_the_watching(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    up("brief")
    try:
        arguments = [RAYGRID, "status", "--name", "brief", "--watch", "--every", "0.1", "--json"]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watching:
            for _ in range(3):
                assert json.loads(watching.stdout.readline())["state"] == "ready"
            assert on("brief", "down").code == 0
            _, told = watching.communicate(timeout=TIMEOUT)
    finally:
        end("brief")
    assert watching.returncode == 1
    assert re.fullmatch(r"raygrid: the array 'brief' (has closed the connection|\(process \d+\) is gone)\n", told)


# ---- jobs ----


def test_jobs_take_two_lines_each_where_a_terminal_is_too_narrow():
    how = ("1", "cancelled", "1-48", "8/48", "09:36:31", "1 min 05 s", "2 h 10 min", "0")
    rows = [JOB_COLUMNS, (*how, "session 7", "a.nff", "/o/%d.png")]
    one, wide = job_lines(rows, None), job_lines(rows, 200)
    assert one == wide
    assert len(one) == 2
    head, first, about = job_lines(rows, 80)
    assert head.split() == list(JOB_COLUMNS[:8])
    assert first.split() == " ".join(how).split()
    assert about == "     a.nff of session 7: /o/%d.png"
    assert max(map(len, (head, first, about))) <= 80


# ---- jobs of an array that is down ----


def test_jobs_of_an_array_that_is_down_are_read_from_its_journal(journal):
    facts = json.loads(here("jobs", "--name", "film", "--json").out)
    assert [(job["job"], job["state"], job["done"], job["frames"]) for job in facts] == [
        (1, "done", 3, 3), (3, "failed", 0, 3), (2, "running", 2, 3),
    ]  # fmt: skip
    for job in facts:
        assert (job["client"], job["scene"], job["outputs"]) == ("session 7", "/s/a.nff", ["/o/%d.png"])
        assert job["submitted"] > 1e9
    told = here("jobs", "--name", "film")
    assert re.search(r"^3 +failed +1-3 +0/3 .* session 7 +a\.nff +/o/%d\.png  \(frame 1: no light\)$", told.out, re.M)
    assert told.err == (
        "note: the array 'film' is not up, this is from its journal; 1 job goes on after raygrid up --name film\n"
    )
    assert [job["job"] for job in json.loads(here("jobs", "--name", "film", "--ended", "0", "--json").out)] == [2]
    assert os.listdir(journal.parent) == [JOURNAL]  # nothing of SQLite's is left


def test_jobs_of_a_name_that_never_was_are_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    one_line(here("jobs", "--name", "none"), 1, "raygrid: no array named 'none' runs: .*")


@pytest.mark.parametrize(
    "request_", ["{", "[]", '{"outputs": 3}', '{"frames": [1], "outputs": [], "scene": "a"}', b"\xff"]
)
def test_a_row_that_is_none_keeps_no_other_from_being_read(journal, request_):
    with sqlite3.connect(journal) as base:
        base.execute("update jobs set request = ? where job = 2", (request_,))
    base.close()
    facts = journal_facts(journal, 10)
    assert [(job["job"], job["state"]) for job in facts] == [(1, "done"), (3, "failed"), (2, "unreadable")]
    assert "cannot be read" in facts[-1]["error"]
    json.dumps(facts)


def refuse(constant):
    raise AssertionError(f"{constant} is no JSON")


@pytest.mark.parametrize("column", ["submitted", "begun", "ended"])
@pytest.mark.parametrize("value", ["'yesterday'", "x'00ff'", "9e999", "-9e999", "1e300"])
def test_a_time_that_is_none_is_not_passed_on(journal, column, value):
    with sqlite3.connect(journal) as base:
        base.execute(f"update jobs set {column} = {value} where job = 2")
    base.close()
    facts = json.loads(here("jobs", "--name", "film", "--json").out, parse_constant=refuse)
    assert [(job["job"], job["state"]) for job in facts] == [(1, "done"), (3, "failed"), (2, "unreadable")]
    assert facts[-1][column] is None
    assert f"{column} came as" in facts[-1]["error"]
    told = here("jobs", "--name", "film")
    assert told.code == 0
    assert re.search(rf"^2 +unreadable .*{column} came as", told.out, re.M)


def test_a_file_that_is_no_journal_is_one_sentence(journal):
    journal.write_bytes(b"x" * 5000)
    with pytest.raises(OutputError, match="the journal cannot be read"):
        journal_facts(journal, 10)
    one_line(here("jobs", "--name", "film"), 1, "raygrid: .*journal.sqlite: the journal cannot be read .*")


def test_jobs_of_a_service_that_was_killed_are_all_there(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    pid = up("killed")["pid"]
    try:
        with raygrid.connect("killed") as array:
            job = array.submit(shot_of(Path(TINY), 9), output=tmp_path / "%d.npy", frames=(1, 9), **LONG)
            watch_until(array, job.job, "progress")
            os.kill(pid, signal.SIGKILL)
            wait_dead(pid)
        (facts,) = json.loads(on("killed", "jobs", "--json").out)
        assert (facts["job"], facts["state"], facts["frames"]) == (job.job, "running", 9)
    finally:
        end("killed")


# ---- figures ----


def test_a_service_serves_its_own_figures(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    said = up("figures", "--prometheus", "0")
    try:
        url = f"http://127.0.0.1:{said['prometheus']}/metrics"
        with raygrid.connect("figures") as array:
            assert array.status()["prometheus"] == said["prometheus"]
            array.submit(shot_of(Path(TINY), 2), output=tmp_path / "a_%d.npy", frames=(1, 2), size=SIZE).wait()
        with urllib.request.urlopen(url, timeout=20) as answer:
            lines = answer.read().decode().splitlines()
        for line in (
            'raygrid_service_frames_total{result="done"} 2.0',
            'raygrid_service_jobs{state="done"} 1.0',
            "raygrid_service_nodes 2.0",
            "raygrid_service_queue_jobs 0.0",
            "raygrid_service_faults_total 0.0",
            'raygrid_service_state{state="ready"} 1.0',
        ):
            assert line in lines
        one_line(
            on("other", "up", "--array", "1x1x1", "--prometheus", str(said["prometheus"])),
            1,
            r"raygrid: no Prometheus endpoint can be opened at 127\.0\.0\.1:\d+ \(.*\)",
        )
        assert on("figures", "down").code == 0
    finally:
        end("figures")


# ---- one figure of memory ----


def test_probe_and_status_tell_the_same_figure_of_memory_by_the_same_name(name, array):
    status = array.status()
    assert status["pss"] == sum(node["pss"] for node in status["nodes"])
    assert "memory (PSS)" in on(name, "status").out
    with subscribe(name, 20.0) as feed:
        seen = {}
        while len(seen) < 2:
            sample = next(feed.samples)
            if sample is not None:
                seen[sample.node] = sample.memory["pss"]
    for node in array.status()["nodes"]:
        assert seen[tuple(node["node"])] == pytest.approx(node["pss"], rel=0.2)
    assert "memory (PSS)" in on(name, "probe", "--for", "0.5").out


# ---- facts for programs ----


def test_what_was_done_is_told_as_json(name, tmp_path):
    with raygrid.connect(name) as array:
        job = array.submit(TINY, output=tmp_path / "a.npy", **LONG).job
    assert json.loads(on(name, "cancel", str(job), "--json").out) == {"cancelled": [job]}
    told = json.loads(on(name, "reset", "--json").out)
    with raygrid.connect(name) as array:
        assert told == {"name": name, "nodes": [node["pid"] for node in array.status()["nodes"]]}
    try:
        assert json.loads(on(name, "down", "--json").out) == {"name": name, "killed": False, "unfinished": 0}
        up(name)
        assert json.loads(on(name, "down", "--kill", "--json").out) == {
            "name": name,
            "killed": True,
            "unfinished": None,
        }
    finally:
        end(name)
        up(name)
