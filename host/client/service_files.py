"""Finds and keeps the files of an array that stays, by its name.

$XDG_STATE_HOME/raygrid/NAME/       (~/.local/state/raygrid/NAME/), mode 0700; stays when the array ends
    journal.sqlite                  jobs and frames (`journal`)
    lock                            locked by the service while it runs
    service.json                    where the service is; there while it runs
    log                             what the service had to say
a private socket directory          `raygrid.emulator.topology.socket_directory`: 0700, a fresh name, removed at the end
    service                         the socket
    token                           the secret that a client must present, mode 0600
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path

from raygrid.emulator.topology import process_mark
from raygrid.host.files.part_files import replacing
from raygrid.host.files.state_home import state_home
from raygrid.node.errors import ArrayError

DEFAULT_NAME = "default"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,31}")
LOCK, RECORD, JOURNAL, LOG = "lock", "service.json", "journal.sqlite", "log"
SOCKET, TOKEN = "service", "token"
LONGEST_FILE = 1 << 16  # bytes of a record or a token


class LockTaken(ArrayError):
    """Another service has the state directory."""


@dataclass(frozen=True)
class ServiceRecord:
    """Where a service is.

    name        of the array
    pid, mark   of its process; `mark` tells it from another one with the same number
    directory   of its socket and token
    shape       processors on each axis
    started     seconds since 1970
    """

    name: str
    pid: int
    mark: str
    directory: str
    shape: tuple[int, int, int]
    started: float

    @property
    def alive(self) -> bool:
        """Whether that process is there."""
        return process_mark(self.pid) == self.mark


def check_array_name(name: str) -> None:
    """Raise ArrayError for what cannot be the name of an array."""
    if not NAME.fullmatch(name):
        shown = repr(name if len(name) <= 40 else name[:37] + "...")
        raise ArrayError(
            f"the name of an array came as {shown}, wanted 1 to 32 letters, digits, dots, dashes or underscores, "
            "the first a letter or digit"
        )


def state_directory(name: str) -> Path:
    """The state directory of an array, whether it is there or not. Raises ArrayError for a bad name."""
    check_array_name(name)
    return state_home() / name


def make_state_directory(name: str) -> Path:
    """Make the state directory of an array unless it is there. Raises ArrayError if it cannot be made, or is not ours."""
    directory = state_directory(name)
    for made in (directory.parent, directory):
        try:
            _make_private(made)
        except OSError as error:
            raise ArrayError(
                f"{made}: the directory for the journal cannot be made ({error.strerror or error}): set XDG_STATE_HOME"
            ) from None
        check_private(made, directory=True)
    return directory


def _make_private(directory: Path) -> None:
    """Make a directory, and those above it, for us alone, whatever the umask; those that are there stay as they are."""
    missing = [path for path in (directory, *directory.parents) if not path.exists()]
    for path in reversed(missing):
        with contextlib.suppress(FileExistsError):  # another one of us was as quick
            path.mkdir(mode=0o700)
            path.chmod(0o700)  # a strange umask may have taken our own rights away
    if not directory.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))


def check_private(path: Path | str, directory: bool) -> None:
    """Raise ArrayError unless it is a directory, or else a file, of ours that nobody else may write to; no link."""
    try:
        status = os.lstat(path)
    except OSError as error:
        raise ArrayError(f"{path}: {error.strerror or error}") from None
    wanted = stat.S_ISDIR if directory else stat.S_ISREG
    if not wanted(status.st_mode):
        raise ArrayError(f"{path}: a {_kind(status.st_mode)} is there, wanted a {'directory' if directory else 'file'}")
    if status.st_uid != os.geteuid():
        raise ArrayError(f"{path}: it belongs to user {status.st_uid}, wanted one of our own ({os.geteuid()})")
    if status.st_mode & 0o022:
        raise ArrayError(f"{path}: others may write to it (mode {status.st_mode & 0o777:o}), wanted 700 or 600")


def _kind(mode: int) -> str:
    return "link" if stat.S_ISLNK(mode) else "directory" if stat.S_ISDIR(mode) else "file of another kind"


def take_lock(directory: Path) -> int:
    """Lock a state directory for this process; the descriptor holds it. Raises ArrayError if another one has it."""
    while True:
        try:
            descriptor = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            raise ArrayError(f"{directory / LOCK}: the lock cannot be made ({error.strerror or error})") from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
            raise LockTaken(str(runs_already(directory))) from None
        if _is_at(descriptor, directory / LOCK):
            return descriptor
        os.close(descriptor)  # it was removed meanwhile: whoever comes next would lock another file


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether the file at a path is the one that is open."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except OSError:
        return False


class Home:
    """The state directory of a service that runs, and its lock. What somebody removes of it is made anew.

    name       of the array
    directory  its state directory
    """

    def __init__(self, name: str) -> None:
        """Make the directory unless it is there, and lock it. Raises ArrayError if another service has it."""
        self.name, self.directory = name, make_state_directory(name)
        self._lock = take_lock(self.directory)
        self._logs = False

    def begin_log(self) -> None:
        """Standard output and error go to the log from now on; the log of the time before is kept as one older.

        Raises OSError."""
        with contextlib.suppress(FileNotFoundError):
            os.replace(self.directory / LOG, self.directory / f"{LOG}.1")
        self._open_log()
        self._logs = True

    def _open_log(self) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW
        log = os.open(self.directory / LOG, flags, 0o600)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.close(log)

    def keep(self) -> None:
        """See to it that directory, lock and log are there. Raises LockTaken if another service has the lock now, other
        ArrayErrors if they cannot be made."""
        if not _is_at(self._lock, self.directory / LOCK):
            make_state_directory(self.name)
            fresh = take_lock(self.directory)
            os.close(self._lock)
            self._lock = fresh
        if self._logs and not os.path.lexists(self.directory / LOG):
            with contextlib.suppress(OSError):
                self._open_log()

    def keep_record(self, record: ServiceRecord) -> None:
        """See to it that it can be found where the service is. Raises OSError."""
        try:
            found = read_record(self.directory)
        except ArrayError:
            found = None
        if found != record:
            write_record(self.directory, record)

    def forget(self, record: ServiceRecord | None) -> None:
        """Remove the record, unless it is another service's. Never raises OSError."""
        with contextlib.suppress(OSError, ArrayError):
            if record is None or read_record(self.directory) == record:
                (self.directory / RECORD).unlink(missing_ok=True)

    def close(self) -> None:
        """Give the directory up."""
        os.close(self._lock)


