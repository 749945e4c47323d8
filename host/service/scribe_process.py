"""Is the scribe: reads scenes, splits space, looks at what is there, and writes pictures for a service.

Whatever touches files, or runs code, of whoever submitted a job is done here, one call after the other, so that the service
can kill it at any moment (`scribe`). It ends with the service.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, assert_never

import numpy as np

from raygrid.emulator.processes import end_with_parent
from raygrid.host.service import scribe_calls
from raygrid.host.service.pickled_calls import Shared, pack, receive
from raygrid.host.service.scene_store import SceneStore, wanted_by
from raygrid.host.service.scribe import SHARED
from raygrid.host.text.error_text import told
from raygrid.node.errors import RaygridError
from raygrid.node.geometry import SurfaceSet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from raygrid.host.image.picture import Picture
    from raygrid.host.render.prepared import PreparedFrame
    from raygrid.host.service.job_files import JobFiles

FILMS = "films"  # in the state directory: frames that wait to be played, a directory a job


class ScribeWork:
    """Does what the service asks for, one call after the other."""

    def __init__(self, shape: tuple[int, int, int], journal: Path, outside: bool) -> None:
        self._store, self._journal = SceneStore(shape, outside), journal
        self._films = journal.parent / FILMS
        self._files: JobFiles | None = None
        self._checked = -1  # the job whose names of files were looked at last

    def do(self, call: scribe_calls.AnyCall) -> object:
        """Do what a call says; returns its answer. Raises RaygridError, and OutputError where files are written."""
        match call:
            case scribe_calls.BeginFrame():
                return self._begin(call)
            case scribe_calls.PrepareAgain(number):
                return _for_the_array(self._store.frame(wanted_by(self._request), number))
            case scribe_calls.FinishFrame(finished):
                with self._guarded() as files:
                    files.write(_picture(finished))
            case scribe_calls.ListLacking():
                return [] if self._files is None else self._files.lacking(self._recorded)
            case scribe_calls.KeepFrame(number, finished):
                with self._guarded() as files:
                    files.keep(number, _picture(finished))
            case scribe_calls.PlayFrames():
                with self._guarded() as files:
                    return files.play(self._recorded)
            case scribe_calls.TraceBackground():
                return _background(call)
            case scribe_calls.SweepFilms():
                self._sweep()
            case scribe_calls.WarmUp():
                _warm_up()
            case _:
                assert_never(call)
        return None

    def _begin(self, call: scribe_calls.BeginFrame) -> scribe_calls.Begun:
        from raygrid.host.files.input_guard import noted
        from raygrid.host.image.moving_pictures import Reel
        from raygrid.host.scene.load import check_taken
        from raygrid.host.service.job_files import JobFiles

        job, request = call.job, call.request
        check_taken(request.program, call.programs)  # a job of the journal may have had another array
        self._request = request
        ready = self._store.frame(wanted_by(request), call.frame)
        self._files = files = JobFiles(request, call.frame, ready, Reel(str(self._films / str(job))))
        remarks = (*ready.remarks, *files.remarks)
        with noted() as inputs:
            files.note(inputs)
            if job != self._checked:
                self._sweep()
                files.check_all()
                self._checked = job
            if request.resume and files.are_there(self._recorded):
                return scribe_calls.Begun(None, files.digests, remarks)
            files.check()
        return scribe_calls.Begun(_for_the_array(ready), files.digests, remarks)

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[JobFiles]:
        """The files of the frame that was begun; none is written over what the frame is made of."""
        from raygrid.host.files.input_guard import noted

        assert self._files is not None
        with noted() as inputs:
            self._files.note(inputs)
            yield self._files

    def _recorded(self, path: str, digest: str) -> bool:
        """Whether the journal vouches for a file. One that cannot be read vouches for nothing."""
        from raygrid.host.journal.journal import Journal

        with contextlib.suppress(RaygridError), contextlib.closing(Journal(self._journal)) as journal:
            return journal.is_recorded(path, digest)
        return False

    def _sweep(self) -> None:
        """Remove the frames that wait for jobs which have ended."""
        from raygrid.host.journal.journal import Journal
        from raygrid.host.service.job_files import sweep_films

        if self._films.is_dir():
            with contextlib.suppress(RaygridError), contextlib.closing(Journal(self._journal)) as journal:
                sweep_films(self._films, journal)


def _background(call: scribe_calls.TraceBackground) -> NDArray[np.int64]:
    from raygrid.host.render.program_file import for_host

    sums = np.zeros((call.frame.width * call.frame.height, 3), np.int64)
    for_host(call.program).add_missed(call.frame, call.step, sums)
    return sums


def _warm_up() -> None:
    import raygrid.emulator.partition.cost_grid
    import raygrid.emulator.partition.sampling_prepass
    import raygrid.host.image.picture
    import raygrid.host.image.resume_check  # noqa: F401


def _picture(finished: scribe_calls.Finished) -> Picture:
    from raygrid.host.image.picture import Picture

    return Picture(finished.sums, finished.samples, finished.stats)


def _for_the_array(ready: PreparedFrame) -> PreparedFrame:
    """A frame without what only its making needed: of the scene nothing but its name."""
    scene = ready.job.scene
    bare = replace(
        scene,
        surfaces=SurfaceSet(()),
        materials=scene.materials[:0],
        material_names=(),
        lights=scene.lights[:0],
        rules=None,
        shot=None,
    )
    return replace(ready, job=replace(ready.job, scene=bare))


def _serve(stream: socket.socket, work: ScribeWork) -> None:
    """Do what is asked for until the service closes the socket."""
    shared = Shared(SHARED)
    with contextlib.suppress(EOFError):
        while True:
            call: scribe_calls.AnyCall = receive(shared, stream.recv_into)
            try:
                answer: scribe_calls.CallDone[object] | scribe_calls.CallFailed = scribe_calls.CallDone(work.do(call))
            except Exception as error:
                answer = scribe_calls.CallFailed(told(error))
            if not isinstance(call, scribe_calls.Unanswered):
                for piece in pack(answer, shared):
                    stream.sendall(piece)


def main() -> None:
    """The whole life of a scribe."""
    parser = argparse.ArgumentParser(prog="python -m raygrid.host.service.scribe_process")
    parser.add_argument("socket", type=int)
    parser.add_argument("parent", type=int)
    parser.add_argument("journal", type=Path)
    parser.add_argument("shape", nargs=3, type=int)
    parser.add_argument("--outside", action="store_true")
    given = parser.parse_args()
    end_with_parent(given.parent, signal.SIGKILL)  # it may be held up by a file, and would not hear of it
    signal.pthread_sigmask(signal.SIG_SETMASK, set())
    for number in (signal.SIGINT, signal.SIGHUP):  # of the terminal that the service was launched from
        signal.signal(number, signal.SIG_IGN)
    nx, ny, nz = given.shape
    with socket.socket(fileno=given.socket) as stream, contextlib.suppress(BrokenPipeError, ConnectionResetError):
        os.set_inheritable(stream.fileno(), False)
        _serve(stream, ScribeWork((nx, ny, nz), given.journal, given.outside))
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
