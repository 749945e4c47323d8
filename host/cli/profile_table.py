"""Prints where each node's time went, in parts of a hundred: the table of `--profile`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypedDict

from raygrid.node.runtime import PARTS


class NodeProfile(TypedDict):
    """What is used here of the record of a node: its coordinates, and seconds by part."""

    index: list[int]
    profile: dict[str, float]


def profile_table(nodes: Iterable[NodeProfile]) -> list[str]:
    """Lines of text: a head, a line a node, one for all of them. `nodes`: records with `profile`, seconds by part."""
    rows = [(",".join(map(str, node["index"])), node["profile"]) for node in nodes]
    total = {part: sum(seconds[part] for _, seconds in rows) for part in PARTS}
    if len(rows) > 1:
        rows.append(("all", total))
    width = max(len("node"), *(len(name) for name, _ in rows))
    head = f"{'node':>{width}}{'CPU s':>8}" + "".join(f"{part:>{_wide(part)}}" for part in PARTS)
    return [head, *(_row(name.rjust(width), seconds) for name, seconds in rows)]


def _wide(part: str) -> int:
    """Columns of a part: with names of two digits an axis all of them fit a terminal of 80."""
    return max(7, len(part) + 1)


def _row(name: str, seconds: dict[str, float]) -> str:
    """Parts of the CPU seconds; waiting, which takes none, as seconds of the clock."""
    busy = sum(seconds[part] for part in PARTS if part != "wait")
    shares = "".join(
        f"{100.0 * seconds[part] / max(busy, 1e-9):{_wide(part) - 1}.1f}%" for part in PARTS if part != "wait"
    )
    return f"{name} {busy:7.3f}{shares} {seconds['wait']:{_wide('wait') - 3}.2f} s"
