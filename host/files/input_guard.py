"""Notes the files that a command reads, and refuses outputs that would replace one of them.

    with noted() as inputs:         # the command line for each command, the worker of a service for each frame
        ...                         # whoever reads a file says so: note(path)
        check_outputs([path])       # before the work, when all is read; and `outputs` asks again at every write

A file is the same one by whatever way it is reached: links, relative paths and hard links (device and number of the
file). A file that was looked for and not found counts as well, for what is written there would be read the next time.
The files of arrays that stay (their journals above all) are always counted.
"""

from __future__ import annotations

import os
from collections.abc import Hashable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar

from raygrid.host.text.misuse import OutputMisuse
from raygrid.node.errors import ArrayError, OutputError

STANDARD = "-"  # standard output


class Inputs:
    """Maps the path of each file that was read to its purpose."""

    def __init__(self) -> None:
        self.files: dict[str, str] = {}

    def add(self, path: str | os.PathLike[str], what: str) -> None:
        """Note a file that is read, or was looked for."""
        with suppress(ValueError):
            self.files.setdefault(os.path.abspath(path), what)

    def by_identity(self) -> dict[Hashable, str]:
        """Return the purpose of each file by its identity."""
        return {identity(path): what for path, what in self.files.items()}


_noting: ContextVar[Inputs | None] = ContextVar("noting", default=None)


@contextmanager
def noted() -> Iterator[Inputs]:
    """Note what is read in this block, by this thread."""
    token = _noting.set(Inputs())
    try:
        found = _noting.get()
        assert found is not None
        yield found
    finally:
        _noting.reset(token)


def note(path: str | os.PathLike[str], what: str = "a file that the scene is made of") -> None:
    """Say that a file is read, or was looked for. `what`: as in "the output is ...", wanted another."""
    inputs = _noting.get()
    if inputs is not None:
        inputs.add(path, what)


def identity(path: str | os.PathLike[str]) -> Hashable:
    """Identify a file by its device and number, the same for all ways to it; by its real path if there is none yet."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return os.path.realpath(path) if "\0" not in os.fspath(path) else os.fspath(path)
    return status.st_dev, status.st_ino


def check_outputs(outputs: Iterable[str | os.PathLike[str]]) -> None:
    """Raise OutputError if one file would be written twice, or one be written over that is read."""
    inputs = _noting.get()
    taken = {} if inputs is None else inputs.by_identity()
    taken |= _files_of_arrays()
    for output in outputs:
        place: Hashable = STANDARD if os.fspath(output) == STANDARD else identity(output)
        if place == STANDARD and place in taken:
            raise OutputMisuse("-: standard output came twice, wanted it once")
        if place in taken:
            raise OutputError(f"{os.fspath(output)}: the output is {taken[place]}, wanted another")
        taken[place] = f"the same file as the output {os.fspath(output)}"


def check_kept(output: str | os.PathLike[str]) -> None:
    """Raise OutputError if this output is a file that is read: asked at every write."""
    check_outputs([output])


def _files_of_arrays() -> dict[Hashable, str]:
    """The files that arrays which stay keep, by identity."""
    from raygrid.host.files.state_home import state_home

    found: dict[Hashable, str] = {}
    with suppress(OSError, ArrayError), os.scandir(state_home()) as directories:
        for directory in directories:
            with suppress(OSError), os.scandir(directory.path) as files:
                what = f"a file of the array {directory.name!r} that stays"
                found |= {identity(file.path): what for file in files if not file.is_dir()}
    return found
