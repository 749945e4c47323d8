"""Says of a job what there is to say, whether it is in memory or in the journal, fit to be sent whatever was recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypedDict, TypeGuard

from raygrid.host.image.frames import LAST_FRAME
from raygrid.host.text.bounds import LONGEST_CLIENT, LONGEST_PATH, MOST_OUTPUTS
from raygrid.host.text.clean_text import printable

if TYPE_CHECKING:
    from raygrid.host.client.facts import JobFacts
    from raygrid.host.client.requests import SubmitMessage
    from raygrid.host.journal.journal import JobRow
    from raygrid.host.service.schedule import Entry

LEAST_BYTES = 300  # of a job's facts as a message, without its texts


class AskedFacts(TypedDict):
    """What was asked for by a job; as in `JobFacts`."""

    scene: str
    outputs: list[str]
    first: int | None
    last: int | None
    frames: int
    priority: int


def entry_facts(entry: Entry, request: SubmitMessage) -> JobFacts:
    """Of a job that has not ended."""
    return {
        "job": entry.job,
        "state": str(entry.state),
        "client": entry.client,
        **_asked(request.model_dump(mode="json", include={"scene", "outputs", "frames", "priority"})),
        "done": entry.done,
        "skipped": entry.skipped,
        "submitted": entry.submitted,
        "begun": entry.begun,
        "ended": None,
        "error": "",
    }


def row_facts(row: JobRow) -> JobFacts:
    """Of a job of the journal."""
    return {
        "job": row.job,
        "state": row.state,
        "client": printable(row.client, LONGEST_CLIENT),
        **_asked(row.request),
        "done": row.done,
        "skipped": row.skipped,
        "submitted": row.submitted,
        "begun": row.begun,
        "ended": row.ended,
        "error": printable(row.error),
    }


def _asked(request: Mapping[str, object]) -> AskedFacts:
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


def first_page(jobs: list[JobFacts], most_bytes: int) -> list[JobFacts]:
    """Take as many of these as a message of about so many bytes has room for, one at least."""
    room = most_bytes
    for count, facts in enumerate(jobs):
        texts = (facts["client"], facts["scene"], facts["error"], *facts["outputs"])
        room -= LEAST_BYTES + sum(len(text.encode()) + 5 for text in texts)
        if room < 0 and count:
            return jobs[:count]
    return jobs
