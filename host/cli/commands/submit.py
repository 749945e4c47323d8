"""Submits jobs and follows them, for `raygrid submit` and `raygrid wait`."""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import dataclass, replace
from typing import Any

from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.client.connection import NO_JOB, Connection, EventListener
from raygrid.host.client.facts import ENDED
from raygrid.host.client.job_events import end_of
from raygrid.host.client.service_files import find
from raygrid.host.client.submission import Submission, absolute
from raygrid.host.files.input_guard import STANDARD, check_outputs, note
from raygrid.host.image.frames import Ends, FrameNames, default_outputs, frames_of, longest_number, path_of, wants_shot
from raygrid.host.image.moving_pictures import check_played
from raygrid.host.image.outputs import check_named, check_picture_path, write_result
from raygrid.host.render.given_settings import parted
from raygrid.host.render.progress import PHASES
from raygrid.host.scene.load import check_name, check_program_name
from raygrid.host.scene.view import view_of
from raygrid.host.text.misuse import OutputMisuse
from raygrid.node.errors import ArrayError, SceneError

WORDS = PHASES | {"read": "reading", "load": "loading", "write": "writing"}  # surfaces, and a program if there is one
CANCEL_SECONDS = 5.0

Facts = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class SubmitRequest(Submission):
    """What the command line asks for: a job, of which array, and how to tell of it."""

    scene: str
    outputs: tuple[str, ...]
    stats: str | None
    program: str | None = None
    name: str
    detach: bool
    as_json: bool
    quiet: bool

    @property
    def of_shot(self) -> bool:
        """Whether frames of a shot are asked for, and not a picture of the scene as it stands. Raises OutputError."""
        return wants_shot(self.frames, self.turntable is not None, self.outputs, self.stats)


def run_submit(order: SubmitRequest) -> None:
    """Queue a job and follow it. Raises RaygridError."""
    order = _named(order)
    _check(order)
    order = replace(order, frames=_frames(order))
    connection = Connection(find(order.name))
    with contextlib.closing(connection):
        listener = connection.listen(NO_JOB)
        answer = connection.ask(order.message(follow=not order.detach), listener=listener)
        job = answer["job"]
        if order.detach:
            write_result(json.dumps({"job": job, "frames": answer["frames"]}) if order.as_json else str(job))
            return
        try:
            _follow(listener, job, answer["frames"], order.as_json, order.quiet)
        except BaseException as error:
            if _is_interrupt(error):
                _cancel(connection, job)
            raise


def run_wait(job: int, name: str, as_json: bool, quiet: bool) -> None:
    """Follow a job. Raises RaygridError, also if the job has failed or was cancelled."""
    connection = Connection(find(name))
    with contextlib.closing(connection):
        listener = connection.listen(job)
        facts = connection.ask({"do": "follow", "job": job})
        if facts["state"] in ENDED:
            if as_json:
                write_result(json.dumps(end_of(facts)))
            _judge(job, facts)
            return
        _follow(listener, job, facts["frames"], as_json, quiet)


def _named(order: SubmitRequest) -> SubmitRequest:
    """The same with the default output, if none was named."""
    return order if order.outputs else replace(order, outputs=default_outputs(order.scene, order.of_shot))


def _frames(order: SubmitRequest) -> Ends | None:
    """The frames of the job, as `render` has them: where none are named, but a shot is asked for, all of it.

    Raises SceneError for a scene in which nothing moves.
    """
    if order.frames is not None or not order.of_shot:
        return order.frames
    if order.turntable is not None:
        return 1, order.turntable.frames
    from raygrid.host.scene.load import load_scene

    numbers = frames_of(load_scene(order.scene, **parted(order.settings)[1]), None)
    return numbers[0], numbers[-1]


