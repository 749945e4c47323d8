"""What is said of a job: the same map whether it is in memory or in the journal, fit to be sent whatever was recorded.

job, state, client  its number, what it is doing, whose it is
scene, outputs      as submitted
first, last         its frames; None if it names none
frames, done        how many there are, and are done; `skipped` of them were there already
priority            as submitted
submitted, begun, ended  when, in seconds since 1970; None: not yet, or not known
error               why it failed
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raygrid.host.image.frames import LAST_FRAME
from raygrid.host.text.clean_text import printable

if TYPE_CHECKING:
    from raygrid.host.client.requests import SubmitMessage
    from raygrid.host.journal.journal import JobRow
    from raygrid.host.service.schedule import Entry

LONGEST_PATH = 4096
MOST_OUTPUTS = 16
LEAST_BYTES = 300  # of a job's facts as a message, without its texts
Facts = dict[str, Any]


def entry_facts(entry: Entry, request: SubmitMessage) -> Facts:
    """Of a job that has not ended."""
    times = {"submitted": entry.submitted, "begun": entry.begun, "ended": None}
    what = _asked(request.model_dump(mode="json", include={"scene", "outputs", "frames", "priority"}))
    how = {"done": entry.done, "skipped": entry.skipped}
    return {"job": entry.job, "state": str(entry.state), "client": entry.client, **what, **how, **times, "error": ""}


def row_facts(row: JobRow) -> Facts:
    """Of a job of the journal."""
    times = {"submitted": row.submitted, "begun": row.begun, "ended": row.ended}
    how = {"done": row.done, "skipped": row.skipped}
    whose = {"job": row.job, "state": row.state, "client": printable(row.client, 64)}
    return {**whose, **_asked(row.request), **how, **times, "error": printable(row.error)}


def _asked(request: Facts) -> Facts:
    """What was asked for. A request of the journal may be none: then as much of it as can be said."""
    frames = request.get("frames")
    first, last = frames if isinstance(frames, list | tuple) and len(frames) == 2 else (None, None)
    if not (_is_number(first) and _is_number(last)):
        first = last = None
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


def _is_number(value: Any) -> bool:
    return type(value) is int and 0 <= value <= LAST_FRAME


def _path(value: Any) -> str:
    """A path as it is, if a message can carry it: whoever asks may want to open it."""
    text = value if isinstance(value, str) else ""
    try:
        sound = len(text.encode()) <= LONGEST_PATH * 4 and len(text) <= LONGEST_PATH
    except UnicodeEncodeError:
        sound = False
    return text if sound else printable(text, LONGEST_PATH)


def first_page(jobs: list[Facts], most_bytes: int) -> list[Facts]:
    """As many of these as a message of about so many bytes has room for, one at least."""
    room = most_bytes
    for count, facts in enumerate(jobs):
        texts = (facts["client"], facts["scene"], facts["error"], *facts["outputs"])
        room -= LEAST_BYTES + sum(len(text.encode()) + 5 for text in texts)
        if room < 0 and count:
            return jobs[:count]
    return jobs
