"""Signals to the service, at moments of wall time, with jobs queued: no job is lost, and the pictures have the same bits.

What a client was told is submitted is in the journal: after the end of the service, by whatever signal, and another `up`,
every job is there and is done.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import psutil
from faults_bed import Case, Outcome
from faults_service import MOBILE, NAME, ServiceBed, Wrong, right, submit, wait_until

import raygrid
from raygrid.host.client.client import Service, wait_gone
from raygrid.node.errors import RaygridError

JOBS, FRAMES = 3, 4
SPAN = 1.2  # seconds: some signals come when all is done
ENDS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
END_SECONDS = 20.0  # for a service that is told to end
LOST_JOB = 100  # ended jobs that are asked for when one is looked for


def _ended(sign: signal.Signals, rng: random.Random) -> Case:
    """A signal that ends it, while its queue is worked off."""

    def do(bed: ServiceBed, after: float) -> Outcome:
        jobs = _queue(bed)
        time.sleep(after)  # a moment of wall time is what is tried here
        begun = time.perf_counter()
        record = bed.record
        os.kill(record.pid, sign)
        if not wait_gone(record, END_SECONDS):
            raise Wrong(f"the service was there {END_SECONDS:g} s after {sign.name}")
        told = time.perf_counter() - begun
        again = time.perf_counter()
        bed.bring_up()
        ready = time.perf_counter() - again
        _all_done(bed, jobs)
        return Outcome("same", noticed=(told,), ready=(ready,))

    after = rng.random() * SPAN
    return Case(f"{sign.name} after {after:.3f} s", partial(do, after=after))


def _ending(signs: tuple[signal.Signals, ...], times: int) -> Callable[[random.Random], list[Case]]:
    def cases(rng: random.Random) -> list[Case]:
        return [_ended(rng.choice(signs), rng) for _ in range(times)]

    return cases


def _queue(bed: ServiceBed) -> dict[int, Path]:
    """Jobs of three clients: number -> pattern of outputs."""
    jobs = {}
    with raygrid.connect(NAME) as array:
        for number in range(JOBS):
            pattern = bed.folder / f"{number}_%d.npy"
            jobs[submit(array, pattern, MOBILE, frames=(1, FRAMES), client=f"client {number}").job] = pattern
    return jobs


def _all_done(bed: ServiceBed, jobs: dict[int, Path]) -> None:
    """Every job is known, and done, and right. Raises Wrong."""
    with raygrid.connect(NAME) as array:
        known = {facts["job"] for facts in array.jobs(LOST_JOB)}
        if not set(jobs) <= known:
            raise Wrong(f"jobs were lost: {sorted(set(jobs) - known)}")
        for job, pattern in jobs.items():
            array.wait(job)
            for frame in range(1, FRAMES + 1):
                right(Path(str(pattern) % frame), frame=frame)


def _killed_while_submitting(rng: random.Random) -> list[Case]:
    """It is killed while clients submit as fast as they can: what they were told is submitted is there afterwards."""

    def do(bed: ServiceBed, after: float) -> Outcome:
        told: dict[int, Path] = {}
        record = bed.record

        def hurry(client: int) -> None:
            with contextlib.suppress(RaygridError), raygrid.connect(NAME) as array:
                for number in range(1000):
                    pattern = bed.folder / f"{client}_{number}_%d.npy"
                    told[submit(array, pattern, MOBILE, frames=(1, 1)).job] = pattern

        threads = [threading.Thread(target=hurry, args=(client,)) for client in range(3)]
        for thread in threads:
            thread.start()
        time.sleep(after)
        os.kill(record.pid, signal.SIGKILL)
        for thread in threads:
            thread.join(60.0)
        wait_gone(record, END_SECONDS)
        bed.bring_up()
        with raygrid.connect(NAME) as array:
            known = {facts["job"] for facts in array.jobs(10_000)}
            if not set(told) <= known:
                raise Wrong(f"of {len(told)} jobs these were lost: {sorted(set(told) - known)[:20]}")
            array.cancel([job for job in told if job in {facts["job"] for facts in array.jobs(0)}][5:])
            for job in list(told)[:5]:
                array.wait(job)
                right(Path(str(told[job]) % 1), frame=1)
        return Outcome("same", ready=(0.0,))

    return [
        Case(f"SIGKILL after {after:.3f} s of submitting", partial(do, after=after))
        for after in (rng.uniform(0.1, 0.6) for _ in range(2))
    ]


def _stopped(rng: random.Random) -> list[Case]:
    """Stopped for a while and continued: those who wait hear no word of an end, and nothing is done twice or not at all."""

    def do(bed: ServiceBed, after: float, seconds: float) -> Outcome:
        jobs = _queue(bed)
        time.sleep(after)
        record = bed.record
        os.kill(record.pid, signal.SIGSTOP)
        timer = threading.Timer(seconds, os.kill, (record.pid, signal.SIGCONT))
        timer.start()
        begun = time.perf_counter()
        try:
            with raygrid.connect(NAME) as array:  # waits for it
                array.status()
        finally:
            timer.join()
        _all_done(bed, jobs)
        return Outcome("same", ready=(time.perf_counter() - begun,))

    return [
        Case(f"after {after:.3f} s for {seconds:.1f} s", partial(do, after=after, seconds=seconds))
        for after, seconds in ((rng.random() * SPAN, rng.uniform(0.2, 4.0)) for _ in range(3))
    ]


def _nodes(rng: random.Random) -> list[Case]:
    """Nodes of the service are struck while its queue is worked off, at several moments."""

    def do(bed: ServiceBed, seed: float, sign: signal.Signals) -> Outcome:
        own = random.Random(seed)
        jobs = _queue(bed)
        with raygrid.connect(NAME) as array:
            for _ in range(3):
                time.sleep(own.random() * 0.4)
                pids = [node["pid"] for node in array.status()["nodes"]]
                if pids:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(own.choice(pids), sign)
        _all_done(bed, jobs)
        return Outcome("same", ready=(0.0,))

    signs = (signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV)
    return [Case(f"three times {sign.name}", partial(do, seed=rng.random(), sign=sign)) for sign in signs]


def _any_process(rng: random.Random) -> list[Case]:
    """Whatever process the service has, nodes or others, is struck while its queue is worked off, at several moments."""

    def do(bed: ServiceBed, seed: float, sign: signal.Signals) -> Outcome:
        own = random.Random(seed)
        jobs = _queue(bed)
        service = psutil.Process(bed.record.pid)
        for _ in range(3):
            time.sleep(own.random() * 0.3)
            found = sorted(service.children(recursive=True), key=lambda process: process.pid)
            if found:
                with contextlib.suppress(psutil.Error):
                    own.choice(found).send_signal(sign)
        _all_done(bed, jobs)
        return Outcome("same", ready=(0.0,))

    signs = (signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM)
    return [Case(f"three times {sign.name}", partial(do, seed=rng.random(), sign=sign)) for sign in signs]


def _fork_server(rng: random.Random) -> list[Case]:
    """The fork server is stopped or killed, and a node killed: repaired while idle, or by the next frame."""

    def do(bed: ServiceBed, sign: signal.Signals, idle: bool, node: int) -> Outcome:
        with raygrid.connect(NAME) as array:
            pid = array.status()["nodes"][node]["pid"]
            server = _parent(pid)
            os.kill(server, sign)
            os.kill(pid, signal.SIGKILL)
            begun = time.perf_counter()
            if idle:
                wait_until(lambda: _healthy(array, pid), 15.0, "the repair of an idle array")
            job = submit(array, bed.folder / "a.npy")
            job.wait()
            seconds = time.perf_counter() - begun
            if seconds > 15.0:
                raise Wrong(f"the next frame came after {seconds:.1f} s")
        right(bed.folder / "a.npy")
        return Outcome("same", ready=(seconds,))

    return [
        Case(
            f"{sign.name}, {'idle' if idle else 'and a frame at once'}",
            partial(do, sign=sign, idle=idle, node=rng.randrange(2)),
        )
        for sign in (signal.SIGSTOP, signal.SIGKILL)
        for idle in (True, False)
    ]


def _healthy(array: Service, lost: int) -> bool:
    status = array.status()
    states = [node["state"] for node in status["nodes"]]
    pids = [node["pid"] for node in status["nodes"]]
    return status["state"] == "ready" and lost not in pids and bool(states) and "dead" not in states


def _parent(pid: int) -> int:
    with open(f"/proc/{pid}/stat") as file:
        return int(file.read().rpartition(")")[2].split()[1])


GROUPS = {
    "service told to end": _ending(ENDS, 3),
    "service killed": _ending((signal.SIGKILL,), 4),
    "service killed while clients submit": _killed_while_submitting,
    "service stopped and continued": _stopped,
    "nodes of a service struck": _nodes,
    "any process of a service struck": _any_process,
    "fork server of a service": _fork_server,
}
