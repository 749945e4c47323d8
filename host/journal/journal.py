"""Records jobs and frames on disk, so that they survive the service. SQLite, in write-ahead mode.

A job that is neither done, failed nor cancelled comes back at the next start, without the frames that are recorded as
done. A frame is recorded after its files are in place; one that was written and not recorded is rendered again, to
the same bits.

What is on disk is not trusted: a row that cannot be read is moved to the table `set_aside`, and the others go on. A file
that SQLite cannot read is `Damaged`; `host.journal.repair` sets it aside as a whole.
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

from raygrid.host.client.facts import ENDED
from raygrid.host.text.clean_text import printable
from raygrid.node.errors import OutputError

VERSION = 2  # 1 did not say when a job was begun
KEPT = 1000  # jobs that have ended
BUSY_SECONDS = 5.0
LATEST = 253_402_300_800  # seconds from 1970 to the year 10,000
TABLES = """
create table if not exists jobs (
    job integer primary key autoincrement,
    client text not null,
    request text not null,
    submitted real not null,
    ended real,
    state text not null,
    error text not null default '',
    begun real
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
create table if not exists set_aside (
    job integer not null,
    at real not null,
    why text not null,
    row text not null
);
"""
COLUMNS = ("job", "client", "request", "submitted", "begun", "ended", "state", "error")
CORRUPT = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
# Of a record and not of the disk: it would fail again whenever it is tried.
HOPELESS = (sqlite3.IntegrityError, sqlite3.DataError, sqlite3.InterfaceError, sqlite3.ProgrammingError)
Record = tuple[Any, ...]


class Damaged(OutputError):
    """The file is no journal any more."""


class Unwritable(OutputError):
    """A record that can never be written, whatever the disk."""


class JobRow(NamedTuple):
    """A job of the journal.

    request            what was submitted
    submitted, begun, ended  seconds since 1970; None: not yet
    done, skipped      how many of its frames are, and were there already
    """

    job: int
    client: str
    request: dict[str, object]
    submitted: float
    begun: float | None
    ended: float | None
    state: str
    error: str
    done: int
    skipped: int


class Journal:
    """The journal of one array. For use by one thread.

    remarks   on rows that were set aside; for the caller to tell and to clear
    """

    def __init__(self, path: Path) -> None:
        """Open it, or make it. Raises Damaged for a file that is no journal, OutputError for what else is wrong."""
        self.path = path
        self.remarks: list[str] = []
        with self._our_errors():
            # made by us first, because SQLite would make it readable for all
            os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600))
            self._base = sqlite3.connect(path, timeout=BUSY_SECONDS, isolation_level=None)
        self._base.text_factory = bytes  # or one text that is no UTF-8 would keep all rows from being read
        try:
            self._check()
            with self._our_errors():
                self._set_up()
            self._check()
        except BaseException:
            self._base.close()
            raise
        self._files = self._look()

    def _set_up(self) -> None:
        base = self._base
        base.execute("pragma journal_mode = wal")
        base.execute("pragma synchronous = normal")
        base.execute("pragma foreign_keys = on")
        (version,) = base.execute("pragma user_version").fetchone()
        if version == 1:
            base.execute("alter table jobs add column begun real")
        base.executescript(TABLES)
        if version < VERSION:
            base.execute(f"pragma user_version = {VERSION}")

    def _check(self) -> None:
        """Raise Damaged if pages or columns are not as they should be, OutputError for a later version. Writes nothing."""
        with self._our_errors():
            (version,) = self._base.execute("pragma user_version").fetchone()
            (found,) = self._base.execute("pragma quick_check(1)").fetchone()
            columns = _names(self._base)
        if version > VERSION:
            raise OutputError(f"{self.path}: the journal has version {version}, wanted at most {VERSION}")
        wanted = [name for name in COLUMNS if version > 1 or name != "begun"]
        missing = [name for name in wanted if name not in columns and (columns or version)]
        if found != b"ok" or missing:
            why = f"no column {missing[0]}" if missing else printable(found.decode(errors="replace"), 200)
            raise Damaged(f"{self.path}: the journal is damaged ({why})")

    def _look(self) -> tuple[int | None, ...]:
        """The numbers of its two files, None for one that is not there."""
        return tuple(_inode(f"{self.path}{suffix}") for suffix in ("", "-wal"))

    @property
    def there(self) -> bool:
        """Whether what is at its path is still what was opened."""
        return self._look() == self._files

    @contextlib.contextmanager
    def _our_errors(self) -> Iterator[None]:
        """Errors of the disk and of SQLite as ours."""
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            why = (error.strerror if isinstance(error, OSError) else None) or str(error)
            # of an extended code the lowest byte says what it is
            corrupt = (getattr(error, "sqlite_errorcode", None) or 0) & 0xFF in CORRUPT
            kind = Damaged if corrupt else Unwritable if isinstance(error, HOPELESS) else OutputError
            raise kind(f"{self.path}: the journal cannot be kept ({why})") from None
        except (ValueError, OverflowError) as error:  # of half characters, and of numbers that SQLite has no room for
            raise Unwritable(f"{self.path}: the journal cannot hold it ({printable(str(error), 200)})") from None

    @contextlib.contextmanager
    def _change(self) -> Iterator[sqlite3.Connection]:
        """A transaction: all or nothing."""
        with self._our_errors():
            self._base.execute("begin immediate")
            try:
                yield self._base
                self._base.execute("commit")
            except BaseException:
                with contextlib.suppress(sqlite3.Error):
                    self._base.execute("rollback")
                raise

    def add(self, client: str, request: dict[str, object], at: float | None = None) -> int:
        """Record a job submitted at that time, in seconds since 1970, None: now; returns its number.

        Raises OutputError, and then it is not recorded.
        """
        row = (printable(client), json.dumps(request), time.time() if at is None else at)
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

    def set_state(self, job: int, state: str, error: str = "", at: float | None = None) -> bool:
        """Record what became of a job, and when, in seconds since 1970; None: now. Whether there is such a job.

        Raises OutputError.
        """
        now = time.time() if at is None else at
        begun, ended = (now if state == "running" else None), (now if state in ENDED else None)
        values = (state, printable(error), begun, ended, job)
        with self._change() as base:
            done = base.execute(
                "update jobs set state = ?, error = ?, begun = coalesce(begun, ?), ended = ? where job = ?", values
            )
            return done.rowcount > 0

    def restore(self, row: JobRow, frames: Iterable[Record], last: int = 0) -> None:
        """Record a job as it stands, under its own number; no later job has one of up to `last`. Raises OutputError.

        frames  those that are done: frame, skipped, seconds
        """
        values = (*row[:2], json.dumps(row.request), *row[3:8])
        with self._change() as base:
            marks = ", ".join("?" * len(COLUMNS))
            base.execute(f"insert or replace into jobs ({', '.join(COLUMNS)}) values ({marks})", values)
            base.executemany("insert or ignore into frames values (?, ?, ?, ?)", ((row.job, *of) for of in frames))
            self._go_on_after(last)

    def skip_to(self, last: int) -> None:
        """Give no later job a number of up to `last`. Raises OutputError."""
        with self._change():
            self._go_on_after(last)

    def _go_on_after(self, last: int) -> None:
        found = self._base.execute("update sqlite_sequence set seq = max(seq, ?) where name = 'jobs'", (last,))
        if found.rowcount == 0:
            self._base.execute("insert into sqlite_sequence (name, seq) values ('jobs', ?)", (last,))

    def is_recorded(self, path: str, digest: str) -> bool:
        """Whether this file was written with that digest, and nobody has touched it since. Raises OutputError."""
        with self._our_errors():
            row = self._base.execute("select digest, size, changed from files where path = ?", (path,)).fetchone()
        try:
            status = os.stat(path)
        except (OSError, ValueError):
            return False
        return bool(row == (digest.encode(), status.st_size, status.st_mtime_ns))

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
        with self._our_errors():
            return {frame for (frame,) in self._base.execute("select frame from frames where job = ?", (job,))}

    def counts(self) -> dict[str, int]:
        """Jobs by state. Raises OutputError."""
        with self._our_errors():
            found = self._base.execute("select cast(state as blob), count(*) from jobs group by state").fetchall()
        return {state.decode(errors="replace"): count for state, count in found}

    def _rows(self, which: str, values: Record) -> list[JobRow]:
        with self._our_errors():
            rows = self._base.execute(f"select {columns_of(self._base)} from jobs {which}", values).fetchall()
        good = []
        for row in rows:
            try:
                good.append(read_row(row))
            except (ValueError, RecursionError) as error:
                self._set_aside(row, str(error))
        return good

    def _set_aside(self, row: Record, why: str) -> None:
        """Move a row that cannot be read out of the way of the others, with the frames of it that are done."""
        job, why = row[0], printable(why, 200)
        self.remarks.append(f"{self.path}: job {job} cannot be read ({why}), and is set aside")
        with contextlib.suppress(OutputError), self._change() as base:
            frames = base.execute("select frame from frames where job = ?", (job,)).fetchall()
            text = json.dumps([*row, frames], default=lambda value: value.decode(errors="backslashreplace"))
            base.execute("insert into set_aside values (?, ?, ?, ?)", (job, time.time(), why, text))
            base.execute("delete from jobs where job = ?", (job,))

    def close(self) -> None:
        """Close it. May be called twice."""
        with contextlib.suppress(sqlite3.Error):
            self._base.close()


def columns_of(base: sqlite3.Connection) -> str:
    """What is to be selected from the table of jobs for `read_row`, also from that of an earlier version."""
    done = "(select count(*) from frames where frames.job = jobs.job)"
    skipped = "(select cast(coalesce(sum(skipped), 0) as integer) from frames where frames.job = jobs.job)"
    there = _names(base)
    return ", ".join([*(name if name in there else f"null as {name}" for name in COLUMNS), done, skipped])


def _names(base: sqlite3.Connection) -> list[str]:
    """The names of the columns of the table of jobs."""
    return [name.decode(errors="replace") for _, name, *_ in base.execute("pragma table_info(jobs)")]


def read_row(row: Record) -> JobRow:
    """A row of the table `jobs` in the order of COLUMNS, and how many frames are done and skipped. Raises ValueError."""
    job, client, request, submitted, begun, ended, state, error, done, skipped = row
    wanted = json.loads(_text("request", request))
    if not isinstance(wanted, dict):
        raise ValueError(f"the request came as {type(wanted).__name__}, wanted a map")
    for name, value in (("submitted", submitted), ("begun", begun), ("ended", ended)):
        never = value is None and name != "submitted"
        if not never and not is_time(value):
            raise ValueError(f"{name} came as {str(value)[:40]}, wanted a time")
    times = submitted, begun, ended
    texts = printable(_text("state", state), 20), printable(_text("error", error))
    return JobRow(job, printable(_text("client", client)), wanted, *times, *texts, done, skipped)


def is_time(value: object) -> TypeGuard[float]:
    """Whether a value of the journal is a time that a calendar has, in seconds since 1970."""
    return isinstance(value, int | float) and abs(value) < LATEST


def _text(name: str, value: object) -> str:
    if not isinstance(value, bytes):
        raise ValueError(f"{name} came as {type(value).__name__}, wanted text")
    return value.decode()


def _inode(path: str) -> int | None:
    try:
        return os.lstat(path).st_ino
    except OSError:
        return None
