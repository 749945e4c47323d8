"""Cleaners of temporary files for the fault campaign: directories and files of a running service are removed.

A client is then served all the same, or told in one line; `up` brings the array back, and jobs that a service knew are done.
Two services never share a journal.
"""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from faults_bed import Case, Outcome
from faults_service import MOBILE, NAME, ServiceBed, Wrong, command, one_line, right, services, submit

import raygrid
from raygrid.emulator.topology import socket_directory
from raygrid.host.client.client import Service
from raygrid.host.client.service_files import LOCK, LOG, RECORD, SOCKET, TOKEN, state_directory
from raygrid.node.errors import RaygridError

FRAMES = 3
SERVED_SECONDS = 15.0  # for a service to make anew what was removed, if it does
DONE_SECONDS = 30.0
Clean = Callable[[ServiceBed], None]


def _listener(bed: ServiceBed) -> None:
    shutil.rmtree(bed.record.directory)


def _socket(bed: ServiceBed) -> None:
    os.unlink(Path(bed.record.directory, SOCKET))


def _token(bed: ServiceBed) -> None:
    os.unlink(Path(bed.record.directory, TOKEN))


def _links(bed: ServiceBed) -> None:
    """The sockets of the nodes, with their directories."""
    door = bed.record.directory
    for base in map(Path, socket_directory.bases()):
        for folder in base.glob(f"{socket_directory.PREFIX}*"):
            if str(folder) != door and str(folder).startswith(str(bed.root)):
                shutil.rmtree(folder, ignore_errors=True)


def _all_sockets(bed: ServiceBed) -> None:
    for folder in Path(os.environ["XDG_RUNTIME_DIR"]).iterdir():
        shutil.rmtree(folder, ignore_errors=True)


def _state(bed: ServiceBed) -> None:
    shutil.rmtree(state_directory(NAME))


def _lock_and_record(bed: ServiceBed) -> None:
    for name in (LOCK, RECORD):
        state_directory(NAME).joinpath(name).unlink()


def _record(bed: ServiceBed) -> None:
    state_directory(NAME).joinpath(RECORD).unlink()


def _lock(bed: ServiceBed) -> None:
    state_directory(NAME).joinpath(LOCK).unlink()


def _log(bed: ServiceBed) -> None:
    state_directory(NAME).joinpath(LOG).unlink()


def _journal(bed: ServiceBed) -> None:
    """SQLite's own files beside the journal too."""
    for path in state_directory(NAME).glob("journal*"):
        path.unlink()


def _temporary(bed: ServiceBed) -> None:
    """The directory for temporary files itself."""
    shutil.rmtree(os.environ["TMPDIR"])


CLEANS: tuple[Clean, ...] = (
    *(
        _listener,
        _socket,
        _token,
        _links,
        _all_sockets,
        _state,
        _lock_and_record,
        _record,
        _lock,
        _log,
        _journal,
        _temporary,
    ),
)


def _cleaned(rng: random.Random) -> list[Case]:
    def do(bed: ServiceBed, clean: Clean, after: float) -> Outcome:
        jobs = {}
        with raygrid.connect(NAME) as array:
            for number in range(2):
                pattern = bed.folder / f"{number}_%d.npy"
                jobs[submit(array, pattern, MOBILE, frames=(1, FRAMES), client=f"client {number}").job] = pattern
            time.sleep(after)
            try:
                clean(bed)
            finally:
                Path(os.environ["TMPDIR"]).mkdir(mode=0o700, exist_ok=True)
            # who was let in before is served on
            for job, pattern in jobs.items():
                _done_or_told(array, job, pattern)
        said = _meet(bed)
        _back(bed)
        return Outcome("refused", said) if said else Outcome("same", ready=(0.0,))

    return [
        Case(f"{clean.__name__.strip('_')} after {after:.3f} s", partial(do, clean=clean, after=after))
        for clean, after in ((clean, rng.random() * 0.5) for clean in CLEANS)
    ]


def _done_or_told(array: Service, job: int, pattern: Path) -> None:
    try:
        array.wait(job)
    except RaygridError as error:
        one_line(str(error))
        return
    for frame in range(1, FRAMES + 1):
        right(Path(str(pattern) % frame), frame=frame)


def _meet(bed: ServiceBed) -> str:
    """A client comes: "" if it is served within some seconds, else what it is told in one line."""
    deadline = time.monotonic() + SERVED_SECONDS
    while True:
        try:
            with raygrid.connect(NAME) as array:
                submit(array, bed.folder / "met.npy").wait()
            right(bed.folder / "met.npy")
            return ""
        except RaygridError as error:
            said = one_line(str(error))
        if time.monotonic() > deadline:
            return said
        time.sleep(0.2)


def _back(bed: ServiceBed) -> None:
    """The commands that a user has bring it back, and there is one service then. Raises Wrong."""
    up = bed.up()
    if up.returncode != 0:
        one_line(up.stderr)
    for arguments in (("down",), ("down", "--kill")):
        if up.returncode == 0:
            break
        command(*arguments, "--name", NAME)
        up = bed.up()
    if up.returncode != 0:
        raise Wrong(f"neither down nor down --kill makes room for another: {one_line(up.stderr)}")
    deadline = time.monotonic() + DONE_SECONDS
    while len(services()) > 1 and time.monotonic() < deadline:
        time.sleep(0.1)
    there = services()
    if len(there) > 1:
        pids = [process.pid for process in there]
        with contextlib.suppress(RaygridError):
            pids.remove(bed.record.pid)
        raise Wrong(f"two services are up, of which nobody finds {pids}")


GROUPS = {"cleaners of temporary files": _cleaned}
