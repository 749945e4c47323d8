"""Strikes at moments of wall time for the fault campaign: in frames, in increments, with a program, with the fork server stopped.

Phases are known to the host; what nodes do in between is not. So these strike when a part of the time has gone by that the
frame takes if nothing happens, whatever the array is doing then.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import time
from collections.abc import Callable
from functools import partial

from faults_bed import SMALL, Bed, Case, Frame, Outcome, Strike, judge, moving, programmed, render, right

from raygrid.node.errors import RaygridError

AHEAD = 1.15  # of a frame's time: some strikes come when it is over
FRAMES = 4  # a frame of the mobile that follows another one by an increment is one of the second to this
PROMPT = 15.0  # seconds in which an array whose fork server is stopped must be of use again
Act = Callable[[Bed], object]


def _kill(sign: signal.Signals, seed: float, part_of: float = 0.0) -> Act:
    """Some nodes, one or a part, get a signal."""

    def act(bed: Bed) -> None:
        pids = bed.array.pids
        for pid in random.Random(seed).sample(pids, max(1, int(part_of * len(pids)))):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, sign)

    return act


def _fork_server(sign: signal.Signals) -> Act:
    def act(bed: Bed) -> None:
        fork_server = bed.array._fork_server
        if fork_server is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(fork_server.pid, sign)

    return act


def _acts(rng: random.Random) -> list[tuple[str, Act]]:
    """What strikes."""
    return [
        ("SIGKILL", _kill(signal.SIGKILL, rng.random())),
        ("SIGSTOP", _kill(signal.SIGSTOP, rng.random())),
        ("SIGSEGV", _kill(signal.SIGSEGV, rng.random())),
        ("SIGKILL of half", _kill(signal.SIGKILL, rng.random(), 0.5)),
        ("SIGKILL of the fork server", _fork_server(signal.SIGKILL)),
    ]


def _at_times(rng: random.Random) -> list[Case]:
    """A frame, its loading included, struck at a moment of wall time."""

    def do(bed: Bed, part: float, act: Act) -> Outcome:
        # another picture's surfaces are held: so the frame that is struck is flooded first
        render(bed.array, moving(1))
        return bed.strike_after(part, lambda: act(bed))

    found = []
    for name, act in _acts(rng):
        part = rng.random() * AHEAD
        found.append(Case(f"{name} at {part:.3f} of a frame", partial(do, part=part, act=act)))
    return found


def _increments(rng: random.Random) -> list[Case]:
    """A frame that follows another one of its shot, struck at a moment of wall time; and the frame after it."""

    def do(bed: Bed, number: int, part: float, act: Act) -> Outcome:
        bed.seconds(moving(number))
        render(bed.array, moving(number - 1))
        outcome = bed.strike_after(part, lambda: act(bed), moving(number))
        if outcome.what == "same" and not right(render(bed.array, moving(number + 1)), bed.shape, moving(number + 1)):
            return Outcome("wrong", "the frame that follows has other bits")
        return outcome

    found = []
    for name, act in _acts(rng):
        number, part = rng.randint(2, FRAMES), rng.random() * AHEAD
        found.append(Case(f"{name} at {part:.3f} of frame {number}", partial(do, number=number, part=part, act=act)))
    return found


def _programs(rng: random.Random) -> list[Case]:
    """A frame with a program, which all nodes are told of first, struck at a moment of wall time."""

    def do(bed: Bed, part: float, act: Act) -> Outcome:
        bed.seconds(programmed())
        render(bed.array)  # the program is dropped
        return bed.strike_after(part, lambda: act(bed), programmed())

    found = []
    for name, act in _acts(rng):
        part = rng.random() * AHEAD
        found.append(Case(f"{name} at {part:.3f} of a frame with a program", partial(do, part=part, act=act)))
    return found


def _stopped_server(rng: random.Random) -> list[Case]:
    """The fork server is stopped, and a node is lost: at a moment of wall time, or while the array is idle."""

    def do(bed: Bed, part: float, frame: Frame, seed: float) -> Outcome:
        def act() -> None:
            _fork_server(signal.SIGSTOP)(bed)
            _kill(signal.SIGKILL, seed)(bed)

        begun = time.perf_counter()
        outcome = bed.strike_after(part, act, frame)
        return _prompt(outcome, time.perf_counter() - begun)

    def idle(bed: Bed, seed: float) -> Outcome:
        _fork_server(signal.SIGSTOP)(bed)
        _kill(signal.SIGKILL, seed)(bed)
        begun = time.perf_counter()
        noticed = False
        while not noticed and time.perf_counter() - begun < PROMPT:
            try:
                bed.array.check()
                time.sleep(0.02)  # as the service looks, only more often
            except RaygridError:
                noticed = True
        if not noticed:
            bed.array.reset()
            return Outcome("wrong", "an idle array did not notice a node's end")
        bed.array.reset()
        return _prompt(judge(lambda: render(bed.array), bed), time.perf_counter() - begun)

    def reset(bed: Bed) -> Outcome:
        strike = Strike("reset", 1, lambda: _fork_server(signal.SIGSTOP)(bed))
        begun = time.perf_counter()
        return _prompt(bed.strike(strike), time.perf_counter() - begun)

    part = rng.random() * AHEAD
    return [
        Case(f"and a node killed at {part:.3f} of a frame", partial(do, part=part, frame=SMALL, seed=rng.random())),
        Case("and a node killed while idle", partial(idle, seed=rng.random())),
        Case("in the reset after a node was killed", reset),
    ]


def _prompt(outcome: Outcome, seconds: float) -> Outcome:
    if outcome.what != "wrong" and seconds > PROMPT:
        return Outcome("wrong", f"it took {seconds:.1f} s, wanted at most {PROMPT:g}")
    return outcome


GROUPS = {
    "struck at moments of wall time": _at_times,
    "struck in increments": _increments,
    "struck with a program": _programs,
    "fork server stopped": _stopped_server,
}
