"""Crowds at the door for the fault campaign: idle clients, clients that say nothing, and many that come while it is stopped."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from faults_bed import Case, Outcome
from faults_service import NAME, ServiceBed, Wrong, command, one_line, right, submit

import raygrid
from raygrid.host.client.service_files import SOCKET
from raygrid.node.errors import RaygridError


def _idle_clients(rng: random.Random) -> list[Case]:
    """More clients than there are places, that are let in and do nothing: status and cancel get in all the same."""

    def do(bed: ServiceBed, number: int, greet: bool) -> Outcome:
        with contextlib.ExitStack() as stack:
            array = stack.enter_context(raygrid.connect(NAME))
            refused = 0
            for _ in range(number):
                try:
                    if greet:
                        stack.enter_context(raygrid.connect(NAME))
                    else:
                        stack.enter_context(_silent(bed))
                except RaygridError as error:
                    _true(str(error))
                    refused += 1
                except OSError:
                    refused += 1
            done = command("status", "--name", NAME, "--json")
            if done.returncode != 0:
                raise Wrong(f"status: {one_line(done.stderr)}")
            submit(array, bed.folder / "a.npy").wait()
        right(bed.folder / "a.npy")
        return Outcome("same", ready=(0.0,) if refused else ())

    numbers = rng.randint(210, 260), rng.randint(210, 260)
    return [
        Case(f"{numbers[0]} that are let in", partial(do, number=numbers[0], greet=True)),
        Case(f"{numbers[1]} that say nothing", partial(do, number=numbers[1], greet=False)),
    ]


@contextlib.contextmanager
def _silent(bed: ServiceBed) -> Iterator[None]:
    with socket.socket(socket.AF_UNIX) as peer:
        peer.settimeout(5.0)
        peer.connect(str(Path(bed.record.directory) / SOCKET))
        yield


def _true(words: str) -> None:
    """Raise Wrong for words that say of a service that is up that it is not."""
    one_line(words)
    if "is gone" in words or "--kill" in words or "no array named" in words:
        raise Wrong(f"of a service that is up a client was told: {words}")


def _many_at_once(rng: random.Random) -> list[Case]:
    """Many clients come while the service is stopped for half a second: each is let in, and none is told that it is gone."""

    def do(bed: ServiceBed, number: int, seconds: float) -> Outcome:
        said: list[str] = []

        def come() -> None:
            try:
                with raygrid.connect(NAME) as array:
                    array.status()
            except RaygridError as error:
                said.append(str(error))

        pid = bed.record.pid
        os.kill(pid, signal.SIGSTOP)
        try:
            threads = [threading.Thread(target=come) for _ in range(number)]
            for thread in threads:
                thread.start()
            time.sleep(seconds)
        finally:
            os.kill(pid, signal.SIGCONT)
        for thread in threads:
            thread.join(60.0)
        if said:
            raise Wrong(f"{len(said)} of {number} clients were told: {said[0]}")
        return Outcome("same", ready=(seconds,))

    number, seconds = rng.randint(100, 150), rng.uniform(0.3, 1.0)
    return [Case(f"{number} while it is stopped for {seconds:.2f} s", partial(do, number=number, seconds=seconds))]


def _rude(rng: random.Random) -> list[Case]:
    """A client that asks for what cannot be, or goes away in the middle: its connection or it alone has the trouble."""

    def bad(bed: ServiceBed, more: dict[str, object]) -> Outcome:
        with raygrid.connect(NAME) as array:
            try:
                submit(array, bed.folder / "a.npy", **more)
                raise Wrong(f"a job with {more} was taken")
            except (RaygridError, ValueError, TypeError) as error:
                said = one_line(str(error))
            array.status()  # the connection lives
            submit(array, bed.folder / "b.npy").wait()
        right(bed.folder / "b.npy")
        return Outcome("refused", said)

    def leave(bed: ServiceBed) -> Outcome:
        array = raygrid.connect(NAME)
        submit(array, bed.folder / "a.npy")
        array.close()
        with raygrid.connect(NAME) as other:
            other.wait(other.jobs(0)[-1]["job"] if other.jobs(0) else other.jobs(1)[-1]["job"])
        right(bed.folder / "a.npy")
        return Outcome("same")

    wishes: list[dict[str, object]] = [
        {"size": (0, 1)},
        {"size": (99_999, 99_999)},
        {"samples": -rng.randint(1, 99)},
        {"depth": 1000},
        {"min_weight": float("nan")},
        {"frames": (9, 3)},
    ]
    wish = rng.choice(wishes)
    return [
        Case(f"a wish that cannot be: {wish}", partial(bad, more=wish)),
        Case("a client that leaves at once", leave),
    ]


GROUPS = {
    "a crowd at the door": _idle_clients,
    "clients while it is stopped": _many_at_once,
    "clients without manners": _rude,
}
