"""Says of a job that has not ended what there is to say, and pages lists of such facts; `host.journal.facts`: of the others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raygrid.host.journal.facts import asked_facts

if TYPE_CHECKING:
    from raygrid.host.client.facts import JobFacts
    from raygrid.host.client.requests import SubmitMessage
    from raygrid.host.service.schedule import Entry

LEAST_BYTES = 300  # of a job's facts as a message, without its texts


def entry_facts(entry: Entry, request: SubmitMessage) -> JobFacts:
    """Of a job that has not ended."""
    return {
        "job": entry.job,
        "state": str(entry.state),
        "client": entry.client,
        **asked_facts(request.model_dump(mode="json", include={"scene", "outputs", "frames", "priority"})),
        "done": entry.done,
        "skipped": entry.skipped,
        "submitted": entry.submitted,
        "begun": entry.begun,
        "ended": None,
        "error": "",
    }


def first_page(jobs: list[JobFacts], most_bytes: int) -> list[JobFacts]:
    """Take as many of these as a message of about so many bytes has room for, one at least."""
    room = most_bytes
    for count, facts in enumerate(jobs):
        texts = (facts["client"], facts["scene"], facts["error"], *facts["outputs"])
        room -= LEAST_BYTES + sum(len(text.encode()) + 5 for text in texts)
        if room < 0 and count:
            return jobs[:count]
    return jobs
