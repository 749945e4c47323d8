"""Where compiled kernels are kept: a directory named by a digest of this package's sources.

numba checks only the file of the function that it loads, but a kernel has parts of other files inlined: after
a change in one of those it would load the old machine code. So every state of the sources has a directory of its
own. Directories of states that nobody has used for FORGET_DAYS are removed.

The base is $RAYGRID_CACHE, else $NUMBA_CACHE_DIR, else $XDG_CACHE_HOME/raygrid, else ~/.cache/raygrid; numba falls back
by itself to beside the sources if the base cannot be written.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numba.core import config as _config

config: Any = _config  # its names are made at run time

FORGET_DAYS = 30.0
_SETTINGS = ("BOUNDSCHECK", "OPT", "DEBUG", "ENABLE_PROFILING")  # of numba, that change the machine code


def _digest() -> str:
    """Of the sources of this package, and of the settings of numba that change what is compiled."""
    state = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        state.update(source.name.encode() + b"\0" + source.read_bytes())
    state.update(repr([getattr(config, name, None) for name in _SETTINGS]).encode())
    return state.hexdigest()[:16]


def _base() -> Path:
    for name in ("RAYGRID_CACHE", "NUMBA_CACHE_DIR"):
        if os.environ.get(name):
            return Path(os.environ[name])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "raygrid"


def _forget(base: Path, kept: Path) -> None:
    """Remove directories of other states that have not been used for long."""
    oldest = time.time() - FORGET_DAYS * 86400.0
    for other in base.glob("kernels-*"):
        if other != kept and other.stat().st_mtime < oldest:
            shutil.rmtree(other, ignore_errors=True)


def _directory() -> str | None:
    """The directory of this state, made if need be; None if it cannot be, and numba's own choice holds."""
    try:
        base = _base()
        directory = base / f"kernels-{_digest()}"
        if not directory.is_dir():
            directory.mkdir(parents=True, mode=0o700)
            _forget(base, directory)
        os.utime(directory)
        return str(directory) if os.access(directory, os.W_OK) else None
    except (OSError, RuntimeError):  # no home, read-only, full
        return None


DirectoryName = str | None  # None: numba chooses

DIRECTORY: DirectoryName = _directory()


@contextlib.contextmanager
def apart(name: str) -> Iterator[str]:
    """Functions decorated within are cached in a directory of this name in DIRECTORY. Raises OSError if it cannot be."""
    global DIRECTORY
    before = DIRECTORY
    if before is None:
        raise OSError("there is no directory for compiled code")
    inner = Path(before) / name
    inner.mkdir(mode=0o700, exist_ok=True)
    DIRECTORY = str(inner)
    try:
        yield DIRECTORY
    finally:
        DIRECTORY = before


@contextlib.contextmanager
def in_directory(directory: DirectoryName) -> Iterator[None]:
    """Caches made within are in this directory; numba's setting for everybody else stays as it was."""
    before = config.CACHE_DIR
    if directory is not None:
        config.CACHE_DIR = directory
    try:
        yield
    finally:
        config.CACHE_DIR = before
