"""The table of `--profile`: where each node's time went, in parts of a hundred."""

from __future__ import annotations

from typing import Any

from raygrid.node.runtime import PARTS


def profile_table(nodes: list[dict[str, Any]]) -> list[str]:
    """Lines of text: a head, a line a node, one for all of them. `nodes`: records with `profile`, seconds by part."""
    rows = [(",".join(map(str, node["index"])), node["profile"]) for node in nodes]
    total = {part: sum(seconds[part] for _, seconds in rows) for part in PARTS}
    if len(rows) > 1:
        rows.append(("all", total))
    width = max(len("node"), *(len(name) for name, _ in rows))
    head = f"{'node':>{width}}  {'CPU s':>8}" + "".join(f"{part:>9}" for part in PARTS)
    return [head, *(_row(name.rjust(width), seconds) for name, seconds in rows)]


def _row(name: str, seconds: dict[str, float]) -> str:
    """Parts of the CPU seconds; waiting, which takes none, as seconds of the clock."""
    busy = sum(seconds[part] for part in PARTS if part != "wait")
    shares = "".join(f"{100.0 * seconds[part] / max(busy, 1e-9):8.1f}%" for part in PARTS if part != "wait")
    return f"{name}  {busy:8.3f}{shares}{seconds['wait']:7.2f} s"
