"""Limits which files of this computer a scene may refer to, and how much it may bring.

    with reading(path, allow_outside=False, remedy="--allow-outside"):
        data = read_bytes(path)         # the scene's own file, and those that it cannot do without
        data = find_bytes(other)        # None if there is none: noted, so that its coming is seen as a change

A scene refers to files by names that whoever wrote it has chosen. They are followed within the scene's folder, and
outside it only if that was allowed: otherwise a scene from elsewhere could show what lies on this computer.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from raygrid.host.files.input_guard import note
from raygrid.host.files.regular_file import Irregular, TooLong, open_regular, read_open
from raygrid.host.scene.sources import look_at, recording
from raygrid.node.errors import SceneError

LARGEST_FILE = 1 << 30  # bytes
MOST_BYTES = 1 << 32  # of all files of a scene together, each counted as often as it is read
# What else is said of names that no file can have; a scene that can do without the file need not care.
NOT_THERE = (errno.ENOTDIR, errno.ENAMETOOLONG)
MOST_TEXELS = 1 << 28  # of all its textures together


@dataclass
class Reach:
    """Holds the limits of the scene that is being read.

    folders  where its files may lie, as real paths; None: anywhere
    remedy   what allows more
    """

    folders: tuple[str, ...] | None
    remedy: str
    bytes_left: int = field(default_factory=lambda: MOST_BYTES)
    texels_left: int = field(default_factory=lambda: MOST_TEXELS)

    def check(self, path: Path, place: str) -> None:
        """Raise SceneError if a real path is not within reach; `path` is what it was called."""
        if self.folders is None or any(_within(place, folder) for folder in self.folders):
            return
        raise SceneError(
            f"{path}: the scene refers to a file outside its folder {self.folders[0]}, wanted one within, "
            f"or {self.remedy} for scenes that you trust"
        )


_reach: ContextVar[Reach | None] = ContextVar("reach", default=None)


@contextmanager
def reading(path: Path, allow_outside: bool, remedy: str) -> Iterator[bool]:
    """Read a scene in this block, by this thread; within another one it is a part of that. Yields whether it is the whole.

    The scene's folder is the one in which its file lies, with all below it, and, if that file is a link, the one in
    which the file itself lies as well. Other links count as what they lead to.
    """
    if _reach.get() is not None:
        yield False
        return
    folders = os.path.realpath(path.parent), os.path.dirname(os.path.realpath(path))
    before = _reach.set(Reach(None if allow_outside else folders, remedy))
    try:
        yield True
    finally:
        _reach.reset(before)


def read_bytes(path: Path) -> bytes:
    """Read a file that a scene cannot do without. Raises SceneError if there is none, or none that it may read."""
    data = _read(path, needed=True)
    if data is None:
        raise SceneError(f"{path}: there is no such file")
    return data


def find_bytes(path: Path) -> bytes | None:
    """Read a file, None if there is none. Raises SceneError for one that the scene may not read."""
    return _read(path, needed=False)


def take_texels(count: int, most: int, where: str) -> None:
    """Raise SceneError if a texture, or all of the scene so far, have more texels than may be. Before they are decoded."""
    if count > most:
        raise SceneError(f"{where}: the texture has {count:,} texels, wanted at most {most:,}")
    reach = _reach.get()
    if reach is not None:
        reach.texels_left -= count
        if reach.texels_left < 0:
            raise SceneError(f"{where}: the scene's textures have more than {MOST_TEXELS:,} texels together")


def _read(path: Path, needed: bool) -> bytes | None:
    note(path)
    sources, reach = recording(), _reach.get()
    look = look_at(path) if sources is not None else None
    if needed and reach is not None:
        reach.check(path, _real(path))  # whether it is there or not: a scene is not to find out
    try:
        with open_regular(path) as file:
            if reach is not None:
                reach.check(path, _place_of(file, path))
            data = read_open(file, LARGEST_FILE)
    except Irregular as error:
        if not needed and os.path.isdir(path):
            data = None  # a name cut short, as good as none
        else:
            raise SceneError(f"{path}: {error}") from None
    except TooLong as error:
        raise SceneError(f"{path}: {error}") from None
    except OSError as error:
        if not (isinstance(error, FileNotFoundError) or (not needed and error.errno in NOT_THERE)):
            raise SceneError(f"{path}: the file cannot be read ({error.strerror or error})") from None
        data = None
    if sources is not None:
        sources.note(path, look if data is not None else None, data)
    if reach is not None and data is not None:
        reach.bytes_left -= len(data)
        if reach.bytes_left < 0:
            raise SceneError(f"{path}: with this file the scene has more than {MOST_BYTES:,} bytes")
    return data


def _place_of(file: BinaryIO, path: Path) -> str:
    """The real path of an open file: asked of the system, since names may have changed meanwhile."""
    try:
        return os.readlink(f"/proc/self/fd/{file.fileno()}")
    except OSError:  # no /proc here
        return _real(path)


def _real(path: Path) -> str:
    try:
        return os.path.realpath(path)
    except (OSError, ValueError):
        return os.path.abspath(str(path).replace("\0", ""))


def _within(place: str, folder: str) -> bool:
    return place == folder or place.startswith(folder if folder.endswith("/") else folder + "/")
