"""The fault campaign: faults of every kind at seeded moments; each must end in the right bits or a clear refusal.

    python benchmarks/faults.py                                        all of it
    python benchmarks/faults.py --rounds 1 --only stop                 a little: kinds whose name begins so
    python benchmarks/faults.py --seed 1 --only journal --case "of 40" one case again, by its name
    python benchmarks/faults.py --write docs/faults.md                 and write the table, as `make faults` does

A case is one fault, or one frame over bad links. It counts as `same` if what it hit came out with the bits of an
undisturbed run, as `refused` if it ended in one line of an error that raygrid raises on purpose and the right frame came
afterwards, as `hang` if it took longer than LIMIT seconds, and otherwise as `wrong`. After each kind, and at the end,
nothing may be left: processes, files, sockets, descriptors, threads.

With --write each kind is kept in a file under build/ as soon as it has run, and the table is written anew: a run that was
interrupted goes on where it was, as long as the seed, the rounds and the sources are the same (--fresh: from the beginning).
"""

from __future__ import annotations

import argparse
import faulthandler
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from faults_bed import Case, Outcome, warm
from faults_kinds import STAGES, Stage
from faults_rest import Leftovers, own_places
from faults_table import Kept, Row, render, write

LIMIT = 120.0  # seconds that any case may take
DUMP_AFTER = 60.0  # seconds after that in which even the end of a case did not come: the campaign ends with a traceback


class Hang(BaseException):
    """A case took longer than LIMIT."""


def main() -> int:
    """Run the cases; returns the exit code: 0 if none was wrong, none hung and nothing was left behind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=2, help="how often to go through all cases")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", action="append", metavar="KIND", help="kinds whose name begins so; may be repeated")
    parser.add_argument("--on", default="", metavar="WHERE", help="only on what is called so, such as 2x2x2 or service")
    parser.add_argument("--case", default="", metavar="TEXT", help="only cases with this in their name")
    parser.add_argument(
        "--share", type=int, default=0, metavar="N", help="at most N cases of each kind, chosen by the seed"
    )
    parser.add_argument("--write", type=Path, help="write the table into this file, below its line of dashes")
    parser.add_argument("--fresh", action="store_true", help="take nothing from a run that was interrupted")
    options = parser.parse_args()
    faulthandler.enable()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # and leave nothing behind
    begun = time.monotonic()
    kept = Kept(options.seed, options.rounds, _is_whole(options))
    if options.fresh:
        kept.forget()
    warm()
    with tempfile.TemporaryDirectory(prefix="rgf-") as folder, own_places(Path(folder)):
        for stage in STAGES:
            run_stage(stage, Path(folder), options, kept, begun)
    table = render(kept, time.monotonic() - begun)
    print(table)
    if options.write is not None:
        write(options.write, table)
        kept.forget()
    return 0 if kept.good else 1


def _is_whole(options: Any) -> bool:
    """Whether all of it is to be run, and written."""
    return options.write is not None and not (options.only or options.on or options.case or options.share)


def run_stage(stage: Stage, folder: Path, options: Any, kept: Kept, begun: float) -> None:
    """All kinds of one stage that are wanted and not done yet."""
    kinds = {
        name: cases
        for name, cases in stage.kinds.items()
        if name.startswith(tuple(options.only or [""]))
        and stage.name.startswith(options.on)
        and not kept.has(name, stage.name)
    }
    why = stage.cannot() if kinds else ""
    if not kinds or why:
        if why:
            print(f"{stage.name}: not run: {why}", flush=True)
        return
    leftovers = Leftovers(folder)
    with ExitStack() as stack:
        bed = stack.enter_context(stage.make(folder))
        for name, cases in kinds.items():
            row = Row(name, stage.name)
            kept.begin(row)
            for number in range(options.rounds):
                # the same faults on every stage and whatever is run besides
                for case in chosen(cases(random.Random(f"{options.seed} {name} {number}")), options):
                    run(bed, case, row)
            row.left += bed.left()
            say(row)
            kept.keep(row)
            if options.write is not None:
                write(options.write, render(kept, time.monotonic() - begun, unfinished=True))
    for line in leftovers.find():
        print(f"left behind by {stage.name}: {line}", flush=True)
        kept.leave(f"{stage.name}: {line}")


def chosen(cases: list[Case], options: Any) -> list[Case]:
    """Those that are wanted of a round."""
    found = [case for case in cases if options.case in case.name]
    if options.share and len(found) > options.share:
        return random.Random(options.seed).sample(found, options.share)
    return found


@contextmanager
def limited() -> Iterator[None]:
    """Raises Hang in the block when its time is over; when even that does not help, ends with all tracebacks."""

    def late(*_: Any) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, late)
    faulthandler.dump_traceback_later(LIMIT + DUMP_AFTER, exit=True)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGALRM, before)


def run(bed: Any, case: Case, row: Row) -> None:
    """One case."""
    begun = time.monotonic()
    try:
        with limited():
            outcome = bed.run(case)
    except Hang:
        outcome = Outcome("hang", f"not over within {LIMIT:g} s")
        with limited():
            bed.renew()
    row.count(outcome, f"{case.name}: {outcome.why}")
    if outcome.what in ("wrong", "hang"):
        print(f"{outcome.what.upper()} {row.where}, {row.name}: {case.name}: {outcome.why}", flush=True)
    elif time.monotonic() - begun > 10.0:
        print(f"{row.where}, {row.name}: {case.name}: {time.monotonic() - begun:.1f} s", flush=True)


def say(row: Row) -> None:
    """A line while it goes on."""
    bad = f"{len(row.wrong)} wrong, {len(row.hangs)} hangs, {len(row.left)} left"
    print(f"{row.where} {row.name}: {row.cases} cases, {row.same} same, {row.refused} refused, {bad}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
