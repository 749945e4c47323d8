"""The command `raygrid render`."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import click

from raygrid.emulator.array import Array
from raygrid.host.job import Settings, make_job, samples_expected
from raygrid.host.load import load_scene
from raygrid.host.picture import Picture, check_output
from raygrid.host.progress import Talk
from raygrid.host.render import render_job
from raygrid.host.stats import ray_counts
from raygrid.node.errors import OutputError


def run_render(
    path: str,
    shape: tuple[int, int, int],
    outputs: tuple[str, ...],
    *,
    batch: int,
    budget: int,
    transfer: str,
    stats: str | None,
    patience: float,
    quiet: bool,
    **settings: Any,
) -> None:
    """Launch, read, load, trace, collect, write. Raises RaygridError."""
    begun = time.perf_counter()
    outputs = outputs or (Path(path).stem + ".png",)
    for output in outputs:
        check_output(output)
    if stats is not None:
        _check_stats(stats)
    with Talk(quiet) as talk, Array(shape, batch=batch, patience=patience, on_warming=talk.warming) as array:
        array.begin()  # warms up while the scene is read
        talk.phase(f"reading {path}")
        scene = load_scene(path)
        for remark in scene.remarks:
            talk.remark(remark)
        job = make_job(scene, shape, Settings(**settings))
        read = time.perf_counter()
        talk.phase(f"launching {shape[0] * shape[1] * shape[2]} processors")
        array.wait_ready()
        ready = time.perf_counter()
        talk.expect(samples_expected(job))
        picture = render_job(array.driver, job, budget, talk.watch)
        picture.stats["wall_seconds"] |= {"read": round(read - begun, 6), "launch": round(ready - read, 6)}
    _write(picture, outputs, transfer, stats, begun)
    talk.say(_summary(picture, begun))
    for output in outputs:
        click.echo(output)


def _write(picture: Picture, outputs: tuple[str, ...], transfer: str, stats: str | None, begun: float) -> None:
    for output in outputs:
        picture.save(output, transfer)
    picture.stats["wall_seconds"]["whole"] = round(time.perf_counter() - begun, 6)
    if stats is not None:
        try:
            Path(stats).write_text(json.dumps(picture.stats, indent=1) + "\n")
        except OSError as error:
            raise OutputError(f"{stats}: the statistics cannot be written: {error}") from None


def _check_stats(path: str) -> None:
    folder = Path(path).parent
    if Path(path).is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
        raise OutputError(f"{path}: the statistics cannot be written there")


def _summary(picture: Picture, begun: float) -> str:
    """One line: what was traced, and the wall seconds of this computer (not of the machine of 1983)."""
    seconds = picture.stats["wall_seconds"]
    counts = ray_counts(picture.stats)
    rays = ", ".join(f"{count:,} {kind}" for kind, count in counts.items() if count)
    rate = sum(counts.values()) / max(seconds["trace"], 1e-9)
    return (
        f"{rays} rays, {picture.stats['total']['hops']:,} hops; "
        f"wall seconds: trace {seconds['trace']:.2f} ({rate / 1e6:.2f} million rays a second), "
        f"whole {time.perf_counter() - begun:.2f}"
    )
