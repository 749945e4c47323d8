"""The fault campaign: faults of every kind at named moments, seeded; each must end in the right bits or a clear refusal.

    python benchmarks/faults.py                            all of it
    python benchmarks/faults.py --rounds 1 --only stop     a little
    python benchmarks/faults.py --write docs/faults.md

A case is one fault, or one frame over bad links. It counts as `same` if the frame that it hit came out with the bits
of an undisturbed run, as `refused` if it ended in one line of an error that raygrid raises on purpose and the array
gave the right frame afterwards, and otherwise as `wrong`. A case that takes longer than LIMIT seconds is a hang, and
ends the campaign with a traceback of every thread. At the end nothing may be left: processes, files, descriptors.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import faults_ends
import faults_links
import faults_nodes
from faults_bed import SHAPES, Bed, Case, Leftovers, text_of

LIMIT = 120.0  # seconds that any case may take
Cases = Callable[[random.Random], list[Case]]
GROUPS: dict[str, Cases] = {**faults_nodes.GROUPS, **faults_links.GROUPS, **faults_ends.GROUPS}


@dataclass
class Row:
    """What came of the cases of one group on one shape."""

    cases: int = 0
    told: int = 0  # cases in which a fault was told; others did no harm, such as a limit that was not reached
    same: int = 0
    refused: int = 0
    wrong: list[str] = field(default_factory=list)
    noticed: list[float] = field(default_factory=list)  # seconds from the fault until it was told
    ready: list[float] = field(default_factory=list)  # seconds from there until the array was ready again


def main() -> int:
    """Run the cases; returns the exit code: 0 if none was wrong and nothing was left behind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=2, help="how often to go through all cases")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="groups whose name begins so")
    parser.add_argument("--write", type=Path, help="write the table into this file, below its line of dashes")
    options = parser.parse_args()
    faulthandler.enable()
    begun = time.monotonic()
    rows: dict[tuple[str, tuple[int, int, int]], Row] = {}
    leftovers = Leftovers()
    with tempfile.TemporaryDirectory(prefix="rgfaults-") as folder:
        for shape in SHAPES:
            with Bed(shape, Path(folder)) as bed:
                for name, cases in GROUPS.items():
                    if name.startswith(options.only):
                        row = rows[name, shape] = Row()
                        for number in range(options.rounds):
                            # the same faults on every shape and whatever is run besides
                            chosen = cases(random.Random(f"{options.seed} {name} {number}"))
                            for case in chosen:
                                run(bed, case, row)
                        say(name, shape, row)
    left = leftovers.find()
    for line in left:
        print(f"left behind: {line}")
    table = render(rows, left, options.seed, time.monotonic() - begun)
    print(table)
    if options.write is not None:
        write(options.write, table)
    return 1 if left or any(row.wrong for row in rows.values()) else 0


def run(bed: Bed, case: Case, row: Row) -> None:
    """One case."""
    faulthandler.dump_traceback_later(LIMIT, exit=True)
    try:
        outcome = bed.run(case)
    finally:
        faulthandler.cancel_dump_traceback_later()
    row.cases += 1
    row.told += bool(outcome.ready) or outcome.what == "refused"
    row.same += outcome.what == "same"
    row.refused += outcome.what == "refused"
    if outcome.what == "wrong":
        row.wrong.append(f"{case.name}: {outcome.why}")
        print(f"WRONG {text_of(bed.shape)} {case.name}: {outcome.why}", flush=True)
    row.noticed += outcome.noticed
    row.ready += outcome.ready


def say(name: str, shape: tuple[int, int, int], row: Row) -> None:
    """A line while it goes on."""
    print(
        f"{text_of(shape)} {name}: {row.cases} cases, {row.same} same, {row.refused} refused, {len(row.wrong)} wrong",
        flush=True,
    )


def render(rows: dict[tuple[str, tuple[int, int, int]], Row], left: list[str], seed: int, seconds: float) -> str:
    """The table as Markdown."""
    lines = [
        "| fault | array | cases | told | same bits | refused | wrong | told after, s | then ready after, s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (name, shape), row in rows.items():
        times = f"{spread(row.noticed)} | {spread(row.ready)}"
        lines.append(
            f"| {name} | {text_of(shape)} | {row.cases} | {row.told} | {row.same} | {row.refused} | {len(row.wrong)} | {times} |"
        )
    cases, wrong = sum(row.cases for row in rows.values()), sum(len(row.wrong) for row in rows.values())
    same, refused = sum(row.same for row in rows.values()), sum(row.refused for row in rows.values())
    told = sum(row.told for row in rows.values())
    lines += [
        f"| all | | {cases} | {told} | {same} | {refused} | {wrong} | | |",
        "",
        f"Hangs: 0. Left behind: {len(left)}. Seed {seed}, {seconds:.0f} s of wall time on {processors()} processors. "
        "Times are the median and, in brackets, the most.",
    ]
    return "\n".join(lines) + "\n"


def processors() -> int:
    """Processors of this computer that the campaign may use."""
    return len(os.sched_getaffinity(0))


def spread(values: list[float]) -> str:
    """Median and most."""
    return f"{statistics.median(values):.2f} ({max(values):.2f})" if values else ""


def write(path: Path, table: str) -> None:
    """Replace what stands below the line of dashes."""
    head, dashes, _ = path.read_text().partition("\n---\n")
    if not dashes:
        raise SystemExit(f"{path}: there is no line of dashes, wanted one above the table")
    path.write_text(f"{head}{dashes}\n{table}")


if __name__ == "__main__":
    sys.exit(main())
