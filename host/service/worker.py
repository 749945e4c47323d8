"""Drives the array in a thread of the service: one frame after another, and tells what became of each.

The service hands it tasks and interrupts it; it answers by events, each handed to `post` in this thread.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from raygrid.host.service.array_supervisor import ArraySupervisor, NoArray
from raygrid.host.service.scribe import Begun, Finished, Scribe, ScribeLost
from raygrid.host.text.clean_text import printable
from raygrid.host.text.error_text import told

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from raygrid.emulator.driver import Progress
    from raygrid.host.client.requests import SubmitMessage
    from raygrid.host.image.picture import Picture
    from raygrid.host.render.machine_job import Job
    from raygrid.host.render.prepared import PreparedFrame

LAUNCH_SECONDS = 5.0  # between two attempts to launch an array that could not be
LOOK_SECONDS = 0.25  # between two looks at an array that has nothing to do
ATTEMPTS = 4  # at a frame whose scribe ends, as at one whose nodes do
TELL_SECONDS = 0.1  # between two reports of progress


class Interrupted(Exception):
    """The frame was given up because the service asked for it."""


@dataclass(frozen=True)
class Task:
    """A frame to be rendered. `frame` is None if the job names no frames; `last`: no other of the job is left."""

    serial: int
    job: int
    frame: int | None
    request: SubmitMessage
    last: bool = True


class Event(NamedTuple):
    """What happened: its kind, the task that it is about, and what there is to say.

    warming   done, total, what        compiling or loading kernels
    ready     pids                     the array can render
    broken    why                      it cannot, and could not be launched again
    begun                              a task was begun
    note      text                     a remark on its scene
    moved     phase, part, in_flight   how far it is; `part` of its rays from 0 to 1
    done      files, played, skipped, seconds  its files are there, path -> digest; `played`: those that hold all
                                       frames of the job, if they were written now
    failed    why                      it cannot be done
    interrupted                        it was given up, as asked
    fault     what                     the array failed and was repaired
    reset                              it was reset, as asked
    sample    sample                   how a node stands
    ended                              the thread has ended, and the array with it
    """

    kind: str
    task: Task | None = None
    facts: dict[str, Any] = {}  # noqa: RUF012  (never changed)


@dataclass
class Options:
    """Of the array: processors on each axis, most packets a message, seconds until it is taken to hang, its journal,
    whether it takes programs, and whether scenes may refer to files outside their folders."""

    shape: tuple[int, int, int]
    batch: int = 4096
    patience: float = 30.0
    journal: Path = field(default_factory=Path)
    programs: bool = False
    outside: bool = False


class Worker(threading.Thread):
    """Drives the array, which its `supervisor` keeps."""

    def __init__(self, options: Options, post: Callable[[Event], None]) -> None:
        super().__init__(name="array", daemon=True)
        self._options, self._post = options, post
        self._inbox: queue.SimpleQueue[Task | str] = queue.SimpleQueue()
        self._unwanted = -1  # serial of the task that is to be given up
        self._ending = False
        self._task: Task | None = None
        self._told = 0.0
        self._noted: set[tuple[int, str]] = set()
        self.supervisor = ArraySupervisor(
            options.shape,
            lambda what: post(Event("fault", self._task, {"what": what})),
            self._look,
            batch=options.batch,
            patience=options.patience,
            programs=options.programs,
            on_warming=lambda *now: post(
                Event("warming", None, dict(zip(("done", "total", "what"), now, strict=True)))
            ),
        )
        self.supervisor.on_sample = lambda sample: post(Event("sample", None, {"sample": sample}))
        arguments = [str(options.journal), *map(str, options.shape), *["--outside"] * options.outside]
        self._scribe = Scribe(arguments, self._look)
        self._unswept = True  # whether frames may wait for a job that has ended

    # --- what the service says; callable from its thread ----------------------------------------------

    def give(self, task: Task) -> None:
        """Render this next."""
        self._inbox.put(task)

    def interrupt(self, task: Task) -> None:
        """Give this task up, if it is still under way."""
        self._unwanted = task.serial

    def ask_reset(self) -> None:
        """Reset the array, after the task under way; interrupt that first if it is not to be waited for."""
        self._inbox.put("reset")

    def ask_end(self) -> None:
        """Give up what is under way, end the array and the thread."""
        self._ending = True
        self._inbox.put("end")

    # --- the thread -----------------------------------------------------------------------------------

    def run(self) -> None:
        """Launch, serve, end."""
        try:
            if self._launch():
                self._serve()
        finally:
            self._ending = False  # or the array could not say goodbye
            self._scribe.close()
            self.supervisor.close()
            self._post(Event("ended"))

    def _launch(self) -> bool:
        try:
            self._scribe.start()
            self.supervisor.launch()
            self._scribe.tell("warm")
        except Interrupted:
            return False
        except Exception as error:
            self._post(Event("broken", None, {"why": told(error)}))
            return False
        self._post(Event("ready", None, {"pids": self.supervisor.pids}))
        return True

    def _serve(self) -> None:
        while not self._ending:
            try:
                given = self._inbox.get(timeout=LOOK_SECONDS if self.supervisor.there else LAUNCH_SECONDS)
            except queue.Empty:
                if self._unswept:
                    self._scribe.tell("sweep")
                    self._unswept = False
                self._repair(self.supervisor.check)
                continue
            if isinstance(given, Task):
                self._unswept = True
                self._do(given)
            elif given == "reset" and self._repair(self.supervisor.reset):
                self._post(Event("reset"))

    def _repair(self, work: Callable[[], None]) -> bool:
        """Look after the array; whether it can be used."""
        pids = self.supervisor.pids
        try:
            work()
        except Interrupted:
            return False
        except Exception as error:
            self._post(Event("broken", None, {"why": told(error)}))
            return False
        if self.supervisor.pids not in ([], pids):
            self._post(Event("ready", None, {"pids": self.supervisor.pids}))
        return True

    def _do(self, task: Task) -> None:
        self._task, self._told = task, 0.0
        pids = self.supervisor.pids
        try:
            self._look()
            self._post(Event("begun", task))
            event = self._frame(task)
        except Interrupted:
            event = Event("interrupted", task)
        except NoArray as error:  # the frame can wait
            self._post(Event("broken", task, {"why": told(error)}))
            event = Event("interrupted", task)
        except Exception as error:
            event = Event("failed", task, {"why": told(error)})
        finally:
            self._task = None
        self._make_scribe()
        if self.supervisor.pids not in ([], pids):
            self._post(Event("ready", None, {"pids": self.supervisor.pids}))
        self._post(event)

    def _make_scribe(self) -> None:
        """Start the scribe if it had to be killed, before it is needed."""
        if self._scribe.pid is None:
            self._scribe.tell("warm")

    def _look(self) -> None:
        """Called often while the array works. Raises Interrupted."""
        if self._ending or (self._task is not None and self._task.serial == self._unwanted):
            raise Interrupted

    # --- one frame ------------------------------------------------------------------------------------

    def _frame(self, task: Task) -> Event:
        """Make a frame, and begin it again if the scribe ends meanwhile: a scene that is its end each time fails its job."""
        for _ in range(ATTEMPTS - 1):
            try:
                return self._make(task)
            except ScribeLost as error:
                self._note(task, [f"{error}; the frame is begun again"])
        return self._make(task)

    def _make(self, task: Task) -> Event:
        began = time.perf_counter()
        request = task.request
        self._tell(task, "read", 0.0, 0)
        begun: Begun = self._scribe.ask("begin", task.job, request, task.frame, self._options.programs)
        self._note(task, begun.remarks)
        facts: dict[str, Any] = {"files": begun.files, "skipped": begun.ready is None, "played": {}, "seconds": {}}
        if begun.ready is not None:
            picture = self._picture(task, begun.ready)
            self._tell(task, "write", 1.0, 0)
            self._scribe.ask("finish", Finished(picture.sums, picture.samples, picture.stats))
            facts["seconds"] = dict(picture.stats["wall_seconds"]) | {"whole": round(time.perf_counter() - began, 6)}
        if task.last:
            facts["played"] = self._play(task)
        return Event("done", task, facts)

    def _play(self, task: Task) -> dict[str, str]:
        """Write the files that hold all frames of a job, whose last is done; frames that have gone are rendered again."""
        for number in self._scribe.ask("lacking"):
            picture = self._picture(task, self._scribe.ask("again", number))
            self._scribe.ask("keep", number, Finished(picture.sums, picture.samples, picture.stats))
        played: dict[str, str] = self._scribe.ask("play")
        return played

    def _picture(self, task: Task, ready: PreparedFrame) -> Picture:
        job = replace(ready.job, add_missed=self._add_missed)
        picture = self.supervisor.render(job, task.request.budget, self._watch(task, ready))
        if (blank := picture.blank()) is not None:
            self._note(task, [blank if task.frame is None else f"frame {task.frame}: {blank}"])
        return picture

    def _add_missed(self, job: Job, sums: NDArray[np.int64]) -> None:
        """The background of a program runs in the scribe: it may never come to an end."""
        sums += self._scribe.ask("background", job.settings.program, job.frame, job.space.step)

    def _watch(self, task: Task, ready: PreparedFrame) -> Callable[[str, Progress | None], None]:
        from raygrid.host.render.machine_job import samples_expected

        expected = samples_expected(ready.job)

        def watch(phase: str, now: Progress | None) -> None:
            self._look()
            if now is None:
                self._tell(task, phase, 1.0 if phase == "collect" else 0.0, 0)
            elif time.monotonic() - self._told > TELL_SECONDS:
                born, died = sum(now.born), sum(now.died)
                part = min(1.0, now.primaries / expected) * died / max(born, 1)
                self._tell(task, phase, part, now.in_flight)

        return watch

    def _tell(self, task: Task, phase: str, part: float, in_flight: int) -> None:
        self._told = time.monotonic()
        self._post(Event("moved", task, {"phase": phase, "part": part, "in_flight": in_flight}))

    def _note(self, task: Task, remarks: Any) -> None:
        """Tell of remarks, each once a job."""
        for text in map(printable, remarks):
            if (task.job, text) not in self._noted:
                self._noted.add((task.job, text))
                self._post(Event("note", task, {"text": text}))
        if len(self._noted) > 10_000:
            self._noted.clear()
