"""Medians, ratios and Markdown: what the figures of the suite become. No measuring, no processes."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

MARK = "<!-- From here on written by benchmarks/bench.py; what stands above this line is kept. -->"
TITLE = "# Performance"  # of a file that has none yet


@dataclass(frozen=True)
class Spread:
    """Repeated measurements of one thing; printed as `median (least - most)`."""

    values: tuple[float, ...]

    @property
    def median(self) -> float:
        """The median."""
        return statistics.median(self.values)

    def __str__(self) -> str:
        if len(self.values) == 1:
            return number(self.values[0])
        return f"{number(self.median)} ({number(min(self.values))} - {number(max(self.values))})"


@dataclass(frozen=True)
class Target:
    """Something that was promised: what, how much was wanted, what came, and whether that is enough."""

    what: str
    wanted: str
    came: str
    met: bool


@dataclass
class Table:
    """Rows under a heading. Each row is as long as `columns`."""

    columns: Sequence[str]
    rows: list[list[str]] = field(default_factory=list)

    def add(self, *cells: object) -> None:
        """Add a row. Raises ValueError if it does not fit."""
        if len(cells) != len(self.columns):
            raise ValueError(f"a row has {len(cells)} cells, wanted {len(self.columns)} ({', '.join(self.columns)})")
        self.rows.append([str(cell) for cell in cells])

    def lines(self) -> list[str]:
        """Markdown."""
        rule = ["---"] * len(self.columns)
        escaped = [[cell.replace("|", "\\|") for cell in row] for row in (self.columns, rule, *self.rows)]
        return ["| " + " | ".join(row) + " |" for row in escaped]


@dataclass
class Section:
    """One part of the suite: text, tables and targets in the order in which they are to be read."""

    title: str
    parts: list[str | Table] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Add a paragraph."""
        self.parts.append(text)

    def table(self, *columns: str) -> Table:
        """Add an empty table and return it."""
        made = Table(columns)
        self.parts.append(made)
        return made

    def expect(self, what: str, value: float, wanted: float, at_most: bool, unit: str = "") -> None:
        """Compare a figure with what was promised. A figure that is not there (NaN) is left out."""
        if math.isnan(value):
            return
        met = value <= wanted if at_most else value >= wanted
        sign = "at most" if at_most else "at least"
        self.targets.append(Target(what, f"{sign} {number(wanted)}{unit}", f"{number(value)}{unit}", met))

    def lines(self) -> list[str]:
        """Markdown."""
        out = [f"## {self.title}", ""]
        for part in self.parts:
            out += [*(part.lines() if isinstance(part, Table) else [part]), ""]
        return out


def number(value: float) -> str:
    """Three significant digits, without an exponent."""
    if math.isnan(value):
        return "-"
    if value == 0.0 or math.isinf(value):
        return f"{value:g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"


def spread(values: Iterable[float]) -> Spread:
    """Raises ValueError if there is none."""
    kept = tuple(values)
    if not kept:
        raise ValueError("no measurements came, wanted at least one")
    return Spread(kept)


def ratio(of: Spread, over: Spread) -> float:
    """The ratio of two medians; NaN if the second is 0."""
    return of.median / over.median if over.median else math.nan


def geometric_mean(ratios: Iterable[float]) -> float:
    """NaN if there is none."""
    kept = [value for value in ratios if value > 0.0]
    return math.exp(statistics.fmean(math.log(value) for value in kept)) if kept else math.nan


def document(head: Sequence[str], sections: Sequence[Section]) -> str:
    """All of it, the targets first."""
    targets = [target for section in sections for target in section.targets]
    out = [MARK, "", *head, ""]
    if targets:
        table = Table(("what", "wanted", "measured", "met"))
        for target in targets:
            table.add(target.what, target.wanted, target.came, "yes" if target.met else "NO")
        out += ["## Targets", "", *table.lines(), ""]
    for section in sections:
        out += section.lines()
    return "\n".join(out).rstrip() + "\n"


def with_head_kept(old: str, new: str) -> str:
    """The new document below what stands above the mark in the old one, or else below a title."""
    above, found, _ = old.partition(MARK)
    return (above if found else f"{TITLE}\n\n") + new