def _check(order: SubmitRequest) -> None:
    """What can be seen to be wrong before the array is asked. Raises SceneError, OutputError."""
    check_name(order.scene)
    view_of(parted(order.settings)[1])
    named = [*order.outputs] + ([] if order.stats is None else [order.stats])
    for what, path in (("scene", order.scene), *(("output", path) for path in named)):
        absolute(what, path)
    if not os.path.isfile(order.scene):
        raise SceneError(f"{order.scene}: there is no such file")
    if order.program is not None:
        check_program_name(order.program)
    if order.program is not None and not os.path.isfile(order.program):
        raise SceneError(f"{order.program}: there is no such file")
    shot = order.of_shot
    names = FrameNames.checked(order.outputs, order.stats, order.frames, shot)
    longest = longest_number(order.frames) if shot else None
    for path in names.of(longest):
        if path == STANDARD:
            raise OutputMisuse("-: the output is standard output, wanted a file, since the service writes it")
        check_picture_path(path)
    for path in names.played:
        check_played(path)
    if names.stats is not None:
        check_named(path_of(names.stats, longest))
    note(order.scene, "the same file as the scene")
    if order.program is not None:
        note(order.program, "the same file as the program")
    check_outputs(names.every([longest]))


def _follow(listener: EventListener, job: int, frames: int, as_json: bool, quiet: bool) -> None:
    """Tell of a job until it has ended. Raises ArrayError unless it is done."""
    with ProgressReporter(quiet or as_json) as reporter:
        teller = _JobReporter(reporter, job, frames)
        for event in listener.follow():
            if as_json:
                write_result(json.dumps({key: value for key, value in event.items() if key != "is"}))
            else:
                teller.tell(event)
    if not as_json:
        teller.sum_up(event, quiet)
    _judge(job, event)


class _JobReporter:
    """Events as a person reads them: files to standard output, the rest as a live line."""

    def __init__(self, reporter: ProgressReporter, job: int, frames: int) -> None:
        self._reporter, self._job, self._frames = reporter, job, frames
        self._phase: str | None = None
        reporter.phase(f"job {job} is queued")

    def tell(self, event: Facts) -> None:
        """Tell of one event."""
        what = event["what"]
        if what == "progress":
            self._progress(event)
        elif what == "note":
            self._reporter.remark(event["text"])
        elif what == "fault":
            self._reporter.remark(f"the array failed and was repaired: {event['text']}")
        elif what == "frame":
            for file in (*([] if event["skipped"] else event["files"]), *event["played"]):
                write_result(os.path.relpath(file) if _is_below(file) else file)

    def _progress(self, event: Facts) -> None:
        words = WORDS.get(event["phase"], str(event["phase"]))
        if self._frames == 1:
            if words != self._phase:
                self._phase = words
                self._reporter.phase(words, 1 if event["phase"] == "trace" else None)
            if event["phase"] == "trace":
                self._reporter.part(event["part"], f"{event['in_flight']:,} packets in flight")
            return
        if self._phase is None:
            self._phase = ""
            self._reporter.phase(f"job {self._job}", self._frames)
        self._reporter.part(
            event["done"] + event["part"], f"frame {event['frame']}: {words}, {event['done']} of {self._frames} done"
        )

    def sum_up(self, event: Facts, quiet: bool) -> None:
        """What is said of files that were there."""
        if not quiet and event.get("skipped"):
            self._reporter.remark(f"{event['skipped']} of {event['frames']} frames were there already")


def _is_below(file: str) -> bool:
    try:
        return file.startswith(os.path.join(os.getcwd(), ""))
    except FileNotFoundError:  # the current directory was removed
        return False


def _judge(job: int, end: Facts) -> None:
    """Raise ArrayError unless the job is done."""
    if end["state"] == "failed":
        raise ArrayError(f"job {job} failed: {end['error']}")
    if end["state"] == "cancelled":
        raise ArrayError(f"job {job} was cancelled")
    if end["state"] != "done":
        raise ArrayError(f"job {job} is not done: {end['error']}")


def _is_interrupt(error: BaseException) -> bool:
    """Whether it was Ctrl-C; other signals leave the job to go on."""
    import signal

    return isinstance(error, KeyboardInterrupt) or getattr(error, "number", None) == signal.SIGINT


def _cancel(connection: Connection, job: int) -> None:
    """Cancel over a new connection: the old one may have been left within a message."""
    with contextlib.suppress(Exception), contextlib.closing(Connection(connection.record, CANCEL_SECONDS)) as fresh:
        fresh.ask({"do": "cancel", "jobs": [job]})
