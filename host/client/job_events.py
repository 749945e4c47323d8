"""Reads what a service tells of a job: what became of it, how far it is, what is to be said of it. No socket in here."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass

from raygrid.host.client.protocol import Message
from raygrid.host.image.frames import FrameNames
from raygrid.host.render.progress import ProgressHook, RenderProgress
from raygrid.host.text.remarks import remark
from raygrid.node.errors import ArrayError


@dataclass(frozen=True)
class Result:
    """What became of a job.

    job     its number
    files   all its files, in the order of its frames
    frames  how many it has; `skipped` of them were there already
    """

    job: int
    files: tuple[str, ...]
    frames: int
    skipped: int


def end_of(facts: Message) -> Message:
    """The end of a job that has ended, made of what is said of it: as who follows it is told."""
    return {**facts, "is": "event", "what": "end"}


def check_done(job: int, end: Message) -> None:
    """Raise ArrayError for the end of a job that is not done, saying what became of it."""
    if end["state"] == "done":
        return
    if end["state"] == "failed":
        raise ArrayError(f"job {job} failed: {end['error']}")
    said = "was cancelled" if end["state"] == "cancelled" else f"is not done: {end['error']}"
    raise ArrayError(f"job {job} {said}")


def result_of(job: int, facts: Message, end: Message) -> Result:
    """The result of a job, from its facts and its last event. Raises ArrayError if it is not done."""
    check_done(job, end)
    return Result(job, tuple(_files_of(facts)), end["frames"], end["skipped"])


def _files_of(facts: Message) -> Iterator[str]:
    """All files of a job, in the order of its frames; those that play after the last."""
    shot = facts["first"] is not None
    names = FrameNames.split(facts["outputs"], None, shot)
    for number in range(facts["first"], facts["last"] + 1) if shot else [None]:
        yield from names.of(number)
    yield from names.played


def tell(event: Message, scene: str, hook: ProgressHook | None) -> None:
    """Pass an event on to users of Python: progress to the hook, remarks on the scene and faults as remarks."""
    what = event["what"]
    if what == "progress" and hook is not None:
        hook(RenderProgress(event["phase"], event["part"], event["in_flight"], event["frame"]))
    elif what == "note":
        remark(f"{scene}: {event['text']}")
    elif what == "fault":
        remark(event["text"], logging.WARNING)
