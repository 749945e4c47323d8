"""Outputs of a job that are no files, for the fault campaign: each is refused in one line or written whole, and nothing hangs."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from functools import partial
from pathlib import Path

from faults_bed import Case, Outcome
from faults_service import NAME, ServiceBed, neighbour, one_line, right, submit

import raygrid
from raygrid.host.client.service_files import state_directory
from raygrid.node.errors import RaygridError

Make = Callable[[Path], Path]  # makes what is in the way; returns the path of the output


def _fifo(folder: Path) -> Path:
    os.mkfifo(folder / "a.npy")
    return folder / "a.npy"


def _link_to_fifo(folder: Path) -> Path:
    os.mkfifo(folder / "fifo")
    (folder / "a.npy").symlink_to("fifo")
    return folder / "a.npy"


def _link_to_full(folder: Path) -> Path:
    (folder / "a.npy").symlink_to("/dev/full")
    return folder / "a.npy"


def _link_to_itself(folder: Path) -> Path:
    (folder / "a.npy").symlink_to("a.npy")
    return folder / "a.npy"


def _directory(folder: Path) -> Path:
    (folder / "a.npy").mkdir()
    return folder / "a.npy"


def _no_directory(folder: Path) -> Path:
    return folder / "none" / "a.npy"


def _file_for_directory(folder: Path) -> Path:
    (folder / "file").touch()
    return folder / "file" / "a.npy"


def _long_name(folder: Path) -> Path:
    return folder / ("a" * 300 + ".npy")


def _kernel(folder: Path) -> Path:
    return Path("/proc/self/a.npy")


def _link_to_journal(folder: Path) -> Path:
    """What the service itself reads and writes."""
    (folder / "a.npy").symlink_to(state_directory(NAME) / "journal.sqlite")
    return folder / "a.npy"


MAKES: tuple[Make, ...] = (
    *(_fifo, _link_to_fifo, _link_to_full, _link_to_itself, _directory),
    *(_no_directory, _file_for_directory, _long_name, _kernel, _link_to_journal),
)


def _outputs(rng: random.Random) -> list[Case]:
    def do(bed: ServiceBed, make: Make, stats: bool) -> Outcome:
        folder = bed.folder / "outputs"
        folder.mkdir()
        path = make(folder)
        with neighbour(bed), raygrid.connect(NAME) as array:
            try:
                if stats:
                    submit(array, bed.folder / "b.npy", stats=path.with_suffix(".npy")).wait()
                else:
                    submit(array, path).wait()
            except RaygridError as error:
                return Outcome("refused", one_line(str(error)))
        if not stats and path.is_file():
            right(path)
        return Outcome("same")

    cases = rng.sample(MAKES, 6)
    return [
        Case(f"{make.__name__.strip('_')}{', statistics' * stats}", partial(do, make=make, stats=stats))
        for make, stats in ((make, rng.random() < 0.3) for make in cases)
    ]


GROUPS = {"outputs that are no files": _outputs}
