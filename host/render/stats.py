"""What the machine did for a frame, as a map ready for JSON. Documented in docs/stats.md."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from raygrid.emulator.driver import Driver, Progress
from raygrid.host.image.outputs import write_whole
from raygrid.host.render.machine_job import Job
from raygrid.node.links import why_python
from raygrid.node.protocol import PacketKind
from raygrid.node.tracing import UNIT

VERSION = 1


def make_stats(job: Job, driver: Driver, progress: Progress, seconds: dict[str, float]) -> dict[str, Any]:
    """Totals over the array, a record a node, and wall seconds a phase."""
    nodes = driver.report()
    frame = job.frame
    busy = [node["busy_seconds"] for node in nodes]
    total = {
        "born": _sum_kinds(nodes, "born"),
        "died": _sum_kinds(nodes, "died"),
        "hops": sum(sum(node["sent"]) for node in nodes),
        "messages": sum(node["messages"] for node in nodes),
        "bytes": sum(node["bytes"] for node in nodes),
        "walks": sum(node["walks"] for node in nodes),
        "tests": _sum_kinds(nodes, "tests"),
        "boxes": sum(node["boxes"] for node in nodes),
        "hits": sum(node["hits"] for node in nodes),
    }
    stats = {
        "version": VERSION,
        "scene": job.scene.name,
        "frame": job.number,
        "program": None if job.settings.program is None else job.settings.program.name,
        "surfaces": len(job.surfaces),
        "array": list(driver.shape),
        "split": job.settings.split,
        "planes": [job.space.planes[axis, : driver.shape[axis] + 1].tolist() for axis in range(3)],
        "size": [frame.width, frame.height],
        "samples": frame.samples,
        "depth": frame.depth,
        "unit": int(UNIT),
        "total": total,
        "links": served_by([node["served_by"] for node in nodes]),
        "waves": driver.waves,
        "most_in_flight": driver.most_in_flight,
        "balance": max(busy) / float(np.mean(busy)) if sum(busy) > 0.0 else 1.0,
        "wall_seconds": {phase: round(spent, 6) for phase, spent in seconds.items()},
        "nodes": nodes,
    }
    if "machine" in nodes[0]:
        stats["ticks"] = max(node["machine"]["ended_tick"] for node in nodes)
    return stats


def served_by(ways: list[str]) -> dict[str, Any]:
    """What serves the links of nodes while they trace, compiled code or Python alone, and why it is Python."""
    if all(way == "compiled" for way in ways):
        return {"served_by": "compiled", "why": None}
    return {
        "served_by": "python",
        "why": why_python() or "links with faults, of an array that keeps time, or in memory",
    }


def _sum_kinds(nodes: list[dict[str, Any]], name: str) -> dict[str, int]:
    return {kind: sum(node[name][kind] for node in nodes) for kind in nodes[0][name]}


def ray_counts(stats: dict[str, Any]) -> dict[str, int]:
    """Rays by kind (primary, reflected, refracted, shadow), for a line of summary."""
    kinds = (PacketKind.PRIMARY, PacketKind.REFLECTED, PacketKind.REFRACTED, PacketKind.SHADOW)
    return {kind.name.lower(): stats["total"]["born"][kind.name.lower()] for kind in kinds}


def save_stats(path: str | Path, stats: dict[str, Any]) -> None:
    """Write as JSON: a line for each key, in `nodes` a line for each node. Raises OutputError."""
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in stats.items() if key != "nodes"]
    nodes = ",\n".join(f"  {json.dumps(node)}" for node in stats["nodes"])
    text = "{\n" + ",\n".join([*lines, f' "nodes": [\n{nodes}\n ]']) + "\n}\n"
    write_whole(path, lambda file: file.writelines([text.encode()]))