def runs_already(directory: Path) -> ArrayError:
    """What is told to who would launch an array of a name that is taken. Nothing in it ends an array: whose it is, is not known."""
    name, record = directory.name, read_record(directory)
    if record is None or not record.alive:
        return ArrayError(
            f"an array named {name!r} is just being launched or taken down by another process: "
            f"raygrid status --name {name} shows it when it is up, another --name launches one beside it"
        )
    shape = "x".join(map(str, record.shape))
    return ArrayError(
        f"the array {name!r} ({shape}, process {record.pid}) runs already: "
        f"raygrid status --name {name} shows it, another --name launches one beside it"
    )


def write_private(path: Path, text: str) -> None:
    """Write a file with mode 0600, whole or not at all. Raises OSError."""
    with replacing(str(path), mode=0o600) as (_, file):
        file.write(text.encode())


def read_private(path: Path) -> str:
    """A small file that only we may write. Raises ArrayError if it is not there or not as it should be."""
    check_private(path, directory=False)
    try:
        with open(path, encoding="utf-8") as file:
            return file.read(LONGEST_FILE)
    except (OSError, UnicodeDecodeError) as error:
        raise ArrayError(f"{path}: the file cannot be read ({error})") from None


def write_record(directory: Path, record: ServiceRecord) -> None:
    """Say where the service is. Raises OSError."""
    write_private(directory / RECORD, json.dumps(record.__dict__) + "\n")


def read_record(directory: Path) -> ServiceRecord | None:
    """Where the service is, or was when it was last heard of; None if there is no word of it.

    Raises ArrayError if the file is not ours.
    """
    if not os.path.lexists(directory / RECORD):
        return None
    try:
        facts = json.loads(read_private(directory / RECORD))
        nx, ny, nz = map(int, facts["shape"])
        return ServiceRecord(
            str(facts["name"]),
            int(facts["pid"]),
            str(facts["mark"]),
            str(facts["directory"]),
            (nx, ny, nz),
            float(facts["started"]),
        )
    except (ValueError, KeyError, TypeError):
        return None  # torn by a full disk: as good as none


def find(name: str) -> ServiceRecord:
    """Where the running service of that name is. Raises ArrayError if there is none, naming those that run."""
    directory = state_directory(name)
    record = read_record(directory) if directory.is_dir() else None
    if record is not None and record.alive:
        return record
    others = [other.name for other in running() if other.name != name]
    which = f"; those that run: {', '.join(others)}" if others else ""
    if record is not None:
        raise ArrayError(
            f"the array {name!r} has ended without being told to: raygrid up --name {name} brings its jobs back{which}"
        )
    raise ArrayError(f"no array named {name!r} runs: raygrid up --name {name} launches one{which}")


def running() -> list[ServiceRecord]:
    """All services of this user that run, by name."""
    found = []
    with contextlib.suppress(OSError, ArrayError):
        for directory in sorted(state_home().iterdir()):
            with contextlib.suppress(ArrayError):
                record = read_record(directory) if NAME.fullmatch(directory.name) else None
                if record is not None and record.alive:
                    found.append(record)
    return found
