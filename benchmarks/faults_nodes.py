"""Faults of processes for the campaign: nodes and the fork server killed, stopped, starved of memory or descriptors."""

from __future__ import annotations

import os
import random
import resource
import signal
import time
from collections.abc import Callable
from functools import partial

from faults_bed import LARGE, MOMENTS, Bed, Case, Outcome, Strike, judge, render, right

from raygrid.node.protocol.messages import MessageKind

# Descriptors: with 8 a node can wait for those that it has, but open no socket. With 3 the kernel refuses to let it
# wait for more than 3 at once as well, and ZeroMQ gives up.
FEW_DESCRIPTORS = (3, 8)
NO_DESCRIPTORS = ("exit code 1: ZMQError: Too many open files", "signal SIGABRT: Invalid argument (src/")
LITTLE_ROOM = 1 << 16  # bytes; the arrays that the large frame needs are larger


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


def _fork_server(rng: random.Random) -> list[Case]:
    def act(bed: Bed) -> None:
        fork_server = bed.array._fork_server
        assert fork_server is not None
        os.kill(fork_server.pid, signal.SIGKILL)

    return [_strike("fork server killed", rng.choice(MOMENTS[:4]), rng.randint(1, 4), act)]


def _memory(rng: random.Random) -> list[Case]:
    """A node can get no more memory, or little, in a frame for which it needs much more than it has.

    Not an old node: what it was given for earlier frames is not taken from it, so it would not notice. One that was
    just forked gets no more at all, and its libraries need some of their own; one that has rendered a small frame since
    then gets a little more, so that arrays find none.
    """

    def do(bed: Bed, moment: str, used: bool, number: int) -> Outcome:
        os.kill(bed.array.pids[number], signal.SIGKILL)
        bed.array.reset()
        if used and not right(render(bed.array), bed.shape):
            return Outcome("wrong", "the frame before it has other bits")
        pid = bed.array.pids[number]
        _, hard = resource.prlimit(pid, resource.RLIMIT_AS)

        def act() -> None:
            limit = _memory_of(pid) + LITTLE_ROOM if used else _memory_of(pid) // 2
            resource.prlimit(pid, resource.RLIMIT_AS, (limit, hard))

        outcome = bed.strike(Strike(moment, 1, act), LARGE)
        if pid in bed.array.pids:
            resource.prlimit(pid, resource.RLIMIT_AS, (hard, hard))
        return outcome

    found = []
    for moment in ("idle", "load", "trace"):
        for used in (False, True):
            name = f"RLIMIT_AS of a {'used' if used else 'new'} node at {moment}"
            found.append(Case(name, partial(do, moment=moment, used=used, number=rng.randrange(8))))
    return found


def _memory_of(pid: int) -> int:
    with open(f"/proc/{pid}/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


def _descriptors(rng: random.Random) -> list[Case]:
    """A node can open no more descriptors when a reset asks it for new links: it ends, says why, and is forked anew."""

    def do(bed: Bed, moment: str, limit: int, number: int) -> Outcome:
        pid, other = bed.array.pids[number], bed.array.pids[number - 1]

        def act() -> None:
            resource.prlimit(pid, resource.RLIMIT_NOFILE, (limit, limit))
            if moment in ("load", "trace"):  # at the moment "reset" a node was killed before
                os.kill(other, signal.SIGKILL)

        outcome = _idle(bed, act) if moment == "idle" else bed.strike(Strike(moment, 1, act))
        if outcome.what == "wrong":
            return outcome
        if pid in bed.array.pids:
            return Outcome("wrong", "the node went through a reset without descriptors")
        words = [f"(pid {pid}) ended: {why}" for why in NO_DESCRIPTORS]
        if not any(word in fault for word in words for fault in bed.faults):
            return Outcome("wrong", f"nobody said why the node ended: {bed.faults}")
        return outcome

    found = []
    for moment in ("idle", "load", "trace", "reset"):
        for limit in FEW_DESCRIPTORS:
            number = rng.randrange(7)  # not the last one, which is killed for the moment "reset"
            found.append(
                Case(f"RLIMIT_NOFILE of {limit} at {moment}", partial(do, moment=moment, limit=limit, number=number))
            )
    return found


def _idle(bed: Bed, act: Callable[[], None]) -> Outcome:
    """Strike an array that does nothing, and reset it: what was lost is told by the array itself."""
    act()
    begun = time.perf_counter()
    bed.array.reset()
    ready = time.perf_counter() - begun
    bed.faults[:] = bed.array.lost_nodes
    outcome = judge(lambda: render(bed.array), bed)
    return Outcome(outcome.what, outcome.why, ready=(ready,))


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
    "fork server killed": _fork_server,
    "memory of a node limited": _memory,
    "descriptors of a node used up": _descriptors,
    "rubbish on a corner link": _rubbish,
}
