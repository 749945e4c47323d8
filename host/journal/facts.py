"""Says what there is to say of jobs of a journal, also of an array that is not up. Nothing in the journal is changed.

A row that cannot be read is told as such, and keeps no other from being read.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import TypedDict, TypeGuard

from raygrid.host.client.facts import ENDED, JobFacts
from raygrid.host.image.frames import LAST_FRAME
from raygrid.host.journal.journal import BUSY_SECONDS, JobRow, Record, columns_of, is_time, read_row
from raygrid.host.text.bounds import LONGEST_CLIENT, LONGEST_PATH, MOST_OUTPUTS
from raygrid.host.text.clean_text import printable
from raygrid.node.errors import OutputError

UNREADABLE = "unreadable"  # the state of a job whose row is none


class AskedFacts(TypedDict):
    """What was asked for by a job; as in `JobFacts`."""

    scene: str
    outputs: list[str]
    first: int | None
    last: int | None
    frames: int
    priority: int


def journal_facts(path: Path, ended: int) -> list[JobFacts]:
    """The last `ended` jobs that have ended, and all that have not, each oldest first; facts as of `raygrid jobs --json`.

    Raises OutputError if it is no journal.
    """
    marks = ", ".join("?" * len(ENDED))
    try:
        # Not mode=ro: of a journal that a crash left, SQLite must bring the last records in, and take its own files away.
        with contextlib.closing(sqlite3.connect(f"{path.as_uri()}?mode=rw", uri=True, timeout=BUSY_SECONDS)) as base:
            base.execute("pragma query_only = on")
            base.text_factory = bytes  # text that is no UTF-8 is to be told, not to stop all
            some = f"select {columns_of(base)} from jobs where state"
            last = f"{some} in ({marks}) order by job desc limit ?"
            rows = base.execute(last, (*ENDED, ended)).fetchall()[::-1]
            rows += base.execute(f"{some} not in ({marks}) order by job", ENDED).fetchall()
    except sqlite3.Error as error:
        raise OutputError(f"{path}: the journal cannot be read ({error})") from None
    return [_facts(row) for row in rows]


def _facts(row: Record) -> JobFacts:
    try:
        read = read_row(row)
        _check(read.request)
        return row_facts(read)
    except (ValueError, RecursionError) as wrong:
        job, client, _, submitted, begun, at_end, _, _, done, skipped = row
        client = client.decode(errors="backslashreplace") if isinstance(client, bytes) else str(client)
        why = f"the journal's row of it cannot be read: {wrong}"
        facts = row_facts(JobRow(job, client, {}, 0.0, None, None, UNREADABLE, why, done, skipped))
        facts["submitted"], facts["begun"], facts["ended"] = map(_time, (submitted, begun, at_end))
        return facts


def _time(value: object) -> float | None:
    """A time that can be told."""
    return value if is_time(value) else None


def _check(request: Mapping[str, object]) -> None:
    """Raise ValueError for what cannot have been submitted."""
    frames, outputs = request.get("frames"), request.get("outputs")
    if frames is not None and not (isinstance(frames, list) and [type(frame) for frame in frames] == [int, int]):
        raise ValueError("its frames are none")
    if not (isinstance(outputs, list) and all(isinstance(path, str) for path in [*outputs, request.get("scene")])):
        raise ValueError("its paths are none")


def row_facts(row: JobRow) -> JobFacts:
    """What there is to say of a job of the journal, fit to be sent whatever was recorded."""
    return {
        "job": row.job,
        "state": row.state,
        "client": printable(row.client, LONGEST_CLIENT),
        **asked_facts(row.request),
        "done": row.done,
        "skipped": row.skipped,
        "submitted": row.submitted,
        "begun": row.begun,
        "ended": row.ended,
        "error": printable(row.error),
    }


def asked_facts(request: Mapping[str, object]) -> AskedFacts:
    """What was asked for. A request of the journal may be none: then as much of it as can be said."""
    first, last = _ends(request.get("frames"))
    outputs = request.get("outputs")
    priority = request.get("priority", 0)
    return {
        "scene": _path(request.get("scene")),
        "outputs": [_path(path) for path in outputs[:MOST_OUTPUTS]] if isinstance(outputs, list) else [],
        "first": first,
        "last": last,
        "frames": 1 if first is None or last is None else last - first + 1,
        "priority": priority if isinstance(priority, int) and abs(priority) < 1 << 31 else 0,
    }


def _ends(frames: object) -> tuple[int, int] | tuple[None, None]:
    """First and last frame, if these are that."""
    first, last = frames if isinstance(frames, list | tuple) and len(frames) == 2 else (None, None)
    return (first, last) if _is_number(first) and _is_number(last) else (None, None)


def _is_number(value: object) -> TypeGuard[int]:
    return type(value) is int and 0 <= value <= LAST_FRAME


def _path(value: object) -> str:
    """A path as it is, if a message can carry it: whoever asks may want to open it."""
    text = value if isinstance(value, str) else ""
    try:
        sound = len(text.encode()) <= LONGEST_PATH * 4 and len(text) <= LONGEST_PATH
    except UnicodeEncodeError:
        sound = False
    return text if sound else printable(text, LONGEST_PATH)
