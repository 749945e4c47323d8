"""The scribe: the process of a service that reads scenes, splits space, looks at what is there, and writes pictures.

Whatever touches files, or runs code, of whoever submitted a job is done here, one call after the other, so that the service
can kill it at any moment (`scribe`). It ends with the service.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import socket
import stat
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from raygrid.emulator.nursery import end_with_parent
from raygrid.host.frames import path_of
from raygrid.host.pickled import Shared, pack, receiving
from raygrid.host.scene_store import Ready, SceneStore
from raygrid.host.scribe import SHARED, Begun, Finished
from raygrid.host.told import told
from raygrid.node.errors import OutputError, RaygridError
from raygrid.node.surfaces import SurfaceSet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from raygrid.host.requests import Submit
    from raygrid.node.programs import Program
    from raygrid.node.tables import Frame


class Work:
    """What the service may call."""

    def __init__(self, shape: tuple[int, int, int], journal: Path, outside: bool) -> None:
        self._store, self._journal = SceneStore(shape, outside), journal

    def begin(self, request: Submit, frame: int | None, programs: bool) -> Begun:
        """Read the scene, make a frame of it ready, and look at where its files go. Raises RaygridError."""
        from raygrid.host.load import check_taken
        from raygrid.host.outputs import check_path, check_picture_path, check_side

        check_taken(request.program, programs)  # a job of the journal may have had another array
        files = [path_of(pattern, frame) for pattern in request.outputs]
        stats = None if request.stats is None else path_of(request.stats, frame)
        for file in (*files, *filter(None, [stats])):
            _check_kind(file)
        ready = self._store.frame(request.wanted(), frame)
        digest = ready.digest(frame, request.transfer)
        size = ready.job.frame.width, ready.job.frame.height
        begun = Begun(_for_the_array(ready), dict.fromkeys(files, digest), stats, ready.remarks)
        if request.resume and self._there(files, stats, digest, size):
            return replace(begun, ready=None)
        for file in files:
            check_picture_path(file)
            check_side(file, *size)
        if stats is not None:
            check_path(stats)
        return begun

    def _there(self, files: list[str], stats: str | None, digest: str, size: tuple[int, int]) -> bool:
        from raygrid.host.journal import Journal
        from raygrid.host.whole import is_whole

        def recorded(path: str, digest: str) -> bool:
            with contextlib.closing(Journal(self._journal)) as journal:
                return journal.is_recorded(path, digest)

        if stats is not None and not Path(stats).is_file():
            return False
        with contextlib.suppress(RaygridError):  # a journal that cannot be read vouches for nothing
            return all(is_whole(file, digest, *size, recorded) for file in files)
        return False

    def background(self, program: Program, frame: Frame, step: tuple[float, float, float]) -> NDArray[np.int64]:
        """What the rays see by a program that never enter the world box, int64 (pixels, 3). Raises ProtocolError."""
        from raygrid.host.program_file import for_host

        sums = np.zeros((frame.width * frame.height, 3), np.int64)
        for_host(program).add_missed(frame, step, sums)
        return sums

    def finish(self, finished: Finished) -> None:
        """Write the files of a frame, each whole or not at all. Raises OutputError."""
        from raygrid.host.picture import Picture
        from raygrid.host.stats import save_stats
        from raygrid.host.whole import KEYWORD

        picture = Picture(finished.sums, finished.samples, finished.stats)
        for file, digest in finished.files.items():
            _check_kind(file)
            picture.save(file, finished.transfer, {KEYWORD: digest})
        if finished.stats_path is not None:
            _check_kind(finished.stats_path)
            save_stats(finished.stats_path, finished.stats)

    def warm(self) -> None:
        """Import what larger frames need, while there is nothing else to do."""
        import raygrid.emulator.pilot
        import raygrid.emulator.work
        import raygrid.host.picture
        import raygrid.host.whole  # noqa: F401


def _check_kind(path: str) -> None:
    """Raise OutputError for what only takes bytes while somebody reads them. A device such as /dev/null is let pass."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return
    kind = "pipe" if stat.S_ISFIFO(mode) else "socket" if stat.S_ISSOCK(mode) else "disk" if stat.S_ISBLK(mode) else ""
    if kind:
        raise OutputError(f"{path}: the output is a {kind}, wanted a file")


def _for_the_array(ready: Ready) -> Ready:
    """A frame without what only its making needed: of the scene nothing but its name."""
    scene = ready.job.scene
    bare = replace(
        scene, surfaces=SurfaceSet(()), materials=scene.materials[:0], lights=scene.lights[:0], rules=None, shot=None
    )
    return replace(ready, job=replace(ready.job, scene=bare))


def _serve(door: socket.socket, work: Work) -> None:
    """Do what is asked for until the service closes the socket."""
    shared = Shared(SHARED)
    with door.makefile("rb", buffering=0) as incoming:
        while (message := _receive(incoming, shared)) is not None:
            what, arguments = message
            try:
                answer = "done", getattr(work, what)(*arguments)
            except Exception as error:
                answer = "failed", told(error)
            if what != "warm":
                for piece in pack(answer, shared):
                    door.sendall(piece)


def _receive(incoming: Any, shared: Shared) -> Any:
    """The next message; None when there will be no more."""
    message = receiving(shared)
    room = next(message)
    try:
        while True:
            while room:
                count = incoming.readinto(room)
                if not count:
                    return None
                room = room[count:]
            room = next(message)
    except StopIteration as end:
        return end.value


def main() -> None:
    """The whole life of a scribe."""
    parser = argparse.ArgumentParser(prog="python -m raygrid.host.scribe_process")
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
    with socket.socket(fileno=given.socket) as door, contextlib.suppress(BrokenPipeError, ConnectionResetError):
        os.set_inheritable(door.fileno(), False)
        _serve(door, Work((nx, ny, nz), given.journal, given.outside))
    sys.stderr.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
