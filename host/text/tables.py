"""Writes tables, counts and spans of time as text."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Sequence


def table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Align a table, as lines: columns to the left, two blanks between them."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]) - 1)]
    return [
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]]) for row in rows
    ]


def folded(text: str, width: int | None = None) -> str:
    """Fold text for a terminal, which would break its lines within words: what is too long goes on, set in, on the next line.

    Words that are longer than a line, such as paths, stay whole. `width`: columns, None: of the terminal
    """
    columns = width or shutil.get_terminal_size().columns
    return "\n".join(line if len(line) <= columns else _folded(line, columns) for line in text.split("\n"))


def _folded(line: str, columns: int) -> str:
    indent = line[: len(line) - len(line.lstrip())]
    return "\n".join(wrapped(line.lstrip(), columns, indent, indent + "  "))


def wrapped(text: str, columns: int, first: str, others: str) -> list[str]:
    """Break text into lines that begin so; words that are longer than a line, such as paths, stay whole."""
    whole = textwrap.TextWrapper(columns, first, others, break_long_words=False, break_on_hyphens=False)
    return whole.wrap(text)


def count_of(number: int, noun: str) -> str:
    """Count a noun: 1 job, 2 jobs."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def bytes_of(number: int) -> str:
    """Write bytes with their unit."""
    return f"{number / 1e9:.1f} GB" if number >= 10**9 else f"{number / 1e6:.1f} MB"


def span(seconds: float) -> str:
    """Write a span of time: 5 s, 3 min 05 s, 4 h 24 min, 3 days 4 h."""
    minutes, left = divmod(round(max(0.0, seconds)), 60)
    if minutes < 60:
        return f"{minutes} min {left:02} s" if minutes else f"{left} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02} min" if hours < 48 else f"{hours // 24} days {hours % 24} h"
