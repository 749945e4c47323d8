"""Keeps compiled kernels on disk: in a directory named by a digest of this package's sources.

numba checks only the file of the function that it loads, but a kernel has parts of other files inlined: after
a change in one of those it would load the old machine code. So every state of the sources has a directory of its
own. Directories of states that nobody has used for FORGET_DAYS are removed.

The base is $RAYGRID_CACHE, else $NUMBA_CACHE_DIR, else $XDG_CACHE_HOME/raygrid, else ~/.cache/raygrid. One that cannot be
made, or in which anybody else could lay files (`node.jit.trusted_files`), is not used, and beside the sources is looked for a
place instead. One that can be read and not written is used for what it holds.

Files are believed only if they are whole: each begins with a digest of the rest (`read_sealed`), is written beside its
place, brought to the disk and then renamed (`write_whole`). Whatever cannot be loaded is as if it were not there.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import numba
from numba.core import config as _config
from xxhash import xxh3_128_digest

from raygrid.node.jit.switches import code_state
from raygrid.node.jit.trusted_files import why_not_file, why_not_trusted
from raygrid.node.remarks import remark

config: Any = _config  # its names are made at run time

FORGET_DAYS = 30.0
NAME = re.compile(r"kernels-[0-9a-f]{16}")
SEAL = b"raygrid kernel 1\n"
SEALED = len(SEAL) + 16  # bytes before the rest of a file
_SOURCES = Path(__file__).parents[1]  # all of `raygrid.node`
_SETTINGS = ("BOUNDSCHECK", "OPT", "DEBUG", "ENABLE_PROFILING")  # of numba, that change the machine code


class Keeping(NamedTuple):
    """The place in which kernels are kept.

    directory  None: nowhere
    writable   whether new ones can be put there
    why        what is wrong with the places that come before this one, for people; "" if it is the first
    """

    directory: str | None
    writable: bool
    why: str


def digest() -> str:
    """Digest of the sources of a processor, of all its packages, and of what compiles them: numba, llvmlite, and the settings,
    theirs and ours, that change what is compiled."""
    state = hashlib.sha256()
    for source in sorted(_SOURCES.rglob("*.py")):
        state.update(str(source.relative_to(_SOURCES)).encode() + b"\0" + source.read_bytes())
    libraries = [numba.__version__, llvmlite.__version__]
    state.update(repr([*libraries, *(getattr(config, name, None) for name in _SETTINGS), *code_state()]).encode())
    return state.hexdigest()[:16]


def bases() -> Iterator[Path]:
    """Bases in which the directory may be, best first."""
    named = [os.environ[name] for name in ("RAYGRID_CACHE", "NUMBA_CACHE_DIR") if os.environ.get(name)]
    if named:
        yield Path(named[0])
    else:
        with contextlib.suppress(RuntimeError):  # no home
            yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "raygrid"
    yield _SOURCES / "__pycache__"


def _forget(base: Path, kept: Path) -> None:
    """Remove directories of other states that have not been used for long: such as have our names, and are ours."""
    oldest = time.time() - FORGET_DAYS * 86400.0
    with contextlib.suppress(OSError), os.scandir(base) as entries:
        for entry in entries:
            if not NAME.fullmatch(entry.name) or entry.name == kept.name:
                continue
            status = entry.stat(follow_symlinks=False)
            if stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and status.st_mtime < oldest:
                shutil.rmtree(entry.path, ignore_errors=True)


def make_private(directory: Path) -> None:
    """Make a directory and those above it, which nobody else may write in whatever our umask is. Raises OSError."""
    if not directory.is_dir():
        if not directory.parent.is_dir():
            make_private(directory.parent)
        directory.mkdir(mode=0o700, exist_ok=True)


def _keeping() -> Keeping:
    """The first place that can be used; it is made if need be."""
    wrong = []
    name = f"kernels-{digest()}"
    for base in bases():
        directory = Path(os.path.abspath(base)) / name
        try:
            fresh = not directory.is_dir()
            make_private(directory)
            why = why_not_trusted(str(directory))
        except OSError as error:
            why = error.strerror or str(error)
        if why is not None:
            wrong.append(f"{directory}: {why}")
            continue
        if fresh:
            _forget(directory.parent, directory)
        writable = os.access(directory, os.W_OK | os.X_OK, effective_ids=True)
        if writable:
            with contextlib.suppress(OSError):
                os.utime(directory)
        return Keeping(os.path.realpath(directory), writable, "; ".join(wrong))
    return Keeping(None, False, "; ".join(wrong))


DirectoryName = str | None  # None: nothing can be kept

KEEPING = _keeping()
DIRECTORY: DirectoryName = KEEPING.directory

REMEDY = "set RAYGRID_CACHE to a directory that is yours alone"


def say_where() -> None:
    """Say once where kernels that were just compiled are kept, or why they are not, if that is not the usual place."""
    if KEEPING.directory is None:
        remark("kept", f"compiled kernels cannot be kept, and each run compiles them anew ({KEEPING.why}); {REMEDY}")
    elif not KEEPING.writable:
        where = f"{KEEPING.directory} cannot be written"
        remark("kept", f"kernels that it lacks cannot be kept, and each run compiles them anew ({where}); {REMEDY}")
    elif KEEPING.why:
        remark("kept", f"compiled kernels are kept in {KEEPING.directory} ({KEEPING.why})")


# --- files -----------------------------------------------------------------------------------------------


def read_sealed(path: str) -> bytes | None:
    """Read what `write_sealed` has put into a file; None if it is not there, is not whole, or may be another user's."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        with open(descriptor, "rb") as file:
            why = why_not_file(os.fstat(descriptor))
            data = b"" if why is not None else file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        why, data = error.strerror or str(error), b""
    if why is None:
        why = _damage(data)
    if why is not None:
        doubt(path, why)
        return None
    return data[SEALED:]


