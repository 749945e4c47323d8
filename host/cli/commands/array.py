"""Carries out the commands that ask or order an array that stays: status, jobs, cancel, reset, down."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path

from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.client.client import Service, connect, wait_gone
from raygrid.host.client.connection import Connection
from raygrid.host.client.facts import JobFacts, RunningFacts, StatusFacts
from raygrid.host.client.service_files import JOURNAL, ServiceRecord, find, state_directory
from raygrid.host.image.outputs import write_lines, write_result
from raygrid.host.journal.facts import journal_facts
from raygrid.host.probes.metrics_server import figures_url
from raygrid.host.text.clean_text import printable
from raygrid.host.text.tables import bytes_of, count_of, span, table
from raygrid.node.errors import ArrayError

KILL_SECONDS = 10.0
NODES_SHOWN = 64
JOB_COLUMNS = (
    "job", "state", "frames", "done", "submitted", "waited", "took", "priority", "client", "scene", "outputs",
)  # fmt: skip
ABOUT = JOB_COLUMNS.index("client")  # from there on columns say what it is, and not how it stands


def run_status(name: str, as_json: bool, watch: bool = False, every: float = 1.0) -> None:
    """Print how an array is; to `watch`: again and again, every so many seconds, until it ends. Raises ArrayError."""
    with connect(name) as array:
        if not watch:
            facts = array.status()
            write_result(json.dumps(facts, indent=2)) if as_json else write_lines(_status_lines(facts))
        elif as_json or not sys.stdout.isatty():
            while True:
                facts = array.status()
                write_result(json.dumps(facts) if as_json else "\n".join([*_status_lines(facts), ""]))
                time.sleep(every)
        else:
            _watch(array, every)


def _watch(array: Service, every: float) -> None:
    """Draw how an array is on the terminal, over what was drawn before.

    Lines longer than the terminal is wide go on below; what does not fit in its height is left out at the end.
    """
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    def drawn() -> Text:
        return Text("\n".join(_status_lines(array.status())))

    with Live(drawn(), console=Console(highlight=False), auto_refresh=False, vertical_overflow="ellipsis") as live:
        while True:
            time.sleep(every)
            live.update(drawn(), refresh=True)


def _status_lines(facts: StatusFacts) -> list[str]:
    shape = "x".join(map(str, facts["array"]))
    load = "" if facts["load"] is None else f", load {100 * facts['load']:.0f} %"
    why = f" ({facts['why']})" if facts["why"] else ""
    frames, queue, faults = facts["frames"], facts["queue"], facts["faults"]
    lines = [
        f"{facts['name']}: {shape} {facts['state']}{why}, up for {span(time.time() - facts['started'])}, "
        f"service {facts['pid']}{load}, {bytes_of(facts['pss'])} memory (PSS)",
        f"frames: {frames['done']:,} done, {frames['skipped']:,} skipped, {frames['failed']:,} failed",
        f"scenes: loaded {facts['floods']:,} times, moved on by increments {facts['increments']:,} times",
        f"queue: {count_of(queue['jobs'], 'job')}, {count_of(queue['frames'], 'frame')} not begun; {_running(facts['running'])}",
        f"faults: {faults['count']:,}, resets: {facts['resets']:,}"
        + (f"; the last: {faults['last'][-1]['what']}" if faults["last"] else ""),
    ]
    if facts["links"]["why"]:
        lines.append(f"links: served by Python alone, which is slower ({facts['links']['why']})")
    refused = ", ".join(f"{count} {why}" for why, count in facts["refused"].items() if count)
    lines.append(f"clients: {facts['clients']}; refused: {refused or 'none'}")
    lines += [f"journal: {words}" for words in (facts["journal"]["trouble"], *facts["journal"]["remarks"]) if words]
    if facts["prometheus"]:
        lines.append(f"figures for Prometheus: {figures_url(facts['prometheus'])}")
    rows = [("node", "pid", "state", "load", "PSS")]
    for node in facts["nodes"][:NODES_SHOWN]:
        busy = "-" if node["load"] is None else f"{100 * node['load']:.0f} %"
        place = ",".join(map(str, node["node"]))
        rows.append((place, str(node["pid"]), node["state"], busy, bytes_of(node["pss"])))
    lines += table(rows)
    if len(facts["nodes"]) > NODES_SHOWN:
        lines.append(f"... and {len(facts['nodes']) - NODES_SHOWN} more (--json has all)")
    return lines


def _running(running: RunningFacts | None) -> str:
    if running is None:
        return "idle"
    frame = "" if running["frame"] is None else f" frame {running['frame']}"
    done = f" {100 * running['part']:.0f} %" if running.get("phase") == "trace" else ""
    return f"job {running['job']}{frame}: {running.get('phase', 'waiting')}{done}"


def run_jobs(name: str, ended: int, as_json: bool) -> None:
    """Print the jobs of an array, out of its journal if it is not up. Raises ArrayError if there is neither."""
    jobs, down = _jobs(name, ended)
    if as_json:
        write_result(json.dumps(jobs, indent=2))
        return
    now = time.time()
    rows = [JOB_COLUMNS, *(_job_row(job, now) for job in jobs)]
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    write_result("\n".join(job_lines(rows, width)) if jobs else "no jobs")
    if down:
        left = sum(job["state"] in ("queued", "running") for job in jobs)
        goes = "none goes on" if not left else f"{count_of(left, 'job')} {'goes' if left == 1 else 'go'} on"
        ProgressReporter(False).remark(
            f"the array {name!r} is not up, this is from its journal; {goes} after raygrid up --name {name}"
        )


def _jobs(name: str, ended: int) -> tuple[list[JobFacts], bool]:
    """The jobs of an array, and whether it is down."""
    try:
        find(name)
    except ArrayError:
        path = state_directory(name) / JOURNAL
        if not path.is_file():
            raise
        return journal_facts(path, ended), True
    with connect(name) as array:
        return array.jobs(ended), False


def job_lines(rows: list[tuple[str, ...]], width: int | None) -> list[str]:
    """The table of jobs; where a terminal is too narrow, each in two lines: how it stands, and below that of what it is."""
    lines = table(rows)
    if width is None or max(map(len, lines)) <= width:
        return lines
    head, *jobs = table([row[:ABOUT] for row in rows])
    about = (f"     {scene} of {client}: {outputs}" for client, scene, outputs in (row[ABOUT:] for row in rows[1:]))
    return [head, *(line for pair in zip(jobs, about, strict=True) for line in pair)]


def _job_row(job: JobFacts, now: float) -> tuple[str, ...]:
    """A job as a row: how long it waited for its first frame, and took from then on, until now or its end."""
    submitted, begun, ended = job.get("submitted"), job.get("begun"), job.get("ended")
    going = job["state"] in ("queued", "running")
    waited = took = "-"
    if submitted is not None and (going or begun or ended):
        waited = span((begun or ended or now) - submitted)
    if begun is not None and (ended or job["state"] == "running"):
        took = span((ended or now) - begun)
    frames = "-" if job["first"] is None else f"{job['first']}-{job['last']}"
    words = f"  ({job['error']})" if job["error"] else ""
    texts = [Path(job["scene"]).name, " ".join(job["outputs"]) + words]
    how = frames, f"{job['done']}/{job['frames']}", _moment(submitted), waited, took, str(job["priority"])
    return (str(job["job"]), job["state"], *how, *map(printable, (job["client"] or "-", *texts)))


def _moment(seconds: float | None) -> str:
    """A moment by the clock here; with its date if that is not today's."""
    if seconds is None:
        return "-"
    then = time.localtime(seconds)
    today = then[:3] == time.localtime()[:3]
    return time.strftime("%H:%M:%S" if today else "%Y-%m-%d %H:%M", then)


