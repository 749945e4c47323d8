"""Plots a simulated frame (needs the extra `plots`): heat maps a layer of processors, and queues over time."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.simulator import LINKS, SERVICES, WAITS
from raygrid.host.image.outputs import write_whole
from raygrid.node.errors import OutputError
from raygrid.node.geometry import PORTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from raygrid.host.machine_time.simulate import Simulated

FILES = ("busy.png", "links.png", "time.png")


def check_matplotlib(*others: str) -> None:
    """Raise OutputError if matplotlib is not installed; others: libraries that are wanted as well."""
    if find_spec("matplotlib") is None:
        raise OutputError(f"plots need matplotlib: pip install {' '.join(('matplotlib', *others))}")


def new_figure(width: float, height: float) -> Figure:
    """A figure of so many inches that is drawn into files alone.

    It is none of pyplot's, so that the backend of whoever plots in the same process, as notebooks do, stays as it is, and no
    figure is kept after its last use. Raises OutputError.
    """
    check_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure whole or not at all. Raises OutputError."""
    write_whole(path, lambda file: figure.savefig(file, format="png", dpi=120))


def save_plots(folder: str | Path, done: Simulated) -> list[str]:
    """Write FILES into a folder that is there; returns their paths. Raises OutputError."""
    phase, shape = done.frames["middle"], done.job.space.shape
    busy = phase.column("busy") / max(phase.ticks, 1)
    prices = done.cost.prices("middle", done.search)
    sent = phase.nodes["sent"][:, :PORTS].max(axis=1) * prices.transmit / max(phase.ticks, 1)
    what = f"{done.job.scene.name}, {'x'.join(map(str, shape))}, {done.cost.name} ({done.search})"
    figures = (
        _layers(busy, shape, f"busy share of each processor: {what}", "busy time / frame time"),
        _layers(sent, shape, f"load of each processor's busiest outgoing link: {what}", "sending time / frame time"),
        _over_time(done, what),
    )
    paths = [str(Path(folder) / name) for name in FILES]
    for figure, path in zip(figures, paths, strict=True):
        save_figure(figure, path)
    return paths


def _layers(values: NDArray[np.float64], shape: tuple[int, int, int], title: str, scale: str) -> Figure:
    """A picture for each layer of the array, all on one scale."""
    cube = values.reshape(shape[2], shape[1], shape[0])
    across = min(shape[2], 10)
    down = math.ceil(shape[2] / across)
    size = 2.4 if shape[2] > 1 else 6.0
    wide, high = (max(size * side / max(shape[:2]), 0.8) for side in shape[:2])
    figure = new_figure(wide * across + 1.8, high * down + 1.4)
    axes = figure.subplots(down, across, squeeze=False)
    for z, axis in enumerate(axes.flat):
        if z >= shape[2]:
            axis.axis("off")
            continue
        axis.imshow(cube[z], origin="lower", vmin=0.0, vmax=max(float(values.max()), 1e-9), cmap="viridis")
        axis.set_title(f"z = {z}", fontsize=8)
        _number_processors(axis, z % across == 0, z + across >= shape[2])
    figure.colorbar(axes.flat[shape[2] - 1].images[0], ax=axes.ravel().tolist(), label=scale)
    figure.suptitle(title, fontsize=9)
    return figure


def _number_processors(axis: Axes, left: bool, bottom: bool) -> None:
    """Whole numbers along the axes of a layer, and their names at the left and the bottom of all layers."""
    from matplotlib.ticker import MaxNLocator

    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(MaxNLocator(nbins=5, integer=True, min_n_ticks=1))
    axis.tick_params(labelsize=7)
    if bottom:
        axis.set_xlabel("x", fontsize=8)
    if left:
        axis.set_ylabel("y", fontsize=8)


def _over_time(done: Simulated, what: str) -> Figure:
    """Packets that wait, processors that serve, packets on links."""
    phase = done.frames["middle"]
    bins = phase.ticks // phase.bin_ticks + 1
    seconds = np.arange(bins) * (phase.bin_ticks / done.cost.file.hertz)
    figure = new_figure(8, 6)
    axes = figure.subplots(2, 1, sharex=True)
    axes[0].plot(seconds, phase.levels[WAITS, :bins], label="packets that wait", linewidth=0.8)
    axes[0].plot(seconds, phase.levels[LINKS, :bins], label="packets on links", linewidth=0.8)
    axes[0].legend(fontsize=8)
    axes[0].set_ylabel("packets")
    axes[1].plot(seconds, phase.levels[SERVICES, :bins], linewidth=0.8)
    axes[1].set_ylabel("processors at work")
    axes[1].set_xlabel("machine seconds")
    figure.suptitle(what, fontsize=9)
    return figure
