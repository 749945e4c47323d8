"""Makes and removes the private directory that holds the sockets of one array, and names the sockets in it.

Whoever may open a socket may speak to a node, so the directory is ours alone (mode 0700), fresh, and has a name
that cannot be guessed. An ipc path has at most 107 bytes, so it lies high up in the tree: in $XDG_RUNTIME_DIR if
that can be used, else in the temporary directory, else in /tmp.

A front end that was killed cannot clean up. So each directory names its front end in the file `pid`, as process id,
start time and process namespace, and the next front end removes what is stale. The
namespace is there because containers that share /tmp cannot see each other's processes and must not judge them.
"""

from __future__ import annotations

import atexit
import os
import re
import shutil
import stat
import tempfile
import time
from contextlib import suppress
from typing import Self

from raygrid.emulator.topology.coordinates import Index
from raygrid.emulator.topology.process_stat import pid_namespace, process_mark
from raygrid.node.errors import ArrayError

PREFIX = "raygrid-"
NAME_BYTES = 6  # of chance
NAME = re.compile(f"{re.escape(PREFIX)}[0-9a-f]{{{2 * NAME_BYTES}}}")  # not a user's own raygrid-pictures
PID_FILE = "pid"
LONGEST_PATH = 107  # bytes; sun_path holds 108 with its closing zero
LAST_EPOCH = 0xFFFF  # the epoch of a message header is a u16
TOUCH_SECONDS = 3600.0  # cleaners remove what is days old
REMOVALS = 5  # a node that is just ending may make a socket in what is being removed
UNSIGNED_AGE = 60.0  # seconds; a directory without a pid file may be one that is just being made


def endpoint(directory: str, epoch: int, index: Index, axis: int) -> str:
    """The name of the link between the node at `index` and its + neighbour on `axis` (0, 1, 2).

    The epoch is part of it, because an endpoint is never used twice.
    """
    x, y, z = index
    return f"ipc://{directory}/{epoch}-{x},{y},{z}{'xyz'[axis]}"


def host_endpoint(directory: str, epoch: int, corner: Index) -> str:
    """The name of the link between the host and the corner node at index `corner`."""
    x, y, z = corner
    return f"ipc://{directory}/{epoch}-{x},{y},{z}h"


def longest_path(directory: str, shape: Index) -> int:
    """Bytes of the longest socket path that an array of this shape can need in `directory`, in any epoch."""
    last = (shape[0] - 1, shape[1] - 1, shape[2] - 1)
    names = (endpoint(directory, LAST_EPOCH, last, 0), host_endpoint(directory, LAST_EPOCH, last))
    return max(len(os.fsencode(name.removeprefix("ipc://"))) for name in names)


