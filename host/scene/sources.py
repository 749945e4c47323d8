"""Records the files that a scene was read from, with digests of their contents, to detect when it has changed.

    with recorded() as sources:
        scene = load_scene(path)
    sources.changed()       # whether a file is another one now
    sources.digest()        # the same for the same contents, wherever the files lie

Every reader reads its files through `file_access`, which tells of each here: the scene's own file, those
it includes, materials, textures and buffers, and those that were looked for and not found. A file that was another one
when it was read again, for the same scene, counts as changed for ever: that scene was never in any files.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from raygrid.host.files.regular_file import read_regular

# A file that was written less than this before it was read may be written again within the same tick of the file
# system's clock, and then looks the same: its contents are compared, not its times.
YOUNG_NS = 2_000_000_000
MISSING = ""

Look = tuple[int, int, int, int]
NEVER_THE_SAME: tuple[Look | None, bool] = (None, True)  # what has to be compared by its contents


class Sources:
    """Records the files that were read: path -> SHA-256 of the contents, "" if there was no such file.

    Where a file was not the same whenever it was read, several stand there, with spaces between.
    """

    def __init__(self) -> None:
        self.files: dict[str, str] = {}
        self._looks: dict[str, tuple[Look | None, bool]] = {}

    def note(self, path: str | Path, look: Look | None, data: bytes | None) -> None:
        """Remember a file as it was read. `look`: of `look_at`, taken before it was read; `data` None: not there."""
        name, came = os.path.abspath(path), _digest(data)
        before = self.files.get(name, came)
        if came != before:
            self.files[name], self._looks[name] = f"{before} {came}", NEVER_THE_SAME
        else:
            self.files[name], self._looks[name] = came, _aged(look)

    def changed(self) -> bool:
        """Test whether any file has other contents now, or has come or gone."""
        return any(self._has_changed(name) for name in self.files)

    def _has_changed(self, name: str) -> bool:
        look, young = self._looks[name]
        now = look_at(name)
        if now == look and not young:
            return False
        before = self.files[name]
        if now is None or before == MISSING:
            return (now is None) != (before == MISSING)
        try:
            data = read_regular(name, sys.maxsize - 1)
        except OSError:
            return True
        if _digest(data) == before:
            self._looks[name] = _aged(now)
            return False
        self._looks[name] = NEVER_THE_SAME  # until it is read anew
        return True

    def digest(self) -> str:
        """A digest of all contents, in the order in which they were read."""
        return hashlib.sha256("\n".join(self.files.values()).encode()).hexdigest()


def _digest(data: bytes | None) -> str:
    return MISSING if data is None else hashlib.sha256(data).hexdigest()


def _aged(look: Look | None) -> tuple[Look | None, bool]:
    """A look, and whether the file is so young that it says little."""
    return look, look is not None and look[0] > time.time_ns() - YOUNG_NS


_recording: ContextVar[Sources | None] = ContextVar("recording", default=None)


@contextmanager
def recorded() -> Iterator[Sources]:
    """Record the files that are read in this block, by this thread."""
    sources = Sources()
    before = _recording.set(sources)
    try:
        yield sources
    finally:
        _recording.reset(before)


def recording() -> Sources | None:
    """Return the record in which the reading of files is to be noted, None if there is none."""
    return _recording.get()


def look_at(path: str | Path) -> Look | None:
    """Return what changes with a file, without reading it: times of change, size, number; None if no regular file is there."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    if not stat.S_ISREG(status.st_mode):
        return None
    return max(status.st_mtime_ns, status.st_ctime_ns), status.st_mtime_ns, status.st_size, status.st_ino
