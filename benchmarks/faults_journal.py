"""Damaged journals for the fault campaign: rows that are none are set aside, and the others' jobs go on.

A journal with jobs that have not ended is damaged while the service is down. After damage to a row the service comes up and
does the other jobs; after damage to the file it does so or is refused in one line, and with the file as it was all jobs are done.
"""

from __future__ import annotations

import os
import random
import shutil
import sqlite3
from collections.abc import Callable
from functools import partial
from pathlib import Path

from faults_bed import Case, Outcome
from faults_service import MOBILE, NAME, TINY, ServiceBed, Wrong, one_line, right, submit

import raygrid
from raygrid.host.client.service_files import JOURNAL, state_directory
from raygrid.node.errors import RaygridError

FRAMES = 3
LONG = {"size": (3000, 3000), "samples": 64}  # it is still under way when the service is taken down
Jobs = dict[int, Path]

ROWS: dict[str, str] = {
    "a request that is no JSON": "update jobs set request = '{{{{{n}' where job = ?",
    "a request that is a list": "update jobs set request = '[{n}]' where job = ?",
    "a request that lacks its keys": """update jobs set request = '{{"do": "submit", "n": {n}}}' where job = ?""",
    "a request of bytes": "update jobs set request = x'ff{n:04x}80' where job = ?",
    "a request with a relative path": "update jobs set request = replace(request, '/', '{n}') where job = ?",
    "a request of frames without end": "update jobs set request = replace(request, '[1, 1]', '[1, {n}00000000000]') where job = ?",
    "a state that is none": "update jobs set state = 'state {n}' where job = ?",
    "a time that is none": "update jobs set submitted = 'noon {n}' where job = ?",
    "a client of bytes": "update jobs set client = x'fe{n:04x}' where job = ?",
    "an error of 9 MB": "update jobs set state = 'failed', ended = {n}, error = hex(zeroblob(4500000)) where job = ?",
    "frames that are none": "insert into frames select job, -{n}, 'x', 'y' from jobs where job = ?",
}


def _rows(rng: random.Random) -> list[Case]:
    def do(bed: ServiceBed, change: str) -> Outcome:
        jobs, victim = _left_over(bed)
        base = sqlite3.connect(state_directory(NAME) / JOURNAL, isolation_level=None)
        base.execute(change, (victim,))
        base.close()
        done = bed.up()
        if done.returncode != 0:
            raise Wrong(f"a bad row keeps it from starting: {done.stderr.strip()[:300]}")
        _all_done(jobs)
        with raygrid.connect(NAME) as array:  # all can be listed, and the bad one be got rid of
            facts = [facts for facts in array.jobs(1000) if facts["job"] == victim]
            if facts and facts[0]["error"]:
                one_line(facts[0]["error"][:3000])
            array.cancel(None)
        return Outcome("same", ready=(0.0,))

    return [
        Case(name, partial(do, change=ROWS[name].format(n=rng.randint(10, 99)))) for name in rng.sample(sorted(ROWS), 6)
    ]


def _left_over(bed: ServiceBed) -> tuple[Jobs, int]:
    """A service that is down with jobs in its journal: what they are, and one more that can be spoilt."""
    jobs: Jobs = {}
    with raygrid.connect(NAME) as array:
        blocking = submit(array, bed.folder / "long.npy", TINY, **LONG)
        for number in range(2):
            pattern = bed.folder / f"{number}_%d.npy"
            jobs[submit(array, pattern, MOBILE, frames=(1, FRAMES), client=f"client {number}").job] = pattern
        victim = submit(array, bed.folder / "victim_%d.npy", MOBILE, frames=(1, 1)).job
        blocking.cancel()
        array.down()
    return jobs, victim


def _all_done(jobs: Jobs) -> None:
    with raygrid.connect(NAME) as array:
        for job, pattern in jobs.items():
            array.wait(job)
            for frame in range(1, FRAMES + 1):
                right(Path(str(pattern) % frame), frame=frame)


Damage = Callable[[Path, random.Random], object]


def _flip(path: Path, rng: random.Random) -> None:
    data = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 1, 40))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)


def _truncate(path: Path, rng: random.Random) -> None:
    os.truncate(path, rng.randrange(path.stat().st_size))


def _zero_page(path: Path, rng: random.Random) -> None:
    pages = path.stat().st_size // 4096
    with path.open("r+b") as file:
        file.seek(4096 * rng.randrange(pages))
        file.write(bytes(4096))


def _empty(path: Path, rng: random.Random) -> None:
    path.write_bytes(b"")


def _garbage(path: Path, rng: random.Random) -> None:
    path.write_bytes(rng.randbytes(rng.randrange(1, 40_000)))


def _log_of_garbage(path: Path, rng: random.Random) -> None:
    path.with_name(path.name + "-wal").write_bytes(rng.randbytes(rng.randrange(1, 40_000)))


def _directory(path: Path, rng: random.Random) -> None:
    path.unlink()
    path.mkdir()


def _fifo(path: Path, rng: random.Random) -> None:
    path.unlink()
    os.mkfifo(path)


def _link(path: Path, rng: random.Random) -> None:
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


def _newer(path: Path, rng: random.Random) -> None:
    base = sqlite3.connect(path, isolation_level=None)
    base.execute(f"pragma user_version = {rng.randrange(50, 999)}")
    base.close()


def _no_table(path: Path, rng: random.Random) -> None:
    base = sqlite3.connect(path, isolation_level=None)
    base.execute(f"drop table {rng.choice(('frames', 'files'))}")
    base.close()


DAMAGE: tuple[Damage, ...] = (
    *(_flip, _flip, _flip, _truncate, _zero_page, _empty, _garbage, _log_of_garbage),
    *(_directory, _fifo, _link, _newer, _no_table),
)


def _files(rng: random.Random) -> list[Case]:
    def do(bed: ServiceBed, damage: Damage, seed: int) -> Outcome:
        jobs, _ = _left_over(bed)
        path = state_directory(NAME) / JOURNAL
        safe = bed.root / "journal.safe"
        shutil.copy2(path, safe)
        damage(path, random.Random(seed))
        done = bed.up()
        outcome = Outcome("same", ready=(0.0,))
        if done.returncode != 0:
            outcome = Outcome("refused", one_line(done.stderr))
        else:
            _usable(bed)
            bed.down()
        _put_back(path, safe)
        bed.bring_up()
        _all_done(jobs)
        with raygrid.connect(NAME) as array:
            array.cancel(None)
        return outcome

    found = []
    for damage in rng.sample(DAMAGE, 6):
        seed = rng.getrandbits(32)
        found.append(Case(f"{damage.__name__.strip('_')} {seed}", partial(do, damage=damage, seed=seed)))
    return found


def _usable(bed: ServiceBed) -> None:
    """A service whose journal is damaged renders right, or refuses a job in one line. Raises Wrong."""
    with raygrid.connect(NAME) as array:
        try:
            array.cancel(None)
            submit(array, bed.folder / "usable.npy").wait()
            right(bed.folder / "usable.npy")
        except RaygridError as error:
            one_line(str(error))


def _put_back(path: Path, safe: Path) -> None:
    for name in (path.name, path.name + "-wal", path.name + "-shm", "elsewhere"):
        found = path.with_name(name)
        if found.is_dir() and not found.is_symlink():
            shutil.rmtree(found)
        else:
            found.unlink(missing_ok=True)
    shutil.copy2(safe, path)


GROUPS = {"rows of a journal damaged": _rows, "file of a journal damaged": _files}