class SocketDirectory:
    """The socket directory of one array, removed with all that is in it at the end of the `with` block.

    path    the directory
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._owner = os.getpid()
        self._inode = os.lstat(path).st_ino
        self._touched = time.monotonic()
        atexit.register(self.remove)

    @classmethod
    def create(cls, shape: Index) -> SocketDirectory:
        """Make a directory whose paths are short enough for the sockets of an array of `shape`.

        Also removes the directories that dead front ends left beside it.
        Raises ArrayError, naming each directory tried and what is wrong with it.
        """
        refused = []
        for base in bases():
            why = _unusable(base, shape)
            if why is None:
                sweep(base)
                try:
                    return cls(_make(base))
                except OSError as error:
                    why = error.strerror or str(error)
            refused.append(f"{base} ({why})")
        raise ArrayError(
            f"no directory for the sockets of the array: {', '.join(refused)}; wanted one that is ours or sticky,"
            " can be written, and is short: set XDG_RUNTIME_DIR or TMPDIR"
        )

    def forget_epochs_before(self, epoch: int) -> None:
        """Remove the sockets of earlier epochs that killed processes left. Never raises OSError."""
        with suppress(OSError), os.scandir(self.path) as entries:
            for entry in entries:
                number, dash, _ = entry.name.partition("-")
                if dash and number.isdigit() and int(number) < epoch:
                    with suppress(OSError):
                        os.unlink(entry.path)

    def keep(self) -> bool:
        """Keep the directory from cleaners of temporary files, which go by age, and from other front ends, which go by its
        sign; whether it is still there. To be called now and then. Never raises OSError."""
        try:
            if os.lstat(self.path).st_ino != self._inode:
                return False
            if not os.path.lexists(os.path.join(self.path, PID_FILE)):
                _sign(self.path)
        except OSError:
            return False
        if time.monotonic() - self._touched > TOUCH_SECONDS:
            self._touched = time.monotonic()
            with suppress(OSError), os.scandir(self.path) as entries:
                for path in (self.path, *(entry.path for entry in entries)):
                    with suppress(OSError):
                        os.utime(path, follow_symlinks=False)
        return True

    def remove(self) -> None:
        """Remove the directory; does nothing if it is gone, or in a fork of the process that made it."""
        atexit.unregister(self.remove)
        if os.getpid() == self._owner:
            remove(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()


def bases() -> list[str]:
    """The directories in which a socket directory may be made, best first."""
    found = [os.environ.get("XDG_RUNTIME_DIR", "")]
    with suppress(FileNotFoundError):  # Python has tried, and found no temporary directory that can be written
        found.append(os.path.realpath(tempfile.gettempdir()))
    return list(dict.fromkeys(base for base in (*found, os.path.realpath("/tmp")) if base))


def why_not_usable(shape: Index) -> dict[str, str | None]:
    """Each of `bases`, with what keeps a socket directory for an array of `shape` from being made there; None: nothing."""
    return {base: _unusable(base, shape) for base in bases()}


def remove(directory: str) -> None:
    """Remove a socket directory. Refuses quietly what is not a raygrid directory of ours, and never raises OSError."""
    if NAME.fullmatch(os.path.basename(directory)) and _is_our_directory(directory):
        for _ in range(REMOVALS):
            shutil.rmtree(directory, ignore_errors=True)
            if not os.path.lexists(directory):
                return


def sweep(base: str) -> list[str]:
    """Remove the socket directories in `base` whose front ends are dead; returns their paths. Never raises OSError."""
    swept = []
    with suppress(OSError), os.scandir(base) as entries:
        for entry in entries:
            if NAME.fullmatch(entry.name) and _is_our_directory(entry.path) and _is_stale(entry.path):
                remove(entry.path)
                swept.append(entry.path)
    return swept


def _is_stale(directory: str) -> bool:
    """Whether the front end that made `directory` is certainly dead."""
    try:
        with open(os.path.join(directory, PID_FILE), encoding="ascii") as file:
            mark = file.read(200)
        pid, _, namespace = mark.split()
    except (OSError, ValueError):  # not there, or half written
        return _age(directory) > UNSIGNED_AGE
    if namespace != pid_namespace() or not pid.isdigit():
        return False
    return process_mark(int(pid)) != mark.strip()


def _age(directory: str) -> float:
    """Seconds since something was made or removed in `directory`; 0 if it is gone."""
    try:
        return time.time() - os.lstat(directory).st_mtime
    except OSError:
        return 0.0


def _is_our_directory(path: str) -> bool:
    try:
        status = os.lstat(path)
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid()


def _unusable(base: str, shape: Index) -> str | None:
    """Why no socket directory for `shape` can be made in `base`; None if it can."""
    length = longest_path(os.path.join(base, _fresh_name()), shape)
    if not os.path.isabs(base):
        return "not an absolute path"
    if length > LONGEST_PATH:
        return f"its socket paths would have {length} bytes, at most {LONGEST_PATH} are allowed"
    try:
        base.encode()
        status = os.lstat(base)
    except UnicodeEncodeError:
        return "not UTF-8"
    except OSError as error:
        return error.strerror or str(error)
    if stat.S_ISLNK(status.st_mode):
        return "a symbolic link"
    if not stat.S_ISDIR(status.st_mode):
        return "not a directory"
    return _unsafe(base, status)


def _unsafe(base: str, status: os.stat_result) -> str | None:
    """Why a directory in `base` would not be safe from other users, or cannot be made."""
    # The owner of a directory, and whoever may write in it unless it is sticky, can put another in place of ours.
    if status.st_uid not in (0, os.geteuid()):
        return f"owned by user {status.st_uid}"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not status.st_mode & stat.S_ISVTX:
        return "writable by others and not sticky"
    if not os.access(base, os.W_OK | os.X_OK, effective_ids=True):
        return "not writable"
    return None


def _fresh_name() -> str:
    return PREFIX + os.urandom(NAME_BYTES).hex()


def _make(base: str) -> str:
    """Make and sign a fresh directory in `base`. Raises OSError."""
    path = os.path.join(base, _fresh_name())
    os.mkdir(path, 0o700)  # fails if anything has that name, a dangling link too
    try:
        os.chmod(path, 0o700)  # a strange umask may have taken our own rights away
        _sign(path)
    except BaseException:
        remove(path)
        raise
    return path


def _sign(directory: str) -> None:
    """Say in a directory whose it is. Raises OSError."""
    mark = process_mark(os.getpid())
    if mark is None:
        raise OSError("/proc does not show this process")
    with open(os.path.join(directory, PID_FILE), "x", encoding="ascii") as file:
        os.chmod(file.fileno(), 0o600)
        file.write(f"{mark}\n")
