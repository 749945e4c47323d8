"""Derives the statistics of a simulated frame: a map for JSON, and a row a node for CSV. See docs/machine-time.md."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from raygrid.emulator.simulator import LINKS, SERVICES, WAITS, Phase
from raygrid.emulator.topology import indices
from raygrid.host.image.outputs import write_whole
from raygrid.host.machine_time.cost_models import LEVELS
from raygrid.host.machine_time.simulate import Simulated
from raygrid.node.geometry import PORTS, SURFACE_KINDS, Kind
from raygrid.node.protocol import BORN, BOXES, DIED, HITS, SENT, TESTS, WALKS, PacketKind
from raygrid.node.tracing import UNIT

VERSION = 1
PORT_NAMES = ("-x", "+x", "-y", "+y", "-z", "+z")
MOST_NODES = 4096  # of which each has a record in the JSON
CURVE = 256  # points of what is told over time

Stats = dict[str, Any]  # as docs/machine-time.md has it


def make_stats(done: Simulated) -> Stats:
    """The map of docs/machine-time.md."""
    job, phase, cost = done.job, done.frames["middle"], done.cost
    frame, shape = job.frame, job.space.shape
    stats: Stats = {
        "version": VERSION,
        "scene": job.scene.name,
        "frame": job.number,
        "surfaces": len(job.surfaces),
        "array": list(shape),
        "split": job.settings.split,
        "planes": [job.space.planes[axis, : shape[axis] + 1].tolist() for axis in range(3)],
        "size": [frame.width, frame.height],
        "samples": frame.samples,
        "depth": frame.depth,
        "unit": int(UNIT),
        "cost": {
            "name": cost.name,
            "about": cost.file.about,
            "hertz": cost.file.hertz,
            "search": done.search,
            "moves": cost.file.link.moves,
        },
        "ticks": phase.ticks,
        "seconds": cost.seconds(phase.ticks),
        "trace": phase.trace,
        "band": {level: _times(done, level) for level in LEVELS if level in done.frames},
        "total": _total(phase, done),
        "shares": _shares(done),
        "queue": {
            "most": int(phase.column("most_waiting").max()),
            "mean": float(phase.column("waited").sum() / max(phase.ticks, 1) / len(phase.nodes)),
            "mean_wait_ticks": float(phase.column("waited").sum() / max(int(phase.column("served").sum()), 1)),
        },
        "busiest": _busiest(done),
        "balance": float(phase.column("busy").max() / max(phase.column("busy").mean(), 1e-9)),
        "hops": _hops(phase),
        "links": _links(done),
        "over_time": _over_time(phase),
        "simulator": {"events": phase.events, "packets_room": phase.most_packets},
        "wall_seconds": {name: round(spent, 6) for name, spent in done.seconds.items()},
    }
    if len(phase.nodes) <= MOST_NODES:
        stats["nodes"] = list(records(done))
    return stats


def _times(done: Simulated, level: str) -> Stats:
    """Ticks and seconds of the phases, for one level of cost."""
    found: Stats = {"frame": done.frames[level].ticks}
    if level in done.floods:
        found |= {"set_up": done.floods[level].ticks, "read_out": done.read_outs[level].host}
    return {"ticks": found, "seconds": {name: done.cost.seconds(ticks) for name, ticks in found.items()}}


def _total(phase: Phase, done: Simulated) -> Stats:
    counts = phase.total
    tests = counts[TESTS : TESTS + len(Kind)]
    if done.search == "list":  # every walk tests all that the node holds
        tests = phase.column("walked") @ done.model.holding.held
    return {
        "born": {kind.name.lower(): int(counts[BORN + kind]) for kind in PacketKind},
        "died": {kind.name.lower(): int(counts[DIED + kind]) for kind in PacketKind},
        "hops": int(counts[SENT : SENT + PORTS].sum()),
        "walks": int(counts[WALKS]),
        "tests": {kind.name.lower(): int(tests[kind]) if kind < len(tests) else 0 for kind in SURFACE_KINDS},
        "boxes": int(counts[BOXES]) if done.search == "tree" else 0,
        "hits": int(counts[HITS]),
    }


def _shares(done: Simulated) -> dict[str, float]:
    """How all nodes spend the time of the frame: working, moving bytes, waiting; and how busy the links are."""
    phase = done.frames["middle"]
    prices = done.cost.prices("middle", done.search)
    whole = max(phase.ticks, 1) * len(phase.nodes)
    moving = int(phase.nodes["sent"][:, :PORTS].sum()) * prices.transmit
    busy = int(phase.column("busy").sum())
    by_processor = moving if prices.by_processor else 0
    links = max(links_of(done), 1)
    return {
        "working": (busy - by_processor) / whole,
        "sending": by_processor / whole,
        "waiting": 1.0 - busy / whole,
        "links": moving / (max(phase.ticks, 1) * links),
    }


def links_of(done: Simulated) -> int:
    """Directed links between neighbours."""
    x, y, z = done.job.space.shape
    return 2 * ((x - 1) * y * z + x * (y - 1) * z + x * y * (z - 1))


def _busiest(done: Simulated) -> Stats:
    """The node that works longest: its place, ticks, and the part of the frame that these are."""
    phase = done.frames["middle"]
    busy = phase.column("busy")
    node = int(busy.argmax())
    return {"node": _index(done, node), "ticks": int(busy[node]), "share": float(busy[node] / max(phase.ticks, 1))}


def _hops(phase: Phase) -> dict[str, list[int]]:
    """Of each kind that died: how many after 0, 1, 2 ... hops."""
    return {
        kind.name.lower(): np.trim_zeros(phase.hops[kind], "b").tolist()
        for kind in PacketKind
        if phase.hops[kind].any()
    }


def _links(done: Simulated) -> Stats:
    """Packets on the busiest link, and of all links of each port together."""
    sent = done.frames["middle"].nodes["sent"][:, :PORTS]
    node, port = np.unravel_index(int(sent.argmax()), sent.shape)
    return {
        "busiest": {"node": _index(done, int(node)), "port": PORT_NAMES[int(port)], "packets": int(sent.max())},
        "mean_packets": float(sent.sum() / max(links_of(done), 1)),
        "by_port": {name: int(sent[:, port].sum()) for port, name in enumerate(PORT_NAMES)},
    }


def _index(done: Simulated, node: int) -> list[int]:
    nx, ny, _ = done.job.space.shape
    return [node % nx, node // nx % ny, node // (nx * ny)]


def _over_time(phase: Phase) -> Stats:
    """Packets that wait, nodes that serve, packets on links, at regular ticks."""
    bins = phase.ticks // phase.bin_ticks + 1
    step = -(-bins // CURVE)
    rows = phase.levels[:, :bins:step]
    return {
        "ticks": phase.bin_ticks * step,
        "waiting": rows[WAITS].tolist(),
        "serving": rows[SERVICES].tolist(),
        "on_links": rows[LINKS].tolist(),
    }


def records(done: Simulated) -> Iterator[dict[str, int]]:
    """A flat map for each node, x fastest."""
    phase = done.frames["middle"]
    for node, index in enumerate(indices(done.job.space.shape)):
        row = phase.nodes[node]
        yield {
            **dict(zip("xyz", index, strict=True)),
            "surfaces": int(done.model.holding.held[node].sum()),
            "samples": int(done.model.borders[node + 1] - done.model.borders[node]),
            "served": int(row["served"]),
            "walks": int(row["walked"]),
            "busy_ticks": int(row["busy"]),
            "waited_ticks": int(row["waited"]),
            "most_waiting": int(row["most_waiting"]),
            "ended_tick": int(row["ended"]),
            **{f"sent{name}": int(row["sent"][port]) for port, name in enumerate(PORT_NAMES)},
        }


def save_csv(path: str | Path, done: Simulated) -> None:
    """Write a row a node, one after the other: a large array has millions. Raises OutputError."""

    def write(file: BinaryIO) -> None:
        text = io.TextIOWrapper(file, encoding="ascii", newline="")
        rows = iter(records(done))
        first = next(rows)
        writer = csv.DictWriter(text, list(first), lineterminator="\n")
        writer.writeheader()
        writer.writerow(first)
        writer.writerows(rows)
        text.flush()
        text.detach()

    write_whole(path, write)
