"""The thread of a service that drives the array: one frame after another, and what became of each.

The service hands it tasks and interrupts it; it answers by events, each handed to `post` in this thread.
"""

from __future__ import annotations

import errno
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from raygrid.host.keeper import Keeper, NoArray
from raygrid.node.errors import RaygridError

if TYPE_CHECKING:
    from raygrid.emulator.driver import Progress
    from raygrid.host.journal import Journal
    from raygrid.host.picture import Picture
    from raygrid.host.requests import Submit
    from raygrid.host.scene_store import Ready, SceneStore

FILMS = "films"  # in the state directory: frames that wait to be played, a directory a job
LAUNCH_SECONDS = 5.0  # between two attempts to launch an array that could not be
LOOK_SECONDS = 0.25  # between two looks at an array that has nothing to do
TELL_SECONDS = 0.1  # between two reports of progress


class Interrupted(Exception):
    """The frame was given up because the service asked for it."""


@dataclass(frozen=True)
class Task:
    """A frame to be rendered. `frame` is None if the job names no frames; `last`: no other of the job is left."""

    serial: int
    job: int
    frame: int | None
    request: Submit
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
    and whether it takes programs."""

    shape: tuple[int, int, int]
    batch: int = 4096
    patience: float = 30.0
    journal: Path = field(default_factory=Path)
    programs: bool = False


class Worker(threading.Thread):
    """Drives the array.

    keeper    of the array
    """

    def __init__(self, options: Options, post: Callable[[Event], None]) -> None:
        super().__init__(name="array", daemon=True)
        self._options, self._post = options, post
        self._inbox: queue.SimpleQueue[Task | str] = queue.SimpleQueue()
        self._unwanted = -1  # serial of the task that is to be given up
        self._ending = False
        self._task: Task | None = None
        self._told = 0.0
        self._noted: set[tuple[int, str]] = set()
        self.keeper = Keeper(
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
        self.keeper.on_sample = lambda sample: post(Event("sample", None, {"sample": sample}))
        self._store: SceneStore | None = None
        self._journal: Journal | None = None
        self._films = options.journal.parent / FILMS
        self._checked = -1  # the job whose names of files were looked at last

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
            self.keeper.close()
            if self._journal is not None:
                self._journal.close()
            self._post(Event("ended"))

    def _launch(self) -> bool:
        try:
            self.keeper.launch()
            from raygrid.host.journal import Journal
            from raygrid.host.scene_store import SceneStore

            self._store = SceneStore(self._options.shape)
            self._journal = Journal(self._options.journal)
        except Interrupted:
            return False
        except Exception as error:
            self._post(Event("broken", None, {"why": _told(error)}))
            return False
        self._post(Event("ready", None, {"pids": self.keeper.pids}))
        return True

    def _serve(self) -> None:
        while not self._ending:
            try:
                given = self._inbox.get(timeout=LOOK_SECONDS if self.keeper.there else LAUNCH_SECONDS)
            except queue.Empty:
                self._sweep()
                self._repair(self.keeper.check)
                continue
            if isinstance(given, Task):
                if given.job != self._checked:
                    self._sweep()
                self._do(given)
            elif given == "reset" and self._repair(self.keeper.reset):
                self._post(Event("reset"))

    def _sweep(self) -> None:
        """Remove what waits for jobs that have ended."""
        from raygrid.host.job_files import sweep_films

        if self._journal is not None and self._films.is_dir():
            sweep_films(self._films, self._journal)

    def _repair(self, work: Callable[[], None]) -> bool:
        """Look after the array; whether it can be used."""
        pids = self.keeper.pids
        try:
            work()
        except Interrupted:
            return False
        except Exception as error:
            self._post(Event("broken", None, {"why": _told(error)}))
            return False
        if self.keeper.pids not in ([], pids):
            self._post(Event("ready", None, {"pids": self.keeper.pids}))
        return True

    def _do(self, task: Task) -> None:
        self._task, self._told = task, 0.0
        pids = self.keeper.pids
        try:
            self._look()
            self._post(Event("begun", task))
            event = self._frame(task)
        except Interrupted:
            event = Event("interrupted", task)
        except NoArray as error:  # the frame can wait
            self._post(Event("broken", task, {"why": _told(error)}))
            event = Event("interrupted", task)
        except Exception as error:
            event = Event("failed", task, {"why": _told(error)})
        finally:
            self._task = None
        if self.keeper.pids not in ([], pids):
            self._post(Event("ready", None, {"pids": self.keeper.pids}))
        self._post(event)

    def _look(self) -> None:
        """Called often while the array works. Raises Interrupted."""
        if self._ending or (self._task is not None and self._task.serial == self._unwanted):
            raise Interrupted

    # --- one frame ------------------------------------------------------------------------------------

    def _frame(self, task: Task) -> Event:
        from raygrid.host.inputs import noted
        from raygrid.host.job_files import JobFiles
        from raygrid.host.load import check_allowed
        from raygrid.host.moving_pictures import Reel

        assert self._store is not None
        assert self._journal is not None
        begun = time.perf_counter()
        request, recorded = task.request, self._journal.is_recorded
        self._tell(task, "read", 0.0, 0)
        check_allowed(request.program, self._options.programs)  # a job of the journal may have had another array
        ready = self._store.frame(request.wanted(), task.frame)
        files = JobFiles(request, task.frame, ready, Reel(str(self._films / str(task.job)), self._look))
        self._note(task, (*ready.remarks, *files.remarks))
        with noted() as inputs:
            files.note(inputs)
            if task.job != self._checked:
                files.check_all()
                self._checked = task.job
            skipped = request.resume and files.are_there(recorded)
            seconds: dict[str, float] = {}
            if not skipped:
                files.check()
                picture = self._picture(task, ready)
                self._tell(task, "write", 1.0, 0)
                files.write(picture)
                seconds = dict(picture.stats["wall_seconds"]) | {"whole": round(time.perf_counter() - begun, 6)}
            played = files.play(lambda number: self._again(task, number), recorded) if task.last else {}
        facts = {"files": files.digests, "played": played, "skipped": skipped, "seconds": seconds}
        return Event("done", task, facts)

    def _picture(self, task: Task, ready: Ready) -> Picture:
        picture = self.keeper.render(ready, task.request.budget, self._watch(task, ready))
        if picture.stats["total"]["hits"] == 0:
            self._note(task, ["no ray of the camera meets a surface: the picture shows the background only"])
        return picture

    def _again(self, task: Task, number: int) -> Picture:
        """A frame of a file that plays which was done, and has gone meanwhile."""
        assert self._store is not None
        return self._picture(task, self._store.frame(task.request.wanted(), number))

    def _watch(self, task: Task, ready: Ready) -> Callable[[str, Progress | None], None]:
        def watch(phase: str, now: Progress | None) -> None:
            self._look()
            if now is None:
                self._tell(task, phase, 1.0 if phase == "collect" else 0.0, 0)
            elif time.monotonic() - self._told > TELL_SECONDS:
                born, died = sum(now.born), sum(now.died)
                part = min(1.0, now.primaries / ready.expected) * died / max(born, 1)
                self._tell(task, phase, part, now.in_flight)

        return watch

    def _tell(self, task: Task, phase: str, part: float, in_flight: int) -> None:
        self._told = time.monotonic()
        self._post(Event("moved", task, {"phase": phase, "part": part, "in_flight": in_flight}))

    def _note(self, task: Task, remarks: Any) -> None:
        """Tell of remarks, each once a job."""
        for text in remarks:
            if (task.job, text) not in self._noted:
                self._noted.add((task.job, text))
                self._post(Event("note", task, {"text": text}))
        if len(self._noted) > 10_000:
            self._noted.clear()


def _told(error: BaseException) -> str:
    """An error as one line; what is not ours goes with its traceback into the log."""
    line = " ".join(str(error).split())
    if isinstance(error, RaygridError):
        return line
    if isinstance(error, MemoryError):
        return "out of memory"
    traceback.print_exception(error, file=sys.stderr)
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return f"the array's service may open no more files: {line}"
    return f"a bug: {type(error).__name__}: {line} (the array's log has more)"
