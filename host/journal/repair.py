"""Sets aside a journal that SQLite cannot read, and goes on in a new one with what can still be read of it."""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from raygrid.host.journal.journal import COLUMNS, Damaged, Journal, Record, read_row
from raygrid.node.errors import OutputError

MOST_SKIPPED = 10_000  # numbers in a row that cannot be read, after which no more is looked for
FILES = ("", "-wal", "-shm")


def open_journal(path: Path) -> tuple[Journal, list[str]]:
    """The journal at a path, mended if it is damaged, and what there is to say of that. Raises OutputError."""
    try:
        return Journal(path), []
    except Damaged as error:
        kept = _set_aside(path)
        journal = Journal(path)
        try:
            saved = _save(kept, journal)
        except OSError as failed:
            journal.close()
            raise OutputError(f"{path}: the damaged journal cannot be read ({failed.strerror or failed})") from None
        except BaseException:
            journal.close()
            raise
        jobs = f"{saved} job{'' if saved == 1 else 's'}"
        return journal, [f"{error}: it is kept as {kept.name}, and the {jobs} that could be read go on in a new one"]


def open_again(old: Journal) -> tuple[Journal, list[str]]:
    """The journal anew, after its file was removed, replaced or damaged while it was open. Raises OutputError."""
    old.close()  # first: what it still had to write goes into its file, wherever that is
    if not os.path.lexists(old.path):
        for suffix in FILES[1:]:  # of the file that is gone, and would be taken for the new one's
            with contextlib.suppress(OSError):
                os.unlink(f"{old.path}{suffix}")
    return open_journal(old.path)


def _set_aside(path: Path) -> Path:
    """Rename the files of a journal; returns the new name of the first. Raises OutputError."""
    stem = f"{path.name}.damaged-{time.strftime('%Y%m%d-%H%M%S')}"
    names = (path.with_name(stem + (f"-{number}" if number else "")) for number in range(1000))
    kept = next(name for name in names if not os.path.lexists(name))
    try:
        os.rename(path, kept)
        for suffix in FILES[1:]:
            with contextlib.suppress(FileNotFoundError):
                os.rename(f"{path}{suffix}", f"{kept}{suffix}")
    except OSError as error:
        raise OutputError(f"{path}: the damaged journal cannot be set aside ({error.strerror or error})") from None
    return kept


def _save(kept: Path, journal: Journal) -> int:
    """Record in a new journal what can be read of another; returns how many jobs."""
    saved = 0
    with tempfile.TemporaryDirectory(prefix=".reading-", dir=kept.parent) as folder:  # SQLite writes to what it opens
        copy = Path(folder) / "journal"
        for suffix in FILES[:2]:
            with contextlib.suppress(OSError):
                shutil.copyfile(f"{kept}{suffix}", f"{copy}{suffix}")
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(copy)) as base:
            base.text_factory = bytes
            last = _last(base)
            for row in _rows(base):
                with contextlib.suppress(ValueError, RecursionError):
                    read = read_row((*row, 0, 0))
                    journal.restore(read, _frames(base, read.job), last)
                    saved += 1
    return saved


def _last(base: sqlite3.Connection) -> int:
    """The highest number that a job had, as far as that can be read."""
    with contextlib.suppress(sqlite3.Error, TypeError, ValueError):
        return int(base.execute("select seq from sqlite_sequence where name = 'jobs'").fetchone()[0])
    return 0


def _rows(base: sqlite3.Connection) -> Iterator[Record]:
    """The rows of the table of jobs that can be read: where a page is damaged, the numbers on it are skipped."""
    there = [name.decode(errors="replace") for _, name, *_ in base.execute("pragma table_info(jobs)")]
    columns = ", ".join(name if name in there else f"null as {name}" for name in COLUMNS)
    job = skipped = 0
    while skipped < MOST_SKIPPED:
        try:
            row = base.execute(f"select {columns} from jobs where job > ? order by job limit 1", (job,)).fetchone()
        except sqlite3.Error:
            job, skipped = job + 1, skipped + 1
            continue
        if row is None:
            return
        yield row
        job, skipped = row[0], 0


def _frames(base: sqlite3.Connection, job: int) -> list[Record]:
    """The frames of a job that are known to be done; one that cannot be read is rendered again."""
    found: list[Record] = []
    with contextlib.suppress(sqlite3.Error):
        for row in base.execute("select frame, skipped, seconds from frames where job = ?", (job,)):
            found.append(row)  # noqa: PERF402  (those before the one that fails count)
    return found