def run_cancel(name: str, jobs: list[int] | None, as_json: bool = False) -> None:
    """Cancel jobs and print their numbers. Raises ArrayError if none of those named could be cancelled any more."""
    with connect(name) as array:
        cancelled = array.cancel(jobs)
    for line in [json.dumps({"cancelled": cancelled})] if as_json else map(str, cancelled):
        write_result(line)
    if jobs and not cancelled:
        raise ArrayError(f"{'job' if len(jobs) == 1 else 'jobs'} {', '.join(map(str, jobs))} had ended already")


def run_reset(name: str, as_json: bool = False) -> None:
    """Reset an array. Raises ArrayError."""
    with connect(name) as array:
        nodes = array.reset()
    write_result(json.dumps({"name": name, "nodes": nodes}) if as_json else f"{name}: reset")


def run_down(name: str, finish: bool, cancel: bool, kill: bool, as_json: bool = False) -> None:
    """End an array and wait until it has ended. Raises ArrayError."""
    if kill:
        _kill(find(name))
        facts = {"name": name, "killed": True, "unfinished": None}
        write_result(json.dumps(facts) if as_json else f"{name}: killed")
        return
    connection = Connection(find(name))
    with contextlib.closing(connection):
        answer = connection.ask({"do": "down", "finish": finish, "cancel": cancel})
    wait_gone(connection.record)
    if as_json:
        write_result(json.dumps({"name": name, "killed": False, "unfinished": answer["unfinished"]}))
        return
    left = f", {count_of(answer['unfinished'], 'job')} left in its journal" if answer["unfinished"] else ""
    write_result(f"{name}: ended{left}")


def _kill(record: ServiceRecord) -> None:
    """Kill a service; its nodes see that it is gone, and end by themselves."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(record.pid, signal.SIGKILL)
    if not wait_gone(record, KILL_SECONDS):
        raise ArrayError(f"process {record.pid} is still there {KILL_SECONDS:g} seconds after it was killed")
