"""The commands that ask an array that stays how it is, or tell it what to do: status, jobs, cancel, reset, down."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from raygrid.host.client import connect, wait_gone
from raygrid.host.connection import Connection
from raygrid.host.outputs import write_result
from raygrid.host.service_files import Record, find
from raygrid.node.errors import ArrayError

KILL_SECONDS = 10.0
NODES_SHOWN = 64

Facts = dict[str, Any]


def run_status(name: str, as_json: bool) -> None:
    """Print how an array is. Raises ArrayError."""
    with connect(name) as array:
        facts = array.status()
    write_result(json.dumps(facts, indent=2) if as_json else "\n".join(_status_lines(facts)))


def _status_lines(facts: Facts) -> list[str]:
    shape = "x".join(map(str, facts["array"]))
    load = "" if facts["load"] is None else f", load {100 * facts['load']:.0f} %"
    why = f" ({facts['why']})" if facts["why"] else ""
    frames, queue, faults = facts["frames"], facts["queue"], facts["faults"]
    lines = [
        f"{facts['name']}: {shape} {facts['state']}{why}, up for {_span(time.time() - facts['started'])}, "
        f"service {facts['pid']}{load}, {_bytes(facts['memory'])} in the nodes",
        f"frames: {frames['done']:,} done, {frames['skipped']:,} skipped, {frames['failed']:,} failed; "
        f"scenes loaded {facts['floods']:,} times, moved on by increments {facts['increments']:,} times",
        f"queue: {_count(queue['jobs'], 'job')}, {_count(queue['frames'], 'frame')} not begun; {_running(facts['running'])}",
        f"faults: {faults['count']:,}, resets: {facts['resets']:,}"
        + (f"; the last: {faults['last'][-1]['what']}" if faults["last"] else ""),
    ]
    refused = ", ".join(f"{count} {why}" for why, count in facts["refused"].items() if count)
    lines.append(f"clients: {facts['clients']}; refused: {refused or 'none'}")
    if facts["journal"]["trouble"]:
        lines.append(f"journal: {facts['journal']['trouble']}")
    rows = [("node", "pid", "state", "load", "memory")]
    for node in facts["nodes"][:NODES_SHOWN]:
        busy = "-" if node["load"] is None else f"{100 * node['load']:.0f} %"
        place = ",".join(map(str, node["node"]))
        rows.append((place, str(node["pid"]), node["state"], busy, _bytes(node["memory"])))
    lines += _table(rows)
    if len(facts["nodes"]) > NODES_SHOWN:
        lines.append(f"... and {len(facts['nodes']) - NODES_SHOWN} more (--json has all)")
    return lines


def _running(running: Facts | None) -> str:
    if running is None:
        return "idle"
    frame = "" if running["frame"] is None else f" frame {running['frame']}"
    done = f" {100 * running['part']:.0f} %" if running.get("phase") == "trace" else ""
    return f"job {running['job']}{frame}: {running.get('phase', 'waiting')}{done}"


def run_jobs(name: str, ended: int, as_json: bool) -> None:
    """Print the jobs of an array. Raises ArrayError."""
    with connect(name) as array:
        jobs = array.jobs(ended)
    if as_json:
        write_result(json.dumps(jobs, indent=2))
        return
    rows = [("job", "state", "frames", "done", "scene", "outputs")]
    for job in jobs:
        frames = "-" if job["first"] is None else f"{job['first']}-{job['last']}"
        done = f"{job['done']}/{job['frames']}"
        scene = Path(job["scene"]).name
        words = f"  ({job['error']})" if job["error"] else ""
        rows.append((str(job["job"]), job["state"], frames, done, scene, " ".join(job["outputs"]) + words))
    write_result("\n".join(_table(rows)) if jobs else "no jobs")


def run_cancel(name: str, jobs: list[int] | None) -> None:
    """Cancel jobs and print their numbers. Raises ArrayError if none of those named could be cancelled any more."""
    with connect(name) as array:
        cancelled = array.cancel(jobs)
    for job in cancelled:
        write_result(str(job))
    if jobs and not cancelled:
        raise ArrayError(f"{'job' if len(jobs) == 1 else 'jobs'} {', '.join(map(str, jobs))} had ended already")


def run_reset(name: str) -> None:
    """Reset an array. Raises ArrayError."""
    with connect(name) as array:
        array.reset()
    write_result(f"{name}: reset")


def run_down(name: str, finish: bool, cancel: bool, kill: bool) -> None:
    """End an array and wait until it has ended. Raises ArrayError."""
    if kill:
        _kill(find(name))
        write_result(f"{name}: killed")
        return
    connection = Connection(find(name))
    with contextlib.closing(connection):
        answer = connection.ask({"do": "down", "finish": finish, "cancel": cancel})
    wait_gone(connection.record)
    left = "" if finish or not answer["unfinished"] else f", {_count(answer['unfinished'], 'job')} left in its journal"
    write_result(f"{name}: ended{left}")


def _kill(record: Record) -> None:
    """Kill a service; its nodes see that it is gone, and end by themselves."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(record.pid, signal.SIGKILL)
    if not wait_gone(record, KILL_SECONDS):
        raise ArrayError(f"process {record.pid} is still there {KILL_SECONDS:g} seconds after it was killed")


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    return [
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]]) for row in rows
    ]


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def _bytes(number: int) -> str:
    return f"{number / 1e9:.1f} GB" if number >= 10**9 else f"{number / 1e6:.1f} MB"


def _span(seconds: float) -> str:
    minutes, left = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {left:02} s" if minutes else f"{left} s"
    return f"{minutes // 60} h {minutes % 60:02} min"