def _damage(data: bytes) -> str | None:
    if len(data) < SEALED or not data.startswith(SEAL):
        return "it is cut, or no file of ours"
    if xxh3_128_digest(memoryview(data)[SEALED:]) != data[len(SEAL) : SEALED]:
        return "its contents are not those that its digest is of"
    return None


def write_sealed(path: str, data: bytes) -> None:
    """Write what `read_sealed` reads. Raises OSError."""
    write_whole(path, SEAL, xxh3_128_digest(data), data)


def write_whole(path: str, *parts: bytes) -> None:
    """Put a file in its place, whole: it is on the disk before it has its name. Raises OSError."""
    part = f"{path}.tmp.{secrets.token_hex(8)}"
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        with open(descriptor, "wb") as file:
            file.writelines(parts)
            file.flush()
            os.fsync(descriptor)
        os.replace(part, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(part)
        raise


def doubt(path: str, why: str) -> None:
    """Say once that what is kept is not used."""
    remark("doubt", f"{path}: compiled code that cannot be used ({why}); it is compiled anew")


# --- for who makes caches --------------------------------------------------------------------------------


@contextlib.contextmanager
def apart(name: str) -> Iterator[str]:
    """Functions decorated within are cached in a directory of this name in DIRECTORY. Raises OSError if it cannot be."""
    global DIRECTORY
    before = DIRECTORY
    if before is None:
        raise OSError(f"there is no directory for compiled code ({KEEPING.why}); {REMEDY}")
    DIRECTORY = _made(before, name)
    try:
        yield DIRECTORY
    finally:
        DIRECTORY = before


def within(directory: DirectoryName, name: str) -> DirectoryName:
    """A directory of this name in a directory of kernels; None if it cannot be used."""
    try:
        return None if directory is None else _made(directory, name)
    except OSError:
        return None


def _made(directory: str, name: str) -> str:
    inner = Path(directory) / name
    make_private(inner)
    why = why_not_trusted(str(inner))
    if why is not None:
        raise OSError(f"{inner} is {why}; remove it, or {REMEDY}")
    return str(inner)


@contextlib.contextmanager
def in_directory(directory: DirectoryName) -> Iterator[None]:
    """Caches made within are in this directory; numba's settings for everybody else stay as they were."""
    wanted = {"CACHE_DIR": directory, "CACHE_LOCATOR_CLASSES": ""}
    before = {name: getattr(config, name) for name in wanted if hasattr(config, name) and directory is not None}
    for name in before:
        setattr(config, name, wanted[name])
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(config, name, value)
