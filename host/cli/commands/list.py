"""Carries out `raygrid list`: prints the arrays that are up, and how each is."""

from __future__ import annotations

import contextlib
import json
import time
from concurrent.futures import ThreadPoolExecutor
from typing import NotRequired, TypedDict

from raygrid.host.client.connection import Connection
from raygrid.host.client.service_files import ServiceRecord, running
from raygrid.host.image.outputs import write_result
from raygrid.host.text.tables import count_of, span, table
from raygrid.node.errors import ArrayError

ANSWER_SECONDS = 3.0  # for each; all are asked at once
MOST_ASKED = 16  # at once
SILENT = "does not answer"


class ListedFacts(TypedDict):
    """What is listed of an array; None of a service that does not answer, `why` then says so."""

    name: str
    array: list[int]
    state: str
    pid: int
    started: float
    jobs: int | None
    frames: int | None
    running: int | None
    why: NotRequired[str]


def run_list(as_json: bool) -> None:
    """Print the arrays of this user that are up."""
    records = running()
    with ThreadPoolExecutor(MOST_ASKED) as asking:
        found = [facts for facts in asking.map(_facts, records) if facts is not None]
    if as_json:
        write_result(json.dumps(found, indent=2))
        return
    rows = [("name", "array", "state", "up for", "jobs", "service")]
    for facts in found:
        since = span(time.time() - facts["started"])
        jobs = "-" if facts["jobs"] is None else _jobs(facts)
        rows.append((facts["name"], "x".join(map(str, facts["array"])), facts["state"], since, jobs, str(facts["pid"])))
    write_result("\n".join(table(rows)) if found else "no array is up")


def _facts(record: ServiceRecord) -> ListedFacts | None:
    """What there is to say of an array; None if it ends just now."""
    facts: ListedFacts = {
        "name": record.name,
        "array": list(record.shape),
        "state": SILENT,
        "pid": record.pid,
        "started": record.started,
        "jobs": None,
        "frames": None,
        "running": None,
    }
    try:
        with contextlib.closing(Connection(record, ANSWER_SECONDS)) as connection:
            status = connection.ask({"do": "status"})
    except ArrayError as error:
        return {**facts, "why": str(error)} if record.alive else None
    job = None if status["running"] is None else status["running"]["job"]
    return {**facts, "state": status["state"], **status["queue"], "running": job, "why": ""}


def _jobs(facts: ListedFacts) -> str:
    if not facts["jobs"]:
        return "none"
    rest = f", {count_of(facts['frames'], 'frame')} not begun" if facts["frames"] else ""
    return f"{count_of(facts['jobs'], 'job')}{rest}"
