"""The table of the fault campaign: rows, what an interrupted run keeps of them, and their Markdown."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import statistics
from dataclasses import asdict, dataclass, field
from pathlib import Path

from faults_bed import Outcome

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "build" / "faults.jsonl"


@dataclass
class Row:
    """What came of the cases of one kind on one stage."""

    name: str
    where: str
    cases: int = 0
    told: int = 0  # cases in which a fault was told; others did no harm, such as a limit that was not reached
    same: int = 0
    refused: int = 0
    wrong: list[str] = field(default_factory=list)
    hangs: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    noticed: list[float] = field(default_factory=list)  # seconds from the fault until it was told
    ready: list[float] = field(default_factory=list)  # seconds from there until it was made good

    def count(self, outcome: Outcome, words: str) -> None:
        """One case more."""
        self.cases += 1
        self.told += bool(outcome.ready) or outcome.what == "refused"
        self.same += outcome.what == "same"
        self.refused += outcome.what == "refused"
        self.wrong += [words] * (outcome.what == "wrong")
        self.hangs += [words] * (outcome.what == "hang")
        self.noticed += outcome.noticed
        self.ready += outcome.ready


class Kept:
    """The rows of a run, on disk as soon as each is done, if `on_disk`.

    rows  in the order in which they were done
    """

    def __init__(self, seed: int, rounds: int, on_disk: bool) -> None:
        self.seed, self.rounds, self._on_disk = seed, rounds, on_disk
        self._mark = f"{seed} {rounds} {sources()}"
        self.rows: list[Row] = []
        self.left: list[str] = []
        if on_disk:
            self._read()

    def _read(self) -> None:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            for line in KEPT.read_text().splitlines():
                facts = json.loads(line)
                if facts.pop("mark") != self._mark:
                    continue
                if "left" in facts and "name" not in facts:
                    self.left.append(facts["left"])
                else:
                    self.rows.append(Row(**facts))
        if self.rows:
            print(f"{len(self.rows)} kinds were done by a run before ({KEPT})", flush=True)

    def has(self, name: str, where: str) -> bool:
        """Whether that kind is done."""
        return any((row.name, row.where) == (name, where) for row in self.rows)

    def begin(self, row: Row) -> None:
        """A row is under way: what it has so far is shown."""
        self.rows.append(row)

    def keep(self, row: Row) -> None:
        """A row is done."""
        self._append(asdict(row))

    def leave(self, line: str) -> None:
        """Something was left behind by a whole stage."""
        self.left.append(line)
        self._append({"left": line})

    def _append(self, facts: dict[str, object]) -> None:
        if self._on_disk:
            KEPT.parent.mkdir(exist_ok=True)
            with KEPT.open("a") as file:
                file.write(json.dumps({"mark": self._mark, **facts}) + "\n")

    def forget(self) -> None:
        """The next run begins at the beginning."""
        if self._on_disk:
            KEPT.unlink(missing_ok=True)

    @property
    def good(self) -> bool:
        """Whether nothing was wrong, hung or was left behind."""
        return not self.left and not any(row.wrong or row.hangs or row.left for row in self.rows)


def sources() -> str:
    """A digest of what is tried and of what tries it."""
    state = hashlib.sha256()
    for folder in ("node", "emulator", "host", "benchmarks"):
        pattern = "faults*.py" if folder == "benchmarks" else "**/*.py"
        for path in sorted((ROOT / folder).glob(pattern)):
            state.update(path.name.encode() + b"\0" + path.read_bytes())
    return state.hexdigest()[:16]


def render(kept: Kept, seconds: float, unfinished: bool = False) -> str:
    """The table as Markdown."""
    lines = [
        "| fault | on | cases | told | same bits | refused | wrong | hangs | left | told after, s | then ready after, s |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in kept.rows:
        counts = (row.cases, row.told, row.same, row.refused, len(row.wrong), len(row.hangs), len(row.left))
        cells = [row.name, row.where, *map(str, counts), spread(row.noticed), spread(row.ready)]
        lines.append(f"| {' | '.join(cells)} |")
    sums = [sum(len(what) if isinstance(what, list) else what for what in column) for column in _columns(kept)]
    lines += [
        f"| all | | {' | '.join(map(str, sums))} | | |",
        "",
        f"Seed {kept.seed}, {seconds:.0f} s of wall time on {processors()} processors. Left behind at the end of a stage: "
        f"{len(kept.left)}. Times are the median and, in brackets, the most.",
    ]
    if unfinished:
        lines += ["", "**The run is not finished**: kinds are missing."]
    return "\n".join(lines) + "\n"


def _columns(kept: Kept) -> list[list[int | list[str]]]:
    names = ("cases", "told", "same", "refused", "wrong", "hangs", "left")
    return [[getattr(row, name) for row in kept.rows] for name in names]


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
