"""Writes files whole or not at all, makes temporary directories, and removes what dead processes left of both.

Who makes one holds a lock on it, which the kernel takes away when that process ends, however it ends. So whoever comes
next can tell what is left of the dead from what is in use, across containers and computers, too.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import BinaryIO

CHANCE = 6  # bytes
FILE, DIRECTORY = ".raygrid-part-", "frames-of-raygrid-"
FILE_NAME = re.compile(rf"{re.escape(FILE)}[0-9a-f]{{{2 * CHANCE}}}(\.mp4)?")
DIRECTORY_NAME = re.compile(rf"{re.escape(DIRECTORY)}[0-9a-f]{{{2 * CHANCE}}}")

Kind = Callable[[int], bool]  # by the mode of a file
TRIES = 100  # a file system whose files have no numbers that stay would try for ever

AGAIN_SECONDS = 600.0  # after which a folder is looked through again, by a process that lives for long

_swept: dict[tuple[str, str], float] = {}  # when this process has looked through folders, and for what


@contextlib.contextmanager
def replacing(path: str, suffix: str = "", mode: int = 0o666) -> Iterator[tuple[str, BinaryIO]]:
    """Make a new file beside the one at `path`, whose place it takes when the block ends; removed if that fails.

    suffix  of the new file's name until then; mode: of the file, less the umask
    Raises OSError.
    """
    folder = os.path.dirname(path)
    _sweep_once(folder, FILE_NAME, stat.S_ISREG)
    part, descriptor = _locked(folder, FILE, suffix, lambda part: _make_file(part, mode))
    try:
        with open(os.dup(descriptor), "wb") as file:  # closing this one keeps the lock
            yield part, file
        os.replace(part, path)  # only now, when it is closed, all errors of the disk are known
    finally:
        with contextlib.suppress(OSError):
            os.unlink(part)  # gone if it was renamed
        os.close(descriptor)


def sweep_folders() -> None:
    """Remove the temporary directories that dead processes left. Never raises OSError."""
    with contextlib.suppress(FileNotFoundError):  # there is no temporary directory, and nothing in it
        _sweep_once(tempfile.gettempdir(), DIRECTORY_NAME, stat.S_ISDIR)


class PartFolder:
    """Owns a new directory among the temporary ones, ours alone. Raises OSError."""

    def __init__(self) -> None:
        sweep_folders()
        self.path, self._descriptor = _locked(tempfile.gettempdir(), DIRECTORY, "", _make_directory)

    def remove(self) -> None:
        """Remove it with all that is in it. May be called twice."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(descriptor)


def sweep(folder: str, name: re.Pattern[str], kind: Kind) -> list[str]:
    """Remove what dead processes left in a folder; returns the paths. Never raises OSError."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        found = [entry.path for entry in entries if name.fullmatch(entry.name)]
        return [path for path in found if _remove_unlocked(path, kind)]
    return []


def _sweep_once(folder: str, name: re.Pattern[str], kind: Kind) -> None:
    """A folder may hold a hundred thousand frames: it is not looked through for each."""
    now = time.monotonic()
    if now - _swept.get((folder, name.pattern), -math.inf) > AGAIN_SECONDS:
        _swept[folder, name.pattern] = now
        sweep(folder, name, kind)


def _remove_unlocked(path: str, kind: Kind) -> bool:
    """Remove a file or directory of ours that nobody holds the lock of."""
    try:
        status = os.lstat(path)
        if not kind(status.st_mode) or status.st_uid != os.geteuid():
            return False
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if stat.S_ISDIR(status.st_mode):
            shutil.rmtree(path)
        else:
            os.unlink(path)
    except OSError:  # in use, or a file system that knows no locks
        return False
    finally:
        os.close(descriptor)
    return True


def _locked(folder: str, prefix: str, suffix: str, make: Callable[[str], int]) -> tuple[str, int]:
    """Make something under a new name and lock it; again if it was swept in between."""
    for left in reversed(range(TRIES)):
        path = os.path.join(folder, prefix + os.urandom(CHANCE).hex() + suffix)
        try:
            descriptor = make(path)
        except FileNotFoundError:
            if not left:
                raise
            continue
        with contextlib.suppress(OSError):  # without locks nothing is swept either
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if not left or _is_there(path, descriptor):
            break
        os.close(descriptor)
    return path, descriptor


def _is_there(path: str, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except OSError:
        return False


def _make_file(path: str, mode: int) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)


def _make_directory(path: str) -> int:
    os.mkdir(path, 0o700)
    return os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
