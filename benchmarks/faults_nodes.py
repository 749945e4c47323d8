"""Faults of processes for the campaign: nodes and the nursery killed, stopped, starved of memory or descriptors."""

from __future__ import annotations

import os
import random
import resource
import signal
from collections.abc import Callable

from faults_bed import MOMENTS, Bed, Case, Outcome, Strike

from raygrid.node.messages import MessageKind


def _strike(name: str, moment: str, nth: int, act: Callable[[Bed], object]) -> Case:
    return Case(f"{name} at {moment} {nth}", lambda bed: bed.strike(Strike(moment, nth, lambda: act(bed))))


def _signals(name: str, sign: signal.Signals, how_many: Callable[[int], int]) -> Callable[[random.Random], list[Case]]:
    """Some nodes get a signal, once at each moment."""

    def cases(rng: random.Random) -> list[Case]:
        found = []
        for moment in MOMENTS:
            seed, nth = rng.random(), rng.randint(1, 6)

            def act(bed: Bed, seed: float = seed) -> None:
                chosen = random.Random(seed).sample(bed.array.pids, how_many(len(bed.array.pids)))
                for pid in chosen:
                    _send(pid, sign)

            found.append(_strike(name, moment, nth, act))
        return found

    return cases


def _send(pid: int, sign: signal.Signals) -> None:
    try:
        os.kill(pid, sign)
    except ProcessLookupError:  # it was killed a moment ago, by the fault that this one is to disturb the reset of
        return


def _nursery(rng: random.Random) -> list[Case]:
    def act(bed: Bed) -> None:
        nursery = bed.array._nursery
        assert nursery is not None
        os.kill(nursery.pid, signal.SIGKILL)

    return [_strike("nursery killed", rng.choice(MOMENTS[:4]), rng.randint(1, 4), act)]


def _limit(name: str, which: int, value: Callable[[int], int]) -> Callable[[random.Random], list[Case]]:
    """A node gets a limit of the kernel's, which is taken from it after the frame if it still lives."""

    def do(bed: Bed, moment: str, nth: int, number: int) -> Outcome:
        pid = bed.array.pids[number]
        _, hard = resource.prlimit(pid, which)

        def act() -> None:
            resource.prlimit(pid, which, (value(pid), hard))

        outcome = bed.strike(Strike(moment, nth, act))
        if pid in bed.array.pids:
            resource.prlimit(pid, which, (hard, hard))
        return outcome

    def cases(rng: random.Random) -> list[Case]:
        found = []
        for moment in ("idle", "load", "trace"):
            number, nth = rng.randrange(8), rng.randint(1, 4)
            found.append(
                Case(
                    f"{name} at {moment} {nth}",
                    lambda bed, moment=moment, nth=nth, number=number: do(bed, moment, nth, number),
                )
            )
        return found

    return cases


def _memory_of(pid: int) -> int:
    with open(f"/proc/{pid}/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


def _descriptors_of(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))


def _rubbish(rng: random.Random) -> list[Case]:
    """The host itself sends to a corner what it must not."""

    def act(bed: Bed, corner: int, kind: MessageKind, payload: bytes) -> None:
        links = bed.array.driver.links
        link = links[sorted(links)[corner % len(links)]]
        link._send_now(kind, len(payload) % 7, payload)

    found = []
    for moment in ("idle", "trace", "collect"):
        corner, kind = rng.randrange(8), rng.choice(list(MessageKind))
        payload = rng.randbytes(rng.choice((0, 1, 25, 400)))
        found.append(
            _strike(
                f"{kind.name} of {len(payload)} bytes from the host",
                moment,
                rng.randint(1, 4),
                lambda bed, corner=corner, kind=kind, payload=payload: act(bed, corner, kind, payload),
            )
        )
    return found


def _deaf(rng: random.Random) -> list[Case]:
    """Stopped while it is told to begin anew: the reset kills it."""

    def do(bed: Bed) -> Outcome:
        pid = bed.array.pids[rng.randrange(len(bed.array.pids))]
        os.kill(pid, signal.SIGSTOP)
        bed.array.reset()
        return Outcome("same") if pid not in bed.array.pids else Outcome("wrong", "the stopped node is still there")

    return [Case("reset of an idle array with a stopped node", do)]


GROUPS = {
    "one node killed": _signals("SIGKILL", signal.SIGKILL, lambda nodes: 1),
    "one node stopped": _signals("SIGSTOP", signal.SIGSTOP, lambda nodes: 1),
    "one node crashed": _signals("SIGSEGV", signal.SIGSEGV, lambda nodes: 1),
    "half of the nodes killed": _signals("SIGKILL of half", signal.SIGKILL, lambda nodes: nodes // 2),
    "all nodes stopped": _signals("SIGSTOP of all", signal.SIGSTOP, lambda nodes: nodes),
    "stopped and reset": _deaf,
    "nursery killed": _nursery,
    "memory of a node limited": _limit("RLIMIT_AS", resource.RLIMIT_AS, _memory_of),
    "descriptors of a node used up": _limit("RLIMIT_NOFILE", resource.RLIMIT_NOFILE, _descriptors_of),
    "rubbish on a corner link": _rubbish,
}
