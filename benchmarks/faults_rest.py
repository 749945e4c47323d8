"""What a stage of the fault campaign may leave behind: nothing. Places of its own, so that whatever lies in them is its."""

from __future__ import annotations

import contextlib
import os
import secrets
import threading
from collections.abc import Iterator
from pathlib import Path

import psutil

MARK = "RAYGRID_CAMPAIGN"  # in the environment of all processes of the campaign; orphans keep it
GRACE = 5.0  # seconds for processes and files to go


@contextlib.contextmanager
def own_places(folder: Path) -> Iterator[None]:
    """Sockets, temporary files and state of everything that is started in this block lie in `folder`."""
    places = {"XDG_RUNTIME_DIR": folder / "run", "TMPDIR": folder / "tmp", "XDG_STATE_HOME": folder / "state"}
    before = {name: os.environ.get(name) for name in (*places, MARK)}
    for name, path in places.items():
        path.mkdir(mode=0o700)
        os.environ[name] = str(path)
    folder.chmod(0o711)  # another user gets this far, and no further
    os.environ[MARK] = secrets.token_hex(8)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class Leftovers:
    """Finds what has appeared since this was made: processes, files, descriptors, threads."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files, self._descriptors, self._threads = self._found()

    def find(self) -> list[str]:
        """A line for each. Ends the processes."""
        _, alive = psutil.wait_procs(self._processes(), timeout=GRACE)
        lines = [f"process {process.pid}: {' '.join(_command(process))[:80]}" for process in alive]
        for process in alive:
            with contextlib.suppress(psutil.Error):
                process.kill()
        files, descriptors, threads = self._found()
        lines += [f"file {name}" for name in sorted(files - self._files)]
        if descriptors > self._descriptors:
            lines.append(f"{descriptors - self._descriptors} descriptors")
        lines += [f"thread {name}" for name in sorted(threads - self._threads)]
        return lines

    @staticmethod
    def _processes() -> list[psutil.Process]:
        """Children of this process, and whatever carries its mark."""
        me = psutil.Process()
        found = set(me.children(recursive=True))
        mark = f"{MARK}={os.environ[MARK]}".encode()
        for process in psutil.process_iter():
            with contextlib.suppress(OSError):
                if process.pid != me.pid and mark in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0"):
                    found.add(process)
        return list(found)

    def _found(self) -> tuple[set[str], int, set[str]]:
        files = {str(path) for name in ("run", "tmp") for path in (self._folder / name).iterdir()}
        threads = {thread.name for thread in threading.enumerate()}
        return files, len(os.listdir("/proc/self/fd")), threads


def _command(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []
