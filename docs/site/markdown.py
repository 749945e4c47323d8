"""Writes Markdown: text that means itself, tables, blocks of code."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

CODE = re.compile(r"(`[^`\n]+`)")


def escaped(text: str) -> str:
    """Text in which nothing but code in backticks is markup; of several lines, one."""
    parts = CODE.split(" ".join(text.split()))
    return "".join(
        part.replace("|", r"\|")
        if part.startswith("`") and len(part) > 1
        else re.sub(r"([\\*_<>|\[\]`#])", r"\\\1", part)
        for part in parts
    )


def code(text: str) -> str:
    """Code within a line, in a table too."""
    return f"`{text}`".replace("|", r"\|")


def block(lines: str, language: str = "text") -> str:
    return f"```{language}\n{lines.rstrip()}\n```"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are Markdown already."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
