"""Drives the array in a thread of the service: one frame after another, and tells what became of each.

The service hands it tasks and interrupts it; it answers by events, each handed to `post` in this thread.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from raygrid.host.render.progress import traced_part
from raygrid.host.service import events, scribe_calls
from raygrid.host.service.array_supervisor import ArraySupervisor, NoArray
from raygrid.host.service.scribe import Scribe, ScribeLost
from raygrid.host.text.clean_text import printable
from raygrid.host.text.error_text import told

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from raygrid.emulator.driver import Progress
    from raygrid.host.image.picture import Picture
    from raygrid.host.render.machine_job import Job
    from raygrid.host.render.prepared import PreparedFrame

LAUNCH_SECONDS = 5.0  # between two attempts to launch an array that could not be
LOOK_SECONDS = 0.25  # between two looks at an array that has nothing to do
ATTEMPTS = 4  # at a frame whose scribe ends, as at one whose nodes do
TELL_SECONDS = 0.1  # between two reports of progress


class Interrupted(Exception):
    """The frame was given up because the service asked for it."""


class Worker(threading.Thread):
    """Drives the array.

    supervisor  of the array
    """

    def __init__(self, options: events.Options, post: Callable[[events.Event], None]) -> None:
        super().__init__(name="array", daemon=True)
        self._options, self._post = options, post
        self._inbox: queue.SimpleQueue[events.Task | str] = queue.SimpleQueue()
        self._unwanted = -1  # serial of the task that is to be given up
        self._ending = False
        self._task: events.Task | None = None
        self._told = 0.0
        self._noted: set[tuple[int, str]] = set()
        self.supervisor = ArraySupervisor(
            options.shape,
            lambda what: post(events.ArrayRepaired(what, self._task)),
            self._look,
            batch=options.batch,
            patience=options.patience,
            programs=options.programs,
            on_warming=lambda done, total, what: post(events.KernelsWarming(done, total, what)),
        )
        self.supervisor.on_sample = lambda sample: post(events.NodeSampled(sample))
        arguments = [str(options.journal), *map(str, options.shape), *["--outside"] * options.outside]
        self._scribe = Scribe(arguments, self._look)
        self._unswept = True  # whether frames may wait for a job that has ended

    # --- what the service says; callable from its thread ----------------------------------------------

    def give(self, task: events.Task) -> None:
        """Render this next."""
        self._inbox.put(task)

    def interrupt(self, task: events.Task) -> None:
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
            self._post(events.ArrayEnded())

    def _launch(self) -> bool:
        try:
            self._scribe.start()
            self.supervisor.launch()
            self._scribe.tell(scribe_calls.WarmUp())
        except Interrupted:
            return False
        except Exception as error:
            self._post(events.ArrayBroken(told(error)))
            return False
        self._post(events.ArrayReady(self.supervisor.pids))
        return True

    def _serve(self) -> None:
        while not self._ending:
            try:
                given = self._inbox.get(timeout=LOOK_SECONDS if self.supervisor.there else LAUNCH_SECONDS)
            except queue.Empty:
                if self._unswept:
                    self._scribe.tell(scribe_calls.SweepFilms())
                    self._unswept = False
                self._repair(self.supervisor.check)
                continue
            if isinstance(given, events.Task):
                self._unswept = True
                self._do(given)
            elif given == "reset" and self._repair(self.supervisor.reset):
                self._post(events.ArrayReset())

    def _repair(self, work: Callable[[], None]) -> bool:
        """Look after the array; whether it can be used."""
        pids = self.supervisor.pids
        try:
            work()
        except Interrupted:
            return False
        except Exception as error:
            self._post(events.ArrayBroken(told(error)))
            return False
        if self.supervisor.pids not in ([], pids):
            self._post(events.ArrayReady(self.supervisor.pids))
        return True

    def _do(self, task: events.Task) -> None:
        self._task, self._told = task, 0.0
        pids = self.supervisor.pids
        try:
            self._look()
            self._post(events.FrameBegun(task))
            event: events.TaskEnd = self._frame(task)
        except Interrupted:
            event = events.FrameInterrupted(task)
        except NoArray as error:  # the frame can wait
            self._post(events.ArrayBroken(told(error), task))
            event = events.FrameInterrupted(task)
        except Exception as error:
            event = events.FrameFailed(task, told(error))
        finally:
            self._task = None
        self._make_scribe()
        if self.supervisor.pids not in ([], pids):
            self._post(events.ArrayReady(self.supervisor.pids))
        self._post(event)

    def _make_scribe(self) -> None:
        """Start the scribe if it had to be killed, before it is needed."""
        if self._scribe.pid is None:
            self._scribe.tell(scribe_calls.WarmUp())

    def _look(self) -> None:
        """Called often while the array works. Raises Interrupted."""
        if self._ending or (self._task is not None and self._task.serial == self._unwanted):
            raise Interrupted

    # --- one frame ------------------------------------------------------------------------------------

    def _frame(self, task: events.Task) -> events.FrameDone:
        """Make a frame, and begin it again if the scribe ends meanwhile: a scene that is its end each time fails its job."""
        for _ in range(ATTEMPTS - 1):
            try:
                return self._make(task)
            except ScribeLost as error:
                self._note(task, [f"{error}; the frame is begun again"])
        return self._make(task)

    def _make(self, task: events.Task) -> events.FrameDone:
        began = time.perf_counter()
        request = task.request
        self._tell(task, "read", 0.0, 0)
        begun = self._scribe.ask(scribe_calls.BeginFrame(task.job, request, task.frame, self._options.programs))
        self._note(task, begun.remarks)
        seconds: dict[str, float] = {}
        if begun.ready is not None:
            picture = self._picture(task, begun.ready)
            self._tell(task, "write", 1.0, 0)
            self._scribe.ask(scribe_calls.FinishFrame(scribe_calls.Finished.of(picture)))
            seconds = dict(picture.stats["wall_seconds"]) | {"whole": round(time.perf_counter() - began, 6)}
        played = self._play(task) if task.last else {}
        return events.FrameDone(task, begun.files, played, begun.ready is None, seconds)

    def _play(self, task: events.Task) -> dict[str, str]:
        """Write the files that hold all frames of a job, whose last is done; frames that have gone are rendered again."""
        for number in self._scribe.ask(scribe_calls.ListLacking()):
            picture = self._picture(task, self._scribe.ask(scribe_calls.PrepareAgain(number)))
            self._scribe.ask(scribe_calls.KeepFrame(number, scribe_calls.Finished.of(picture)))
        return self._scribe.ask(scribe_calls.PlayFrames())

    def _picture(self, task: events.Task, ready: PreparedFrame) -> Picture:
        job = replace(ready.job, add_missed=self._add_missed)
        picture = self.supervisor.render(job, task.request.budget, self._watch(task, ready))
        if (blank := picture.blank()) is not None:
            self._note(task, [blank if task.frame is None else f"frame {task.frame}: {blank}"])
        return picture

    def _add_missed(self, job: Job, sums: NDArray[np.int64]) -> None:
        """The background of a program runs in the scribe: it may never come to an end."""
        assert job.settings.program is not None
        sums += self._scribe.ask(scribe_calls.TraceBackground(job.settings.program, job.frame, job.space.step))

    def _watch(self, task: events.Task, ready: PreparedFrame) -> Callable[[str, Progress | None], None]:
        from raygrid.host.render.machine_job import samples_expected

        expected = samples_expected(ready.job)

        def watch(phase: str, now: Progress | None) -> None:
            self._look()
            if now is None:
                self._tell(task, phase, 1.0 if phase == "collect" else 0.0, 0)
            elif time.monotonic() - self._told > TELL_SECONDS:
                self._tell(task, phase, traced_part(now, expected), now.in_flight)

        return watch

    def _tell(self, task: events.Task, phase: str, part: float, in_flight: int) -> None:
        self._told = time.monotonic()
        self._post(events.FrameMoved(task, phase, part, in_flight))

    def _note(self, task: events.Task, remarks: Iterable[str]) -> None:
        """Tell of remarks, each once a job."""
        for text in map(printable, remarks):
            if (task.job, text) not in self._noted:
                self._noted.add((task.job, text))
                self._post(events.SceneRemarked(task, text))
        if len(self._noted) > 10_000:
            self._noted.clear()
