"""Reads the jobs of an array that is not up out of its journal. Nothing in it is changed.

A row that cannot be read is told as such, and keeps no other from being read.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
from pathlib import Path
from typing import Any, cast

from raygrid.host.client.facts import ENDED, JobFacts
from raygrid.node.errors import OutputError

BUSY_SECONDS = 5.0
TIMES = ("submitted", "begun", "ended")  # those that the journal has
UNREADABLE = "unreadable"  # the state of a job whose row is none

Row = dict[str, Any]  # of the table of jobs, or what was submitted


def journal_facts(path: Path, ended: int) -> list[JobFacts]:
    """The last `ended` jobs that have ended, and all that have not, each oldest first; facts as of `raygrid jobs --json`.

    Raises OutputError if it is no journal.
    """
    marks = ", ".join("?" * len(ENDED))
    counts = (
        "(select count(*) from frames where frames.job = jobs.job) as done, "
        "(select coalesce(sum(skipped), 0) from frames where frames.job = jobs.job) as skipped"
    )
    try:
        # Not mode=ro: of a journal that a crash left, SQLite must bring the last records in, and take its own files away.
        with contextlib.closing(sqlite3.connect(f"{path.as_uri()}?mode=rw", uri=True, timeout=BUSY_SECONDS)) as base:
            base.execute("pragma query_only = on")
            base.text_factory = bytes  # text that is no UTF-8 is to be told, not to stop all
            base.row_factory = sqlite3.Row
            some = f"select *, {counts} from jobs where state"
            last = f"{some} in ({marks}) order by job desc limit ?"
            rows = base.execute(last, (*ENDED, ended)).fetchall()[::-1]
            rows += base.execute(f"{some} not in ({marks}) order by job", ENDED).fetchall()
    except sqlite3.Error as error:
        raise OutputError(f"{path}: the journal cannot be read ({error})") from None
    return [_facts({name: row[name] for name in row.keys()}) for row in rows]  # noqa: SIM118  (a Row is no map)


def _facts(row: Row) -> JobFacts:
    row = {
        name: value.decode(errors="backslashreplace") if isinstance(value, bytes) else value
        for name, value in row.items()
    }
    try:
        request, error = _request(str(row["request"])), str(row["error"])
    except (ValueError, RecursionError) as wrong:
        request, error, row["state"] = {}, f"the journal's row of it cannot be read: {wrong}", UNREADABLE
    frames = request.get("frames")
    first, last = frames or (None, None)
    count = 1 if frames is None else frames[1] - frames[0] + 1
    facts = {
        "job": row["job"],
        "state": row["state"],
        "client": row["client"],
        "scene": request.get("scene", ""),
        "outputs": request.get("outputs", []),
        "first": first,
        "last": last,
        "frames": count,
        "priority": request.get("priority", 0),
        "done": row["done"],
        "skipped": row["skipped"],
        **{name: row[name] for name in TIMES if name in row},
        "error": error,
    }
    return cast(JobFacts, facts)


def _request(text: str) -> Row:
    """What was submitted. Raises ValueError for what cannot have been."""
    request: Row = json.loads(text)
    if not isinstance(request, dict):
        raise ValueError("it is no map")
    frames, outputs = request.get("frames"), request.get("outputs")
    if frames is not None and not (isinstance(frames, list) and [type(frame) for frame in frames] == [int, int]):
        raise ValueError("its frames are none")
    if not (isinstance(outputs, list) and all(isinstance(path, str) for path in [*outputs, request.get("scene")])):
        raise ValueError("its paths are none")
    return request
