"""The journal: jobs and frames on disk, so that they survive the service. SQLite, in write-ahead mode.

A job that is neither done, failed nor cancelled comes back at the next start, without the frames that are recorded as
done. A frame is recorded after its files are in place; one that was written and not recorded is rendered again, to
the same bits.
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from raygrid.node.errors import OutputError

VERSION = 1
KEPT = 1000  # jobs that have ended
ENDED = ("done", "failed", "cancelled")
BUSY_SECONDS = 5.0
TABLES = """
create table if not exists jobs (
    job integer primary key autoincrement,
    client text not null,
    request text not null,
    submitted real not null,
    ended real,
    state text not null,
    error text not null default ''
);
create index if not exists jobs_by_state on jobs (state);
create table if not exists frames (
    job integer not null references jobs (job) on delete cascade,
    frame integer not null,
    skipped integer not null,
    seconds real not null,
    primary key (job, frame)
) without rowid;
create table if not exists files (
    path text primary key,
    digest text not null,
    size integer not null,
    changed integer not null,
    job integer not null
) without rowid;
create index if not exists files_by_job on files (job);
"""


class JobRow(NamedTuple):
    """A job of the journal. `done`: how many of its frames are; `request`: what was submitted."""

    job: int
    client: str
    request: dict[str, Any]
    submitted: float
    ended: float | None
    state: str
    error: str
    done: int
    skipped: int


class Journal:
    """The journal of one array. For use by one thread."""

    def __init__(self, path: Path) -> None:
        """Open it, or make it. Raises OutputError."""
        self.path = path
        with self._told():
            # made by us first, because SQLite would make it readable for all
            os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600))
            self._base = sqlite3.connect(path, timeout=BUSY_SECONDS, isolation_level=None)
        try:
            with self._told():
                self._base.execute("pragma journal_mode = wal")
                self._base.execute("pragma synchronous = normal")
                self._base.execute("pragma foreign_keys = on")
                (version,) = self._base.execute("pragma user_version").fetchone()
                if version > VERSION:
                    raise OutputError(f"{path}: the journal has version {version}, wanted at most {VERSION}")
                self._base.executescript(TABLES)
                self._base.execute(f"pragma user_version = {VERSION}")
        except BaseException:
            self._base.close()
            raise

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Errors of the disk and of SQLite as ours."""
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            why = (error.strerror if isinstance(error, OSError) else None) or str(error)
            raise OutputError(f"{self.path}: the journal cannot be kept ({why})") from None

    @contextlib.contextmanager
    def _change(self) -> Iterator[sqlite3.Connection]:
        """A transaction: all or nothing."""
        with self._told():
            self._base.execute("begin immediate")
            try:
                yield self._base
                self._base.execute("commit")
            except BaseException:
                with contextlib.suppress(sqlite3.Error):
                    self._base.execute("rollback")
                raise

    def add(self, client: str, request: dict[str, Any]) -> int:
        """Record a new job; returns its number. Raises OutputError, and then it is not recorded."""
        row = (client, json.dumps(request), time.time())
        with self._change() as base:
            made = base.execute(
                "insert into jobs (client, request, submitted, state) values (?, ?, ?, 'queued')", row
            ).lastrowid
            old = "select job from jobs where state in (?, ?, ?) order by job desc limit -1 offset ?"
            base.execute(f"delete from files where job in ({old})", (*ENDED, KEPT))
            base.execute(f"delete from jobs where job in ({old})", (*ENDED, KEPT))
        assert made is not None
        return made

    def frame_done(self, job: int, frame: int, skipped: bool, seconds: float, files: dict[str, str]) -> None:
        """Record a frame whose files (path -> digest) are in place. Raises OutputError."""
        with self._change() as base:
            base.execute("insert or replace into frames values (?, ?, ?, ?)", (job, frame, int(skipped), seconds))
            for path, digest in files.items():
                with contextlib.suppress(OSError):
                    status = os.stat(path)
                    row = (path, digest, status.st_size, status.st_mtime_ns, job)
                    base.execute("insert or replace into files values (?, ?, ?, ?, ?)", row)

    def set_state(self, job: int, state: str, error: str = "") -> None:
        """Record what became of a job. Raises OutputError."""
        ended = time.time() if state in ENDED else None
        with self._change() as base:
            base.execute("update jobs set state = ?, error = ?, ended = ? where job = ?", (state, error, ended, job))

    def is_recorded(self, path: str, digest: str) -> bool:
        """Whether this file was written with that digest, and nobody has touched it since. Raises OutputError."""
        with self._told():
            row = self._base.execute("select digest, size, changed from files where path = ?", (path,)).fetchone()
        try:
            status = os.stat(path)
        except OSError:
            return False
        return bool(row == (digest, status.st_size, status.st_mtime_ns))

    def unfinished(self) -> list[JobRow]:
        """The jobs that have not ended, oldest first. Raises OutputError."""
        return self._rows("where state not in (?, ?, ?) order by job", ENDED)

    def ended(self, most: int) -> list[JobRow]:
        """The last jobs that have ended, oldest first. Raises OutputError."""
        return self._rows("where state in (?, ?, ?) order by job desc limit ?", (*ENDED, most))[::-1]

    def find(self, job: int) -> JobRow | None:
        """A job by its number. Raises OutputError."""
        rows = self._rows("where job = ?", (job,))
        return rows[0] if rows else None

    def frames_done(self, job: int) -> set[int]:
        """The frames of a job that are recorded. Raises OutputError."""
        with self._told():
            return {frame for (frame,) in self._base.execute("select frame from frames where job = ?", (job,))}

    def counts(self) -> dict[str, int]:
        """Jobs by state. Raises OutputError."""
        with self._told():
            return dict(self._base.execute("select state, count(*) from jobs group by state"))

    def _rows(self, which: str, values: tuple[Any, ...]) -> list[JobRow]:
        done = "(select count(*) from frames where frames.job = jobs.job)"
        skipped = "(select coalesce(sum(skipped), 0) from frames where frames.job = jobs.job)"
        columns = f"job, client, request, submitted, ended, state, error, {done}, {skipped}"
        with self._told():
            rows = self._base.execute(f"select {columns} from jobs {which}", values).fetchall()
        return [JobRow(row[0], row[1], json.loads(row[2]), *row[3:]) for row in rows]

    def close(self) -> None:
        """Close it. May be called twice."""
        with contextlib.suppress(sqlite3.Error):
            self._base.close()
